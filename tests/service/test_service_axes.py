"""A live point along both image axes is two points, and the rows of each hold the truth along its axis."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

import midspan
from midspan.engine.point import PointStatus
from midspan.errors import DataError
from midspan.recording.streams.recording import open_recording
from midspan.records import NANOSECONDS, Arrival, Readings
from midspan.service.calibrations import loaded, number_in_force
from midspan.service.intake import Intake
from midspan.service.opening import opened
from midspan.service.point import Phase
from midspan.service.replayed import readings
from midspan.service.running import running
from midspan.settings.site import load_site
from midspan.simulate.scenarios.table import sideways
from midspan.store.store import open_store
from recording_edits import read_columns, set_keys

SITE = """
name = "site"
[store]
path = "store"
[[point]]
name = "deck"
calibration_s = 12
{more}
[point.accelerometer]
source = "replay:recording"
[point.camera]
source = "replay:recording"
direction = "xy"
"""
# Of the footbridge's rows at 10 frames a second, as for one axis: a frame is good for 0.006 mm.
RMS_MM = 0.03


@pytest.fixture(scope="module")
def bridge(simulated):
    """A footbridge that moves down and sideways, with an accelerometer of two axes."""
    return simulated("two axes", across=sideways)


@pytest.fixture
def folder(bridge, tmp_path):
    shutil.copytree(bridge, tmp_path / "recording")
    return tmp_path


def points_of(folder, more=""):
    (folder / "SITE.toml").write_text(SITE.format(more=more))
    return [running(plan, folder / plan.name, folder) for plan in load_site(folder / "SITE.toml").points]


def arrivals(points, folder):
    """The records that each point is given, by its name, in the order of their stamps."""
    intake = Intake(points, folder, lambda _one: None, lambda _one, _kind, _text: None)
    film, own = list(open_recording(folder / "recording").frames.frames()), {}
    first_ns = int(open_recording(folder / "recording").acceleration.time_ns[0])
    for at, source in intake._sources.items():
        begin_ns = int(at.rpartition("@")[2].partition("#")[0])
        for one, name in source.users:
            if name == "camera":
                records = [replace(frame, time_ns=frame.time_ns - first_ns + begin_ns) for frame in film]
            else:
                records = [record for _, record in readings(at)]
            own.setdefault(one.name, []).extend(Arrival(name, 0, record) for record in records)
    return {name: sorted(found, key=lambda one: (one.newest_ns, one.stream)) for name, found in own.items()}, begin_ns


def lived(live, records, calibration=None):
    """Push everything, doing the point's jobs at once; returns its rows."""
    for arrival in records:
        live.push(arrival)
        if live.job is not None and live.job.kind == "calibrate":
            calibration = midspan.calibrate(live.job.folder)
            live.calibrated(1)
        elif live.job is not None:
            live.is_opened(opened(live.job.folder, live.name, calibration, 1))
    assert (live.phase, live.status) == (Phase.RUNNING, PointStatus.TRACKING)
    rows = [one for one in live.batch().chunks if one.stream == "rows"]
    time_ns = np.concatenate([one.time_ns for one in rows])
    return time_ns, *(np.concatenate([one.columns[name] for one in rows]) for name in ("displacement_m", "std_m"))


def check(rows, folder, column, begin_ns):
    """The rows hold the truth, from the zero of the frames that the point was opened from."""
    time_ns, value, std = rows
    truth = read_columns(folder / "recording" / "truth.csv")
    error = 1e3 * value - np.interp((time_ns - begin_ns) / NANOSECONDS, truth[:, 0], truth[:, column])
    # The velocity is not known at first.
    sharp = std < 2.0 * np.median(std)
    error -= np.average(error[sharp], weights=std[sharp] ** -2.0)
    assert np.count_nonzero(sharp) > 500
    assert np.sqrt(np.mean(error[sharp] ** 2)) < RMS_MM
    assert np.mean(np.abs(error) < 1.96e3 * std) > 0.9


def test_both_axes_hold_the_truth_and_share_what_they_are_measured_with(folder):
    points = points_of(folder)
    assert [one.name for one in points] == ["deck", "deck-x"]
    assert [one.live.plan.axis for one in points] == ["y", "x"]
    records, begin_ns = arrivals(points, folder)
    # One camera for both; the accelerations are two.
    intake = Intake(points, folder, lambda _one: None, lambda _one, _kind, _text: None)
    assert sorted(len(source.users) for source in intake._sources.values()) == [1, 1, 2]
    for one, column in zip(points, (1, 3), strict=True):
        check(lived(one.live, records[one.name]), folder, column, begin_ns)


def test_each_axis_takes_its_own_part_of_a_calibration_of_both(folder):
    whole = midspan.calibrate(folder / "recording")
    whole.save(folder / "both.json")
    points, scales = points_of(folder, 'calibration = "both.json"'), []
    records, begin_ns = arrivals(points, folder)
    for one in points:
        store = open_store(folder / "store")
        one.live.number = number_in_force(one.live, store, folder)
        calibration = loaded(one.live, store)
        store.close()
        scales.append(calibration.camera.scale.value_m_per_px)
        assert calibration.direction == one.live.plan.axis
    check(lived(one.live, records[one.name], calibration), folder, 3, begin_ns)
    both = [one.camera.scale.value_m_per_px for one in (whole, whole.across)]
    # As many digits as the file has.
    assert scales == pytest.approx(both, rel=1e-6)


def test_a_calibration_without_the_axis_is_refused(folder):
    set_keys(folder / "recording", "accelerometer", value_x=None)
    midspan.calibrate(folder / "recording").save(folder / "one.json")
    set_keys(folder / "recording", "accelerometer", value_x="accel_x")
    points = points_of(folder, 'calibration = "one.json"')
    store = open_store(folder / "store")
    assert number_in_force(points[0].live, store, folder) == 1
    with pytest.raises(DataError, match=r"one.json: has no scale factor along x: too little motion, or no"):
        number_in_force(points[1].live, store, folder)
    store.close()


def test_a_replayed_accelerometer_is_the_one_along_the_points_axis(folder):
    """Of a recording with both axes a point along x was given the acceleration along y."""
    (folder / "SITE.toml").write_text(SITE.format(more="").replace('direction = "xy"', 'direction = "x"'))
    (one,) = (running(plan, folder / plan.name, folder) for plan in load_site(folder / "SITE.toml").points)
    records, _ = arrivals([one], folder)
    own = np.concatenate([r.record.value[:, 0] for r in records["deck"] if isinstance(r.record, Readings)])
    recording = open_recording(folder / "recording")
    np.testing.assert_array_equal(own, recording.across.acceleration.value)
