"""A recording through a live point: the rows of `estimate`, kept once, and computed again from what was kept."""

import json
import shutil

import numpy as np
import pyarrow.parquet
import pytest

import midspan
from midspan.cli.main import run
from midspan.engine.sensors import CameraSensor
from midspan.errors import UsageError
from midspan.recording.run import records_of
from midspan.records import NANOSECONDS, Arrival, Readings
from midspan.service.journal import STD_STEP, STEP, VELOCITY_STEP
from midspan.service.opening import checkpoint, head_of, opened, resumed
from midspan.service.replay import point_name, replay
from midspan.service.stored_recording import instant, stored_table
from midspan.store.chunk import Chunk
from midspan.store.store import Batch, open_store


@pytest.fixture(scope="module")
def bridge(footbridge):
    """A recording and its calibration."""
    recording = midspan.open_recording(footbridge)
    return recording, midspan.calibrate(recording)


def replayed(bridge, folder, **options):
    recording, calibration = bridge
    store = open_store(folder)
    replay(recording, store, name="p", calibration=calibration, **options)
    return store


def check_values(table, result):
    """Rows are kept in whole steps, to the nearest one; deviations to the next one."""
    steps = {
        "displacement_mm": 0.5e3 * STEP,
        "displacement_std_mm": 1e3 * STD_STEP,
        "velocity_mm_s": 0.5e3 * VELOCITY_STEP,
    }
    for name, atol in steps.items():
        np.testing.assert_allclose(table.columns[name], getattr(result, name), rtol=1e-12, atol=atol)
    assert (table.columns["displacement_std_mm"] >= result.displacement_std_mm * (1 - 1e-12)).all()


@pytest.mark.parametrize(
    ("method", "literal"),
    [("kalman", False), ("lag", False), ("adaptive-kalman", False), ("adaptive-kalman", True), ("two-stage-fir", True)],
)
def test_the_rows_are_those_of_estimate(bridge, tmp_path, method, literal):
    known, calibration = bridge
    changed = known.settings.fusion.model_copy(update={"method": method, "literal": literal})
    recording = midspan.open_recording(known.folder)
    recording.settings = known.settings.model_copy(update={"fusion": changed})
    result = midspan.estimate(recording, calibration, method=method)
    store = replayed((recording, calibration), tmp_path, method=method)
    table = stored_table(store, "p", None, None)
    np.testing.assert_array_equal(table.time_ns, result.estimate.time_ns)
    check_values(table, result)
    np.testing.assert_array_equal(table.columns["status"], result.estimate.status)
    store.close()


def test_in_real_time_rows_are_as_late_as_frames_come(bridge, tmp_path):
    recording, calibration = bridge
    store = open_store(tmp_path)
    done = replay(recording, store, name="p", calibration=calibration, speed=4.0, length_s=6.0)
    store.close()
    # Samples wait for the next frame, which may be of an instant before theirs: 0.1 s at 10 Hz, four times as fast.
    assert 0.01 < done.from_frame.median_s < 0.1
    assert 0.005 < done.from_sample.median_s <= done.from_frame.of_95_s
    assert done.rows < 650


class Interrupted(BaseException):
    """Somebody pressed Ctrl-C."""


def test_an_interrupted_replay_leaves_the_store_as_it_was(bridge, tmp_path):
    recording, calibration = bridge
    store = open_store(tmp_path)
    whole = replayed(bridge, tmp_path / "whole")
    since_ns = int(recording.acceleration.time_ns[0])
    earlier = Chunk("p", "rows", since_ns - NANOSECONDS * np.arange(30, 0, -1), {"displacement_mm": np.arange(30.0)},
                    shown="displacement_mm")  # fmt: skip
    store.write(Batch([earlier]))
    before = [store.buckets("p", "rows", since_ns - 10**12, since_ns + 10**12, count) for count in (4, 400)]

    def impatient(done, _of, task):
        if task == "replaying" and done > 15:
            raise Interrupted

    with pytest.raises(Interrupted):
        replay(recording, store, name="p", calibration=calibration, progress=impatient)
    assert store.newest_ns("p", "rows") == since_ns - NANOSECONDS
    assert store.streams("p") == ["rows"]
    assert not store.calibrations("p")
    assert not store.events("p", 0, 2**62)
    for old, count in zip(before, (4, 400), strict=True):
        now = store.buckets("p", "rows", since_ns - 10**12, since_ns + 10**12, count)
        np.testing.assert_array_equal(now.low, old.low)
        np.testing.assert_array_equal(now.high, old.high)
    done = replay(recording, store, name="p", calibration=calibration)
    again, once = stored_table(store, "p", since_ns, None), stored_table(whole, "p", None, None)
    assert done.rows == len(once.time_ns)
    np.testing.assert_array_equal(again.columns["displacement_mm"], once.columns["displacement_mm"])
    store.close()
    whole.close()


def test_rows_end_with_the_last_measurement_however_early_it_is(gnss, tmp_path):
    for file in gnss.iterdir():
        if file.is_file():
            shutil.copy(file, tmp_path)
    heights = (tmp_path / "gnss.csv").read_text().splitlines(keepends=True)
    (tmp_path / "gnss.csv").write_text("".join(heights[:-7]))
    recording = midspan.open_recording(tmp_path)
    calibration = midspan.calibrate(recording)
    result = midspan.estimate(recording, calibration, method="kalman")
    store = replayed((recording, calibration), tmp_path / "store")
    table = stored_table(store, "p", None, None)
    assert recording.acceleration.time_ns[-1] - result.estimate.time_ns[-1] > 6 * NANOSECONDS
    np.testing.assert_array_equal(table.time_ns, result.estimate.time_ns)
    check_values(table, result)
    store.close()


@pytest.mark.parametrize("method", ["smoother", "kalman"])
def test_what_was_kept_gives_the_same_result_again(bridge, tmp_path, method):
    recording, calibration = bridge
    replayed(bridge, tmp_path / "store").close()
    output = tmp_path / "again.parquet"
    assert run(["estimate", str(tmp_path / "store"), "--method", method, "-o", str(output), "--quiet"]) == 0
    found = pyarrow.parquet.read_table(output)["displacement_mm"].to_numpy()
    expected = midspan.estimate(recording, calibration, method=method).displacement_mm
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def test_a_segment_can_be_exported_and_computed(bridge, tmp_path):
    replayed(bridge, tmp_path / "store").close()
    store, output = str(tmp_path / "store"), tmp_path / "part.parquet"
    assert run(["export", store, "--from", "5", "--to", "1970-01-01T00:00:12Z", "-o", str(output), "--quiet"]) == 0
    time_s = pyarrow.parquet.read_table(output)["time_s"].to_numpy()
    assert time_s[0] == 5.0
    assert time_s[-1] == 12.0
    again = ["estimate", store, "--from", "5", "--to", "20", "-o", str(output), "--quiet"]
    assert run(again) == 0
    time_s = pyarrow.parquet.read_table(output)["time_s"].to_numpy()
    assert 5.0 <= time_s[0] < 5.5
    assert time_s[-1] <= 20.0


def test_rows_are_never_overwritten(bridge, tmp_path, capsys):
    recording, calibration = bridge
    store = replayed(bridge, tmp_path)
    with pytest.raises(UsageError, match="another name"):
        replay(recording, store, name="p", calibration=calibration)
    replay(recording, store, name="q", calibration=calibration)
    assert store.points == ["p", "q"]
    store.close()
    assert run(["export", str(tmp_path), "-o", str(tmp_path / "x.csv")]) == 2
    assert "--point must be one of p, q" in capsys.readouterr().err


@pytest.mark.parametrize(("cut_s", "later_s"), [(3.0, 1.5), (11.3, 7.0), (19.9, 1.5)])
def test_a_point_goes_on_from_its_checkpoint_with_the_same_rows(bridge, footbridge, tmp_path, cut_s, later_s):
    _, calibration = bridge
    whole = opened(footbridge, "p", calibration, 1)
    expected = whole.journal.batch()
    # Another one is given the same records, is kept in the middle, and ends later than it was kept.
    store = open_store(tmp_path)
    first = opened(footbridge, "p", calibration, 1, push=False)
    kept = None
    for stream, arrival in arrivals(first, footbridge, calibration):
        stamp_ns = newest(arrival)
        if stamp_ns > (cut_s + later_s) * NANOSECONDS:
            break
        if kept is None and stamp_ns > cut_s * NANOSECONDS:
            store.write(first.journal.batch())
            kept = b"".join(checkpoint(first, footbridge))
        first.counts[stream] = first.counts.get(stream, -1) + 1
        first.newest_ns[stream] = max(stamp_ns, first.newest_ns.get(stream, stamp_ns))
        first.journal.arrived(arrival)
        first.journal.given(first.point.push(arrival))
    store.write(first.journal.batch())
    assert head_of(kept)["calibration"] == 1
    second = opened(footbridge, "p", calibration, 1, push=False)
    resumed(second, kept, store)
    last_ns = dict(second.newest_ns)
    for stream, arrival in arrivals(first, footbridge, calibration):
        later = after(arrival, last_ns[stream])
        if later is not None:
            second.journal.arrived(later)
            second.journal.given(second.point.push(later))
    second.journal.given(second.point.finish())
    store.write(second.journal.batch())
    found = stored_table(store, "p", None, None)
    rows = next(one for one in expected.chunks if one.stream == "rows")
    same = np.isin(found.time_ns, rows.time_ns)
    np.testing.assert_array_equal(found.time_ns[same], rows.time_ns)
    apart = np.abs(found.columns["displacement_mm"][same] - 1e3 * rows.columns["displacement_m"])
    assert apart[rows.time_ns <= last_ns["accelerometer"] - NANOSECONDS // 2].max() == 0.0
    # The camera's tracker was kept before its last frames: what it finds later differs by parts of its noise.
    assert np.all(apart < found.columns["displacement_std_mm"][same])
    store.close()


def arrivals(found, folder, calibration):
    """The records of a recording as live ones, with the frames as they are."""
    from midspan.recording.estimate import Asked
    from midspan.recording.tracked import open_tracked_cameras

    recording = midspan.open_recording(folder)
    sides = Asked(recording, calibration, "kalman", True).sides
    tracked_cameras = open_tracked_cameras(sides, None, lambda *_: None)
    assert any(isinstance(sensor, CameraSensor) for sensor in found.point.sensors.values())
    for stream, record in records_of(found.point, sides, tracked_cameras, block_s=0.1):
        if isinstance(record, Arrival):
            yield stream, record


def newest(arrival):
    record = arrival.record
    return int(record.time_ns[-1]) if isinstance(record, Readings) else int(record.time_ns)


def after(arrival, last_ns):
    """The part of a record after a stamp, None where there is nothing of it."""
    record = arrival.record
    if isinstance(record, Readings):
        later = record.time_ns > last_ns
        return Arrival(arrival.stream, 0, Readings(record.time_ns[later], record.value[later])) if later.any() else None
    return arrival if record.time_ns > last_ns else None


@pytest.mark.parametrize(
    ("text", "expected"),
    [("0.25", 250_000_000), ("-1.5", -1_500_000_000), ("1970-01-01T00:00:01Z", NANOSECONDS), ("1970-01-01", 0)],
)
def test_instants(text, expected):
    assert instant(text, "--from") == expected


def test_an_instant_that_is_none_is_named():
    with pytest.raises(UsageError, match="--to: must be an instant"):
        instant("noon", "--to")


def test_names_and_metadata(bridge, tmp_path):
    assert point_name("bridge, quarter span") == "bridge--quarter-span"
    store = replayed(bridge, tmp_path)
    metadata = stored_table(store, "p", None, None).metadata
    assert metadata["calibrations"][0]["number"] == 1
    assert "camera" in metadata["calibrations"][0]
    assert json.dumps(metadata)
    store.write(Batch())
    store.close()
