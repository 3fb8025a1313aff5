"""The local socket: what comes is whole, and a reader that takes nothing costs a bounded amount and no time."""

import asyncio
import stat
import time

import pytest

from midspan.errors import MidspanError, UsageError
from midspan.service import live_socket
from midspan.service.live_socket import SOCKET_FILE, LiveSocket, packed, read_frame, short_address


async def answered(head):
    if head["command"] == "no":
        raise MidspanError("not now")
    return {"text": "done"}, b"body"


def test_a_reader_gets_the_newest_state_rows_and_answers(tmp_path):
    async def talk():
        server = LiveSocket(tmp_path, answered)
        await server.start()
        assert stat.S_IMODE((tmp_path / SOCKET_FILE).stat().st_mode) == 0o600
        server.publish({"kind": "state", "n": 1})
        server.publish({"kind": "rows"}, b"lost: nobody listens")
        server.publish({"kind": "state", "n": 2})
        with short_address(tmp_path) as address:
            reader, writer = await asyncio.open_unix_connection(address)
        found = [await read_frame(reader)]
        server.publish({"kind": "rows", "point": "p"}, b"\n\x00rows\n")
        found.append(await read_frame(reader))
        for command in ("yes", "no"):
            writer.write(packed({"command": command, "id": command}))
            found.append(await read_frame(reader))
        writer.close()
        with pytest.raises(UsageError, match="another `midspan run` uses this store"):
            await LiveSocket(tmp_path, answered).start()
        await server.stop()
        assert not (tmp_path / SOCKET_FILE).exists()
        return found

    assert asyncio.run(talk()) == [
        ({"kind": "state", "n": 2}, b""),
        ({"kind": "rows", "point": "p"}, b"\n\x00rows\n"),
        ({"kind": "answer", "id": "yes", "text": "done"}, b"body"),
        ({"kind": "answer", "id": "no", "error": "not now"}, b""),
    ]


def test_a_reader_that_takes_nothing_is_dropped_and_nobody_waits_for_it(tmp_path, monkeypatch):
    monkeypatch.setattr(live_socket, "MAX_WAITING_BYTES", 2_000_000)

    async def talk():
        server = LiveSocket(tmp_path, answered)
        await server.start()
        with short_address(tmp_path) as address:
            _, writer = await asyncio.open_unix_connection(address, limit=1000)
        while not server.has_readers:
            await asyncio.sleep(0.01)
        longest_s = 0.0
        for _ in range(100):
            begun_s = time.perf_counter()
            server.publish({"kind": "rows"}, bytes(100_000))
            longest_s = max(longest_s, time.perf_counter() - begun_s)
            await asyncio.sleep(0)
        assert (server.dropped, server.has_readers) == (1, False)
        writer.close()
        await server.stop()
        return longest_s

    # A copy of 100 kB takes microseconds; the rest is what a busy machine may take.
    assert asyncio.run(talk()) < 0.5


@pytest.mark.parametrize("rubbish", [b"\xff\xff\xff\xff", b"\x03\x00\x00\x00abc", b"\x00\x00\x00\x00", b"\x10\x00"])
def test_rubbish_ends_its_connection_alone(tmp_path, rubbish):
    async def talk():
        server = LiveSocket(tmp_path, answered)
        await server.start()
        with short_address(tmp_path) as address:
            reader, writer = await asyncio.open_unix_connection(address)
            writer.write(rubbish)
            writer.write_eof()
            assert await asyncio.wait_for(reader.read(), 20.0) == b""
            writer.close()
            other, writer = await asyncio.open_unix_connection(address)
        while not server.has_readers:
            await asyncio.sleep(0.01)
        server.publish({"kind": "rows"}, b"x")
        assert await read_frame(other) == ({"kind": "rows"}, b"x")
        writer.close()
        await server.stop()

    asyncio.run(talk())
