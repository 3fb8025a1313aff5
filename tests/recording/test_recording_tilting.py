"""A camera that tilts with its structure: targets at two distances show the tilt, one target cannot."""

import shutil
import tomllib

import numpy as np
import pytest

import midspan
from midspan.simulate.scenarios.write import write
from recording_edits import set_keys


@pytest.fixture(scope="module")
def footbridge(tmp_path_factory):
    return write("tilting-footbridge", tmp_path_factory.mktemp("tilting") / "recording", seed=1)


@pytest.fixture(scope="module")
def calibration(footbridge):
    return midspan.calibrate(footbridge)


def errors(result, folder, start_s=5.0):
    """Errors in mm without their mean, the rows' own deviations, errors and deviations with the zero."""
    time_s, truth_mm = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1, usecols=(0, 1)).T
    late = result.time_s > start_s
    error = (result.displacement_mm - np.interp(result.time_s, time_s, truth_mm))[late]
    std = result.displacement_std_mm[late]
    own = np.sqrt(np.maximum(std**2 - (1e3 * result.zero_std_m) ** 2, 0.0))
    return error - np.mean(error), own, error, std


def inside(error, std):
    return float(np.mean(np.abs(error) < 1.96 * std))


def test_differences_are_calibrated_without_a_distance(calibration):
    camera = calibration.camera
    near, far = (1.0 / target.scale.value_m_per_px for target in camera.targets)
    # 5000 px times the difference of one over the distances; the box goes up where the accelerometer reads more.
    true = 5000.0 * (1.0 / 3.0 - 1.0 / 10.0)
    assert near - far == pytest.approx(true, abs=3.0 * camera.relative_std * true)
    assert camera.relative_std < 5e-4
    assert camera.tilt_std_px > 0.1
    assert any(one.code == "tilt" and "near and far" in one for one in calibration.warnings)


# Bounds of a smoother and a filter for two targets of 0.002 px (1.3 times the Cramér-Rao bound of a frame) at 10
# frames/s and 1 mm/s² are 0.0016 and 0.0034 mm; a tilt that is not seen makes 0.3 mm.
@pytest.mark.parametrize(("method", "most_mm"), [("smoother", 0.0025), ("kalman", 0.006)])
def test_the_tilt_is_removed_and_the_band_honest(method, most_mm, footbridge, calibration):
    result = midspan.estimate(footbridge, calibration, method=method, given=False)
    error, own, whole, std = errors(result, footbridge)
    assert np.std(error) < most_mm
    # Errors are correlated over some tenths of a second: 100 s hold some two hundred draws.
    assert 0.88 < inside(error, own) <= 1.0
    assert inside(whole, std) > 0.88
    assert not any("tilt not observed" in one for one in result.not_in_band)


@pytest.mark.parametrize("name", ["near", "far"])
def test_one_target_alone_has_a_wide_band_or_is_refused(name, footbridge, tmp_path):
    alone = shutil.copytree(footbridge, tmp_path / "alone")
    targets = tomllib.loads((alone / "recording.toml").read_text())["camera"]["target"]
    set_keys(alone, "camera", target=[one for one in targets if one["name"] == name])
    try:
        result = midspan.estimate(alone)
    except midspan.UntrustedError:
        return
    _, _, whole, std = errors(result, footbridge)
    assert inside(whole, std) > 0.9
    assert any("at another distance" in one for one in result.warnings)


def test_the_calibration_keeps_the_tilt(calibration, tmp_path):
    again = midspan.load_calibration(calibration.save(tmp_path / "calibration.json"))
    assert again.camera.tilt_std_px == pytest.approx(calibration.camera.tilt_std_px)


def test_the_report_of_a_tilting_camera_is_written(footbridge, calibration, tmp_path):
    result = midspan.estimate(footbridge, calibration, given=False)
    text = midspan.write_report(result, tmp_path / "report.html").read_text()
    assert "tilts by" in text
