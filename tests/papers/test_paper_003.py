"""The two-stage paper (Ma, Liu, Choi and Sohn) from frames to rows, its steps in plain NumPy and SciPy."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import RectBivariateSpline

from lively_recordings import Lively, write
from midspan.cli.main import run
from midspan.sinks.metadata import partner
from plain_filters import printed_calibration, two_stage

# Excitations 1 and 3 at 3 frames a second: 2.2 Hz shows as 0.8 Hz, 5.1 Hz as 0.9 Hz. The clocks are one: by aliased
# series the printed steps find no offset of a part of a frame's interval (docs/papers.md).
TONES_HZ = (2.2, 5.1)
ROI = (18, 18, 48, 48)
# Rows within this of either end may lack a part of a filter, here or there: 9.2 s as the package says.
EDGE_S = 9.5


@pytest.fixture(scope="module", params=TONES_HZ)
def estimated(request, tmp_path_factory):
    """The case and its folder, in which the command has estimated."""
    tones = ((8e-3, 0.1), (3e-3, request.param))
    case = Lively(2, first_s=0.0037, rate_hz=2.997, duration_s=54.0, tones=tones, noise_m_s2=1e-3, mm_per_px=-1.6)
    folder = write(tmp_path_factory.mktemp("two-stage") / "recording", case, "camera")
    asked = ["--tracker", "template", "--method", "two-stage-fir", "--literal", "--quiet"]
    assert run(["estimate", str(folder), *asked]) == 0
    return case, folder


def tracked(frames):
    """Translation (n,) in px, downwards: equation 2 at whole pixels and FITPACK's spline through the matrix."""
    x, y, width, height = ROI
    template = frames[0, y : y + height, x : x + width].astype(float)
    template -= template.mean()
    fine = np.linspace(-1.0, 1.0, 201)
    found = []
    for frame in frames.astype(float):
        subsets = sliding_window_view(frame, (height, width))
        mean, square = subsets.mean(axis=(2, 3)), np.einsum("yxij,yxij->yx", subsets, subsets)
        matrix = np.einsum("yxij,ij->yx", subsets, template)
        matrix /= np.sqrt((square - width * height * mean**2) * np.sum(template**2))
        row, column = np.unravel_index(np.argmax(matrix), matrix.shape)
        spline = RectBivariateSpline(np.arange(matrix.shape[0]), np.arange(matrix.shape[1]), matrix, s=0)
        for step in (1.0, 0.01):  # the largest of a grid of hundredths, then of ten-thousandths
            values = spline(row + step * fine, column + step * fine)
            r, c = np.unravel_index(np.argmax(values), values.shape)
            row, column = row + step * fine[r], column + step * fine[c]
        found.append(row - y)
    return np.array(found)


def rows_of(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) and displacements (mm) of the result."""
    table = np.genfromtxt(folder / "result.csv", delimiter=",", names=True, dtype=None, encoding=None)
    return table["time_s"], table["displacement_mm"]


def test_the_whole_system_is_the_papers_steps_in_plain_numpy(estimated):
    case, folder = estimated
    time, value = np.genfromtxt(folder / "accel.csv", delimiter=",", skip_header=1).T
    met = case.met_s
    px = tracked(np.load(folder / "camera.npy"))
    offset_s, scale = printed_calibration((time, value), (met, px), (0.3, 1.5), 0.5, sampled_first=True)
    plain = 1e3 * two_stage(time, value, met + offset_s, scale * px)
    reported = json.loads(partner(folder / "result.csv").read_text())
    camera = reported["calibration"]["camera"]
    assert camera["literal"]
    # One per cent of the whole: filters, integrals and splines of other make.
    assert camera["scale_mm_per_px"] == pytest.approx(1e3 * scale, rel=0.01)
    assert camera["time_offset_s"] == pytest.approx(offset_s, abs=1e-3)
    at_s, found = rows_of(folder)
    inner = (at_s > time[0] + EDGE_S) & (at_s < time[-1] - EDGE_S)
    expected = np.interp(at_s[inner], time, plain)
    difference = (found[inner] - found[inner].mean()) - (expected - expected.mean())
    assert np.std(difference) < 0.01 * np.std(expected)


def test_the_whole_system_is_as_near_to_the_truth_as_published(estimated):
    case, folder = estimated
    at_s, found = rows_of(folder)
    inner = (at_s > EDGE_S) & (at_s < case.duration_s - EDGE_S)
    # "In all five excitation cases … RMSEs less than 0.3 mm."
    assert np.std((found - case.from_zero_mm(at_s))[inner]) < 0.3


def test_track_follows_the_settings_of_the_file(estimated, tmp_path):
    _, folder = estimated
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(
        text.replace("[camera]\n", '[camera]\ntracker = "template"\ntracker_settings = { literal = true }\n')
    )
    assert run(["track", str(folder), "-o", str(tmp_path / "track.csv"), "--quiet"]) == 0
    (folder / "recording.toml").write_text(text)
    table = np.genfromtxt(tmp_path / "track.csv", delimiter=",", names=True, dtype=None, encoding=None)
    # The plain search ends at ten-thousandths of a pixel.
    np.testing.assert_allclose(table["y_px"], tracked(np.load(folder / "camera.npy")), atol=1e-4)
