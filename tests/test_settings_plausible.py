"""Warnings on a unit, a sensitivity or optics that do not fit each other."""

import math
from dataclasses import replace

import pytest
from pydantic import ValidationError

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.records import Region, ScaleFactor, TimeOffset
from midspan.settings.plausible import expected_m_per_px, implausible
from midspan.settings.recording import RecordingSettings
from midspan.settings.stored.calibration import Calibration

# 4 m in front of 8 mm and pixels of 3 µm: 4000 mm / (8 / 0.003 px) = 1.5 mm/px.
OPTICS = {"distance_m": 4.0, "focal_length_mm": 8.0, "pixel_pitch_um": 3.0}
REGION = Region(10, 10, 64, 64)


def settings(**camera):
    return RecordingSettings.model_validate(
        {"accelerometer": {"file": "a.csv", "unit": "m/s^2"}, "camera": {"file": "c.mkv", **camera}}
    )


def calibration(mm_per_px, bias_m_s2=0.0):
    scale = ScaleFactor(1e-3 * mm_per_px, 1e-12)
    camera = CameraCalibration(scale, TimeOffset(0.0, 1e-8), REGION, "y", "template", 0.01, 1.0)
    return Calibration(1e-3, bias_m_s2, camera=camera)


def test_the_optics_give_millimetres_per_pixel():
    camera = settings(**OPTICS).sensors[0].settings
    assert math.isclose(expected_m_per_px(camera, calibration(1.0).first_camera), 1.5e-3)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_unit_that_makes_the_scale_ten_times_off_is_named_and_a_nominal_focal_length_is_not(sign):
    (line,) = implausible(settings(**OPTICS), calibration(sign * 14.71))
    assert "9.81 times" in line
    assert "accelerometer.unit" in line
    assert implausible(settings(**OPTICS), calibration(sign * 1.8)) == ()
    assert implausible(settings(), calibration(sign * 14.71)) == ()


@pytest.mark.parametrize("bias_g", [0.0, 0.2, -0.2, 1.0, -0.98])
def test_a_level_or_an_upright_axis_is_not_odd(bias_g):
    assert implausible(settings(), calibration(1.5, 9.80665 * bias_g)) == ()


@pytest.mark.parametrize("bias_g", [0.6, -0.5, 1.3, 9.81, -9.81])
def test_a_bias_that_no_level_or_upright_axis_reads_is_named(bias_g):
    (line,) = implausible(settings(), calibration(1.5, 9.80665 * bias_g))
    assert "the reading at rest is" in line


def test_optics_that_are_not_whole_are_refused():
    with pytest.raises(ValidationError, match="together"):
        settings(**{**OPTICS, "pixel_pitch_um": None})


def test_a_second_camera_is_compared_with_its_own_optics():
    two = RecordingSettings.model_validate(
        {
            "accelerometer": {"file": "a.csv", "unit": "m/s^2"},
            "camera": [{"file": "c.mkv", "name": "near", **OPTICS}, {"file": "d.mkv", "name": "far"}],
        }
    )
    near = replace(calibration(3.0).first_camera, name="near")
    far = replace(calibration(14.0).first_camera, name="far")
    found = implausible(two, Calibration(1e-3, 0.0, camera=near, others=(far,)))
    assert len(found) == 1
    assert found[0].startswith("near: ")
