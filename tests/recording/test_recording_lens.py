"""A recording through a wide lens: with [camera.lens] the displacement is right, without it the rim bends it."""

import json
from pathlib import Path

import numpy as np
import pytest

from midspan.cli.main import run
from midspan.errors import UsageError
from midspan.recording.calibrate import calibrate
from midspan.recording.estimate import estimate
from midspan.recording.streams.recording import open_recording
from midspan.recording.tracking.track import track
from midspan.simulate.motion.motion import Sines
from midspan.simulate.scene.camera import Camera
from midspan.simulate.scene.texture import textured_scene
from midspan.vision.lens import Lens, bent, straight

# The region's middle lies 77 px from the axis: 38° through this lens, as at the rim of an action camera.
LENS = Lens("pinhole", (100.0, 100.0, 59.5, 19.5), (-0.3, 0.1, 0.0, 0.0), (120, 190))
ROI = (28, 65, 64, 64)
SCALE_M_PER_PX = -1.5e-3
# Mostly slow, where the camera and not the accelerometer decides.
MOTION = Sines(np.array([14e-3, 4e-3, 2e-3]), np.array([0.25, 1.7, 2.9]), phase_rad=np.array([0.0, 1.0, 2.0]))
SECTION = f"\n[camera.lens]\nmatrix = {list(LENS.matrix)}\ndistortion = {list(LENS.distortion)}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """25 s at 10 frames/s: the target moves by the image, under the lens, of a straight ideal motion."""
    place = tmp_path_factory.mktemp("wide")
    rng = np.random.default_rng(3)
    time_s, frame_s = np.arange(0, 25, 0.01), np.arange(0, 24.8, 0.1)
    accel = MOTION.acceleration(time_s) + rng.normal(0, 2.5e-3, time_s.size)
    np.savetxt(place / "accel.csv", np.column_stack((time_s, accel)), delimiter=",", header="time_s,accel", comments="")
    middle = np.array([ROI[0] + 31.5, ROI[1] + 31.5])
    origin = straight(middle, LENS)[0][0]
    ideal = np.column_stack((np.zeros(frame_s.size), MOTION.displacement(frame_s) / SCALE_M_PER_PX))
    shown = bent(origin + ideal - ideal[0], LENS)[0] - middle
    scene, camera = textured_scene("natural", (190, 120), rng=rng), Camera()
    frames = np.array([camera.expose(scene.render(float(x), float(y)), rng=rng) for x, y in shown])
    np.savez(place / "camera.npz", frames=frames, time_s=frame_s)
    write(place, SECTION + "size = [120, 190]\n")
    return place


def write(place: Path, section: str) -> None:
    text = (
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n[camera]\nfile = "camera.npz"\n'
        f'roi = {list(ROI)}\ntracker = "template"\n{section}'
    )
    (place / "recording.toml").write_text(text, encoding="utf-8")


def run_of(place):
    recording = open_recording(place)
    calibration = calibrate(recording)
    result = estimate(recording, calibration=calibration).to_pandas()
    time_s = result.index.to_numpy(dtype=float)
    error = result["displacement_mm"].to_numpy() - 1e3 * MOTION.displacement(time_s)
    return calibration, error - error.mean()


def test_the_displacement_is_right_with_the_lens_and_bent_without(folder, tmp_path):
    calibration, error = run_of(folder)
    for name in ("accel.csv", "camera.npz"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    write(tmp_path, "")
    _, bare = run_of(tmp_path)
    # The scale factor is that of the ideal camera, to half a percent.
    assert calibration.camera.scale.value_m_per_px / SCALE_M_PER_PX == pytest.approx(1.0, abs=5e-3)
    assert np.sqrt(np.mean(error**2)) < 0.02
    assert np.sqrt(np.mean(bare**2)) > 3.0 * np.sqrt(np.mean(error**2))


def test_the_tracked_pixels_are_those_of_the_ideal_camera(folder):
    rows = track(folder).track
    frame_s = np.arange(0, 24.8, 0.1)
    ideal = (MOTION.displacement(frame_s) - MOTION.displacement(frame_s[:1])) / SCALE_M_PER_PX
    # One frame's noise is 0.004 px of the picture and 1.5 times that here; the zero is one frame.
    assert np.sqrt(np.mean((rows.y_px - ideal) ** 2)) < 0.02
    assert np.ptp(ideal) > 15.0


def test_frames_of_another_size_are_refused_with_both_sizes(folder, tmp_path, capsys):
    for name in ("accel.csv", "camera.npz"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    write(tmp_path, SECTION + "size = [1920, 1080]\n")
    assert run(["estimate", str(tmp_path), "--json"]) == 2
    message = json.loads(capsys.readouterr().out)["error"]
    for word in ("recording.toml", "1920x1080", "120x190", "midspan lens"):
        assert word in message
    assert not (tmp_path / "result.csv").exists()


def test_a_calibration_without_the_lens_is_refused(folder, tmp_path):
    calibration = calibrate(open_recording(folder))
    for name in ("accel.csv", "camera.npz"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    write(tmp_path, "")
    with pytest.raises(UsageError, match=r"camera\.lens.*[Cc]alibrate"):
        estimate(open_recording(tmp_path), calibration=calibration)
