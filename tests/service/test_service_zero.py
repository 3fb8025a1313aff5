"""A point that is opened again keeps its zero, gives no row twice and leaves none out; what waits for it is whole."""

from dataclasses import replace

import numpy as np
import pytest

import midspan
from lively_recordings import Lively, _film
from midspan.records import NANOSECONDS, Arrival, Frame, Readings, Region, Status
from midspan.service.capture import capture_settings
from midspan.service.feeding import Waiting
from midspan.service.opening import opened
from midspan.service.point import LivePoint
from midspan.service.stored_recording import stored_table
from midspan.settings.site import load_site
from midspan.store.store import open_store

SITE = """
name = "site"
[store]
path = "store"
[[point]]
name = "p"
calibration_s = 12
[point.accelerometer]
source = "serial:/dev/none"
[point.camera]
source = "rtsp://127.0.0.1:1/none"
direction = "y"
roi = [18, 18, 48, 48]
"""
BEGIN_NS = 1_790_000_000 * NANOSECONDS
# The slow part is elsewhere by millimetres when the point is opened again.
CASE = Lively(tones=((3e-3, 0.02), (1.5e-3, 2.1), (1e-3, 3.3)), duration_s=56.0)
# The first opening takes this long, s: 22 s of frames wait.
OPENING_S = 22.0


def arrivals():
    """(when it comes in s, record): blocks of 0.2 s of acceleration and ten frames a second."""
    rng = np.random.default_rng(0)
    film = _film(CASE, rng)
    film = np.clip(np.rint(film + rng.normal(0.0, 1.0, film.shape)), 0, 255).astype(np.uint8)
    time_s = np.arange(round(100 * CASE.duration_s)) / 100.0
    value = CASE.motion(time_s, 2) + CASE.bias_m_s2 + rng.normal(0.0, CASE.noise_m_s2, len(time_s))
    time_ns = BEGIN_NS + np.rint(time_s * NANOSECONDS).astype(np.int64)
    found = [
        (time_s[k + 19], Arrival("accelerometer", 0, Readings(time_ns[k : k + 20], value[k : k + 20, None])))
        for k in range(0, len(time_s), 20)
    ]
    found += [
        (at_s, Arrival("camera", 0, Frame(BEGIN_NS + round(at_s * NANOSECONDS), frame)))
        for at_s, frame in zip(CASE.met_s.tolist(), film, strict=True)
    ]
    return sorted(found, key=lambda one: one[0])


@pytest.fixture(scope="module")
def lived(tmp_path_factory):
    """A store with all that a point gave that was opened twice, and what each batch had."""
    folder = tmp_path_factory.mktemp("zero")
    (folder / "SITE.toml").write_text(SITE)
    (plan,) = load_site(folder / "SITE.toml").points
    point = LivePoint(plan, capture_settings(plan.recording, {}), folder / "captures", follows=True)
    store, calibration, due_s = open_store(folder / "store"), None, np.inf
    for at_s, arrival in arrivals():
        point.push(arrival)
        point.tick(BEGIN_NS + round(at_s * NANOSECONDS))
        if point.job is not None and point.job.kind == "calibrate":
            calibration = midspan.calibrate(point.job.folder)
            point.calibrated(1)
        elif point.job is not None and due_s == np.inf:
            due_s = at_s + (1.0 if point.number == 2 else OPENING_S)
        elif point.job is not None and at_s >= due_s:
            point.is_opened(opened(point.job.folder, "p", calibration, point.number))
            due_s = np.inf
        if at_s > 42.0 and point.number == 1:
            point.calibrated(2)
        if round(at_s * 100) % 100 == 0:
            store.write(point.batch())
    store.write(point.batch(last=True))
    yield store
    store.close()


def test_the_zero_is_kept_where_a_point_is_opened_again(lived):
    events = lived.events("p", 0, 2**62)
    (zero,) = [event for event in events if event.kind == "zero"]
    rows = stored_table(lived, "p", None, None)
    error = rows.columns["displacement_mm"] - 1e3 * CASE.motion((rows.time_ns - BEGIN_NS) / NANOSECONDS)
    before = rows.time_ns <= zero.time_ns
    assert min(np.count_nonzero(before), np.count_nonzero(~before)) > 500
    std = rows.columns["displacement_std_mm"]
    step = error[~before].mean() - error[before].mean()
    # The zeros are 2 mm apart. What is left is the deviation of the rows that are compared, some 0.01 mm.
    assert abs(step) < 3.0 * np.median(std[~before])
    assert np.median(std[~before]) < 1.5 * np.median(std[before])
    assert abs(float(zero.text.split("by ")[1].split(" ")[0])) > 1.0
    assert [event.time_ns for event in events if event.kind == "new_datum"] == [rows.time_ns[0]]


def test_no_row_and_no_frame_is_left_out_while_a_point_is_opened(lived):
    rows = stored_table(lived, "p", None, None)
    assert set(np.diff(rows.time_ns).tolist()) == {10**7}
    assert set(rows.columns["status"].tolist()) == {Status.TRACKING}
    frames = np.concatenate([one.time_ns for one in lived.chunks("p", "camera:0", 0, 2**62)])
    assert set(np.rint(np.diff(frames) / 1e8).tolist()) == {1.0}
    assert not {event.kind for event in lived.events("p", 0, 2**62)} & {"gap", "late", "lost"}


def test_an_export_across_a_new_zero_counts_the_zeros(lived):
    rows = stored_table(lived, "p", None, None)
    assert "datum" not in rows.columns
    middle_ns = int(rows.time_ns[1000])
    # The store is shared with the other tests, whichever of them comes first.
    lived._site.execute("BEGIN")
    lived._site.execute("INSERT INTO event VALUES ('p', ?, 'new_datum', '', 0)", (middle_ns,))
    counted = stored_table(lived, "p", None, None).columns["datum"]
    lived._site.execute("ROLLBACK")
    assert counted[999] + 1 == counted[1000] == counted[-1]


def test_frames_that_wait_keep_what_is_needed_and_the_oldest_make_room(tmp_path, monkeypatch):
    rng, waiting = np.random.default_rng(0), Waiting(tmp_path)
    waiting.regions = {"camera": Region(3, 4, 10, 8)}
    films = [rng.integers(0, 256, (30, 40), dtype=np.uint8) for _ in range(9)]
    monkeypatch.setattr("midspan.service.feeding.MAX_BYTES", 6 * 80)
    for k, pixels in enumerate(films):
        waiting.append(Arrival("camera", k, Frame(k, pixels, k)))
        waiting.append(Arrival("a", k, Readings(np.array([k]), np.zeros((1, 1)))))
    assert waiting.dropped == 3
    found = [waiting.popleft() for _ in range(len(waiting))]
    frames = [one for one in found if one.stream == "camera"]
    assert [one.record.index for one in frames] == list(range(3, 9))
    assert [one.sequence for one in found if one.stream == "a"] == list(range(9))
    for one in frames:
        assert one.record.pixels.shape == (30, 40)
        np.testing.assert_array_equal(one.record.pixels[4:12, 3:13], films[one.record.index][4:12, 3:13])
    waiting.append(replace(frames[0], sequence=99))
    assert waiting.popleft().sequence == 99
    assert not list(tmp_path.iterdir())
