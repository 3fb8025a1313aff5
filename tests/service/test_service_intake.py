"""What comes from sensors that are broken or hostile: counted, said once, and no other stream is touched."""

import json
import time

import numpy as np
import pytest

from midspan.records import NANOSECONDS
from midspan.service.intake import Intake, in_si
from midspan.service.running import running
from midspan.settings.site import load_site
from midspan.sources.live.blocks import ACCELERATION, DISPLACEMENT, Block, pack
from midspan.sources.live.instants import SourceFault
from midspan.sources.live.serial_line import Dating, block_of
from midspan.store.numbers import encode_numbers

SITE = """
name = "site"
[store]
path = "store"
[mqtt]
"""
POINT = """
[[point]]
name = "{name}"
[point.accelerometer]
source = "mqtt:{name}/acc"
[point.displacement]
source = "mqtt:{name}/dis"
unit = "mm"
"""
INPUTS = 10_000
NOW_NS = time.time_ns()


@pytest.fixture
def site(tmp_path):
    """The points of a site, its intake, and the events that it tells."""
    (tmp_path / "SITE.toml").write_text(SITE + POINT.format(name="a") + POINT.format(name="b"))
    plans = load_site(tmp_path / "SITE.toml").points
    points = [running(plan, tmp_path / plan.name, tmp_path) for plan in plans]
    events = []
    intake = Intake(points, tmp_path, lambda one: None, lambda one, kind, text: events.append((one.name, kind, text)))
    yield points, intake, events
    for one in points:
        one.live.close()


def block(number, kind=ACCELERATION, ahead_s=-3000.0, count=20):
    t0_ns = NOW_NS + round((ahead_s + 0.2 * number) * NANOSECONDS)
    return Block(kind, number, t0_ns, 10_000_000, np.sin(np.arange(count, dtype=np.float64)))


def as_json(one):
    tree = {"sequence": one.sequence, "t0": one.t0_ns, "dt_s": 0.01, "values": one.values.tolist()}
    return json.dumps(tree).encode()


def damaged(payload, rng):
    """A payload with bytes changed, cut, doubled, or of nothing that was sent."""
    data = bytearray(payload)
    way = rng.integers(5)
    if way == 0:
        for place in rng.integers(0, len(data), rng.integers(1, 9)):
            data[place] = rng.integers(256)
    elif way == 1:
        del data[rng.integers(len(data)) :]
    elif way == 2:
        data += data[rng.integers(len(data)) :]
    elif way == 3:
        data = bytearray(rng.integers(0, 256, rng.integers(0, 200), dtype=np.uint8).tobytes())
    else:
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
    return bytes(data)


def test_ten_thousand_damaged_payloads_touch_no_other_stream(site):
    (first, second), intake, events = site
    rng = np.random.default_rng(0)
    for number in range(INPUTS):
        whole = block(number % 50)
        intake.payload("a/acc", damaged(as_json(whole) if number % 3 == 0 else pack(whole), rng))
        if number % 100 == 0:
            intake.payload("b/acc", pack(block(number // 100)))
            intake.payload("b/dis", pack(block(number // 100, DISPLACEMENT)))
    assert first.streams["accelerometer"].faults > INPUTS // 2
    assert {stream.faults for name, stream in first.streams.items() if name != "accelerometer"} == {0}
    for stream in second.streams.values():
        assert (stream.records, stream.faults, stream.reason) == (INPUTS // 100, 0, "")
    assert {name for name, _, _ in events} <= {"a"}
    # Nothing of the future came in, whatever its bytes said.
    assert first.live.newest_ns < time.time_ns() + 2 * NANOSECONDS


def test_ten_thousand_damaged_lines_are_blocks_or_faults():
    rng, dating, faults = np.random.default_rng(1), Dating(), 0
    for number in range(INPUTS):
        tree = json.loads(as_json(block(number % 50)))
        if number % 2:
            del tree["t0"]
        try:
            found = block_of(damaged(json.dumps(tree).encode(), rng), ACCELERATION, dating, time.time_ns())
        except SourceFault:
            faults += 1
        else:
            assert len(found.time_ns) == len(found.values)
    assert faults > INPUTS // 2


def test_doubled_blocks_are_dropped_and_lost_ones_reported(site):
    (first, _), intake, events = site
    for number in (100, 101, 101, 102, 106, 105, 107):
        intake.payload("a/acc", pack(block(number)))
    stream = first.streams["accelerometer"]
    # One came twice; what changed places is the engine's to judge.
    assert (stream.records, stream.faults) == (6, 1)
    assert [text for _, kind, text in events if kind == "lost_records"] == [
        "accelerometer: blocks lost in transmission: 3."
    ]
    # A sender that was started again counts from 0.
    intake.payload("a/acc", pack(block(120)))
    intake.payload("a/acc", pack(block(0, ahead_s=-100.0)))
    assert stream.records == 8
    # A block that only bears the next number does not shut out the one that should.
    intake.payload("a/acc", pack(block(1, ahead_s=-50.0)))
    intake.payload("a/acc", pack(block(1, ahead_s=-100.0)))
    assert (stream.records, stream.faults) == (10, 1)


def test_lost_blocks_are_one_event_a_minute_with_their_sum(site, monkeypatch):
    (first, _), intake, events = site
    now_s = time.time()
    for number in range(0, 400, 2):
        # Every second block is lost; two blocks last 0.4 s.
        monkeypatch.setattr(time, "time", lambda at_s=now_s + 0.2 * number: at_s)
        intake.payload("a/acc", pack(block(number)))
    reported = [text for _, kind, text in events if kind == "lost_records"]
    assert reported == [f"accelerometer: blocks lost in transmission: {n}." for n in (1, 150)]
    assert first.streams["accelerometer"].lost == 48


def test_another_senders_number_is_no_loss(site):
    (first, _), intake, events = site
    for number in range(100, 110):
        intake.payload("a/acc", pack(block(number)))
        foreign = block(number)
        intake.payload("a/acc", pack(Block(foreign.kind, 5000 + number, foreign.t0_ns, foreign.dt_ns, foreign.values)))
    assert first.streams["accelerometer"].records == 20
    assert "lost_records" not in [kind for _, kind, _ in events]


def test_rubbish_on_a_serial_line_is_called_a_line_that_is_no_block():
    with pytest.raises(SourceFault, match=r"a line must be one block as JSON, \{…\}; received one that begins b'lxyz'"):
        block_of(b"lxyz\n", ACCELERATION, Dating(), NOW_NS)


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: pack(block(1, ahead_s=3600.0)), "clock_ahead"),
        (lambda: pack(Block(ACCELERATION, 1, time.time_ns() - 10**9, 3600 * 10**9, np.zeros(3))), "clock_ahead"),
        (lambda: b"\x00" * 40, "payload"),
        (lambda: pack(Block(ACCELERATION, 1, time.time_ns() - 10**9, 10**7, np.full(5, np.nan))), "no_values"),
    ],
    ids=["first sample ahead", "later samples ahead", "zeros", "NaN"],
)
def test_a_fault_has_a_reason_until_good_records_come(site, make, code):
    (first, _), intake, events = site
    wrong = make()
    intake.payload("a/acc", pack(block(0)))
    for _ in range(3):
        intake.payload("a/acc", wrong)
    now_s = time.time()
    assert first.streams["accelerometer"].standing(now_s, "")["reason"] == code
    assert [kind for _, kind, _ in events].count(code) == 1
    intake.payload("a/acc", pack(block(2)))
    assert first.streams["accelerometer"].standing(now_s, "")["reason"] == ""
    assert "returned" in [kind for _, kind, _ in events]
    # A fault that comes and goes is an event once a minute.
    for number in range(3, 20):
        intake.payload("a/acc", wrong)
        intake.payload("a/acc", pack(block(number)))
    assert [kind for _, kind, _ in events].count(code) == 1
    assert [kind for _, kind, _ in events].count("returned") == 1


def test_silence_is_judged_by_the_usual_interval(site):
    (first, _), _, _ = site
    fast, slow = first.streams["accelerometer"], first.streams["displacement"]
    for number in range(20):
        for stream, at_s in ((fast, 1000.0 + 0.1 * number), (slow, 1000.0 + 30.0 * number)):
            stream.heard(at_s, round(at_s * NANOSECONDS), 1)
    fast.reason = slow.reason = ""
    assert fast.standing(1001.9 + 4.0, "")["reason"] == ""
    assert fast.standing(1001.9 + 6.0, "")["reason"] == "silent"
    assert slow.standing(1570.0 + 60.0, "")["reason"] == ""
    assert slow.standing(1570.0 + 100.0, "")["reason"] == "silent"


def test_a_source_says_its_rate_its_delay_and_how_often_it_was_opened_again(site):
    (first, _), intake, _ = site
    for number in range(50):
        intake.payload("a/acc", pack(block(number)))
    found = first.standing(time.time())["sources"][0]
    # Values, of which a block holds 20; they were sent 3000 s too late.
    assert (found["rate_hz"], found["nominal_rate_hz"]) == (100.0, 100.0)
    # Those of the ten seconds before the last second, of which the mean is six before what came 3000 s ago.
    assert found["delay_s"] == pytest.approx(time.time() - NOW_NS / NANOSECONDS + 3000.0 - 5.0, abs=5.0)
    assert found["restarts"] == 0
    assert {found[key] for key in ("late", "clock_offset_s", "clock_offset_std_s", "clock_drift_ppm")} == {None}
    gone = SourceFault("stopped", "cannot be read")
    for number in range(50, 53):
        intake._came(first, "accelerometer", gone)
        intake._came(first, "accelerometer", gone)
        intake._came(first, "accelerometer", block(number))
    intake._came(first, "accelerometer", SourceFault("payload", "no block"))
    intake._came(first, "accelerometer", block(53))
    # What was never heard is opened for the first time.
    intake._came(first, "displacement", gone)
    intake._came(first, "displacement", block(0, DISPLACEMENT))
    assert [one["restarts"] for one in first.standing(time.time())["sources"]] == [3, 0]


def test_what_comes_in_float32_has_no_more_digits_in_si_units():
    rng = np.random.default_rng(0)
    sent = rng.normal(0.0, 1.0, 1000).astype(np.float32).astype(np.float64)
    sent[0] = np.nan
    value = in_si(sent, 9.80665)
    np.testing.assert_array_equal(value, value.astype(np.float32))
    np.testing.assert_allclose(value, 9.80665 * sent, rtol=2.0**-24)
    # A store takes 4 bytes of each and no more, where all digits would be 7.
    assert len(encode_numbers(value)) < 4.1 * len(value)
    # Others, as a height of 123.4567891 m in text, keep all theirs.
    text = np.array([123.4567891, np.nan, 0.1, 1e300])
    np.testing.assert_array_equal(in_si(text, 1e-3), 1e-3 * text)


def test_what_came_while_a_point_was_begun_is_its_own_and_what_is_dropped_is_counted(site, monkeypatch):
    (first, _), intake, events = site
    monkeypatch.setattr("midspan.service.running.MAX_QUEUED", 10)
    first.beginning = True
    for number in range(14):
        intake.payload("a/acc", pack(block(number)))
    stream = first.streams["accelerometer"]
    # It is heard, though the point takes it later.
    assert (stream.records, len(first.early)) == (0, 10)
    assert stream.heard_s == pytest.approx(time.time(), abs=5.0)
    intake.begin([first])
    assert (stream.records, len(first.early), stream.restarts) == (10, 0, 0)
    lost = [text for name, kind, text in events if (name, kind) == ("a", "lost_records")]
    assert len(lost) == 1
    assert "4 records were dropped" in lost[0]
