"""Two cameras that contradict each other: the one that the acceleration speaks against is left out, and it is told."""

from types import SimpleNamespace

import numpy as np
import pytest

from midspan.fusion.kalman import KalmanSettings
from midspan.recording.cameras.belief import believed
from midspan.recording.cameras.contradiction import Contradiction
from midspan.recording.fusing.fuse import CourseError, FusionInputs, fuse
from midspan.records import Acceleration, Displacement, Source

LENGTH_S, NOISE_M, BLIND_S = 240.0, 1.5e-5, (90.0, 150.0)


def nanoseconds(time_s):
    return np.rint(1e9 * np.asarray(time_s)).astype(np.int64)


def motion(time_s):
    """Displacement in m: a mode of 1 mm at 0.9 Hz."""
    return 1e-3 * np.sin(2 * np.pi * 0.9 * time_s)


def measured(source, errors, seed, blind=None):
    """A camera at 4 Hz; errors: what its zero is off by, m, as a function of time."""
    time_s = np.arange(0.1 if source is Source.CAMERA else 0.2, LENGTH_S - 0.2, 0.25)
    value = motion(time_s) + errors(time_s) + NOISE_M * np.random.default_rng(seed).standard_normal(len(time_s))
    if blind is not None:
        value[(time_s > blind[0]) & (time_s < blind[1])] = np.nan
    return Displacement(
        nanoseconds(time_s), value, np.full(len(time_s), NOISE_M**2), np.full(len(time_s), source, np.uint8)
    )


def one_result(of_camera, of_infrared, seed=0, blind=BLIND_S):
    """Belief, time (n,) s, error (n,) and standard deviation (n,) in mm of the fusion of both cameras."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, LENGTH_S, 0.01)
    value = -((2 * np.pi * 0.9) ** 2) * motion(time_s) + 2.5e-3 * rng.standard_normal(len(time_s))
    acceleration = Acceleration(nanoseconds(time_s), value, np.full(len(time_s), 2.5e-3**2 * 0.01))
    kalman = KalmanSettings(coasting_s=1.0)
    blocks = (measured(Source.CAMERA, of_camera, seed + 1, blind), measured(Source.INFRARED, of_infrared, seed + 2))
    seen = tuple(
        SimpleNamespace(
            eye=SimpleNamespace(sensor=sensor, source=source, strength=np.full(len(block.time_ns), 90.0)),
            measured=block,
            wandering=None,
        )
        for sensor, source, block in zip(("camera", "infrared"), (Source.CAMERA, Source.INFRARED), blocks, strict=True)
    )
    settings = SimpleNamespace(fusion=SimpleNamespace(switching="variance"), site=None)
    side = SimpleNamespace(acceleration=acceleration, kalman=kalman, recording=SimpleNamespace(settings=settings))
    belief = believed(side, seen)
    inputs = FusionInputs(
        acceleration, belief.measured, kalman, zero_ns=int(blocks[0].time_ns[0]), levels=belief.levels
    )
    rows = fuse(inputs, "smoother").estimate
    error = 1e3 * (rows.displacement_m - (motion(time_s) - motion(0.1)))
    return belief, time_s, error, 1e3 * np.sqrt(rows.variance_m2)


def told(belief):
    return [event for event in belief.events if event.kind == "contradiction"]


def steady(time_s):
    return np.zeros(len(time_s))


def away(time_s):
    """9 mm off within a second, from 40 to 52 s."""
    return 9e-3 * np.clip(np.minimum(time_s - 40.0, 52.0 - time_s), 0.0, 1.0)


def stays_away(time_s):
    """3 mm off from 40 s on, for ever."""
    return np.where(time_s > 40.0, 3e-3, 0.0)


def night_jump(time_s):
    """Comes back from the night 2 mm off."""
    return np.where(time_s > 120.0, 2e-3, 0.0)


def drifts(time_s):
    """9 mm to and fro within 80 s, too slow for the acceleration."""
    return 9e-3 * np.sin(np.pi * np.clip((time_s - 5.0) / 80.0, 0.0, 1.0)) ** 2


def test_cameras_that_agree_contradict_in_nothing_and_are_exact():
    belief, time_s, error, std = one_result(steady, steady)
    assert not told(belief)
    assert not belief.warnings
    # The noise of two cameras at 4 Hz is 0.015 mm a frame; beyond the last frame the acceleration alone is left.
    assert np.sqrt(np.mean(error[(time_s > 0.1) & (time_s < 239.5)] ** 2)) < 0.02
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9


@pytest.mark.parametrize("wrong", ["camera", "infrared"])
def test_a_camera_that_goes_away_and_comes_back_is_left_out_and_told(wrong):
    belief, time_s, error, std = one_result(*((away, steady) if wrong == "camera" else (steady, away)))
    (event,) = told(belief)
    assert event.time_ns / 1e9 == pytest.approx(40.0, abs=2.0)
    assert f"contradicts the {wrong}" in event.text
    assert event.text in belief.warnings
    # The other camera carries these seconds at its own noise.
    assert np.abs(error).max() < 0.15
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9
    beside = (time_s > 42.0) & (time_s < 50.0)
    assert np.abs(error[beside]).max() < 0.05


@pytest.mark.parametrize("wrong", ["camera", "infrared"])
def test_a_camera_whose_zero_jumps_for_ever_does_not_take_the_result_with_it(wrong):
    belief, time_s, error, std = one_result(*((stays_away, steady) if wrong == "camera" else (steady, stays_away)))
    (event,) = told(belief)
    assert f"contradicts the {wrong}" in event.text
    assert "stays changed by" in event.text
    assert np.abs(error[np.abs(time_s - 40.0) > 1.5]).max() < 0.1
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9
    assert np.median(std) < 0.05


def test_a_zero_that_changed_unseen_is_told_and_the_band_holds_both():
    belief, time_s, error, std = one_result(night_jump, steady)
    # The level may take it for a walk over the night: then the band over the night holds it.
    late = time_s > 155.0
    assert np.mean(np.abs(error[late]) < 1.96 * std[late]) > 0.9
    assert told(belief)


def test_a_camera_that_comes_back_with_another_zero_is_brought_to_that_of_the_one_that_went_on_seeing():
    belief, time_s, error, std = one_result(night_jump, steady)
    (event,) = told(belief)
    assert event.time_ns / 1e9 == pytest.approx(150.0, abs=1.5)
    assert "the camera was brought to the other's zero" in event.text
    assert np.abs(error[time_s < 239.5]).max() < 0.1
    # Nothing tells which one is right: the camera's own zero is in the band as well.
    late = (time_s > 155.0) & (time_s < 239.5)
    assert np.all(1.96 * std[late] > 2.0)


def test_one_that_jumps_alone_in_the_dark_is_brought_to_the_camera_that_comes_back_as_it_was():
    # Infrared is knocked by 4 mm in the middle of the night; the acceleration knows nothing of it.
    belief, time_s, error, std = one_result(steady, lambda time: np.where(time > 121.0, 4e-3, 0.0))
    (event,) = told(belief)
    assert "the infrared was brought to the other's zero" in event.text
    # Around the knock nothing but the acceleration is left for the gate's five seconds; afterwards nothing is off.
    assert np.abs(error[(time_s < 239.5) & (np.abs(time_s - 123.5) > 4.0)]).max() < 0.1
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9


def test_one_that_stays_away_until_the_end_is_brought_back_as_well():
    # Back for ten seconds only: too short for a new level.
    belief, time_s, error, _ = one_result(lambda t: np.where(t > 120.0, 2e-3, 0.0), steady, blind=(90.0, 229.0))
    assert "the camera was brought to the other's zero" in " ".join(event.text for event in told(belief))
    assert np.abs(error[time_s < 239.5]).max() < 0.1


def test_a_drift_over_a_night_is_bridged_without_a_step():
    rate = 8e-6
    belief, time_s, error, std = one_result(steady, lambda t: rate * t)
    seen = (time_s > 0.1) & (time_s < 239.5)
    # As far as 0.48 mm over the night, all of it infrared's, which the difference before and after tells.
    assert np.abs(error[seen]).max() < 0.12
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9
    assert told(belief)


def test_a_zero_that_goes_further_and_further_stays_in_the_band():
    belief, time_s, error, std = one_result(lambda t: 8e-6 * np.maximum(t - 5.0, 0.0), steady)
    assert np.mean(np.abs(error) < 1.96 * std) > 0.95
    late = (time_s > 200.0) & (time_s < 239.5)
    assert np.mean(np.abs(error[late]) < 1.96 * std[late]) > 0.95
    # Told from where it is ten standard deviations of a frame: 0.15 mm after 19 s.
    (event,) = told(belief)
    assert event.time_ns / 1e9 == pytest.approx(25.0, abs=10.0)


@pytest.mark.parametrize("wrong", ["camera", "infrared"])
def test_the_camera_that_makes_a_small_jump_is_found_by_its_first_frames(wrong):
    def jumps(time_s):
        return np.where(time_s > 40.0, 0.3e-3, 0.0)

    belief, time_s, error, _ = one_result(*((jumps, steady) if wrong == "camera" else (steady, jumps)))
    assert f"contradicts the {wrong}" in told(belief)[0].text
    assert np.abs(error[(np.abs(time_s - 40.0) > 1.5) & (time_s < 239.5)]).max() < 0.08


def test_a_drift_that_the_acceleration_does_not_see_is_told_and_the_band_holds_it():
    belief, _, error, std = one_result(drifts, steady)
    assert told(belief)
    assert "tell" in " ".join(belief.warnings)
    assert np.mean(np.abs(error) < 1.96 * std) > 0.9
    assert np.median(std) > 0.5


def test_an_error_of_several_sensors_moves_them_together():
    time_ns = nanoseconds([0.0, 1.0])
    alone = CourseError(Source.INFRARED, time_ns, np.ones(2))
    both = CourseError((Source.CAMERA, Source.INFRARED), time_ns, np.ones(2))
    assert np.isin([int(Source.CAMERA), int(Source.INFRARED)], alone.source).tolist() == [False, True]
    assert np.isin([int(Source.CAMERA), int(Source.INFRARED)], both.source).tolist() == [True, True]


@pytest.mark.parametrize(("lasts_ns", "begins"), [(0, "At 205.407 s "), (250_000_000, "From 205.407 s to 205.657 s ")])
def test_a_contradiction_in_a_single_frame_is_told_by_its_instant(lasts_ns, begins):
    found = Contradiction(205_407_000_000, 205_407_000_000 + lasts_ns, 1e-3, None)
    assert found.told(("camera", "infrared")).text.startswith(begins + "infrared and camera differ by 1 mm")
