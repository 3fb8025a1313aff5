"""Rows of a live point: none for long of one that is lost, none left out while a broker is away, and how they stand."""

from dataclasses import replace

import numpy as np
import pytest
from test_service_point import BEGIN_NS, SITE, live_point, pushed, records
from test_service_point import running as opened_point

import midspan
from lively_recordings import Lively, write
from midspan.cli.main import run
from midspan.engine.point import PointStatus
from midspan.records import NANOSECONDS, Estimate, Status
from midspan.service.journal import STEP, Journal, RowHealth, std_limits, with_reason
from midspan.service.opening import opened, resumed
from midspan.service.running import running
from midspan.service.stored_recording import stored_table
from midspan.settings.site import load_site
from midspan.store.store import open_store
from recording_edits import set_keys

# A displacement sensor that is silent from 25 to 90 s. Rows are lost from 10 s after its last value on.
SILENT_S, LOST_AFTER_S, LOST_ROWS_S = (25.0, 90.0), 10.0, 30.0
CASE = Lively(duration_s=96.0, rate_hz=5.0, rms_m=2e-3, noise_m_s2=1e-4)


@pytest.fixture(scope="module")
def silent(tmp_path_factory):
    """The recording, and the store that it was replayed into."""
    folder = write(tmp_path_factory.mktemp("rows") / "site", CASE, "displacement")
    set_keys(folder, "calibration", window_s=[0.0, 24.0])
    head, *lines = (folder / "slow.csv").read_text().splitlines()
    kept = [line for line in lines if not SILENT_S[0] < float(line.split(",")[0]) < SILENT_S[1]]
    (folder / "slow.csv").write_text("\n".join([head, *kept]) + "\n")
    return folder


def replayed(folder, store):
    assert run(["replay", str(folder), "-o", str(store), "--point", "p", "--quiet"]) == 0
    return open_store(store)


def test_a_point_that_is_lost_gives_rows_for_half_a_minute_and_then_none(silent, tmp_path, monkeypatch):
    # Without the bound by the motion.
    monkeypatch.setattr("midspan.service.journal.LOST_MOTIONS", 1e9)
    store = replayed(silent, tmp_path / "store")
    rows = stored_table(store, "p", None, None)
    time_s, lost = rows.time_ns / NANOSECONDS, rows.columns["status"] == Status.LOST
    assert time_s[lost][0] == pytest.approx(SILENT_S[0] + LOST_AFTER_S, abs=0.3)
    assert time_s[lost][-1] == pytest.approx(time_s[lost][0] + LOST_ROWS_S, abs=0.02)
    gap = int(np.argmax(np.diff(rows.time_ns)))
    assert time_s[gap] == time_s[lost][-1]
    assert time_s[gap + 1] == pytest.approx(SILENT_S[1], abs=0.3)
    # What there is are the rows of the file.
    result = midspan.estimate(midspan.open_recording(silent), method="kalman")
    at = np.searchsorted(result.estimate.time_ns, rows.time_ns)
    np.testing.assert_array_equal(result.estimate.time_ns[at], rows.time_ns)
    np.testing.assert_allclose(result.displacement_mm[at], rows.columns["displacement_mm"], rtol=1e-12, atol=500 * STEP)
    # Lost rows rule no history, fine or coarse.
    for count in (9, 900):
        seen = store.buckets("p", "rows", 0, 90 * NANOSECONDS, count)
        drawn = rows.columns["displacement_mm"][~lost & (time_s < 90.0)]
        assert 1e3 * np.nanmax(seen.high) == pytest.approx(drawn.max(), rel=1e-6)
        assert 1e3 * np.nanmin(seen.low) == pytest.approx(drawn.min(), rel=1e-6)
        assert np.isnan(seen.high[(seen.begin_ns > 45e9) & (seen.begin_ns < 79e9)]).all()
    store.close()


def test_no_lost_row_is_given_that_says_nothing_of_the_motion(silent, tmp_path):
    store = replayed(silent, tmp_path / "store")
    rows = stored_table(store, "p", None, None)
    lost = rows.columns["status"] == Status.LOST
    # Ten times the motion of 2 mm, which the calibration knows to a third.
    assert rows.columns["displacement_std_mm"][lost].max(initial=0.0) < 1.3 * 10.0 * 2.0
    assert np.count_nonzero(lost) < 100 * LOST_ROWS_S
    store.close()


def with_broker(tmp_path):
    """A point that runs, its acceleration by a broker, its displacement by a line."""
    point = live_point(tmp_path)
    _, at_s = opened_point(point)
    point.tick(BEGIN_NS + at_s * NANOSECONDS)
    return point, at_s


@pytest.mark.parametrize("away_s", [3, 10, 60])
def test_no_row_is_lost_where_a_broker_was_away(tmp_path, away_s):
    point, at_s = with_broker(tmp_path)
    late, back_s = [], at_s + 5 + away_s
    for second in range(at_s, back_s + 12):
        away = at_s + 5 <= second < back_s
        for arrival in records(second, second + 1):
            # The sender is back after as long again as the broker was away, at most.
            if arrival.stream == "accelerometer" and at_s + 5 <= second < back_s + min(away_s, 4):
                late.append(arrival)
                continue
            while arrival.stream == "accelerometer" and late:
                point.push(late.pop(0))
            point.push(arrival)
        for tick in range(20):
            now_ns = BEGIN_NS + (second + 1) * NANOSECONDS + tick * NANOSECONDS // 20
            point.tick(now_ns, away=away)
        if away and second > at_s + 5:
            assert point.held_up == "broker_gone"
        assert point.status is PointStatus.TRACKING
    batch = point.batch()
    rows = [one for one in batch.chunks if one.stream == "rows"]
    assert set(np.diff(np.concatenate([one.time_ns for one in rows])).tolist()) == {10**7}
    assert set(np.concatenate([one.columns["status"] for one in rows]).tolist()) == {Status.TRACKING}
    assert not {event.kind for _, event in batch.events} & {"late", "gap", "ahead", "silent", "lost"}
    newest_s = (rows[-1].time_ns[-1] - BEGIN_NS) / NANOSECONDS
    assert newest_s > back_s + 10


def test_readiness_says_whether_a_point_gives_rows(tmp_path):
    (tmp_path / "SITE.toml").write_text(SITE.format(accept="auto"))
    (plan,) = load_site(tmp_path / "SITE.toml").points
    one = running(plan, tmp_path / "captures", tmp_path)
    assert one.ready(0.0)["reason"] == "calibrating"
    assert one.ready(0.0)["rows_age_s"] is None
    at_s = pushed(one.live, 0, 60)
    one.live.refused("Too little motion.")
    assert one.ready(0.0)["reason"] == "calibration_refused"
    one = replace(one, live=live_point(tmp_path))
    _, at_s = opened_point(one.live)
    for second in range(at_s, at_s + 5):
        pushed(one.live, second, second + 1)
        one.looked_at(float(second))
    now = one.ready(second + 0.5)
    assert (now["reason"], now["status"], now["rows_age_s"]) == ("", "tracking", 0.5)
    assert 0.0 < now["sigma_mm"] < 2.0 * now["usual_sigma_mm"] < 0.4
    # Which is as the accelerometer's source says: it is silent, or it brings records of which nothing can be made.
    for stream in one.streams.values():
        stream.reason, stream.heard_s = "", float(second)
    assert (one.ready(second + 6.0)["reason"], one.status(second + 6.0)) == ("silent", "lost")
    for stream in one.streams.values():
        stream.heard_s = second + 6.0
    assert one.ready(second + 6.0)["reason"] == "no_rows"
    # All sources were recordings that are over.
    ended = replace(one, streams={name: replace(stream, reason="replay_ended") for name, stream in one.streams.items()})
    for reported in (ended.ready(second + 6.0), ended.standing(second + 6.0)):
        assert (reported["reason"], reported["status"]) == ("replay_ended", "lost")
    # Stamps of the accelerometer that went back bring no rows.
    pushed(one.live, second - 60, second - 40)
    assert one.ready(second + 6.0)["reason"] == "clock"
    one.looked_at(second + 6.0)
    # While the displacement is lost.
    for arrival in records(at_s + 5, at_s + 30):
        if arrival.stream == "accelerometer":
            one.live.push(arrival)
    one.live.tick(BEGIN_NS)
    one.live.tick(BEGIN_NS + 4 * NANOSECONDS)
    one.live.tick(BEGIN_NS + 8 * NANOSECONDS)
    one.looked_at(second + 31.0)
    assert one.ready(second + 31.0)["reason"] == "lost"


def test_a_recording_that_ends_before_the_calibration_has_ended(tmp_path):
    (tmp_path / "SITE.toml").write_text(SITE.format(accept="auto"))
    (plan,) = load_site(tmp_path / "SITE.toml").points
    one = running(plan, tmp_path / "captures", tmp_path)
    for stream in one.streams.values():
        stream.reason = "replay_ended"
    for reported in (one.ready(0.0), one.standing(0.0)):
        assert (reported["reason"], reported["status"]) == ("replay_ended", "calibrating")


def test_rows_are_there_while_a_clocks_step_is_looked_for(tmp_path):
    """The displacement is away for a second: whether its clock has stepped since is weighed by what comes, which the
    rows' deviation holds.
    """
    (tmp_path / "SITE.toml").write_text(SITE.format(accept="auto"))
    (plan,) = load_site(tmp_path / "SITE.toml").points
    one = replace(running(plan, tmp_path / "captures", tmp_path), live=live_point(tmp_path))
    _, at_s = opened_point(one.live)
    sought = False
    for arrival in records(at_s, at_s + 8):
        second = arrival.newest_ns / NANOSECONDS
        if arrival.stream == "accelerometer" or not at_s + 2 < second - BEGIN_NS / NANOSECONDS < at_s + 4:
            one.live.push(arrival)
            one.looked_at(second)
            sought |= one.live.opened.point.estimator.seeks_clock
            assert one.ready(second)["reason"] == ""
    assert sought


def test_the_usual_deviation_is_the_geometric_mean_of_rows_that_rest_on_measurements():
    def rows(std_m, begin_s):
        time_ns = (begin_s * NANOSECONDS + 10**7 * np.arange(100)).astype(np.int64)
        code = np.zeros(100, dtype=np.uint8)
        return Estimate(time_ns, np.zeros(100), np.full(100, std_m**2), np.zeros(100), code, code)

    health = RowHealth().after_rows(rows(1e-4, 0)).after_rows(rows(2e-4, 1))
    assert health.usual_m == pytest.approx(np.sqrt(2.0) * 1e-4)
    assert health.std_m == pytest.approx(2e-4)


def test_what_a_restart_needs_of_the_rows_is_kept():
    journal = Journal("p", {})
    memory = {"zero": [1e-3, 1e-8], "lost_ns": 5, "usual": [2e-4, 700], "new_datum": "The kept state is unusable."}
    journal.remember(memory)
    assert journal.memory == memory
    assert journal.zero.offset_m == 1e-3


def test_a_point_goes_on_with_the_calibration_before_until_it_is_opened_with_the_new_one(tmp_path):
    point, at_s = with_broker(tmp_path)
    kept, store = point.batch(last=True), open_store(tmp_path / "store")
    store.write(kept)
    state = b"".join(kept.checkpoints["p"][1])
    folder, calibration = point.settled_in, midspan.calibrate(next((tmp_path / "captures").glob("calibration-*")))
    # The service was stopped before the point was opened with the second one.
    again = live_point(tmp_path)
    again.number = 2
    found = opened(folder, "p", calibration, 1, push=False)
    resumed(found, state, store)
    store.close()
    again.resumed(found, folder)
    pushed(again, at_s, at_s + 30)
    assert again.job.kind == "open"
    rows = [one for one in again.batch().chunks if one.stream == "rows"]
    assert {one.calibration for one in rows} == {1}
    assert rows[-1].time_ns[-1] > BEGIN_NS + at_s * NANOSECONDS


def test_rows_that_tell_nothing_are_not_given():
    """After a gap the first ones; of a sensor that is always so coarse all are."""
    time_ns, std_m = np.arange(4) * NANOSECONDS, np.array([1e-5, 0.5, 1e-3, 1e-5])
    rows = Estimate(
        time_ns, np.zeros(4), std_m**2, np.zeros(4), np.zeros(4, np.uint8), np.full(4, Status.TRACKING, np.uint8)
    )
    for motion_m, usual_m, shown in (
        (2e-3, 1e-5, [True, False, True, True]),
        (1e-5, 1e-5, [True, False, False, True]),
        (1e-5, 0.1, [True] * 4),
        (2e-3, np.nan, [True] * 4),
        (0.0, 1e-5, [True] * 4),
    ):
        found, lost_ns = with_reason(rows, None, *std_limits(motion_m, usual_m))
        assert (found.tolist(), lost_ns) == (shown, None)


def test_a_restart_after_a_pause_of_the_accelerometer_goes_on_with_what_came_after_it(tmp_path):
    """Without the shell's time of then the stamps behind the pause would be those of a clock that was set ahead."""
    point, at_s = with_broker(tmp_path)
    for tick in range(3):
        point.tick(BEGIN_NS + (at_s - 3 + tick) * NANOSECONDS)
    kept, store = point.batch(last=True), open_store(tmp_path / "store")
    store.write(kept)
    state = b"".join(kept.checkpoints["p"][1])
    folder, calibration = point.settled_in, midspan.calibrate(next((tmp_path / "captures").glob("calibration-*")))
    back_s, end_s = at_s + 15, at_s + 40
    for second in range(at_s, end_s):
        for arrival in records(second, second + 1):
            if arrival.stream == "displacement" or not at_s + 2 <= second < back_s:
                point.push(arrival)
        for tick in range(10):
            point.tick(BEGIN_NS + (second + 1) * NANOSECONDS + tick * NANOSECONDS // 10)
    undisturbed = point.batch()
    # The process is ended without a further checkpoint.
    store.write(replace(undisturbed, checkpoints={}))
    again = live_point(tmp_path)
    found = opened(folder, "p", calibration, 1, push=False)
    resumed(found, state, store)
    store.close()
    again.resumed(found, folder)
    made = again.batch()
    assert "ahead" not in {event.kind for _, event in made.events}
    rows, before = ([one for one in batch.chunks if one.stream == "rows"] for batch in (made, undisturbed))
    time_ns, others_ns = (np.concatenate([one.time_ns for one in chunks]) for chunks in (rows, before))
    np.testing.assert_array_equal(time_ns[time_ns > others_ns[0]], others_ns[1 : 1 + np.sum(time_ns > others_ns[0])])
    assert time_ns[-1] > BEGIN_NS + (end_s - 3) * NANOSECONDS
