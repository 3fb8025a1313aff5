"""Films from physics next to an accelerometer: torn frames, frames without values, and where the zero lies."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

import midspan
from midspan.errors import DataError
from midspan.records import Status
from repeats import slow

SIDE, RATE_HZ, PX_PER_MM = 150, 30.0, 0.5
SIZE_MM, TURN, PHASE = np.array([6.0, 2.0, 3.0]), 2.0 * np.pi * np.array([0.8, 2.1, 0.3]), np.array([0.7, 1.0, 0.0])
ROI = (25, 25, 100, 100)


def moved_mm(time_s):
    return np.sin(np.multiply.outer(time_s, TURN) + PHASE) @ SIZE_MM


def film(time_s, seed=3, noise=1.5, moved_mm=moved_mm):
    """Frames (n, rows, columns) uint8 of a wall that moves down with the motion, with noise in grey levels."""
    rng = np.random.default_rng(seed)
    wall = gaussian_filter(rng.normal(size=(280, 280)), 1.6)
    wall = spline_filter(128.0 + 40.0 * wall / np.std(wall), 3)
    rows, columns = np.mgrid[:SIDE, :SIDE] + 65.0
    seen = [map_coordinates(wall, [rows + PX_PER_MM * one, columns], prefilter=False) for one in moved_mm(time_s)]
    return np.clip(np.rint(seen + rng.normal(0.0, noise, (len(time_s), SIDE, SIDE))), 0, 255).astype(np.uint8)


def recording(folder, time_s, frames):
    rng, sampled_s = np.random.default_rng(4), np.arange(0.0, time_s[-1] - 1.0, 0.01)
    value = -1e-3 * np.sin(np.multiply.outer(sampled_s, TURN) + PHASE) @ (SIZE_MM * TURN**2)
    table = np.column_stack((sampled_s, value + rng.normal(0.0, 5e-3, len(sampled_s))))
    np.savetxt(folder / "accel.csv", table, "%.6f", ",", header="time_s,accel", comments="")
    np.save(folder / "film.npy", frames)
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n[camera]\nfile = "film.npy"\n'
        f'rate_hz = {RATE_HZ}\nstart_s = {time_s[0]}\ndirection = "y"\nroi = {list(ROI)}\n'
    )
    return folder


@pytest.mark.parametrize(
    ("part", "tracker"), [(0.3, "registration"), (0.5, "features"), *slow((0.7, "registration"), (0.7, "features"))]
)
def test_torn_frames_are_not_measured_and_those_after_them_are(part, tracker, tmp_path):
    # The lower part of the picture stands still for a second, as where packets of a camera are lost.
    time_s = np.arange(0.0, 5.0, 1.0 / RATE_HZ)
    frames, first, last = film(time_s), 60, 90
    row = round(SIDE * (1.0 - part))
    frames[first:last, row:] = frames[first - 1, row:]
    np.save(tmp_path / "film.npy", frames)
    tracked = midspan.track(tmp_path / "film.npy", rate_hz=RATE_HZ, roi=ROI, tracker=tracker)
    moved, track = -PX_PER_MM * (moved_mm(time_s) - moved_mm(time_s[:1])), tracked.track
    assert np.isnan(track.y_px[first:last]).all()
    whole = np.delete(np.arange(len(time_s)), slice(first, last))
    assert np.max(np.abs(track.y_px - moved)[whole] / np.sqrt(track.variance_y_px2[whole])) < 5.0
    assert any(line.code == "frozen" and "30 frames" in line for line in tracked.warnings)


def test_torn_frames_are_found_by_a_camera_of_little_noise_and_where_the_motion_ends(tmp_path):
    def stops_mm(time_s):
        return np.where(time_s < 2.2, moved_mm(time_s), moved_mm(np.array([2.2])) + 0.03 * np.sin(3.0 * time_s))

    time_s = np.arange(0.0, 5.0, 1.0 / RATE_HZ)
    for torn in (0, 40):
        frames = film(time_s, noise=0.2, moved_mm=stops_mm)
        frames[60 : 60 + torn, 75:] = frames[59, 75:]
        np.save(tmp_path / "film.npy", frames)
        track = midspan.track(tmp_path / "film.npy", rate_hz=RATE_HZ, roi=ROI).track
        assert np.array_equal(np.flatnonzero(np.isnan(track.y_px)), np.arange(60, 60 + torn))


def test_torn_frames_are_bridged_by_the_accelerometer(tmp_path):
    time_s = np.arange(0.0, 25.0, 1.0 / RATE_HZ)
    frames = film(time_s)
    frames[300:330, 60:] = frames[299, 60:]
    result = midspan.estimate(recording(tmp_path, time_s, frames))
    error = result.displacement_mm - (moved_mm(result.time_s) - moved_mm(time_s[:1]))
    assert np.max(np.abs(error) / result.displacement_std_mm) < 5.0
    assert np.max(result.displacement_std_mm) < 0.3


@pytest.mark.parametrize(("start_s", "first"), [(-1.21, 37), (-0.45, 0), *slow((0.4, 0))])
def test_the_zero_is_the_films_first_frame_unless_it_begins_long_before_the_acceleration(start_s, first, tmp_path):
    time_s = start_s + np.arange(0.0, 20.0, 1.0 / RATE_HZ)
    result = midspan.estimate(recording(tmp_path, time_s, film(time_s)))
    error = result.displacement_mm - (moved_mm(result.time_s) - moved_mm(time_s[first : first + 1]))
    assert np.max(np.abs(error) / result.displacement_std_mm) < 5.0


def test_frames_without_values_have_lost_rows(tmp_path):
    time_s = np.arange(0.0, 2.0, 1.0 / RATE_HZ)
    frames = film(time_s).astype(np.float32)
    frames[20:23] = np.nan
    np.save(tmp_path / "film.npy", frames)
    tracked = midspan.track(tmp_path / "film.npy", rate_hz=RATE_HZ, roi=ROI)
    assert np.allclose(tracked.track.time_ns / 1e9, time_s, atol=1e-6)
    assert np.array_equal(np.flatnonzero(np.isnan(tracked.track.y_px)), [20, 21, 22])
    assert np.array_equal(np.flatnonzero(tracked.track.status == Status.LOST), [20, 21, 22])
    assert any("3 frames (20, 21, 22)" in line for line in tracked.warnings)


def test_frames_of_no_real_numbers_are_refused():
    frame = film(np.zeros(1))[0]
    for kind in (complex, object):
        with pytest.raises(DataError, match="real numbers"):
            midspan.open_tracker("registration", midspan.Frame(0, frame.astype(kind)), ROI)
