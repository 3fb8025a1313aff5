"""Whether a displacement was felt by the accelerometer."""

import numpy as np
import pytest

from midspan.calibration.unfelt import (
    NOISE_LEFT,
    refuse_lost_cycles,
    refuse_steps_unseen,
    refuse_unfelt,
    refuse_wide,
)
from midspan.errors import UntrustedError
from midspan.records import Estimate, Source, Status, nanoseconds
from midspan.signals.acceleration import PreparedAcceleration

TIME_S = np.arange(0.0, 60.0, 0.01)
SWING = 2.0 * np.pi * 0.7


def judge(moved_m, value_m_s2, *, std_m=2e-4, missing=0.0, every=1) -> None:
    """Compare a displacement (n,) at TIME_S, or at every this many of these, with an acceleration (n,).

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
    with pytest.raises(UntrustedError, match=r"mm rms that the accelerometer would have shown"):
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
    with pytest.raises(UntrustedError, match="The sensor or its clock jumps"):
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
    # What it stands for is a motion of so much, and no more: S T³ / 2520 over 20 s are 25 mm (mean square) at most.
    with pytest.raises(UntrustedError, match="would have shown"):
        judge(MOVED + 50.0 * (bumped - MOVED), np.where(density > 0.0, 0.0, ACCELERATION), missing=density)


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


def rows_of(moved_m, *, std_m=1e-5, status=Status.TRACKING) -> Estimate:
    """Rows of a radar at TIME_S that say so."""
    n = len(TIME_S)
    variance, source = np.broadcast_to(np.square(std_m), n), np.full(n, Source.RADAR, dtype=np.uint8)
    statuses = np.broadcast_to(np.uint8(status), n)
    return Estimate(nanoseconds(TIME_S), moved_m, variance, np.zeros(n), source, statuses)


def felt(value_m_s2) -> PreparedAcceleration:
    none = np.zeros(len(TIME_S), dtype=bool)
    return PreparedAcceleration(nanoseconds(TIME_S), value_m_s2, 0.0 * TIME_S, none, 100.0, events=(), warnings=())


# White noise of 2 mm/s² at 100 Hz.
DENSITY = 2e-3**2 / 100.0
HIDDEN_NS = nanoseconds(np.arange(30.0, 30.2, 0.01))


def test_a_radar_that_comes_back_on_another_cycle_is_refused() -> None:
    # A cycle at 77 GHz is 1.9 mm: far less than the motion, and 70 times what the noise makes within 5 s.
    off = MOVED + 1.9e-3 * (TIME_S > 30.1)
    with pytest.raises(UntrustedError, match=r"From 27\.5\d+ s to 32\.\d+ s the radar loses its target"):
        refuse_lost_cycles(felt(ACCELERATION), rows_of(off), HIDDEN_NS, DENSITY, 1e-3)
    refuse_lost_cycles(felt(ACCELERATION), rows_of(MOVED), HIDDEN_NS, DENSITY, 1e-3)
    # Where the band says so, or nothing was hidden, it is no contradiction.
    unsure = np.where(TIME_S > 30.1, 2e-3, 1e-5)
    refuse_lost_cycles(felt(ACCELERATION), rows_of(off, std_m=unsure), HIDDEN_NS, DENSITY, 1e-3)
    refuse_lost_cycles(felt(ACCELERATION), rows_of(off), HIDDEN_NS[:0], DENSITY, 1e-3)


def test_a_clock_that_steps_where_the_radar_sees_nothing_is_refused() -> None:
    with pytest.raises(UntrustedError, match=r"north: its clock seems to step at 30\.6\d* s"):
        refuse_steps_unseen([30_600_000_000], HIDDEN_NS, "north")
    refuse_steps_unseen([33_600_000_000], HIDDEN_NS, "north")


def test_a_radar_whose_band_is_wider_than_the_motion_or_that_is_hardly_seen_is_refused() -> None:
    # What 20 s show: a motion of 2.1 mm rms, and 2.5 mm of the drift of 0.1 mm/s² a second.
    refuse_wide(felt(ACCELERATION), rows_of(MOVED, std_m=5e-3))
    with pytest.raises(UntrustedError, match=r"σ is 228 mm or more, .* only 3\.\d mm rms"):
        refuse_wide(felt(ACCELERATION), rows_of(MOVED, std_m=0.228))
    # Hidden for 5 of 60 s it is wide there alone.
    refuse_wide(felt(ACCELERATION), rows_of(MOVED, std_m=np.where(np.abs(TIME_S - 30.0) < 2.5, 0.1, 1e-5)))
    hidden = np.where(TIME_S > 25.0, Status.LOST, Status.TRACKING)
    with pytest.raises(UntrustedError, match="Only 42 % of the rows have a measurement"):
        refuse_wide(felt(ACCELERATION), rows_of(MOVED, status=hidden))
