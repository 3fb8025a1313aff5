"""What is said of a camera's tilt, from what it makes of two targets."""

import pytest

from midspan.calibration.camera.disagreement import tilt_text


@pytest.mark.parametrize("kept", ["near", "far"])
def test_what_a_tilt_makes_of_either_target_is_said(kept):
    # A tilt of 0.1 px: 0.1 mm at 1 mm/px and 0.25 mm at 2.5 mm/px.
    scales, error_m = {"near": 1e-3, "far": 2.5e-3}, {"near": 1e-4, "far": 2.5e-4}
    other = "far" if kept == "near" else "near"
    said = tilt_text((kept, scales[kept]), (other, scales[other]), error_m[kept])
    assert "errors of 0.1 mm rms at near and 0.25 mm rms at far" in said
    # 0.1 mm are 5.7 mdeg times a metre.
    assert "tilt_std_mdeg = 5.7 / distance in m" in said
    assert "or one target moves on its own" in said
    decided = tilt_text((kept, scales[kept]), (other, scales[other]), error_m[kept], decided=True)
    assert "excludes motion of one target alone" in decided
