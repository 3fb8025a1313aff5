"""A live point without a shell: captures, jobs, a calibration together with the running one, and its acceptance."""

import re
from dataclasses import replace

import numpy as np
import pytest

import midspan
from midspan.engine.point import PointStatus
from midspan.notices import Notice, notice_trees
from midspan.records import NANOSECONDS, Arrival, Readings
from midspan.service.capture import capture_settings
from midspan.service.opening import opened
from midspan.service.point import LivePoint, Phase
from midspan.service.running import Running
from midspan.settings.site import load_site

SITE = """
name = "site"
[store]
path = "store"
[mqtt]
[[point]]
name = "p"
calibration_s = 20
accept = "{accept}"
[point.accelerometer]
source = "mqtt:a"
[point.displacement]
source = "mqtt:d"
unit = "mm"
"""
BEGIN_NS = 1_790_000_000 * NANOSECONDS


def live_point(folder, accept="auto", more=""):
    (folder / "SITE.toml").write_text(SITE.format(accept=accept) + more)
    (plan,) = load_site(folder / "SITE.toml").points
    return LivePoint(plan, capture_settings(plan.recording, {"displacement": 1e-3}), folder / "captures")


def records(first_s, last_s, seed=0, scale=1.0):
    """Blocks of a second: three tones, the displacement at 10 Hz with 0.1 mm and a scale of its own."""
    rng = np.random.default_rng(seed)
    for second in range(first_s, last_s):
        for name, rate_hz in (("accelerometer", 100), ("displacement", 10)):
            at = second + np.arange(rate_hz) / rate_hz
            value = np.zeros(rate_hz)
            for a, f in ((3e-3, 1.3), (2e-3, 0.6), (1e-3, 2.9)):
                factor = -((2 * np.pi * f) ** 2) if name == "accelerometer" else 1.0
                value += factor * a * np.sin(2 * np.pi * f * at)
            value *= scale if name == "displacement" else 1.0
            value += rng.normal(0, 2e-3 if name == "accelerometer" else 1e-4, rate_hz)
            time_ns = BEGIN_NS + np.round(at * NANOSECONDS).astype(np.int64)
            yield Arrival(name, 0, Readings(time_ns, value[:, None]))


def pushed(point, first_s, last_s, scale=1.0):
    """Push until the point asks for a job; returns the second that it asked in."""
    for arrival in records(first_s, last_s, scale=scale):
        point.push(arrival)
        if point.job is not None:
            break
    return int((point.newest_ns - BEGIN_NS) / NANOSECONDS)


def running(point, scale=1.0):
    """The point opened from its first calibration, and the second that it has come to."""
    at_s = pushed(point, 0, 60)
    assert point.job.kind == "calibrate"
    assert point.phase is Phase.CALIBRATING
    assert point.status is PointStatus.CALIBRATING
    calibration = midspan.calibrate(point.job.folder)
    point.calibrated(1)
    at_s = pushed(point, at_s + 1, at_s + 30, scale)
    assert point.job.kind == "open"
    # What comes while it is opened waits, and is not lost.
    for arrival in records(at_s + 1, at_s + 4, scale=scale):
        point.push(arrival)
    point.is_opened(opened(point.job.folder, "p", calibration, 1))
    assert point.phase is Phase.RUNNING
    return calibration, at_s + 4


def test_a_point_captures_calibrates_opens_and_runs(tmp_path):
    point = live_point(tmp_path)
    _, at_s = running(point)
    for arrival in records(at_s, at_s + 10):
        point.push(arrival)
    batch = point.batch()
    rows = np.concatenate([one.time_ns for one in batch.chunks if one.stream == "rows"])
    assert set(np.diff(rows)) == {10**7}
    assert point.status is PointStatus.TRACKING
    assert "p" in batch.checkpoints
    assert "calibrated" in {event.kind for _, event in batch.events}
    raw = np.unique(np.concatenate([one.time_ns for one in batch.chunks if one.stream == "accelerometer"]))
    assert set(np.diff(raw)) == {10**7}


def test_a_point_says_what_is_prepared_and_how_long_that_still_takes(tmp_path):
    point = live_point(tmp_path)
    assert (point.stage, point.capture_left_s) == ("", 20.0)
    for arrival in records(0, 5):
        point.push(arrival)
    # Five blocks of a second, of which the displacement's last value is 0.1 s before the end.
    assert (point.stage, point.capture_left_s) == ("capturing", pytest.approx(15.1, abs=0.01))
    at_s = pushed(point, 5, 60)
    assert (point.stage, point.capture_left_s) == ("calibrating", 20.0)
    point.refused("too little motion")
    # It is tried again after a minute.
    assert (point.stage, point.capture_left_s) == ("capturing", 80.0)
    point.calibrated(1)
    for arrival in records(at_s + 61, at_s + 63):
        point.push(arrival)
    assert (point.stage, point.capture_left_s) == ("capturing", pytest.approx(3.1, abs=0.01))
    pushed(point, at_s + 63, at_s + 80)
    assert (point.stage, point.job.kind) == ("opening", "open")


@pytest.mark.parametrize(("more", "phase"), [("", Phase.RUNNING), ("noise_std = 0.1", Phase.CAPTURING_TO_OPEN)])
def test_a_point_whose_settings_have_changed_is_opened_anew(tmp_path, more, phase):
    """Its rows go on until then with what it was opened from."""
    point = live_point(tmp_path)
    calibration, _ = running(point)
    later = live_point(tmp_path, more=more)
    later.number = 1
    later.resumed(opened(point.settled_in, "p", calibration, 1), point.settled_in)
    assert later.phase is phase
    assert later.opened is not None


def test_a_late_clock_is_corrected_where_nothing_is_said_of_it(tmp_path):
    """The displacement's stamps are 60 ms late: that is the calibration's offset, and what the engine goes on with."""
    point = live_point(tmp_path)
    for one in records(0, 40):
        late_ns = 60_000_000 * (one.stream == "displacement")
        point.push(Arrival(one.stream, 0, Readings(one.record.time_ns + late_ns, one.record.value)))
        if point.job is not None:
            break
    offset = midspan.calibrate(point.job.folder).displacement.offset
    std_s = offset.variance**0.5
    assert 0.0 < std_s < 5e-3
    assert abs(offset.value_s + 0.060) < 4.0 * std_s


def test_the_engine_says_where_a_sensors_clock_is(tmp_path):
    """As calibrated, and as it has been followed since: the displacement's stamps are 50 ms early, later on 54 ms."""
    point = live_point(tmp_path, more="estimate_offset = true")

    def push_early(first_s, last_s, early_ns):
        for one in records(first_s, last_s):
            moved_ns = early_ns * (one.stream == "displacement")
            point.push(Arrival(one.stream, 0, Readings(one.record.time_ns - moved_ns, one.record.value)))
            if point.job is not None:
                break
        return int((point.newest_ns - BEGIN_NS) / NANOSECONDS) + 1

    at_s = push_early(0, 40, 50_000_000)
    calibration = midspan.calibrate(point.job.folder)
    point.calibrated(1)
    at_s = push_early(at_s, at_s + 20, 50_000_000)
    point.is_opened(opened(point.job.folder, "p", calibration, 1))
    engine = point.opened.point
    for early_s in (0.050, 0.054):
        at_s = push_early(at_s, at_s + 20, round(early_s * NANOSECONDS))
        offset_s, std_s = engine.clock_offset("displacement")
        # 20 s of it tell it to below a millisecond, what came before it included.
        assert 0.0 < std_s < 1e-3
        assert abs(offset_s - early_s) < 4.0 * std_s
    assert engine.interval_s("displacement") == pytest.approx(0.1)
    assert engine.interval_s("accelerometer") == pytest.approx(0.01)


def test_what_a_calibration_warns_of_is_an_event_and_stands_with_the_point(tmp_path):
    point = live_point(tmp_path)
    calibration, _ = running(point)
    note = Notice("exposure", "camera: the exposure is taken out.")
    doubt = Notice("scale-implausible", "displacement: the scale is 2.5.")
    remedy = Notice("clock-uncertain", "displacement: set displacement.estimate_offset = true.")
    warned = replace(calibration, warnings=(note, remedy, doubt))
    point.batch()
    point.calibrated(2, warned.to_act_on)
    point.offered(3, warned.to_act_on)
    said = [event.text for _, event in point.batch().events if event.kind == "calibration_warning"]
    assert said == [f"p: calibration {number}: {text}" for number in (2, 3) for text in (doubt, remedy)]
    live = Running(point, {}, {}, {})
    assert live.state(0.0, live.standing(0.0))["warnings"] == notice_trees(calibration.to_act_on)
    folder = point.settled_in
    point.drop()
    point.is_opened(opened(folder, "p", warned, 2), folder)
    assert [one["severity"] for one in live.state(0.0, live.standing(0.0))["warnings"]] == ["serious", "warning"]


def test_a_new_calibration_stands_beside_the_old_one_until_it_is_accepted(tmp_path):
    point = live_point(tmp_path, "manual")
    _, at_s = running(point)
    assert "records 20 s for a new calibration" in point.calibrate()
    assert "is already being calibrated or opened" in point.calibrate()
    at_s = pushed(point, at_s, at_s + 40)
    assert point.job.kind == "calibrate"
    assert point.phase is Phase.CALIBRATING
    assert point.opened is not None
    point.offered(2)
    assert point.reason == "calibration_offered"
    assert point.number == 1
    # No other one is made until someone asks.
    for arrival in records(at_s + 1, at_s + 41):
        point.push(arrival)
    assert point.job is None
    assert not point.busy
    point.calibrated(2)
    pushed(point, at_s + 41, at_s + 60)
    assert point.job.kind == "open"
    assert point.number == 2


@pytest.mark.parametrize("scale", [1.0, 1.06])
def test_a_scale_that_has_changed_since_asks_for_a_new_calibration_once(tmp_path, scale):
    point = live_point(tmp_path)
    _, at_s = running(point, scale)
    said = []
    for second in range(at_s, at_s + 40):
        pushed(point, second, second + 1, scale)
        said += [event for _, event in point.batch().events if event.kind == "scale"]
    if scale == 1.0:
        assert said == []
        assert point.job is None
        return
    (event,) = said
    # with a displacement whose unit is right the accelerometer measures 1/1.06 of it.
    percent, std = re.search(
        r"accelerometer: .* a scale ([-+][\d.]+) ± ([\d.]+) % different from calibration 1", event.text
    ).groups()
    assert abs(float(percent) - 100.0 * (1.0 / 1.06 - 1.0)) < 4.0 * float(std) + 0.1
    assert point.job.kind == "calibrate"
    assert point.number == 1


def test_a_refused_calibration_is_an_event_and_tried_again_later(tmp_path):
    point = live_point(tmp_path)
    at_s = pushed(point, 0, 60)
    point.refused("Too little motion.")
    assert point.reason == "calibration_refused"
    assert ["Too little motion" in event.text for _, event in point.batch().events] == [True]
    again_s = pushed(point, at_s + 1, at_s + 200)
    assert point.job.kind == "calibrate"
    assert 60 + 20 <= again_s - at_s <= 60 + 25


def test_what_waits_while_a_point_is_opened_leaves_no_row_out_and_none_doubled(tmp_path):
    point = live_point(tmp_path)
    running(point)
    rows = [one for one in point.batch().chunks if one.stream == "rows"]
    steps_ns = np.diff(np.concatenate([one.time_ns for one in rows]))
    # Three seconds came after what the point was opened from; rows are 1.5 s late at most.
    assert len(steps_ns) > 100 * (5 + 1)
    assert set(steps_ns.tolist()) == {NANOSECONDS // 100}


def test_what_waits_while_a_point_is_opened_is_bounded(tmp_path):
    point = live_point(tmp_path)
    at_s = pushed(point, 0, 60)
    midspan.calibrate(point.job.folder)
    point.calibrated(1)
    at_s = pushed(point, at_s + 1, at_s + 30)
    for arrival in records(at_s + 1, at_s + 1 + 610):
        point.push(arrival)
    held = [one for one in point._waiting if one.stream == "accelerometer"]
    assert 599 <= len(held) <= 602
