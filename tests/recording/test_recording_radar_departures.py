"""A radar's targets that do not stay where they were calibrated, and outages in which nothing is seen."""

from dataclasses import dataclass

import numpy as np
import pytest

import midspan
from midspan.errors import UntrustedError
from midspan.records import Floats, Status
from midspan.simulate.radar.signal import Reflector
from radar_recordings import PLATE, Case, true_mm, write
from repeats import slow

WALL = Reflector(3.4, 700.0, ratio=1 / 1.27, azimuth_rad=0.2)
LEAVES_S = 17.0


@dataclass(frozen=True)
class DrivesOff:
    """A parked car that sets out at LEAVES_S with 1.5 m/s²."""

    def displacement(self, time_s: Floats) -> Floats:
        since = np.maximum(np.asarray(time_s) - LEAVES_S, 0.0)
        return np.asarray(np.minimum(0.75 * since**2, 6.0))

    def acceleration(self, time_s: Floats) -> Floats:
        return np.where((np.asarray(time_s) > LEAVES_S) & (np.asarray(time_s) < LEAVES_S + 2.8), 1.5, 0.0)


CAR = Reflector(6.1, 2000.0, ratio=1.0, own=DrivesOff())


def estimated(folder, **options):
    recording = midspan.open_recording(folder, calibration={"window_s": (0.0, 16.0)})
    result = midspan.estimate(recording, **options)
    return result, result.displacement_mm - true_mm(folder, result.time_s)


def test_a_parked_car_that_drives_off_is_left_out_and_the_wall_goes_on(tmp_path) -> None:
    folder = write(tmp_path, Case((CAR, WALL, PLATE), seed=1))
    result, error = estimated(folder)
    # Nothing in the calibration speaks against the car, and it is the quieter target.
    wall, car = sorted(result.calibration.radar.used, key=lambda target: target.range_m)
    assert car.noise_m < 0.5 * wall.noise_m
    reported = [event for event in result.events if event.kind == "contradiction"]
    assert reported[0].time_ns / 1e9 == pytest.approx(LEAVES_S + 0.2, abs=0.2)
    assert all("6.1" in event.text for event in reported)
    # Both targets before, the wall alone after: 8 to 16 µm a frame, smoothed; no step of the hand-over.
    assert np.abs(error).max() < 0.03
    # The zero is one draw that all rows share: it stands for itself, and the rows are judged about it.
    own = np.sqrt(np.maximum(result.displacement_std_mm**2 - (1e3 * result.zero_std_m) ** 2, 0.0))
    assert abs(np.mean(error)) < 3.0 * 1e3 * result.zero_std_m
    assert np.mean(np.abs(error - np.mean(error)) < 1.96 * own) > 0.9
    assert np.all(result.estimate.status == Status.TRACKING)


@pytest.mark.parametrize("method", ["kalman", *slow("smoother")])
def test_an_only_target_that_drives_off_leaves_no_result(method, tmp_path) -> None:
    # Acceleration and radar contradict each other smoothly; it may as well be the accelerometer that is wrong.
    folder = write(tmp_path, Case((CAR, PLATE), seed=2))
    with pytest.raises(UntrustedError, match=r"the accelerometer would have shown|contradict each other"):
        estimated(folder, method=method)


@pytest.mark.parametrize("method", ["kalman", "fir", *slow("smoother")])
def test_rows_that_nothing_carries_are_coasting_and_their_band_holds(method, tmp_path) -> None:
    hidden = Reflector(3.4, 900.0, ratio=1 / 1.27, blocked=((16.5, 21.5),))
    folder = write(tmp_path, Case((hidden, PLATE), seed=3))
    result, error = estimated(folder, method=method)
    std, status = result.displacement_std_mm, result.estimate.status
    unseen = (result.time_s > 16.6) & (result.time_s < 21.4)
    assert np.all(status[unseen] != Status.TRACKING)
    # The acceleration alone carries them: a tenth of a millimetre after a second, by the accelerometer's noise; `fir`
    # comes later, and its rows know what is seen after it.
    assert method == "fir" or np.all(np.diff(std[unseen]) > -1e-3)
    assert method == "fir" or std[unseen][-1] > 0.3
    assert np.all(np.abs(error) < 5.0 * std)
    # The level after it is a new one, and said to be.
    assert "new datum" in {event.kind for event in result.events}


def test_a_refused_result_names_the_sensors_that_are_there(tmp_path) -> None:
    right = write(tmp_path / "right", Case((WALL, PLATE), seed=4))
    turned = write(tmp_path / "turned", Case((WALL, PLATE), seed=4, sign=-1.0))
    calibration = midspan.calibrate(midspan.open_recording(right))
    with pytest.raises(UntrustedError, match="does not belong to this recording") as refused:
        midspan.estimate(midspan.open_recording(turned), calibration)
    assert "radar: its displacement is -1" in str(refused.value)
    assert "roi" not in str(refused.value)
