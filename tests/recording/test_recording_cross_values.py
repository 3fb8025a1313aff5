"""An accelerometer that is inclined: the direction of the other sensors' axis is estimated from its several axes."""

from dataclasses import replace

import numpy as np
import pytest

import midspan
from lively_recordings import Lively, write
from midspan.errors import UsageError
from recording_edits import set_keys
from repeats import slow

# Motion along the sensors' axis and, as large, along one at right angles to it, at other frequencies.
MAIN = Lively(duration_s=40.0, rms_m=2e-3, band_hz=(1.0, 2.0), noise_m=0.2e-3)
ACROSS = replace(MAIN, seed=500, band_hz=(2.2, 3.2))
GRAVITY = 9.81
# Rows without the start and the end, where the estimate settles.
SETTLED_S = 2.0


def inclined(folder, sensor, angle_deg, across, *, cross=True, seed=0):
    """A recording whose accelerometer is turned by an angle in the plane of its main axis and a cross one."""
    # A radar must not turn by half a cycle from frame to frame.
    case = replace(MAIN, seed=seed, rate_hz=40.0 if sensor == "radar" else MAIN.rate_hz)
    write(folder, case, sensor)
    time_s = np.arange(round(case.duration_s * case.accelerometer_hz)) / case.accelerometer_hz
    along = case.motion(time_s, 2)
    companions = np.zeros(len(time_s)) if across is None else across.motion(time_s, 2)
    cos, sin, noise = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg)), np.random.default_rng(seed + 9)
    own = [cos * (along + GRAVITY) - sin * companions, sin * (along + GRAVITY) + cos * companions]
    columns = [time_s, *(one + noise.normal(0.0, case.noise_m_s2, len(time_s)) for one in own)]
    file = folder / "accel.csv"
    np.savetxt(file, np.column_stack(columns), delimiter=",", header="time_s,az,ax", comments="", fmt="%.9f")
    set_keys(folder, "accelerometer", value="az", cross_values=["ax"] if cross else None)
    return case


def scored(case, result, *, zero):
    """Rms error in mm and the share of rows within ±1.96 σ; zero: whether the first instant is that of the sensor. Its
    one draw is left out of the error, and is in the share.
    """
    truth = case.from_zero_mm(result.time_s) if zero else 1e3 * case.motion(result.time_s)
    inner = (result.time_s > SETTLED_S) & (result.time_s < case.duration_s - SETTLED_S)
    error = (result.displacement_mm - truth)[inner]
    rms = float(np.std(error) if zero else np.sqrt(np.mean(error**2)))
    return rms, float(np.mean(np.abs(error) < 1.96 * result.displacement_std_mm[inner]))


@pytest.mark.parametrize(
    ("sensor", "angle_deg"),
    [
        ("displacement", 20.0),
        ("camera", 10.0),
        ("radar", 20.0),
        *slow(("displacement", 10.0), ("camera", 20.0), ("radar", 10.0), ("infrared", 10.0), ("infrared", 20.0)),
    ],
)
def test_cross_motion_of_an_inclined_accelerometer_is_taken_out(tmp_path, sensor, angle_deg):
    """The error about its mean is an aligned accelerometer's, to the 40 % by which two draws of its noise differ."""
    case = inclined(tmp_path / "aligned", sensor, 0.0, ACROSS)
    aligned, _ = scored(case, midspan.estimate(tmp_path / "aligned"), zero=sensor != "displacement")
    inclined(tmp_path / "inclined", sensor, angle_deg, ACROSS)
    result = midspan.estimate(tmp_path / "inclined")
    error, inside = scored(case, result, zero=sensor != "displacement")
    axis = result.calibration.sensor_axis
    assert error < 1.4 * aligned
    assert inside >= 0.9
    # Three standard deviations.
    assert abs(axis.components[0] - np.tan(np.radians(angle_deg))) < 3.0 * axis.std[0]
    assert axis.std[0] < 0.02


def test_without_cross_values_the_same_cross_motion_is_an_error(tmp_path):
    """What the key is for: sin 10° of cross motion as large as the motion itself."""
    case = inclined(tmp_path / "one", "displacement", 10.0, ACROSS, cross=False)
    single, _ = scored(case, midspan.estimate(tmp_path / "one"), zero=False)
    inclined(tmp_path / "two", "displacement", 10.0, ACROSS)
    several, _ = scored(case, midspan.estimate(tmp_path / "two"), zero=False)
    assert several < 0.5 * single


@pytest.mark.parametrize("sensor", ["displacement", "camera"])
def test_without_cross_motion_nothing_changes(tmp_path, sensor):
    """The direction is not known then, and an error 2 % larger is no larger."""
    case = inclined(tmp_path / "one", sensor, 0.0, None, cross=False)
    single, _ = scored(case, midspan.estimate(tmp_path / "one"), zero=sensor != "displacement")
    inclined(tmp_path / "two", sensor, 0.0, None)
    result = midspan.estimate(tmp_path / "two")
    several, inside = scored(case, result, zero=sensor != "displacement")
    assert several < 1.02 * single
    assert inside >= 0.9
    # A mounting by camera is all that is known.
    assert result.calibration.sensor_axis.std[0] > 0.2


def test_the_direction_of_a_calibration_holds_for_another_recording(tmp_path):
    """It is written, read back and applied where nothing is calibrated, to another motion."""
    inclined(tmp_path / "first", "displacement", 15.0, ACROSS)
    calibration = midspan.calibrate(tmp_path / "first")
    file = calibration.save(tmp_path / "first")
    case = inclined(tmp_path / "second", "displacement", 15.0, replace(ACROSS, seed=700), seed=4)
    result = midspan.estimate(tmp_path / "second", file)
    error, inside = scored(case, result, zero=False)
    assert result.calibration.sensor_axis == calibration.sensor_axis
    # Without the direction the error is 0.3 mm (the test above); the sensor's own noise is 0.2 mm.
    assert error < 0.1
    assert inside >= 0.9


def test_a_direction_is_refused_where_its_columns_are_not_named(tmp_path):
    inclined(tmp_path / "two", "displacement", 10.0, ACROSS)
    calibration = midspan.calibrate(tmp_path / "two")
    set_keys(tmp_path / "two", "accelerometer", cross_values=None)
    with pytest.raises(UsageError, match="names 0 columns"):
        midspan.estimate(tmp_path / "two", calibration)


def test_what_is_open_of_the_direction_is_in_the_band_of_later_cross_motion(tmp_path):
    """Calibrated without cross motion, then used with it: the rows are off by sin 10° of it, and say so."""
    inclined(tmp_path / "quiet", "displacement", 10.0, None)
    calibration = midspan.calibrate(tmp_path / "quiet")
    case = inclined(tmp_path / "shaken", "displacement", 10.0, ACROSS)
    _, inside = scored(case, midspan.estimate(tmp_path / "shaken", calibration), zero=False)
    assert inside >= 0.9


@pytest.mark.parametrize(
    ("section", "keys", "words"),
    [
        ("accelerometer", {"value": None}, "must have value"),
        ("accelerometer", {"cross_values": ["ax", "ax"]}, "differ"),
        ("fusion", {"literal": True, "method": "fir"}, "fusion.literal"),
        ("calibration", {"band_hz": [0.5, 5.0]}, "calibration.band_hz"),
    ],
)
def test_settings_that_contradict_several_axes_are_refused(tmp_path, section, keys, words):
    inclined(tmp_path / "two", "displacement", 10.0, ACROSS)
    set_keys(tmp_path / "two", section, **keys)
    with pytest.raises(UsageError, match=words):
        midspan.open_recording(tmp_path / "two")
