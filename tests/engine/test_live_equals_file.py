"""The number from the file is the number live: a point fed record by record gives the rows of `estimate`, bit for bit.

Record by record means: each stream in its own order, the streams in any interleaving, blocks cut anywhere, and in the
middle the state as bytes put into a point that was built anew.
"""

import itertools
import shutil
from dataclasses import replace
from functools import cache

import av
import numpy as np
import pytest

import midspan
from lively_recordings import Lively, add_gyroscope, add_velocity, write, write_several
from midspan.engine.checkpoint import from_bytes, to_bytes
from midspan.engine.point import ACCELEROMETER, PointState
from midspan.fusion.estimator import Estimator, Lag
from midspan.progress import silent
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.estimate import Asked
from midspan.recording.point import radar_frames
from midspan.recording.run import Outcome, run
from midspan.recording.streams.recording import Recording
from midspan.recording.tracked import open_tracked_cameras
from midspan.records import Arrival, Estimate, Readings, Tracked, part
from midspan.simulate.scenarios.stage import CameraSetup
from midspan.simulate.scenarios.table import SCENARIOS
from midspan.simulate.scenarios.write import write as write_scenario
from recording_edits import append, set_keys
from repeats import slow

LIVELY = Lively(duration_s=14.0, band_hz=(1.0, 3.0), rms_m=2e-3)
METHODS = ("kalman", "lag")


def plain(folder):
    return write(folder, LIVELY, "camera")


def compressed(folder):
    """The film as H.264, as cameras store it."""
    film = np.load(write(folder, LIVELY, "camera") / "camera.npy")
    with av.open(str(folder / "camera.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"crf": "23", "bf": "0"})
        stream.height, stream.width, stream.pix_fmt = *film.shape[1:], "yuv420p"
        for picture in film:
            for packet in stream.encode(av.VideoFrame.from_ndarray(picture, format="gray")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    set_keys(folder, "camera", file="camera.mp4")
    return folder


def frozen(folder):
    """Six equal frames while the structure moves, and two that are black."""
    film = np.load(write(folder, LIVELY, "camera") / "camera.npy")
    film[80:86], film[100:102] = film[80], 0
    np.save(folder / "camera.npy", film)
    return folder


def two_targets(folder):
    write(folder, LIVELY, "camera")
    set_keys(folder, "camera", roi=None)
    append(folder, "".join(f'[[camera.target]]\nname = "{k}"\nroi = [{x}, 18, 34, 48]\n' for k, x in ((1, 6), (2, 44))))
    return folder


def tilting(folder):
    """Targets one above the other, the lower one more than three times as far, before a camera that tilts."""
    near = replace(LIVELY, nods=(0.4, 0.13))
    film = np.load(write(folder, near, "camera") / "camera.npy")
    far = np.load(write(folder.parent / "far", replace(near, mm_per_px=-5.0), "camera") / "camera.npy")
    # Turned about its upright middle it is another pattern, with noise of its own.
    np.save(folder / "camera.npy", np.concatenate((film, far[:, :, ::-1]), axis=1))
    set_keys(folder, "camera", roi=None)
    regions = (("near", 18), ("far", 18 + film.shape[1]))
    append(folder, "".join(f'[[camera.target]]\nname = "{name}"\nroi = [18, {y}, 48, 48]\n' for name, y in regions))
    return folder


def infrared(folder):
    return write(folder, LIVELY, "infrared")


def day_and_night(folder):
    """A camera that sees nothing from 8 s to 10.5 s, and a thermal one half a picture later."""
    film = np.load(write(folder, LIVELY, "camera") / "camera.npy")
    film[70:95] = film[70:95] // 64
    np.save(folder / "camera.npy", film)
    lines = (write(folder.parent / "other", replace(LIVELY, first_s=1.05), "infrared") / "recording.toml").read_text()
    (folder.parent / "other" / "infrared.npz").rename(folder / "infrared.npz")
    append(folder, lines[lines.index("[infrared]") :])
    return folder


def slow_and_late(folder):
    """Displacement twice a second, its clock 0.4 s late, a value that is missing and a gap in the acceleration."""
    write(folder, replace(LIVELY, rate_hz=2.0, duration_s=30.0), "displacement")
    set_keys(folder, "displacement", estimate_offset=True)
    head, *rows = (folder / "slow.csv").read_text().splitlines()
    rows = [f"{float(time) + 0.4:.9f},{value}" for time, value in (row.split(",") for row in rows)]
    rows[20] = rows[20].split(",")[0] + ","
    (folder / "slow.csv").write_text("\n".join([head, *rows]) + "\n")
    head, *rows = (folder / "accel.csv").read_text().splitlines()
    (folder / "accel.csv").write_text("\n".join([head, *rows[:400], *rows[460:]]) + "\n")
    return folder


def averaging(folder):
    """Displacement of which each value is a mean over almost its interval: samples wait for half of that."""
    write(folder, replace(LIVELY, rate_hz=5.0, duration_s=30.0), "displacement")
    set_keys(folder, "displacement", exposure_s=0.17)
    return folder


def radar(folder):
    """Fifty frames a second of a motion that turns the phase by up to a cycle a frame, hidden for a second."""
    write(folder, replace(LIVELY, rate_hz=50.0, band_hz=(2.0, 3.0), rms_m=4e-3), "radar")
    frames = np.load(folder / "radar.npy")
    frames[300:350] *= 0.01
    np.save(folder / "radar.npy", frames)
    return folder


CASES = {
    "lossless": plain,
    "crf 23": compressed,
    "frozen": frozen,
    "two targets": two_targets,
    "tilting": tilting,
    "infrared": infrared,
    "day and night": day_and_night,
    "displacement": slow_and_late,
    "radar": radar,
}


class Site:
    """A recording, its calibration, and points made of it again and again.

    given: the calibration counts as one that was given; literal: method, trackers and calibration are as printed.
    """

    def __init__(self, folder, given=True, literal=False):
        self.folder, self.given, self.literal = folder, given, literal
        self.calibration, self.tracking = calibrate_and_track(self.recording(), silent)

    def recording(self, method="adaptive-kalman"):
        if not self.literal:
            return midspan.open_recording(self.folder)
        recording = midspan.open_recording(self.folder, fusion={"literal": True, "method": method})
        return Recording(recording.file, recording.settings.calibrated_as_printed())

    def opened(self, method, tracking=None):
        """The point before its first record, and what it is made of."""
        asked = Asked(self.recording(method), self.calibration, method, self.given)
        tracked_cameras = open_tracked_cameras(asked.sides, tracking, silent)
        return asked.point(asked.sides, tracked_cameras), asked.sides, tracked_cameras


def records(point, sides, tracked_cameras, rng):
    """The arrivals of each stream in their order, readings in blocks of any size."""
    recording = sides[0].recording
    value = np.column_stack([side.recording.acceleration.value for side in sides if side.recording.fused])
    streams = {ACCELEROMETER: blocks(recording.acceleration.time_ns, value, rng)}
    for view in recording.views:
        if view.kind == "displacement":
            series = view.displacement
            streams[view.sensor] = blocks(series.time_ns, series.value[:, None], rng)
        if view.kind == "radar":
            streams[view.sensor] = list(radar_frames(view, point.sensors[view.sensor]))
    for kind, series in recording.auxiliary.items():
        streams[kind] = blocks(series.time_ns, series.value[:, None], rng)
    for tracked_camera in tracked_cameras:
        times = tracked_camera.tracking.time_ns[: tracked_camera.tracking.done].tolist()
        found = [
            Tracked(t, t, tuple(one.translation(k) for one in tracked_camera.tracking.targets))
            for k, t in enumerate(times)
        ]
        streams[tracked_camera.sensor] = [*found, *iter(tracked_camera.tracking.take, None)]
    return {name: [Arrival(name, k, one) for k, one in enumerate(own)] for name, own in streams.items()}


def blocks(time_ns, value, rng):
    cuts = np.sort(rng.integers(0, len(time_ns) + 1, len(time_ns) // 15))
    return [Readings(t, v) for t, v in zip(np.split(time_ns, cuts), np.split(value, cuts), strict=True) if len(t)]


def interleaved(streams, rng):
    """All arrivals in a random order that keeps that of each stream; some streams run far ahead for a while."""
    left = {name: list(reversed(own)) for name, own in streams.items()}
    while left:
        name = list(left)[int(rng.integers(len(left)))]
        for _ in range(int(rng.integers(1, 12))):
            if left[name]:
                yield left[name].pop()
        if not left[name]:
            del left[name]


def live(site, method, seed, tracking=None):
    """What a point gives that is fed in any order, and is put down and taken up again in the middle."""
    rng = np.random.default_rng(seed)
    point, sides, tracked_cameras = site.opened(method, tracking)
    arrivals = list(interleaved(records(point, sides, tracked_cameras, rng), rng))
    middle = int(rng.integers(len(arrivals) // 4, 3 * len(arrivals) // 4))
    outcome = Outcome()
    for number, arrival in enumerate(arrivals):
        if number == middle:
            kept = to_bytes(point.state)
            point, _, _ = site.opened(method)
            point.restore(from_bytes(kept, PointState))
            assert to_bytes(point.state) == kept
        outcome.take(point.push(arrival))
    outcome.take(point.finish())
    return outcome


def assert_same(rows, expected):
    """Rows of the same instants are the same, bit for bit."""
    at = np.searchsorted(rows.time_ns, expected.time_ns)
    for name in Estimate.__slots__:
        np.testing.assert_array_equal(getattr(rows, name)[at], getattr(expected, name), err_msg=name)


def assert_same_events(outcome, result):
    """The events of the loop are those of the file, of rows up to the last measurement."""
    last_ns = int(outcome.measured_ns.max())
    found = [one for one in outcome.fusion_events if one.axis == 0 and one.time_ns <= last_ns] + outcome.sensor_events
    reported, kept = (sorted((one.time_ns, one.kind, one.text) for one in events) for events in (found, result.events))
    assert reported == kept


def two_axes(folder):
    """A camera that measures along both axes of its image, and an accelerometer with two."""
    scenario = replace(SCENARIOS["two-axes"], duration_s=16.0, camera=CameraSetup(size_px=(96, 96), time_offset_s=0.09))
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(SCENARIOS, "small", scenario)
        write_scenario("small", folder, seed=1)
    return folder


def two_radars(folder):
    """Two radars whose clocks and rates differ."""
    near = replace(LIVELY, rate_hz=50.0, late_s=0.05)
    return write_several(folder, LIVELY, "radar", {"near": near, "far": replace(near, rate_hz=40.0, first_s=1.3)})


def one_ends_early(folder):
    """A displacement sensor that ends at 6 s, and one that begins at 8 s, with a camera."""
    write(folder, LIVELY, "camera")
    for name, first_s, last_s in (("morning", 1.0, 6.3), ("evening", 8.0, 14.0)):
        own = replace(LIVELY, first_s=first_s, duration_s=last_s, rate_hz=20.0)
        lines = (write(folder / name, own, "displacement") / "recording.toml").read_text()
        lines = lines[lines.index("[displacement]") :].replace("[displacement]", f'[[displacement]]\nname = "{name}"')
        append(folder, lines.replace('file = "', f'file = "{name}/'))
    return folder


def vibrometer(folder):
    """A vibrometer with a displacement once a second; its values are missing for 2 s and equal for 3 s."""
    case = replace(LIVELY, rate_hz=1.0, duration_s=40.0)
    add_velocity(write(folder, case, "displacement"), case)
    head, *rows = (folder / "velocity.csv").read_text().splitlines()
    held = [f"{row.split(',')[0]},0.5" for row in rows[1200:1350]]
    (folder / "velocity.csv").write_text("\n".join([head, *rows[:600], *rows[700:1200], *held, *rows[1350:]]) + "\n")
    return folder


def nodding(folder):
    """A camera with one target whose tilt a gyroscope measures."""
    case = replace(LIVELY, duration_s=30.0, nods=(1.5, 0.9))
    return add_gyroscope(write(folder, case, "camera"), case)


CASES["vibrometer"] = vibrometer
CASES["nodding"] = nodding
CASES["one ends early"] = one_ends_early
CASES["averaging"] = averaging
CASES["two axes"] = two_axes
CASES["two radars"] = two_radars


# A method reads what the sensors gave: each case goes through one; where the estimator is asked more, through both.
# A thermal camera is in "day and night" as well.
PAIRS = [(case, METHODS[k % 2]) for k, case in enumerate(CASES) if case != "infrared"]
OTHERS = [(case, METHODS[(k + 1) % 2]) for k, case in enumerate(CASES) if case != "infrared"]
BOTH = [pair for pair in OTHERS if pair[0] in ("displacement", "tilting")]
AGAIN = [("infrared", "kalman"), *(pair for pair in OTHERS if pair[0] in ("lossless", "averaging", "two axes"))]
# A sensor of each kind, one that averages, and streams that begin and end: what times are subtracted in.
TIMED = [pair for pair in OTHERS if pair[0] in ("frozen", "displacement", "radar", "one ends early", "averaging")]
REST = [pair for pair in OTHERS if pair not in TIMED]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The site of a case, made once."""
    return cache(lambda case: Site(CASES[case](tmp_path_factory.mktemp("live") / "site")))


@pytest.mark.parametrize(("case", "method"), [*PAIRS, *BOTH, *slow(*AGAIN)])
def test_rows_of_the_file_are_rows_of_the_point(case, method, made):
    site = made(case)
    result = midspan.estimate(midspan.open_recording(site.folder), site.calibration, method=method)
    assert len(result.estimate.time_ns) > 1000
    outcome = live(site, method, 1)
    assert_same(outcome.estimate(0), result.estimate)
    assert_same_events(outcome, result)
    if result.across is not None:
        assert_same(outcome.estimate(1), result.across.estimate)


@pytest.mark.parametrize("method", METHODS)
def test_what_is_lost_and_seen_again_is_reported_when_it_happens(method, tmp_path):
    folder = write(tmp_path / "site", replace(LIVELY, duration_s=26.0), "camera")
    film = np.load(folder / "camera.npy")
    # Frames at 1 s + 0.1 s: something else from 6 s on, darkness from 10.5 s on, the target again at 19 s.
    film[50:95] = np.random.default_rng(1).integers(0, 256, film[50:95].shape, dtype=np.uint8)
    film[95:180] = 0
    np.save(folder / "camera.npy", film)
    set_keys(folder, "calibration", window_s=[0.0, 6.0])
    site = Site(folder)
    result = midspan.estimate(midspan.open_recording(folder), site.calibration, method=method)
    outcome = live(site, method, 2)
    assert_same_events(outcome, result)
    reported = [(event.kind, round(event.time_ns / 1e9, 1)) for event in outcome.sensor_events]
    assert reported == [("lost", 6.0), ("dark", 10.5), ("seen", 19.0)]
    assert outcome.sensor_events[-1].text.endswith("no measurement for 13.0 s.")
    # The last frame before is of 5.9 s, and 2.5 intervals of 0.1 s make a row coasting.
    rows = [event for event in outcome.fusion_events if event.kind in ("lost", "seen")]
    assert [event.kind for event in rows] == ["lost", "seen"]
    assert [event.time_ns / 1e9 for event in rows] == pytest.approx([6.16, 19.0], abs=0.03)
    assert {reported.text for reported in (outcome.sensor_events[0], rows[0])} <= set(result.warnings)


def test_a_stream_that_ends_or_has_not_begun_holds_no_frame_back(tmp_path, monkeypatch):
    site = Site(one_ends_early(tmp_path / "site"))
    point, sides, tracked_cameras = site.opened("kalman")
    waiting, push = [], point.push

    def counted(record):
        out = push(record)
        names = [stream.name for stream in point.merge.state.streams]
        waiting.append(len(point.merge.state.held[names.index("camera")]))
        return out

    monkeypatch.setattr(point, "push", counted)
    outcome = run(point, sides, tracked_cameras)
    assert outcome.measured_by("camera").time_ns[-1] > 13e9
    # A frame waits for those of its instant only.
    assert max(waiting) <= 1


@pytest.mark.parametrize(("case", "method"), [("two targets", "lag"), *slow(("day and night", "kalman"))])
def test_a_point_goes_on_from_what_the_calibration_has_tracked(case, method, tmp_path):
    site = Site(CASES[case](tmp_path / "site"), given=False)
    result = midspan.estimate(midspan.open_recording(site.folder), method=method)
    assert_same(live(site, method, 1, site.tracking).estimate(0), result.estimate)


EPOCH_NS = 1_700_000_000 * 10**9


def shifted(record):
    """The same from clocks that started at another time."""
    return replace(record, time_ns=record.time_ns + EPOCH_NS)


@pytest.mark.parametrize(("case", "method"), [*TIMED, *slow(*REST)])
def test_the_start_of_time_has_no_effect(case, method, made):
    """Times in s are differences: what is left is their rounding to ns."""
    site = made(case)
    point, sides, tracked_cameras = site.opened(method)
    expected = run(point, sides, tracked_cameras).estimate(0)
    point, sides, tracked_cameras = site.opened(method)
    known = point.estimator.settings
    settings = replace(known, zero_ns=None if known.zero_ns is None else known.zero_ns + EPOCH_NS)
    point.estimator = Estimator(settings) if method == "kalman" else Lag(settings, point.estimator.lag_samples)
    outcome, rng = Outcome(), np.random.default_rng(0)
    for arrival in interleaved(records(point, sides, tracked_cameras, rng), rng):
        outcome.take(point.push(replace(arrival, record=shifted(arrival.record))))
    outcome.take(point.finish())
    found = outcome.estimate(0)
    np.testing.assert_array_equal(found.time_ns - EPOCH_NS, expected.time_ns)
    np.testing.assert_allclose(found.displacement_m, expected.displacement_m, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.variance_m2, expected.variance_m2, rtol=1e-6)


def cut(folder, to, stop_s):
    """The recording as it was when it had gone on until `stop_s`."""
    shutil.copytree(folder, to)
    for file in ("accel.csv", "slow.csv"):
        if (to / file).exists():
            head, *rows = (to / file).read_text().splitlines()
            kept = [row for row in rows if float(row.split(",")[0]) < stop_s]
            (to / file).write_text("\n".join([head, *kept]) + "\n")
    frames = int((stop_s - LIVELY.first_s) * LIVELY.rate_hz)
    if (folder / "camera.mp4").exists():
        with av.open(str(folder / "camera.mp4")) as old, av.open(str(to / "camera.mp4"), "w") as new:
            stream = new.add_stream_from_template(old.streams.video[0])
            for packet in itertools.islice(old.demux(video=0), frames):
                packet.stream = stream
                new.mux(packet)
    for file, name in (("camera.npy", None), ("infrared.npz", "celsius")):
        if (to / file).exists():
            film = np.load(to / file) if name is None else np.load(to / file)[name]
            film = film[:frames]
            np.save(to / file, film) if name is None else np.savez(to / file, **{name: film})
    return to


@pytest.mark.parametrize(
    ("case", "method", "stop_s"),
    [
        ("crf 23", "kalman", 6.37),
        ("frozen", "lag", 11.02),
        ("two targets", "kalman", 11.02),
        ("day and night", "lag", 11.02),
        ("displacement", "kalman", 6.37),
        ("displacement", "lag", 11.02),
    ],
)
def test_what_comes_later_changes_no_row(case, method, stop_s, made, tmp_path):
    site = made(case)
    whole = midspan.estimate(midspan.open_recording(site.folder), site.calibration, method=method).estimate
    folder = cut(site.folder, tmp_path / "cut", stop_s)
    found = midspan.estimate(midspan.open_recording(folder), site.calibration, method=method).estimate
    # The rows of `lag` that were due: the last ones are given out with what came until then.
    last_ns = found.time_ns[-1] - (10**9 if method == "lag" else 0)
    found = part(found, found.time_ns <= last_ns)
    assert len(found.time_ns) > 300
    assert_same(whole, found)
