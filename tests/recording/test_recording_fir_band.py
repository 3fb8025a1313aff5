"""`fir` and `two-stage-fir` with a slow camera: what a cubic through its frames makes of the motion is in the band."""

import numpy as np
import pytest

import midspan
from lively_recordings import Lively, write

# A camera so sharp that the cubic through four frames a second errs by more than its noise, at 2 to 3 frames a period
# and more: nothing aliases.
CASE = Lively(duration_s=60.0, rate_hz=4.0, rms_m=4e-3, band_hz=(0.7, 1.1), noise_m_s2=2e-3)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = write(tmp_path_factory.mktemp("slow") / "camera", CASE, "camera")
    return folder, midspan.calibrate(folder)


@pytest.mark.parametrize("method", ["fir", "two-stage-fir"])
def test_the_band_holds_the_interpolations_error(recording, method):
    folder, calibration = recording
    result = midspan.estimate(folder, calibration, method=method)
    error = result.displacement_mm - CASE.from_zero_mm(result.time_s)
    # The level is one draw of the zero; rows about their mean show the interpolation.
    own = np.sqrt(result.displacement_std_mm**2 - (1e3 * result.zero_std_m) ** 2)
    assert np.mean(np.abs(error - np.mean(error)) < 1.96 * own) >= 0.9
