"""A displacement sensor that is not calibrated, in recordings: `estimate_scale`, and values that are static."""

import json
import shutil

import numpy as np
import pytest

import midspan
from midspan.calibration.displacement.sensor import read_with
from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.cli.main import run
from midspan.errors import DataError, UntrustedError, UsageError
from midspan.records import Status, TimeOffset, TimeSeries
from midspan.simulate.motion.motion import random_motion
from recording_edits import append, error_mm, read_columns, set_keys, truth, write_displacement

NOISE_MM = 2.0


@pytest.fixture
def gnss_copy(gnss, tmp_path):
    folder = tmp_path / "gnss"
    shutil.copytree(gnss, folder)
    return folder


def heights(folder):
    return read_columns(folder / "gnss.csv").T


def write_heights(folder, time, value):
    table = np.column_stack((time, value))
    np.savetxt(folder / "gnss.csv", table, delimiter=",", header="time_s,height", comments="", fmt="%.9f")


def scaled(folder, factor, **keys):
    """The recording with readings that must be multiplied by `factor`."""
    time, value = heights(folder)
    write_heights(folder, time, value / factor)
    set_keys(folder, "displacement", estimate_scale=True, **keys)
    return midspan.open_recording(folder)


def with_known_gain(gnss, tmp_path):
    """The recording with an accelerometer whose gain is 1 for certain."""
    folder = tmp_path / "known"
    shutil.copytree(gnss, folder)
    set_keys(folder, "accelerometer", estimate_scale=False)
    return folder


def test_inches_taken_for_millimetres_with_the_wrong_sign_are_put_right(gnss, gnss_copy, tmp_path):
    known = midspan.estimate(midspan.open_recording(with_known_gain(gnss, tmp_path)))
    found = midspan.estimate(scaled(gnss_copy, -25.4))
    estimated = found.calibration.displacement
    assert estimated.scale == pytest.approx(-25.4, abs=4.0 * estimated.scale_std)
    # The second route: a regression of the heights on the true motion, whose part below 0.1 Hz says nothing, as the
    # accelerometer does not see it.
    known_at = truth(gnss_copy)
    moved = np.interp(heights(gnss_copy)[0], known_at[:, 0], known_at[:, 1])
    least = NOISE_MM / (np.std(moved) * np.sqrt(len(moved)))
    assert least < estimated.relative_std < 1.6 * least
    assert 1e3 * estimated.noise_std_m == pytest.approx(NOISE_MM, rel=0.25)
    error = error_mm(gnss_copy, found.time_s, found.displacement_mm)
    tracking = found.estimate.status == Status.TRACKING
    assert np.std(error[tracking]) < 0.6 * NOISE_MM
    assert np.mean(np.abs(error) < 1.96 * found.displacement_std_mm) > 0.88
    # What is not known of the scale stands in the band: it is wider than with the scale given.
    assert np.all(found.displacement_std_mm >= 0.98 * known.displacement_std_mm)
    assert np.median(found.displacement_std_mm) > np.median(known.displacement_std_mm)


def test_the_scale_is_stored_and_read_again(gnss_copy, tmp_path):
    recording = scaled(gnss_copy, -25.4)
    result = midspan.estimate(recording)
    file = result.calibration.save(tmp_path / "calibration.json")
    part = json.loads(file.read_text())["displacement"]
    assert part["scale"] == result.calibration.displacement.scale
    assert part["scale_std"] == result.calibration.displacement.scale_std
    again = midspan.estimate(recording, calibration=file)
    # A given calibration's scale is estimated: the rows differ by what the record tells of it, far within the band.
    assert np.all(np.abs(again.displacement_mm - result.displacement_mm) < 0.1 * result.displacement_std_mm)
    # What the motion does not tell of it widens the band, by 3 % of the displacement from its start at most.
    widest = np.hypot(result.displacement_std_mm, 0.03 * np.max(np.abs(result.displacement_mm)))
    assert np.all(again.displacement_std_mm < 1.01 * widest)
    assert np.all(again.displacement_std_mm > 0.99 * result.displacement_std_mm)
    part["scale"] = 0.0
    file.write_text(json.dumps(json.loads(file.read_text()) | {"displacement": part}))
    with pytest.raises(DataError, match=r"displacement\.scale = 0\.0: must not be 0"):
        midspan.load_calibration(file)


def test_a_calibration_without_the_scale_is_not_taken_where_it_is_wanted(gnss, gnss_copy):
    given = midspan.calibrate(midspan.open_recording(gnss))
    with pytest.raises(UsageError, match=r"has no displacement\.scale"):
        midspan.estimate(scaled(gnss_copy, 2.0), calibration=given)


def test_scale_and_clock_offset_are_estimated_together(gnss_copy):
    time, value = heights(gnss_copy)
    write_heights(gnss_copy, time - 0.2, value)
    estimated = midspan.calibrate(scaled(gnss_copy, 0.5, estimate_offset=True)).displacement
    assert estimated.scale == pytest.approx(0.5, abs=4.0 * estimated.scale_std)
    assert estimated.offset.value_s == pytest.approx(0.2, abs=4.0 * np.sqrt(estimated.offset.variance))
    assert np.sqrt(estimated.offset.variance) < 0.03


def test_a_given_noise_is_in_the_readings_unit(gnss_copy):
    estimated = midspan.calibrate(scaled(gnss_copy, -25.4, noise_std=NOISE_MM / 25.4)).displacement
    assert estimated.noise_std_m == pytest.approx(1e-3 * NOISE_MM / 25.4 * abs(estimated.scale))


def test_a_motion_that_does_not_tell_the_scale_is_refused(gnss_copy):
    time, value = heights(gnss_copy)
    write_heights(gnss_copy, time, value + 15.0 * np.random.default_rng(1).standard_normal(len(value)))
    set_keys(gnss_copy, "displacement", estimate_scale=True)
    with pytest.raises(UntrustedError, match=r"estimate_scale.*at most ± 5 %"):
        midspan.calibrate(midspan.open_recording(gnss_copy))
    assert run(["calibrate", str(gnss_copy)]) == 4
    assert not (gnss_copy / "calibration.json").exists()


def test_a_large_reading_leaves_the_zero_uncertain_and_says_so(gnss_copy):
    time, value = heights(gnss_copy)
    write_heights(gnss_copy, time, value + 2000.0)
    set_keys(gnss_copy, "displacement", estimate_scale=True)
    found = midspan.estimate(midspan.open_recording(gnss_copy))
    error = error_mm(gnss_copy, found.time_s, found.displacement_mm) - 2000.0
    # The sensor's own zero is multiplied as well; the error that this makes stands in the band.
    assert np.abs(np.mean(error)) < 4.0 * np.median(found.displacement_std_mm)
    assert np.median(found.displacement_std_mm) > 0.9 * 2000.0 * found.calibration.displacement.relative_std
    assert any("the zero's uncertainty includes" in line for line in found.warnings)


def test_beside_a_camera_an_uncalibrated_sensor_helps(footbridge, footbridge_copy):
    known = truth(footbridge_copy)
    time = np.arange(0.05, 24.9, 0.05)
    rng = np.random.default_rng(4)
    volts = (np.interp(time, known[:, 0], known[:, 1]) + 0.05 * rng.standard_normal(len(time))) / -12.5 + 3.0
    np.savetxt(footbridge_copy / "lvdt.csv", np.column_stack((time, volts)), delimiter=",", header="time_s,volts",
               comments="", fmt="%.7f")  # fmt: skip
    append(footbridge_copy, '[displacement]\nfile = "lvdt.csv"\nvalue = "volts"\nunit = "mm"\nestimate_scale = true')
    alone = midspan.estimate(midspan.open_recording(footbridge))
    found = midspan.estimate(midspan.open_recording(footbridge_copy))
    estimated = found.calibration.displacement
    assert estimated.scale == pytest.approx(-12.5, abs=4.0 * estimated.scale_std)
    assert estimated.relative_std < 0.01
    assert len(found.innovation.time_ns) > len(alone.innovation.time_ns) + 0.9 * len(time)
    errors = [error_mm(footbridge_copy, r.time_s, r.displacement_mm) for r in (alone, found)]
    assert np.std(errors[1]) < 1.1 * np.std(errors[0])
    assert np.mean(np.abs(errors[1]) < 1.96 * found.displacement_std_mm) > 0.85


@pytest.mark.parametrize("factor", [1.0, -25.4])
def test_values_that_stand_still_are_left_out_and_reported(factor, gnss_copy):
    time, value = heights(gnss_copy)
    value[30:45] = value[30]
    write_heights(gnss_copy, time, value / factor)
    set_keys(gnss_copy, "displacement", estimate_scale=factor != 1.0)
    found = midspan.estimate(midspan.open_recording(gnss_copy))
    frozen = [event for event in found.events if event.kind == "frozen"]
    assert len(frozen) == 1
    assert frozen[0].text in found.warnings
    assert [event for event in found.events if event.kind == "released" and "15 values" in event.text]
    # They are missing, as in a gap: no innovation, and the rows say that nothing supports them.
    met = found.innovation.time_ns / 1e9
    # It takes some equal values together with the acceleration to know.
    assert not np.any((met > time[34] + 0.1) & (met < time[44] + 0.1))
    inside = (found.time_s > time[36] + 2.5) & (found.time_s < time[44])
    assert set(found.estimate.status[inside].tolist()) <= {Status.COASTING, Status.LOST}
    error = np.abs(error_mm(gnss_copy, found.time_s, found.displacement_mm))
    assert np.mean(error < 1.96 * found.displacement_std_mm) > 0.88
    assert 1e3 * found.calibration.displacement.noise_std_m == pytest.approx(NOISE_MM, rel=0.3)


def test_heights_in_whole_millimetres_are_all_used(gnss_copy):
    time, value = heights(gnss_copy)
    write_heights(gnss_copy, time, np.round(value))
    found = midspan.estimate(midspan.open_recording(gnss_copy))
    assert not [event for event in found.events if event.kind == "frozen"]


def test_a_clock_that_runs_apart_is_corrected_where_the_offset_is_to_be_estimated(tmp_path):
    # A logger 60 ppm off: 18 ms in five minutes, ± 9 ms about the one offset that calibration finds.
    motion = random_motion((0.3, 4.0), 3e-3, rng=np.random.default_rng(3), flat="velocity")
    time, met = np.arange(0.0, 300.0, 0.01), np.arange(1.0, 299.0, 0.1)
    rng = np.random.default_rng(4)
    accel = motion.acceleration(time) + 2e-3 * rng.standard_normal(len(time))
    value = 1e3 * motion.displacement(met) + 0.1 * rng.standard_normal(len(met))
    stamps = met - 0.02 - 60e-6 * met
    write_displacement(tmp_path, (time, accel), (stamps, value / 7.0))
    set_keys(tmp_path, "displacement", estimate_offset=True, estimate_scale=True)
    found = midspan.estimate(midspan.open_recording(tmp_path))
    assert any(line.startswith("displacement: its clock drifts by") and "ppm" in line for line in found.warnings)
    error = found.displacement_mm - 1e3 * motion.displacement(found.time_s)
    # 9 ms of 3 mm rms at some 2 Hz would be 0.3 mm; corrected, what is left is the fusion's own error.
    assert np.std(error) < 0.06
    assert np.mean(np.abs(error) < 1.96 * found.displacement_std_mm) > 0.88
    # The drift blurs the calibration: 5 ms rms about the middle takes (2π · 2 Hz · 5 ms)² / 2 = 0.2 % off the slope.
    estimated = found.calibration.displacement
    assert estimated.scale == pytest.approx(7.0, abs=4.0 * estimated.scale_std + 0.002 * 7.0)


def test_readings_are_put_on_the_accelerometers_clock_and_into_metres():
    # The running clock would make up for a wrong offset later on; so it is looked at here, before.
    series = TimeSeries(np.array([0, 1_000_000_000]), np.array([0.002, -0.004]))
    read = read_with(series, DisplacementCalibration(1e-3, TimeOffset(0.25, 0.0), scale=-2.0))
    assert read.time_ns.tolist() == [250_000_000, 1_250_000_000]
    assert read.value == pytest.approx([-0.004, 0.008])
