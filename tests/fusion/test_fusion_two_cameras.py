"""Two cameras at 4 Hz with a accelerometer that disagree for a while: what becomes of the rows and of their band."""

import numpy as np
import pytest
from estimator_cases import camera, estimated

from midspan.records import Samples, Source, nanoseconds, seconds

LENGTH_S, NOISE_M, NIGHT_S, FIRST_S = 240.0, 1.5e-5, (90.0, 150.0), 0.1


def motion(time_s):
    """Displacement in m: a mode of 1 mm at 0.9 Hz."""
    return 1e-3 * np.sin(2 * np.pi * 0.9 * time_s)


class CameraPlan:
    """A camera; errors: what its zero is off by, m, as a function of time; blind: from, to (s)."""

    def __init__(self, channel, first_s, errors, seed, blind=None):
        self.channel, self.time = channel, np.arange(first_s, LENGTH_S - 0.2, 0.25)
        noise = NOISE_M * np.random.default_rng(seed).standard_normal(len(self.time))
        self.value = motion(self.time) + errors(self.time) + noise
        if blind is not None:
            self.value[(self.time > blind[0]) & (self.time < blind[1])] = np.nan
        self.variance, self.reference = np.full(len(self.time), NOISE_M**2), np.zeros(len(self.time))


def one_result(of_camera, of_infrared, seed=0, blind=NIGHT_S):
    """Events, time (n,) s, error (n,) and standard deviation (n,) in mm of both cameras' smoothed rows."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, LENGTH_S, 0.01)
    value = -((2 * np.pi * 0.9) ** 2) * motion(time_s) + 2.5e-3 * rng.standard_normal(len(time_s))
    density = np.full((len(time_s), 1), 2.5e-3**2 * 0.01)
    samples = Samples(nanoseconds(time_s), value[:, None], density, np.zeros(len(time_s), dtype=np.uint8))
    given = {"coasting_s": 0.7}
    infrared = camera(sensor="infrared", source=Source.INFRARED, zero_std_m=np.inf, **given)
    tracked_cameras = [
        CameraPlan(camera(**given), FIRST_S, of_camera, seed + 1, blind),
        CameraPlan(infrared, 0.2, lambda t: 0.05 + of_infrared(t), seed + 2),
    ]
    found = estimated(samples, tracked_cameras, log=True, zero_ns=round(FIRST_S * 1e9))
    rows = found.estimator.smoothed()[0]
    time_s = seconds(rows.time_ns, 0)
    error = 1e3 * (rows.displacement_m - (motion(time_s) - motion(FIRST_S)))
    return found.events, time_s, error, 1e3 * np.sqrt(rows.variance_m2)


def steady(time_s):
    return np.zeros(len(time_s))


def away(time_s):
    """9 mm off within a second, from 40 to 52 s."""
    return 9e-3 * np.clip(np.minimum(time_s - 40.0, 52.0 - time_s), 0.0, 1.0)


def stays_away(time_s):
    """3 mm off from 40 s on, for ever."""
    return np.where(time_s > 40.0, 3e-3, 0.0)


def small_jump(time_s):
    return np.where(time_s > 40.0, 0.3e-3, 0.0)


def night_jump(time_s):
    """Comes back from the night 2 mm off."""
    return np.where(time_s > 120.0, 2e-3, 0.0)


def both_orders(errors):
    return {"camera": (errors, steady), "infrared": (steady, errors)}


def test_cameras_that_agree_are_exact_and_nothing_is_reported():
    events, time_s, error, std = one_result(steady, steady)
    assert not events
    # The noise of two cameras at 4 Hz is 0.015 mm a frame; at the end the acceleration alone is left.
    inner = time_s < 239.5
    assert np.sqrt(np.mean(error[inner] ** 2)) < 0.02
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9


@pytest.mark.parametrize("wrong", ["camera", "infrared"])
@pytest.mark.parametrize(("errors", "limit_mm"), [(away, 0.15), (stays_away, 0.1), (small_jump, 0.08)])
def test_a_camera_that_goes_away_does_not_take_the_rows_with_it(errors, limit_mm, wrong):
    events, time_s, error, std = one_result(*both_orders(errors)[wrong])
    assert any(wrong in event.text and abs(event.time_ns / 1e9 - 40.0) < 2.0 for event in events)
    # The other camera carries the rows at its own noise; only which of both it was is open in the first frames.
    assert np.abs(error[(np.abs(time_s - 40.0) > 1.5) & (time_s < 239.5)]).max() < limit_mm
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9
    assert np.median(std) < 0.05


def test_a_camera_that_comes_back_with_another_zero_leaves_the_rows_on_that_of_the_one_that_went_on_seeing():
    events, time_s, error, std = one_result(night_jump, steady)
    assert any("camera" in event.text and abs(event.time_ns / 1e9 - 150.0) < 1.5 for event in events)
    assert np.abs(error[time_s < 239.5]).max() < 0.1
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9


def test_one_that_jumps_alone_in_the_dark_is_back_on_the_zero_of_the_camera_that_comes_back():
    # Infrared is knocked by 4 mm in the middle of the night; the acceleration knows nothing of it.
    events, time_s, error, std = one_result(steady, lambda t: np.where(t > 121.0, 4e-3, 0.0))
    assert any("infrared" in event.text and abs(event.time_ns / 1e9 - 121.0) < 2.0 for event in events)
    assert np.abs(error[(time_s < 239.5) & (np.abs(time_s - 123.5) > 4.0)]).max() < 0.1
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9
