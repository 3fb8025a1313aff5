"""Every fusion method through the fusion of a recording: error, band with an uncertain calibration, zero, refusals."""

from dataclasses import replace

import numpy as np
import pytest

from midspan.errors import UntrustedError, UsageError
from midspan.fusion.kalman import KalmanSettings
from midspan.fusion.methods import LITERAL, METHODS
from midspan.fusion.runners import MethodSettings
from midspan.recording.fusing.fuse import FusionInputs, SensorError, fuse
from midspan.records import Acceleration, Displacement, Source, nanoseconds
from midspan.settings.load import validate

TIME, MET = np.arange(6000) / 100.0, np.arange(598) / 10.0 + 0.053
NOISE_A, NOISE_D = 2e-3, 1e-4
INNER = slice(1000, 5000)


def motion(time):
    """2 mm at 0.3 Hz and 1 mm at 2.2 Hz: displacement and acceleration."""
    parts = ((2e-3, 0.3), (1e-3, 2.2))
    value = sum(a * np.sin(2 * np.pi * f * time) for a, f in parts)
    return value, -sum(a * (2 * np.pi * f) ** 2 * np.sin(2 * np.pi * f * time) for a, f in parts)


def inputs(seed, *, scale=1.0, errors=(), bias=0.0):
    """A camera's record; `scale` is what its calibration is wrong by."""
    rng = np.random.default_rng(seed)
    acceleration = motion(TIME)[1] + bias + rng.normal(0, NOISE_A, len(TIME))
    value = scale * (motion(MET)[0] + rng.normal(0, NOISE_D, len(MET)))
    return FusionInputs(
        Acceleration(nanoseconds(TIME), acceleration, np.full(len(TIME), NOISE_A**2 / 100.0)),
        Displacement(nanoseconds(MET), value, np.full(len(MET), NOISE_D**2), np.full(len(MET), 1, dtype=np.uint8)),
        KalmanSettings(bias_std=0.05),
        zero_ns=int(nanoseconds(MET[:1])[0]),
        errors=errors,
    )


def error_of(rows):
    truth = motion(TIME)[0] - motion(MET[:1])[0]
    return rows.displacement_m - truth


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("literal", [False, True])
def test_rows_start_at_the_zero_follow_the_truth_and_say_how_well(method, literal):
    if literal and method not in LITERAL:
        pytest.skip("has no literal form")
    inside, errors = [], []
    for seed in range(6):
        rows = fuse(inputs(seed), method, MethodSettings(literal=literal)).estimate
        np.testing.assert_array_equal(rows.time_ns, nanoseconds(TIME))
        errors.append(error_of(rows)[INNER])
        inside.append(np.mean(np.abs(errors[-1]) <= 1.96 * np.sqrt(rows.variance_m2[INNER])))
    # The zero is one draw for a whole record, the same for all its rows, so that six records are hardly more than six
    # draws: 5 to 6 of 6 inside.
    assert np.mean(inside) > 0.8
    # The displacement itself has 0.1 mm at its own instants; the printed hold costs 7 % of 1 mm.
    assert np.sqrt(np.mean(np.square(errors))) < (0.15e-3 if literal else 0.1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_an_uncertain_scale_widens_the_band_by_what_it_moves_the_rows(method):
    plain = fuse(inputs(1), method).estimate
    wide = fuse(inputs(1, errors=(SensorError(Source.CAMERA, relative_scale_std=0.05),)), method).estimate
    added = np.sqrt(wide.variance_m2 - plain.variance_m2)[INNER]
    # A camera that reads 5 % too much moves the rows by that. All methods are linear, apart from what is learnt or
    # rejected anew; `adaptive-kalman` trusts such a camera less, so that it moves up to a quarter less.
    moved = (fuse(inputs(1, scale=1.05), method).estimate.displacement_m - plain.displacement_m)[INNER]
    assert np.sqrt(np.mean(added**2)) == pytest.approx(np.sqrt(np.mean(moved**2)), rel=0.3)


def test_the_smoother_learns_noise_that_changes_within_the_record():
    given = inputs(3)
    rng = np.random.default_rng(33)
    later = MET > 30.0
    value = np.where(later, motion(MET)[0] + rng.normal(0, 6 * NOISE_D, len(MET)), given.displacement.value_m)
    found = fuse(replace(given, displacement=replace(given.displacement, value_m=value)), "smoother")
    assert found.variance_m2 is not None
    # 300 frames in windows of 61: each window knows the deviation to ± 20 %.
    assert np.median(np.sqrt(found.variance_m2[310:])) == pytest.approx(6 * NOISE_D, rel=0.25)
    assert np.median(np.sqrt(found.variance_m2[:250])) == pytest.approx(NOISE_D, rel=1e-9)
    error = error_of(found.estimate)[3200:5800]
    assert np.mean(np.abs(error) <= 1.96 * np.sqrt(found.estimate.variance_m2[3200:5800])) > 0.85


def test_numbers_that_are_none_are_refused_and_never_given_out():
    given = inputs(4)
    value = given.acceleration.value_m_s2.copy()
    value[3000:] = 1e308
    broken = replace(given, acceleration=replace(given.acceleration, value_m_s2=value))
    with np.errstate(all="ignore"), pytest.raises(UntrustedError, match="adaptive-kalman"):
        fuse(broken, "adaptive-kalman", MethodSettings(literal=True))


@pytest.mark.parametrize(("method", "fine"), [("smoother", False), ("lag", False), ("adaptive-kalman", True)])
def test_literal_is_refused_where_there_is_no_printed_form(method, fine):
    tree = {
        "accelerometer": {"file": "a.csv"},
        "displacement": {"file": "d.csv"},
        "fusion": {"method": method, "literal": True},
    }
    if fine:
        assert validate(tree, "recording.toml").fusion.literal
        return
    with pytest.raises(UsageError, match=f"adaptive-kalman.*received method = '{method}'"):
        validate(tree, "recording.toml")
