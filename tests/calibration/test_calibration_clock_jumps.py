"""Jumps of a sensor's clock: found where the motion tells them, never seen in clocks that run well."""

import numpy as np
import pytest

from midspan.calibration.clock import Compared
from midspan.calibration.clock_jumps import clock_jumps, lateness
from midspan.records import Floats
from midspan.simulate.motion.motion import Sines

# m/s² of a sample at 100 Hz, and m of a measurement.
NOISE = (3e-3, 2e-5)
BRIDGE = Sines(np.array([5e-3, 2e-3, 3e-3]), np.array([0.41, 1.3, 0.03]), phase_rad=np.array([0.3, 1.0, 0.0]))
TONE = Sines(np.array([4e-3]), np.array([2.0]))
STILL = Sines(np.array([0.0]), np.array([1.0]))


def companions(
    stamps: Floats, true_s: Floats, *, motion=BRIDGE, loud=lambda t: np.ones_like(t), extra=0.0, noise=NOISE
) -> Compared:
    """Measurements of a motion at true instants (m,) with stamps (m,), next to 100 Hz of acceleration.

    loud: the motion's size, which changes slowly; extra (m,): added to the measurements, m; noise: as NOISE.
    """
    rng = np.random.default_rng(4)
    time, step = np.arange(0.0, true_s[-1] + 1.0, 0.01), 1e-3

    def moved(t: Floats) -> Floats:
        return loud(t) * motion.displacement(t)

    acceleration = (moved(time + step) - 2.0 * moved(time) + moved(time - step)) / step**2
    acceleration += rng.normal(0.0, noise[0], time.size)
    value = moved(true_s) + rng.normal(0.0, noise[1], true_s.size) + extra
    density, variance = np.full(time.size, noise[0] ** 2 / 100.0), np.full(true_s.size, noise[1] ** 2)
    return Compared(np.column_stack((time, acceleration, density)), np.column_stack((stamps, value, variance)))


def even(length_s: float = 40.0, rate_hz: float = 8.0) -> Floats:
    return np.arange(0.5, length_s, 1.0 / rate_hz)


@pytest.mark.parametrize("late_s", [-0.5, 0.125, 0.05, -0.05, 0.02, 0.005])
def test_a_clock_that_was_set_is_found_with_its_size_and_instant(late_s):
    true_s = even()
    (found,) = clock_jumps(companions(true_s - np.where(true_s >= 25.0, late_s, 0.0), true_s))
    # Five of its deviations, and the grid of 0.1 ms that it is sought on.
    assert found.late_s == pytest.approx(late_s, abs=5.0 * found.std_s + 1e-4)
    assert found.std_s < 1e-3
    assert found.first <= np.searchsorted(true_s, 25.0) <= found.last
    # A measurement a second or two away from the jump is on a known side.
    assert found.last - found.first <= 16
    assert found.rival_s is None


# A sensor of 0.4 mm: the offset of 8 s of readings is known to 3 ms only.
COARSE = (5e-3, 4e-4)


@pytest.mark.parametrize(("late_s", "outage_s"), [(0.02, 15.0), (-0.02, 30.0)])
def test_an_outage_is_where_a_step_is_tried_first(late_s, outage_s):
    true_s = even(90.0, 10.0)
    true_s = true_s[(true_s < 30.0) | (true_s >= 30.0 + outage_s)]
    after = true_s >= 30.0
    (found,) = clock_jumps(companions(true_s - np.where(after, late_s, 0.0), true_s, noise=COARSE))
    # The offset before it is as calibrated: nothing of the step is smeared into it.
    assert found.before_s == 0.0
    assert found.row == found.first == found.last == np.argmax(after)
    assert found.late_s == pytest.approx(late_s, abs=5.0 * found.std_s)


def test_an_outage_is_no_step():
    true_s = even(90.0, 10.0)
    true_s = true_s[(true_s < 30.0) | (true_s >= 45.0)]
    assert clock_jumps(companions(true_s, true_s, noise=COARSE)) == []


@pytest.mark.parametrize(("rate_hz", "lost"), [(8.0, 1), (8.0, 3), (30.0, 1), (100.0, 1)])
def test_lost_frames_where_stamps_are_counted_are_a_jump(rate_hz, lost):
    stamps = even(rate_hz=rate_hz)
    k = np.searchsorted(stamps, 25.0)
    (found,) = clock_jumps(companions(stamps[:-lost], np.delete(stamps, slice(k, k + lost))))
    assert found.late_s == pytest.approx(lost / rate_hz, abs=5.0 * found.std_s + 1e-4)


def test_a_doubled_frame_is_a_jump_back():
    stamps = even()
    k = np.searchsorted(stamps, 25.0)
    given = companions(stamps, np.insert(stamps, k, stamps[k - 1])[:-1])
    (found,) = clock_jumps(given)
    assert found.late_s == pytest.approx(-0.125, abs=5.0 * found.std_s + 1e-4)
    assert found.std_s > 1e-5


def test_two_jumps_are_both_found():
    true_s = even(70.0)
    late = np.where(true_s >= 20.0, 0.125, 0.0) + np.where(true_s >= 45.0, -0.03, 0.0)
    found = clock_jumps(companions(true_s - late, true_s))
    assert len(found) == 2
    np.testing.assert_allclose(lateness(found, len(true_s))[[0, 250, -1]], [0.0, 0.125, 0.095], atol=1e-3)


@pytest.mark.parametrize(
    "late",
    [
        lambda t: 0.0 * t,
        lambda t: 0.004 + 0.0 * t,
        lambda t: 1e-4 * (t - 20.0),
        lambda t: 3e-4 * np.random.default_rng(1).standard_normal(t.size),
    ],
    ids=["right", "another offset", "runs 100 ppm apart", "jitters"],
)
def test_clocks_without_a_jump_have_none(late):
    true_s = even(150.0)
    assert clock_jumps(companions(true_s - late(true_s), true_s)) == []


@pytest.mark.parametrize("extra", ["level", "hidden", "outliers"])
def test_what_is_wrong_with_the_measurements_is_no_jump_of_the_clock(extra):
    true_s, rng = even(60.0), np.random.default_rng(3)
    added = {
        "level": np.where(true_s > 30.0, 2e-3, 0.0),
        "hidden": np.where((true_s > 30.0) & (true_s < 36.0), rng.normal(0.0, 5e-3, true_s.size), 0.0),
        "outliers": np.where(rng.random(true_s.size) < 0.03, 4e-3, 0.0),
    }[extra]
    assert clock_jumps(companions(true_s, true_s, extra=added)) == []


def test_where_nothing_moves_nothing_is_found():
    true_s = even()
    assert clock_jumps(companions(true_s - np.where(true_s >= 25.0, 0.5, 0.0), true_s, motion=STILL)) == []


def test_a_jump_in_a_quiet_time_may_have_been_at_any_of_its_instants():
    true_s = even(60.0)

    def pause(t: Floats) -> Floats:
        return 1.0 - np.exp(-(((t - 30.0) / 6.0) ** 8))

    (found,) = clock_jumps(companions(true_s - np.where(true_s >= 30.0, 0.125, 0.0), true_s, loud=pause))
    assert found.late_s == pytest.approx(0.125, abs=5.0 * found.std_s + 1e-4)
    assert true_s[found.first] < 28.0
    assert true_s[found.last] > 32.0


def test_a_single_tone_does_not_tell_a_jump_from_one_a_period_longer():
    true_s = even()
    (found,) = clock_jumps(companions(true_s - np.where(true_s >= 20.0, 0.1, 0.0), true_s, motion=TONE))
    assert found.rival_s is not None
    periods = 2.0 * np.array([found.rival_s - found.late_s, found.late_s - 0.1])
    np.testing.assert_allclose(periods, np.round(periods), atol=0.02)
    assert round(periods[0]) != 0
