"""A recording with a camera and its result, which several files of tests look at."""

import numpy as np
import pytest
from known_motion import SCALE_M_PER_PX, displacement_m, write_recording
from scipy.ndimage import fourier_shift, gaussian_filter

from midspan.recording.estimate import estimate
from midspan.report.report import write_report


@pytest.fixture(name="camera", scope="session")
def camera_recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("camera")
    rng = np.random.default_rng(2)
    scene = gaussian_filter(rng.standard_normal((128, 160)), 1.5, mode="wrap")
    spectrum = np.fft.fft2(120 + 45 * scene / scene.std())
    t = np.arange(0.0, 30.0, 0.1)
    shifts = displacement_m(t) / SCALE_M_PER_PX
    frames = np.stack([np.fft.ifft2(fourier_shift(spectrum, (s, 0.0))).real for s in shifts])
    np.save(folder / "camera.npy", np.clip(frames + rng.standard_normal(frames.shape), 0, 255).astype(np.uint8))
    return write_recording(folder, '[camera]\nfile = "camera.npy"\nrate_hz = 10.0\ndirection = "y"\n')


@pytest.fixture(name="camera_result", scope="session")
def result_of_camera(camera):
    return estimate(camera)


@pytest.fixture(name="camera_report", scope="session")
def report_of_camera(camera, camera_result, tmp_path_factory):
    """The report as a file, alone in its folder."""
    return write_report(camera_result, tmp_path_factory.mktemp("page") / "report.html", camera.reference)
