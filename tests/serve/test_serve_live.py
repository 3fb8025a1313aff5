"""Live rows: numbered, resumed after a cut without a hole, and never held up by who does not take them."""

import asyncio
import contextlib
import json
import socket
import time

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from midspan.records import NANOSECONDS
from midspan.serve import viewers
from midspan.serve.viewers import LiveRows
from midspan.service.live_socket import row_bytes
from served import rows, state, until


def address(served, query=""):
    return f"ws://127.0.0.1:{served.port}/api/v1/live{query}"


def signed(token):
    return {"additional_headers": {"Authorization": f"Bearer {token}"}}


def part(begin_ns, k):
    """The k-th half second of rows."""
    return rows(begin_ns + (1000 + k) * NANOSECONDS // 2, 0.5)


async def received(client, count):
    """A number of messages with rows."""
    found = []
    while len(found) < count:
        message = json.loads(await asyncio.wait_for(client.recv(), 20.0))
        if "sequence" in message:
            found.append(message)
    return found


async def end_of(client):
    """The code that the server ends a connection with."""
    try:
        while True:
            await asyncio.wait_for(client.recv(), 20.0)
    except ConnectionClosed as closed:
        return closed.rcvd.code


def test_rows_come_and_a_cut_leaves_no_hole(served, engine, tokens, begin_ns):
    async def watch():
        async with connect(address(served, "?points=p"), **signed(tokens["read"])) as client:
            await asyncio.to_thread(engine.give, part(begin_ns, 0))
            (first,) = await received(client, 1)
        for k in (1, 2):
            await asyncio.to_thread(engine.give, part(begin_ns, k))
            await asyncio.sleep(0.5)
        async with connect(address(served, f"?points=p&after={first['sequence']}"), **signed(tokens["read"])) as client:
            return [first, *await received(client, 2)]

    found = asyncio.run(watch())
    assert [one["sequence"] for one in found] == sorted({one["sequence"] for one in found})
    times = [stamp for one in found for stamp in one["time"]]
    expected = [stamp for k in range(3) for stamp in part(begin_ns, k).time_ns.tolist()]
    assert times == expected
    assert set(found[0]) == {"sequence", "point", "time", "displacement_mm", "displacement_std_mm", "status"}
    assert {len(found[0][key]) for key in ("time", "displacement_mm", "displacement_std_mm", "status")} == {50}
    assert set(found[0]["status"]) == {"tracking"}
    own = part(begin_ns, 0).columns
    # What is kept, in mm, and rounded for viewers.
    for key, column in (("displacement_mm", "displacement_m"), ("displacement_std_mm", "std_m")):
        assert found[0][key] == pytest.approx((1e3 * own[column]).tolist(), rel=1e-3, abs=1e-4)


def test_a_viewer_gets_the_points_that_it_asked_for(served, engine, tokens, begin_ns):
    async def watch():
        async with connect(address(served, "?points=q"), **signed(tokens["read"])) as client:
            await asyncio.to_thread(engine.give, part(begin_ns, 3))
            await asyncio.to_thread(engine.give, rows(begin_ns, 0.5, point="q"))
            return await received(client, 1)

    (found,) = asyncio.run(watch())
    assert found["point"] == "q"


def test_changes_of_states_come_too(served, engine, tokens):
    first, second = state()["points"]

    async def watch():
        async with connect(address(served), **signed(tokens["read"])) as client:
            # What changes by itself is no change.
            engine.state = state(points=[{**first, "rows_age_s": 9.0}, second])
            await asyncio.sleep(0.5)
            engine.state = state(points=[first, {**second, "reason": "offered"}], ready=False)
            while True:
                message = json.loads(await asyncio.wait_for(client.recv(), 20.0))
                if message.get("type") == "state":
                    return message

    try:
        found = asyncio.run(watch())
    finally:
        engine.state = state()
    (changed,) = found["points"]
    assert (changed["name"], changed["reason"], changed["status"]) == ("q", "offered", "tracking")
    assert (found["ready"], found["sources"], found["again"]) == (False, [], False)


@pytest.mark.parametrize(
    ("query", "headers", "code"),
    [
        ("", {}, 401),
        ("", {"Authorization": "Bearer wrong"}, 401),
        ("", {"Origin": "http://another.example"}, 403),
        ("?points=nobody", None, 404),
        ("?after=x", None, 422),
        ("?after=-1", None, 422),
        ("?points=" + "a," * 1500, None, 422),
    ],
)
def test_who_may_not_look_is_turned_away(served, tokens, query, headers, code):
    headers = signed(tokens["read"])["additional_headers"] if headers is None else headers

    async def knock():
        async with connect(address(served, query), additional_headers=headers):
            pass

    with pytest.raises(InvalidStatus) as refused:
        asyncio.run(knock())
    assert refused.value.response.status_code == code
    assert json.loads(refused.value.response.body)["status"] == code


@pytest.mark.parametrize("sent", ["x" * 100_000, b"\xff" * 100_000])
def test_large_messages_of_a_viewer_end_its_connection_alone(served, tokens, sent, reader):
    async def shout():
        async with connect(address(served), **signed(tokens["read"])) as client:
            await client.send(sent)
            return await end_of(client)

    assert asyncio.run(shout()) == 1009
    assert reader.get("/api/v1/points").status_code == 200


def test_rubbish_in_place_of_frames_ends_its_connection_alone(served, tokens, reader):
    request = (
        f"GET /api/v1/live HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {tokens['read']}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )
    # Rubbish; a frame of 2^62 bytes; half a frame.
    for frame in (b"\x00\x01\x02\x03" * 50, b"\x82\xff" + (2**62).to_bytes(8, "big") + b"abcd", b"\x82"):
        with socket.create_connection(("127.0.0.1", served.port), timeout=20.0) as raw:
            raw.sendall(request.encode())
            assert b"101" in raw.recv(12)
            raw.sendall(frame)
            time.sleep(0.1)
    assert reader.get("/api/v1/points").status_code == 200


def test_a_removed_token_sees_nothing_more(served, store_folder):
    from midspan.cli.main import run
    from served import logged_in

    token = logged_in(store_folder, "leaving", "read")

    async def watch():
        async with connect(address(served), **signed(token)) as client:
            assert await asyncio.to_thread(run, ["access", str(store_folder), "remove", "leaving", "--quiet"]) == 0
            begun_s = time.monotonic()
            return await end_of(client), time.monotonic() - begun_s

    code, took_s = asyncio.run(watch())
    assert code == 1008
    # Looked up every two seconds; the rest is what a busy machine may take.
    assert took_s < 10.0


def test_a_viewer_that_stalls_is_ended_while_others_see_every_row(served, engine, tokens, begin_ns, reader):
    """What waits for it is bounded; its end is its own alone."""
    request = (
        f"GET /api/v1/live?points=p HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {tokens['read']}\r\n"
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
        "Sec-WebSocket-Version: 13\r\n\r\n"
    )

    def dropped():
        (line,) = [one for one in reader.get("/metrics").text.splitlines() if one.startswith("midspan_viewers_dropped")]
        return float(line.split()[1])

    async def watch():
        times = []
        async with connect(address(served, "?points=p"), max_queue=None, **signed(tokens["read"])) as client:
            for k in range(20):
                await asyncio.to_thread(engine.give, rows(begin_ns + (2000 + 100 * k) * NANOSECONDS, 100.0))
                while len(times) < (k + 1) * 100 * 100:
                    times += (await received(client, 1))[0]["time"]
        return times

    with socket.socket() as stalled:
        stalled.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stalled.connect(("127.0.0.1", served.port))
        stalled.sendall(request.encode())
        assert b"101" in stalled.recv(12)
        before = dropped()
        times = asyncio.run(watch())
        assert len(set(times)) == 200_000
        until(lambda: dropped() == before + 1)
        # Its connection is ended by force.
        stalled.settimeout(20.0)
        with contextlib.suppress(ConnectionResetError):
            while stalled.recv(1_000_000):
                pass


def given(live, point, chunk):
    live.came(point, row_bytes(chunk))
    live.send()


def test_a_viewer_that_takes_nothing_is_dropped_and_the_others_are_not(monkeypatch, begin_ns):
    monkeypatch.setattr(viewers, "MAX_WAITING_BYTES", 20_000)

    async def look():
        live = LiveRows()
        stalled, other = live.enter(None, None), live.enter(None, None)
        taken = []
        for k in range(20):
            given(live, "p", part(begin_ns, k))
            taken.append(json.loads(await other.next()))
        assert stalled.dropped.is_set()
        assert await stalled.next() is None
        assert (live.viewers, live.dropped) == (1, 1)
        assert len({one["sequence"] for one in taken}) == 20

    asyncio.run(look())


def test_provisional_rows_go_to_who_asks_for_them_and_are_not_kept(begin_ns):
    async def look():
        live = LiveRows()
        asks, other = live.enter(None, None, head=True), live.enter(None, None)
        elsewhere = live.enter(frozenset({"q"}), None, head=True)
        for k in (0, 1):
            live.came_ahead("p", row_bytes(part(begin_ns, k)))
        live.send()
        head = json.loads(await asks.next())
        assert (head["type"], head["point"], "sequence" in head, "status" in head) == ("head", "p", False, False)
        assert head["time"] == [*part(begin_ns, 0).time_ns.tolist(), *part(begin_ns, 1).time_ns.tolist()]
        assert len(head["displacement_mm"]) == len(head["displacement_std_mm"]) == len(head["time"])
        assert not other.waiting
        assert not elsewhere.waiting
        # Sent once, and none of what a viewer that was cut off is given.
        live.send()
        assert not asks.waiting
        assert not live._kept

    asyncio.run(look())


def test_what_is_kept_no_longer_is_said_to_be_a_gap(monkeypatch, begin_ns):
    monkeypatch.setattr(viewers, "MAX_KEPT_BYTES", 20_000)

    async def look():
        live = LiveRows()
        numbers = []
        viewer = live.enter(None, None)
        for k in range(20):
            given(live, "p", part(begin_ns, k))
            numbers.append(json.loads(await viewer.next())["sequence"])
        late = live.enter(None, numbers[0])
        gap = json.loads(await late.next())
        assert (gap["type"], gap["after"]) == ("gap", numbers[0])
        first = json.loads(await late.next())
        assert first["sequence"] == gap["first"] > numbers[1]
        recent = live.enter(None, numbers[-2])
        assert json.loads(await recent.next())["sequence"] == numbers[-1]

    asyncio.run(look())


def test_the_server_says_when_nothing_measures_and_when_it_does_again(served, engine, reader):
    engine.stop()
    try:
        until(lambda: reader.get("/readyz").json()["sources"][0:1] and not reader.get("/readyz").json()["ready"])
        standing = reader.get("/readyz").json()
        assert [one["reason"] for one in standing["sources"]] == ["not_measuring"]
        answer = reader.get("/api/v1/points/p").json()
        # Rows that are kept are shown, with their age.
        assert (answer["reason"], answer["displacement_mm"] is not None) == ("not_measuring", True)
        assert reader.get("/api/v1/sources/p.camera/picture").status_code in (404, 503)
    finally:
        engine.start()
    until(lambda: reader.get("/readyz").status_code == 200)
