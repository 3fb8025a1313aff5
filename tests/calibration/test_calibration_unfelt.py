"""Whether a displacement was felt by the accelerometer."""

import numpy as np
import pytest

from midspan.calibration.unfelt import NOISE_LEFT, refuse_unfelt
from midspan.errors import UntrustedError
from midspan.records import nanoseconds
from midspan.signals.acceleration import PreparedAcceleration

TIME_S = np.arange(0.0, 60.0, 0.01)
SWING = 2.0 * np.pi * 0.7


def judge(moved_m, value_m_s2, *, std_m=2e-4, missing=0.0, every=1) -> None:
    """Compare a displacement (n,) at TIME_S, or at every so many of these, with an acceleration (n,).

    missing: density (n,) for what is not known of it, (m/s²)²/Hz.
    """
    n, time_ns = len(TIME_S), nanoseconds(TIME_S)
    none, density = np.zeros(n, dtype=bool), np.broadcast_to(missing, n)
    prepared = PreparedAcceleration(time_ns, value_m_s2, density, none, 100.0, events=(), warnings=())
    rows = slice(None, None, every)
    refuse_unfelt(prepared, time_ns[rows], moved_m[rows], np.broadcast_to(np.square(std_m), n)[rows])


MOVED = 3e-3 * np.sin(SWING * TIME_S)
ACCELERATION = -(SWING**2) * MOVED + 0.02 + 1e-4 * TIME_S + np.random.default_rng(0).normal(0, 2e-3, len(TIME_S))


def test_what_the_acceleration_shows_is_accepted_with_a_slow_part_that_it_cannot_show() -> None:
    # A span that bends by 0.3 m within the minute, as the sun or a tide makes it: over 5 s a cubic.
    judge(MOVED + 0.3 * np.sin(2.0 * np.pi * TIME_S / 120.0), ACCELERATION)


@pytest.mark.parametrize("every", [1, 20, 100])
def test_a_step_of_decimetres_that_nothing_felt_is_refused_and_a_felt_one_is_not(every) -> None:
    # As rows, and as readings of 5 and 1 Hz.
    since = np.clip((TIME_S - 31.0) / 2.0, 0.0, 1.0)
    step = 0.2 * (10 * since**3 - 15 * since**4 + 6 * since**5)
    with pytest.raises(UntrustedError, match=r"mm rms that the accelerometer did not feel"):
        judge(MOVED + step, ACCELERATION, every=every)
    pushed = 0.2 / 4.0 * (60 * since - 180 * since**2 + 120 * since**3) * (since < 1.0)
    judge(MOVED + step, ACCELERATION + pushed, every=every)


def test_what_the_accelerometer_errs_by_is_in_what_it_shows() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        drift = np.cumsum(rng.normal(0.0, 1e-3, len(TIME_S)))
        quiet = rng.normal(0.0, 1e-4) * np.sin(SWING * TIME_S)
        judge(quiet, drift + 0.1 * np.sin(2.0 * np.pi * 0.3 * TIME_S) * (TIME_S > 40.0))


def test_what_runs_away_steadily_between_its_jumps_is_refused() -> None:
    # Every 1.5 s another speed, a whole number of cycles (1.9 mm) in 20 frames of a second: smooth within 5 s windows.
    speed = np.repeat(np.random.default_rng(2).integers(-2, 3, 4) * 0.039, len(TIME_S) // 4)
    away = np.cumsum(speed) * 0.01
    smooth = np.convolve(np.pad(away, 200, "edge"), np.hanning(401) / np.sum(np.hanning(401)), "valid")
    with pytest.raises(UntrustedError, match="radar under interference"):
        judge(MOVED + smooth, ACCELERATION)


def test_a_gain_and_a_delay_make_no_jump() -> None:
    judge(MOVED, 0.7 * ACCELERATION)
    judge(MOVED, np.roll(ACCELERATION, 10))


def test_an_accelerometer_that_dies_or_is_bridged_makes_no_motion() -> None:
    judge(MOVED, np.where(TIME_S > 30.0, 0.0, ACCELERATION))
    judge(MOVED, np.where(np.abs(TIME_S - 30.0) < 0.5, 5.0, ACCELERATION))
    # Where acceleration is missing for seconds its noise says so.
    density = np.where(np.abs(TIME_S - 32.0) < 2.0, 1e-3, 0.0)
    bumped = MOVED + 0.02 * np.exp(-((TIME_S - 32.0) ** 2))
    judge(bumped, np.where(density > 0.0, 0.0, ACCELERATION), missing=density)


def test_what_is_uncertain_by_as_much_is_no_contradiction() -> None:
    wide = np.where(np.abs(TIME_S - 32.0) < 2.5, 0.1, 2e-4)
    judge(MOVED + 0.1 * np.exp(-((TIME_S - 32.0) ** 2)), ACCELERATION, std_m=wide)


@pytest.mark.parametrize("unknowns", NOISE_LEFT)
def test_what_is_left_of_white_noise_integrated_twice(unknowns) -> None:
    # The response to an impulse at u is t - u from there on; each leaves its own, and so does their sum on average.
    at = (np.arange(400) + 0.5) / 400.0
    response = np.clip(at[:, None] - at[None, :], 0.0, None)
    basis = np.linalg.qr(np.vander(at, unknowns))[0]
    left = response - basis @ (basis.T @ response)
    assert np.mean(np.sum(left**2, axis=1)) / 400.0 == pytest.approx(1.0 / NOISE_LEFT[unknowns], rel=1e-3)
