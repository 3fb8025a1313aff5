"""What is wrong with a thermal camera's times or range is said with what was found and what to look at."""

import numpy as np
import pytest

import midspan
from midspan.errors import DataError, UsageError
from recording_edits import set_keys


@pytest.fixture
def folder(tmp_path):
    """A recording of 12 s whose infrared camera saw a wall at rest, five frames a second."""
    rng = np.random.default_rng(1)
    time_s = np.arange(0.0, 12.0, 0.01)
    table = np.column_stack((time_s, rng.normal(0.0, 0.02, len(time_s))))
    np.savetxt(tmp_path / "accel.csv", table, delimiter=",", header="time_s,accel", comments="")
    wall = np.kron(rng.normal(15.0, 1.5, (12, 14)), np.ones((4, 4)))
    np.save(tmp_path / "infrared.npy", (wall + rng.normal(0.0, 0.05, (55, 48, 56))).astype(np.float32))
    (tmp_path / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n\n'
        '[infrared]\nfile = "infrared.npy"\nrate_hz = 5.0\nroi = [8, 8, 40, 32]\n\n',
        encoding="utf-8",
    )
    return tmp_path


def refused(folder, error):
    with pytest.raises(error) as reported:
        midspan.estimate(midspan.open_recording(folder))
    return str(reported.value)


def test_frames_that_last_less_than_a_second_are_no_matter_of_clocks(folder):
    np.save(folder / "infrared.npy", np.load(folder / "infrared.npy")[:4])
    text = refused(folder, DataError)
    assert "infrared must last 1 s or more; it has 4 time stamps from 0.000 s to 0.600 s" in text
    assert "clocks" not in text


def test_times_in_milliseconds_are_reported_by_their_distance(folder):
    np.savetxt(folder / "times.csv", 200.0 * np.arange(55), header="time_s", comments="")
    set_keys(folder, "infrared", times="times.csv")
    text = refused(folder, DataError)
    assert "infrared: only 1 of its 55 frames overlap the acceleration" in text
    assert "200 s apart" in text
    assert "in s" in text


def test_a_range_without_the_target_in_it_is_refused_by_its_own_name(folder):
    set_keys(folder, "infrared", temperature_range_c=[80.0, 90.0])
    text = refused(folder, UsageError)
    assert "infrared.temperature_range_c must be a range in °C that contains the target's temperatures" in text
    assert "[80.0, 90.0]" in text


def test_what_was_mended_is_reported_with_what_was_tracked(folder):
    stack = np.load(folder / "infrared.npy")
    stack[:, 20, 20] = np.nan
    stack[30] = np.nan
    np.save(folder / "infrared.npy", stack)
    from midspan.recording.tracking.track import track

    found = track(folder)
    assert len(found.track.time_ns) == 55
    assert np.isnan(found.track.x_px[30])
    reported = " ".join(found.warnings)
    assert "infrared: 54 frames have missing values (NaN), at most 1 a frame, filled" in reported
    assert "infrared: 1 frames (30) have more than 20 % of their values missing (NaN) and were skipped." in reported
