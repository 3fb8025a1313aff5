"""A group in the shell: rows are those of a bank that is fed the same blocks, each point has its own, none doubles."""

import asyncio
import json
import struct
import threading
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from midspan.engine.bank import Bank, BankBlocks, BankSensor, BankSettings
from midspan.engine.point import PointStatus
from midspan.records import NANOSECONDS, Event, GroupRows
from midspan.serve.groups import GroupTable
from midspan.service.group import Group, max_bytes_of, numbered
from midspan.service.group_results import (
    LOST,
    NO_ROWS,
    OPENING,
    SILENT,
    STARTING,
    Standings,
    joined_runs,
    result_blocks,
)
from midspan.service.groups import MAX_EVENTS, Groups, fewer, row_bytes
from midspan.service.live_socket import ROW
from midspan.service.packets import Receipt
from midspan.settings.group import GroupPlan, GroupSettings
from midspan.sources.live.blocks import HEAD, RESULT, parse
from midspan.store.chunk import join
from midspan.store.store import Batch, open_store

POINTS, BEGIN_S = 12, 1_790_000_000
SETTINGS = BankSettings(acceleration_std_m_s2=0.005, displacement_std_m=1.5e-3)


def plan(numbers=range(POINTS), *, shared=False):
    each = "" if shared else "{i}/"
    topics = {"accelerometer": f"mqtt:north/{each}acc", "displacement": f"mqtt:north/{each}gnss"}
    noise = {"accelerometer_noise_std": 0.005, "displacement_noise_std": 1.5}
    return GroupPlan(GroupSettings(name="north", points=POINTS, **topics, **noise), numbers)


def motion_m(point, time_s):
    """Each point has a frequency and a mean of its own."""
    return 5e-3 * point + 3e-3 * np.sin(2.0 * np.pi * (0.4 + 0.1 * point) * time_s)


def readings(second, seed=0):
    """What the sensors of all points read in a second: m/s² (points, 100) and mm (points, 10) as float32."""
    rng = np.random.default_rng([seed, second])
    number = np.arange(POINTS)[:, None]
    rate = 2.0 * np.pi * (0.4 + 0.1 * number)
    fast = -(rate**2) * 3e-3 * np.sin(rate * (second + np.arange(100) / 100)) + rng.normal(0.0, 5e-3, (POINTS, 100))
    slow = 1e3 * motion_m(number, second + np.arange(10) / 10) + rng.normal(0.0, 1.5, (POINTS, 10))
    return fast.astype("<f4"), slow.astype("<f4")


def messages(second, *, shared=False):
    """The messages of a second by topic: of each point, or of all."""
    found = []
    for sensor, values in enumerate(readings(second)):
        count, name = values.shape[1], ("acc", "gnss")[sensor]
        head = HEAD.pack(1, 1 + sensor + 3 * shared, 0, second, (BEGIN_S + second) * NANOSECONDS, 10**9 // count, count)
        if shared:
            found.append((f"north/{name}", head + struct.pack("<I", POINTS) + values.tobytes()))
        else:
            found += [(f"north/{i}/{name}", head + values[i].tobytes()) for i in range(POINTS)]
    return found


def fed(group, seconds, connection=1, **options):
    """What a group gives of some seconds, one after another."""
    found = []
    for second in seconds:
        for topic, payload in messages(second, **options):
            if (place := group.topics.get(topic)) is not None:
                place[0].put(place[1], payload, Receipt(connection, 1 + second))
        found.append(group.second((BEGIN_S + second + 1) * NANOSECONDS))
    return found


def bank_fed(seconds, numbers=range(POINTS)):
    """Rows of a bank that is given the same blocks."""
    bank, found = Bank(len(numbers), SETTINGS), []
    for second in seconds:
        for sensor, values in zip(BankSensor, readings(second), strict=True):
            own = values[numbers.start :: numbers.step]
            whole = np.full(len(own), (BEGIN_S + second) * NANOSECONDS)
            count = values.shape[1]
            si = own.reshape(-1) if sensor is BankSensor.ACCELERATION else 1e-3 * own.reshape(-1).astype(np.float64)
            steps, counts = np.full(len(own), 10**9 // count), np.full(len(own), count, dtype=np.uint32)
            bank.push(BankBlocks(sensor, np.arange(len(own), dtype=np.uint32), whole, steps, counts, si))
        found.append(bank.rows((BEGIN_S + second) * NANOSECONDS + 990_000_000))
    return found


def by_point(parts):
    """Rows of each point: stamps, displacements, deviations."""
    found = {}
    for rows in parts:
        ends = np.cumsum(rows.count, dtype=np.int64)
        for j, end in enumerate(ends):
            at = slice(end - int(rows.count[j]), end)
            stamps = rows.t0_ns[j] + rows.dt_ns[j] * np.arange(rows.count[j])
            part = np.stack((stamps, rows.displacement_m[at], rows.std_m[at], rows.velocity_m_s[at]))
            found.setdefault(int(rows.point[j]), []).append(part)
    return {point: np.concatenate(one, axis=1) for point, one in found.items()}


def assert_same(found, wanted):
    assert found.keys() == wanted.keys()
    for point, rows in wanted.items():
        np.testing.assert_array_equal(found[point], rows)


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("numbers", [range(POINTS), range(2, POINTS, 5)])
def test_live_rows_are_those_of_a_bank_bit_for_bit(shared, numbers):
    group = Group.begun(plan(numbers, shared=shared))
    found = by_point([one.rows for one in fed(group, range(8), shared=shared)])
    assert_same(found, by_point(bank_fed(range(8), numbers)))


def test_what_came_while_the_service_was_away_gives_the_same_rows():
    group, seconds = Group.begun(plan()), range(100)
    sent = [message for second in seconds for message in messages(second)]
    for number, (topic, payload) in enumerate(sent):
        inbox, place = group.topics[topic]
        inbox.put(place, payload, Receipt(1, number + 1))
    found = by_point([group.second((BEGIN_S + 101) * NANOSECONDS).rows])
    assert_same(found, by_point([one.rows for one in fed(Group.begun(plan()), seconds)]))


def test_blocks_of_a_point_are_counted_in_the_order_of_time():
    group, sent = Group.begun(plan()), [message for second in range(30) for message in messages(second)]
    # A second that never came makes two runs of each point.
    for topic, payload in sent[: 40 * POINTS] + sent[44 * POINTS :]:
        group.topics[topic][0].put(group.topics[topic][1], payload, Receipt(1, 1))
    rows = joined_runs(group.second((BEGIN_S + 31) * NANOSECONDS).rows)
    blocks = [parse(body, RESULT) for place, body in result_blocks(rows, np.zeros(POINTS, np.uint32)) if place == 3]
    assert len(blocks) > 1
    assert [one.sequence for one in blocks] == list(range(len(blocks)))
    assert np.all(np.diff(np.concatenate([one.time_ns for one in blocks])) > 0)


def test_what_the_broker_brings_again_is_no_event():
    before = Group.begun(plan())
    fed(before, range(8))
    group = Group.begun(plan(), before.bank.state(), before.until_ns)
    # All that came before, once more.
    again = fed(group, range(9))
    kinds = {event.kind for one in again for _, event in one.events}
    assert "late" not in kinds
    assert len(by_point([one.rows for one in again])[0][0]) >= 100


def test_what_the_broker_brings_again_by_another_connection_is_no_event():
    group = Group.begun(plan())
    fed(group, range(8))
    # What was not acknowledged by the connection that was lost, and what the broker kept meanwhile.
    for number, (topic, payload) in enumerate(message for second in range(5, 12) for message in messages(second)):
        inbox, place = group.topics[topic]
        inbox.put(place, payload, Receipt(2, number + 1))
    given = group.second((BEGIN_S + 12) * NANOSECONDS)
    assert given.events == []
    assert given.rows.count[given.rows.point == 0].sum() >= 300
    # Of the same connection a reading that comes late is an event as ever.
    assert [event.kind for one in fed(group, [*range(12, 18), 14], connection=2) for _, event in one.events] == ["late"]


def test_each_point_has_its_own_displacement():
    group = Group.begun(plan())
    found = by_point([one.rows for one in fed(group, range(20))])
    for point, (stamps, value, std, _) in found.items():
        late = stamps > (BEGIN_S + 8) * NANOSECONDS
        truth = motion_m(point, (stamps[late] - BEGIN_S * NANOSECONDS) / NANOSECONDS)
        # Its neighbour's is 5 mm off; a band of 1.96 σ holds nearly all.
        assert np.sqrt(np.mean((value[late] - truth) ** 2)) < 1.5e-3
        assert np.mean(np.abs(value[late] - truth) < 1.96 * std[late]) > 0.9


def test_it_goes_on_from_its_state_and_gives_nothing_twice():
    whole = by_point([one.rows for one in fed(Group.begun(plan()), range(10))])
    first = Group.begun(plan())
    before = fed(first, range(6))
    second = Group.begun(plan(), before[-1].state)
    # The broker brings again what was not acknowledged, and more than that.
    again = fed(second, range(4, 10))
    assert_same(by_point([one.rows for one in (*before, *again)]), whole)


def test_a_group_with_other_points_than_before_begins_anew():
    state = fed(Group.begun(plan()), range(3))[-1].state
    assert len(Group.begun(plan(range(5)), state).bank) == 5


def test_messages_that_are_no_blocks_are_one_event_a_minute():
    group = Group.begun(plan())
    inbox, events = group.inboxes[0], []
    for second in range(130):
        for place in range(POINTS):
            inbox.put(place, b"\x01 no block", Receipt(1, 1))
        events += group.second((BEGIN_S + second) * NANOSECONDS).events
    assert [one[0] for one in events] == ["north"] * 3
    assert [event.kind for _, event in events] == ["payload"] * 3
    assert events[1][1].text.startswith(
        f"north: blocks that could not be used whole: {60 * POINTS}, such as: a block must be"
    )
    assert group.faults == 121 * POINTS


def test_what_came_may_be_acknowledged_and_what_waits_is_bounded(monkeypatch):
    group = Group.begun(plan())
    assert len(fed(group, range(1))[0].receipts) == 2 * POINTS
    monkeypatch.setattr("midspan.service.group.MAX_WAITING_BYTES", 10)
    monkeypatch.setattr("midspan.service.group.ROOM_WAIT_S", 0.0)
    assert group.inboxes[0].put(0, b"x" * 10, Receipt(1, 1))
    # Both sensors have one room.
    assert not group.inboxes[1].put(0, b"x", Receipt(1, 2))
    given = group.second(BEGIN_S * NANOSECONDS)
    assert given.receipts == [Receipt(1, 1)]
    assert {event.kind for _, event in given.events} == {"overflow", "payload"}
    assert group.inboxes[0].put(0, b"x" * 10, Receipt(1, 1))


def test_a_message_waits_until_there_is_room(monkeypatch):
    monkeypatch.setattr("midspan.service.group.MAX_WAITING_BYTES", 10)
    group = Group.begun(plan())
    assert group.inboxes[0].put(0, b"x" * 10, Receipt(1, 1))
    reader = threading.Timer(0.2, lambda: group.second(BEGIN_S * NANOSECONDS))
    reader.start()
    assert group.inboxes[1].put(0, b"x" * 10, Receipt(1, 2))
    reader.join()


def test_what_came_is_filtered_in_parts_with_both_sensors_in_step(monkeypatch):
    monkeypatch.setattr("midspan.service.group.MAX_TAKEN_BYTES", 20_000)
    group, seconds, found = Group.begun(plan()), range(60), []
    for number, (topic, payload) in enumerate(message for second in seconds for message in messages(second)):
        inbox, place = group.topics[topic]
        inbox.put(place, payload, Receipt(1, number + 1))
    while (given := group.second((BEGIN_S + 61) * NANOSECONDS)).receipts:
        found.append(given.rows)
    assert len(found) > 10
    assert_same(by_point(found), by_point([one.rows for one in fed(Group.begun(plan()), seconds)]))


def test_blocks_that_come_late_are_counted_once_a_minute():
    group = Group.begun(plan())
    fed(group, range(8))
    events = [event for one in fed(group, [2, 3, 4]) for _, event in one.events]
    assert [event.kind for event in events] == ["late"]


def test_messages_are_not_acknowledged_while_the_store_is_away_as_long_as_the_broker_holds_them(monkeypatch):
    groups = Groups(lambda batch: None, print)
    groups._receipts = [Receipt(1, number) for number in range(50_003)]
    assert groups.receipts(kept=False) == [Receipt(1, number) for number in range(3)]
    assert groups.receipts(kept=False) == []
    assert len(groups.receipts(kept=True)) == 50_000


def test_a_message_of_many_points_may_be_longer():
    assert max_bytes_of([]) == 1_000_000
    many = GroupPlan(plan().settings.model_copy(update={"points": 100_000}), range(100_000))
    assert max_bytes_of([plan(), many]) == 100_070_000


def rows_of(point, t0_ns, count, status, values):
    dt_ns = np.full(len(point), 10**7)
    return GroupRows(
        np.array(point, dtype=np.uint32), np.array(t0_ns), dt_ns, np.array(count, dtype=np.uint32),
        np.array(status, dtype=np.uint8), values, values + 1.0, values + 2.0,
    )  # fmt: skip


def test_runs_that_follow_evenly_are_one_block_of_results():
    step = 10**7
    rows = rows_of([0, 0, 0, 1, 1], [0, 3 * step, 9 * step, 0, 2 * step + 1], [3, 2, 1, 2, 1], [0, 1, 1, 0, 2],
                   1e-3 * np.arange(9.0))  # fmt: skip
    one = joined_runs(rows)
    assert one.count.tolist() == [5, 1, 2, 1]
    assert one.status.tolist() == [1, 1, 0, 2]
    # Stamps before 2000 are refused.
    rows = GroupRows(one.point, one.t0_ns + BEGIN_S * NANOSECONDS, *(getattr(one, name) for name in one.__slots__[2:]))
    sequence = np.array([5, 0], dtype=np.uint32)
    blocks = [(point, parse(body, RESULT)) for point, body in result_blocks(rows, sequence)]
    assert sequence.tolist() == [7, 2]
    whole = {(point, one.t0_ns): one for point, one in blocks}
    first = whole[0, BEGIN_S * NANOSECONDS]
    assert first.dt_ns == step
    np.testing.assert_allclose(first.values, np.arange(5.0), rtol=1e-6)
    np.testing.assert_allclose(first.std, 1000.0 + np.arange(5.0), rtol=1e-6)
    np.testing.assert_allclose(whole[1, BEGIN_S * NANOSECONDS].values, [6.0, 7.0], rtol=1e-6)


def test_numbers_of_a_shard_are_those_of_the_group():
    rows = numbered(rows_of([0, 1, 2], [0, 0, 0], [1, 1, 1], [0, 0, 0], np.zeros(3)), range(2, 12, 4))
    assert rows.point.tolist() == [2, 6, 10]


def published(standings, most):
    """The points whose standing is published now."""
    points = standings.changed(most)
    for point in points:
        standings.is_published(point)
    return points


def test_how_points_stand():
    standings = Standings(5)
    both = np.arange(4, dtype=np.uint32)
    standings.look(0.0)
    assert standings.why.tolist() == [STARTING] * 5
    for sensor in (0, 1):
        standings.heard(sensor, both, 1.0)
    standings.given(rows_of([0, 1, 2], [0, 0, 0], [1, 1, 1], [0, 2, 1], np.zeros(3)), 1.0)
    standings.look(2.0)
    assert standings.why.tolist() == [0, LOST, 0, OPENING, STARTING]
    assert published(standings, 10) == [0, 1, 2, 3, 4]
    assert published(standings, 10) == []
    # One sensor of point 0 stops; point 2 gives no rows any more.
    for now_s in range(2, 10):
        standings.heard(0, both, float(now_s))
        standings.heard(1, both[1:], float(now_s))
        standings.given(rows_of([0, 1], [0, 0], [1, 1], [0, 0], np.zeros(2)), float(now_s))
    standings.look(9.5)
    assert standings.why.tolist() == [SILENT, 0, NO_ROWS, OPENING, STARTING]
    assert standings.status[2] == PointStatus.LOST
    assert published(standings, 2) == [0, 1]
    assert published(standings, 2) == [2]
    standings.forget_published()
    assert published(standings, 10) == [0, 1, 2, 3, 4]
    assert standings.tree(2, "north-2")["reason"] == "no_rows"


def stands(standings, arrivals_s, now_s):
    """Why a point gives nothing some seconds after blocks of both sensors, each with rows."""
    for arrival_s in arrivals_s:
        # Two messages of each sensor at once.
        for sensor in (0, 1, 0, 1):
            standings.heard(sensor, np.zeros(1, dtype=np.uint32), float(arrival_s))
        standings.given(rows_of([0], [0], [1], [0], np.zeros(1)), float(arrival_s))
        standings.look(float(arrival_s))
        assert standings.why.tolist() == [0]
    standings.look(now_s)
    return int(standings.why[0])


@pytest.mark.parametrize("interval_s", [0.2, 1.0, 10.0, 60.0])
def test_a_sensor_is_silent_after_three_of_its_intervals(interval_s):
    """From its second block on: the first interval is the usual one."""
    for blocks in (2, 3, 40):
        arrivals_s = interval_s * np.arange(blocks)
        fresh_s = max(5.0, 3.0 * interval_s)
        assert stands(Standings(1), arrivals_s, arrivals_s[-1] + 0.99 * fresh_s) == 0
        assert stands(Standings(1), arrivals_s, arrivals_s[-1] + 1.01 * fresh_s) == SILENT


def test_an_outage_is_no_usual_interval():
    standings = Standings(1)
    assert stands(standings, range(20), 25.0) == SILENT
    # An hour later it comes again for five seconds, and stops: of the hour as much counts as is still fresh.
    assert stands(standings, range(3619, 3624), 3623.0 + 5.1) == SILENT


def test_an_outage_after_the_first_block_is_no_usual_interval():
    # A retained message, then an hour without: a sensor that dies soon after is silent within minutes.
    assert stands(Standings(1), [0.0, 3600.0], 3600.0 + 181.0) == SILENT


def test_rows_of_long_blocks_are_awaited_as_long_as_their_blocks():
    standings = Standings(1)
    assert stands(standings, [0.0, 10.0, 20.0], 30.0) == 0
    # Blocks go on, rows do not.
    for now_s in (30.0, 40.0, 50.0, 60.0):
        for sensor in (0, 1):
            standings.heard(sensor, np.zeros(1, dtype=np.uint32), now_s)
    standings.look(60.0)
    assert standings.why.tolist() == [NO_ROWS]
    assert standings.status.tolist() == [PointStatus.LOST]


def test_many_events_at_once_are_counted():
    events = [(f"north-{k}", Event(k, "lost", "No displacement.")) for k in range(MAX_EVENTS + 5)]
    kept = fewer("north", events)
    assert kept[:MAX_EVENTS] == events[:MAX_EVENTS]
    assert [name for name, _ in kept[MAX_EVENTS:]] == ["north"]
    assert kept[-1][1].text == "north: 5 more points: No displacement."


def test_a_viewer_gets_the_rows_of_its_point():
    rows = rows_of([3, 1, 3], [0, 0, 10**9], [2, 1, 1], [0, 0, 1], 1e-3 * np.arange(4.0))
    found = np.frombuffer(row_bytes(rows, 3), dtype=ROW)
    assert found["time_ns"].tolist() == [0, 10**7, 10**9]
    np.testing.assert_allclose(found["displacement_mm"], [0.0, 1.0, 3.0])
    assert found["status"].tolist() == [0, 0, 1]
    assert row_bytes(rows, 2) == b""


def test_rows_and_state_are_kept_together_and_come_back(tmp_path):
    kept = []
    with closing(open_store(tmp_path / "store", points=["north"])) as store:
        groups = Groups(kept.append, print)
        groups.begin([plan()], store)
        for second in range(5):
            for topic, payload in messages(second):
                inbox, place = groups.inboxes[topic]
                inbox.put(place, payload, Receipt(1, 1))
            groups.second((BEGIN_S + second + 1) * NANOSECONDS, None)
        assert len(groups.receipts(kept=True)) == 5 * 2 * POINTS
        for batch in kept[:4]:
            store.write(batch)
    # The last second was not kept: it comes again.
    with closing(open_store(tmp_path / "store", points=["north"])) as store:
        again = []
        groups = Groups(again.append, print)
        groups.begin([plan()], store)
        for second in (3, 4):
            for topic, payload in messages(second):
                inbox, place = groups.inboxes[topic]
                inbox.put(place, payload, Receipt(1, 1))
        groups.second((BEGIN_S + 5) * NANOSECONDS, None)
        for batch in again:
            store.write(batch)
        wanted = by_point(bank_fed(range(5)))
        for point in range(POINTS):
            chunk = join(list(store.chunks(f"north-{point}", "rows", 0, 2**62)))
            np.testing.assert_array_equal(chunk.time_ns, wanted[point][0])
            np.testing.assert_array_equal(chunk.columns["displacement_m"], wanted[point][1])
            np.testing.assert_array_equal(chunk.columns["std_m"], wanted[point][2])


def test_the_page_s_server_asks_for_all_points_at_once():
    groups = Groups(lambda _: None, print)
    groups._groups = {"north": Group.begun(plan())}
    head, body = asyncio.run(groups.table({"group": "north"}))
    newest = np.frombuffer(body, dtype=ROW, count=POINTS)
    assert newest["status"].tolist() == [PointStatus.WARMING] * POINTS
    assert head["reasons"][body[-1]] == "starting"
    assert groups.watch({"points": ["north-3", "south-1", "north-99"]}) == {"points": ["north-3"]}
    (state,) = groups.state()
    assert state["reasons"] == {"starting": POINTS}
    assert [one["point"] for one in state["points"]] == [f"north-{k}" for k in range(POINTS)]
    # Of points without rows nothing is NaN, which JSON does not have.
    table = GroupTable("north", range(POINTS), head["reasons"], newest, np.frombuffer(body[-POINTS:], dtype=np.uint8))
    shown = table.state(3, float(BEGIN_S), "")
    assert (shown["displacement_mm"], shown["displacement_std_mm"], shown["time"], shown["age_s"]) == (None,) * 4
    for tree in (state, head, shown):
        json.dumps(tree, allow_nan=False)


def test_a_state_that_cannot_be_used_begins_anew(tmp_path):
    said, kept = [], []
    with closing(open_store(tmp_path / "store", points=["north"])) as store:
        groups = Groups(kept.append, said.append)
        groups.begin([plan()], store)
        for topic, payload in messages(0):
            inbox, place = groups.inboxes[topic]
            inbox.put(place, payload, Receipt(1, 1))
        groups.second((BEGIN_S + 1) * NANOSECONDS, None)
        (chunk,) = kept[-1].groups
        store.write(Batch(groups=[replace(chunk, checkpoint=(chunk.checkpoint[0], b"of another version"))]))
        again = Groups(kept.append, said.append)
        again.begin([plan()], store)
    assert again.points == POINTS
    assert "north: the stored state cannot be used" in said[0]
