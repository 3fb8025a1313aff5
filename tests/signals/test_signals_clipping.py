"""Crests of two samples that were cut off are found, and those of a sound record are no clipping."""

import numpy as np
import pytest

from midspan.engine.axis import AxisLimits, AxisMemory, bridge, usual_figures
from midspan.records import TimeSeries
from midspan.signals.acceleration import prepare_acceleration
from midspan.signals.clipping import clipped

RATE_HZ, STEP = 100.0, 1e-3


def record(seed, seconds=600.0):
    """An acceleration to 10 Hz, rms 0.1 m/s², in steps of 1e-3 m/s²: two samples lie evenly about many a crest."""
    from scipy.signal import butter, sosfilt

    noise = np.random.default_rng(seed).normal(size=round(seconds * RATE_HZ))
    motion = sosfilt(butter(4, 10.0, fs=RATE_HZ, output="sos"), noise)
    return STEP * np.round(0.1 / STEP * motion / np.std(motion))


@pytest.mark.parametrize("seed", range(3))
def test_a_sound_record_is_not_clipped(seed):
    # Of 60 such records one has a crest of four samples; none of these.
    value = record(seed)
    assert not clipped(value).any()
    time_ns = np.arange(len(value), dtype=np.int64) * 10_000_000
    assert not prepare_acceleration(TimeSeries(time_ns, value), "accelerometer").warnings


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("level", [1.0, 1.5, 2.5])
def test_all_crests_that_were_cut_off_are_found_however_brief(seed, level):
    value = record(seed, 60.0)
    cut = np.clip(value, -level * 0.1, level * 0.1)
    held = (np.abs(cut) == level * 0.1) & np.r_[False, np.diff(cut) == 0.0]
    assert np.mean(clipped(cut)[held]) > 0.99
    # The engine finds the same.
    figures = usual_figures(cut, RATE_HZ)
    time_ns = np.arange(len(cut), dtype=np.int64) * 10_000_000
    limits = AxisLimits.of(figures, RATE_HZ, 1.0)
    _, bridged, _ = bridge(AxisMemory.before(figures), (time_ns, cut.copy()), figures, limits, end=True)
    assert np.mean(bridged.bridged[held]) > 0.99
