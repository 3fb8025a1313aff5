"""Connections are bounded: how many, how long a request takes to be whole, how long an answer takes to be taken."""

import asyncio
import resource
import socket
import subprocess
import sys
import time

from midspan.serve import connection
from midspan.serve.application import application
from midspan.serve.connection import server
from midspan.serve.serving import Serving

HALF = b"GET /readyz HTTP/1.1\r\nHost: x\r\n"


async def answered(port):
    """The status line of a whole request."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET /healthz HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
    line = await asyncio.wait_for(reader.read(), 30.0)
    writer.close()
    return line.split(b"\r\n", 1)[0]


async def checked(check, tmp_path):
    """Run a check against the application over a folder without a store."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        web = server(application(Serving(str(tmp_path))))
        task = asyncio.create_task(web.serve(sockets=[listener]))
        try:
            return await check(listener.getsockname()[1])
        finally:
            web.should_exit = True
            await asyncio.wait_for(task, 30.0)


ENDING = """
import asyncio, os
from midspan.serve.serving import Worker, process
worker = Worker(process)
assert asyncio.run(worker.run(abs, -1)) == 1
worker.close()
os._exit(0)
"""


def test_a_server_that_ends_leaves_no_semaphore_of_its_worker():
    ended = subprocess.run([sys.executable, "-c", ENDING], capture_output=True, text=True, check=True)
    assert ended.stderr == ""


def test_half_requests_are_ended_and_whole_ones_answered(monkeypatch, tmp_path):
    monkeypatch.setattr(connection, "REQUEST_S", 1.0)

    async def check(port):
        begun_s = time.monotonic()
        halves = [await asyncio.open_connection("127.0.0.1", port) for _ in range(50)]
        for _, writer in halves:
            writer.write(HALF)
        assert await answered(port) == b"HTTP/1.1 200 OK"
        # Each is ended by the server; the test's own limit is what a busy machine may take.
        for reader, _ in halves:
            assert await asyncio.wait_for(reader.read(), 30.0) == b""
        assert time.monotonic() - begun_s >= 1.0
        for _, writer in halves:
            writer.close()

    asyncio.run(checked(check, tmp_path))


def test_a_request_whose_body_does_not_come_is_ended(monkeypatch, tmp_path):
    monkeypatch.setattr(connection, "REQUEST_S", 1.0)

    async def check(port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"POST /healthz HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n\r\nhalf")
        # It may be answered before, but is not held.
        assert b"200 OK" not in await asyncio.wait_for(reader.read(), 30.0)
        writer.close()

    asyncio.run(checked(check, tmp_path))


def test_a_connection_that_asks_again_is_given_the_time_anew(monkeypatch, tmp_path):
    monkeypatch.setattr(connection, "REQUEST_S", 2.0)

    async def check(port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        for _ in range(4):
            writer.write(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n")
            assert b"200 OK" in await asyncio.wait_for(reader.readuntil(b"ok\n"), 30.0)
            await asyncio.sleep(0.8)
        writer.write(HALF)
        assert await asyncio.wait_for(reader.read(), 30.0) == b""
        writer.close()

    asyncio.run(checked(check, tmp_path))


def test_many_half_requests_leave_the_service_its_descriptors(tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)

    async def check(port):
        used = len(asyncio.all_tasks())
        halves = []
        for _ in range(600):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(HALF)
            halves.append((reader, writer))
        # Those above the limit are ended at once: this end of them may be closed too.
        await asyncio.sleep(0.5)
        ended = sum(reader.at_eof() or reader.exception() is not None for reader, _ in halves)
        for _, writer in halves:
            writer.close()
        await asyncio.sleep(0.2)
        assert ended >= 600 - connection.MAX_OF_AN_ADDRESS
        assert len(asyncio.all_tasks()) <= used + 1
        assert await answered(port) == b"HTTP/1.1 200 OK"

    # Both ends of each connection are in this process.
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(max(soft, 2048), hard), hard))
    try:
        asyncio.run(checked(check, tmp_path))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_who_does_not_take_the_answer_is_ended(monkeypatch):
    """Of an answer of megabytes nothing is taken: the connection ends."""
    monkeypatch.setattr(connection, "TAKEN_S", 1.0)

    async def large(scope, receive, send):
        headers = [(b"content-type", b"text/plain")]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        for _ in range(100):
            await send({"type": "http.response.body", "body": b"x" * 1_000_000, "more_body": True})
        await send({"type": "http.response.body", "body": b""})

    async def run():
        with socket.create_server(("127.0.0.1", 0)) as listener:
            web = server(large)
            task = asyncio.create_task(web.serve(sockets=[listener]))
            with socket.create_connection(("127.0.0.1", listener.getsockname()[1])) as slow:
                slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                slow.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
                begun_s = time.monotonic()
                while not web.server_state.connections and time.monotonic() - begun_s < 20.0:
                    await asyncio.sleep(0.05)
                while web.server_state.connections and time.monotonic() - begun_s < 20.0:
                    await asyncio.sleep(0.05)
                ended = not web.server_state.connections
            web.should_exit = True
            await asyncio.wait_for(task, 30.0)
            return ended

    assert asyncio.run(run())


def test_an_answer_does_not_wait_for_an_acknowledgement(tmp_path):
    """Headers and content are two writes: by Nagle's algorithm the second would wait 40 ms for the first one's ACK."""

    async def check(port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        took_s = []
        for _ in range(40):
            begun_s = time.monotonic()
            writer.write(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n")
            assert b"200 OK" in await asyncio.wait_for(reader.readuntil(b"ok\n"), 30.0)
            took_s.append(time.monotonic() - begun_s)
        writer.close()
        return took_s

    # The least of many is the machine's own: some milliseconds, busy or not; with the wait none is below 40.
    assert sorted(asyncio.run(checked(check, tmp_path)))[10] < 0.03
