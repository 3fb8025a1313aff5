"""Streams hold no more late in a record than early in it: what they retain is measured array by array."""

import numpy as np
import pytest
from fusion_oracles import acceleration_block, displacement_block

from midspan.fusion.adaptive import AdaptiveFilter, AdaptiveSettings
from midspan.fusion.fir import FirFilter, FirSettings
from midspan.fusion.kalman import KalmanFilter
from midspan.fusion.lag import LagSmoother
from midspan.fusion.two_stage import TwoStageFir, TwoStageSettings

STREAMS = {
    "kalman": KalmanFilter,
    "lag": LagSmoother,
    "adaptive-kalman": AdaptiveFilter,
    "adaptive-kalman, literal": lambda: AdaptiveFilter(AdaptiveSettings(literal=True)),
    "fir": FirFilter,
    "fir, literal": lambda: FirFilter(FirSettings(literal=True)),
    "two-stage-fir": TwoStageFir,
    "two-stage-fir, literal": lambda: TwoStageFir(TwoStageSettings(literal=True)),
}
BLOCK_S = 20.0


def retained_bytes(thing, seen=None):
    """Bytes of all arrays that an object holds, each view counted with the whole array behind it."""
    seen = set() if seen is None else seen
    if id(thing) in seen:
        return 0
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        return retained_bytes(thing.base, seen) if isinstance(thing.base, np.ndarray) else thing.nbytes
    if isinstance(thing, (list, tuple, set)):
        return sum(retained_bytes(item, seen) for item in thing)
    if isinstance(thing, dict):
        return sum(retained_bytes(item, seen) for item in thing.values())
    held = getattr(thing, "__dict__", {})
    slots = {name: getattr(thing, name) for name in getattr(thing, "__slots__", ()) if hasattr(thing, name)}
    cells = [cell.cell_contents for cell in getattr(thing, "__closure__", None) or ()]
    return sum(retained_bytes(item, seen) for item in (*held.values(), *slots.values(), *cells))


def pushed(stream, block, *, fault):
    """Push block number `block`: noise at 100 Hz and 10 Hz; with `fault` a tenth of outliers and a hole of 5 s."""
    rng = np.random.default_rng(block)
    start = block * BLOCK_S
    time, met = start + np.arange(2000) / 100.0, start + np.arange(200) / 10.0 + 0.003
    value = rng.normal(0, 1e-4, 200)
    if fault:
        value = value + np.where(rng.random(200) < 0.1, 5e-3, 0.0)
        met, value = np.delete(met, np.s_[50:100]), np.delete(value, np.s_[50:100])
    stream.push(displacement_block(met, value, 1e-8))
    stream.push(acceleration_block(time, rng.normal(0, 2e-3, 2000), 4e-8))


@pytest.mark.parametrize("fault", [False, True], ids=["clean", "outliers and holes"])
@pytest.mark.parametrize("name", STREAMS)
def test_a_stream_holds_no_more_after_a_quarter_of_an_hour_than_after_four_minutes(name, fault):
    stream, held = STREAMS[name](), []
    for block in range(45):
        pushed(stream, block, fault=fault)
        held.append(retained_bytes(stream))
    # What is held varies from block to block with what is waiting for its rows, but does not grow.
    early, late = max(held[2:12]), max(held[-10:])
    assert late <= 1.5 * early
    # Twenty seconds are 48 kB of acceleration and 5 kB of displacement; filters, transforms and waiting rows are far
    # from a megabyte, where the rows of a quarter of an hour alone would be 2 MB.
    assert late < 1e6


def test_what_is_retained_is_counted_with_the_array_behind_a_view():
    whole = np.zeros(1000)
    assert retained_bytes([whole[:10], {"a": whole[5:6]}]) == 8000
