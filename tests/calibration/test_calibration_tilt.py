"""What a camera's tilt would make of its targets' displacements, from how far these are apart."""

import numpy as np
import pytest

from midspan.calibration.camera.tilt import tilt_error_m, tilt_text

TILT_RAD, FOCAL_PX = 2e-5, 5000.0


def test_two_targets_tell_the_error_of_either():
    near, far = -1e-3, 2.5e-3
    error_m = [TILT_RAD * FOCAL_PX * abs(scale) for scale in (near, far)]
    apart_m = error_m[1] - error_m[0]
    np.testing.assert_allclose(tilt_error_m([near, far], 0, 1, apart_m), error_m[0])
    np.testing.assert_allclose(tilt_error_m([near, far], 1, 0, apart_m), error_m[1])
    said = tilt_text(("far", far), ("near", near), error_m[1])
    assert "near wrong by 0.1 mm rms and that of far by 0.25 mm" in said
    # 0.1 mm are 5.7 mdeg times a metre.
    assert "tilt_std_mdeg = 5.7 divided" in said


@pytest.mark.parametrize("scales", [[1e-3, 1.05e-3], [1e-3, 2e-3, 1.5e-3]])
def test_a_tilt_is_no_cause_at_one_distance_nor_where_two_distances_agree(scales):
    assert tilt_error_m(scales, 0, 1, 1e-4) == 0.0


def test_a_majority_at_one_distance_may_still_be_a_tilting_camera():
    assert tilt_error_m([1e-3, 2e-3, 1.02e-3], 0, 1, 1e-4) == pytest.approx(1e-4)
