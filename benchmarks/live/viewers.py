"""What fifty viewers cost the server, and what they, slow clients and stalled ones do to rows: nothing.

`python -m benchmarks.live.viewers [SECONDS]`: four points of 100 Hz, one with an RTSP camera. Half of the viewers look
at the camera (a picture a second), half at the trace of a minute, and ask for it, points, health and events as often
as the page does; twenty clients hold half requests and answers that they do not take, five take no live rows at all.
"""

import asyncio
import contextlib
import json
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.live.day import resident_mb
from benchmarks.live.load import children, listened, processor_s
from benchmarks.live.sensors import film, motion
from benchmarks.live.servers import Mosquitto, RtspCamera, command
from benchmarks.live.site import RunningSite, whole_site
from benchmarks.table import goal
from midspan.records import NANOSECONDS

POINTS, RATE_HZ, SHAPE = 4, 15, (240, 320)
VIEWERS, SLOW, STALLED, TRY_LATER = 50, 20, 5, 503
LENGTH_S, READY_S, SETTLED_S = 60.0, 300.0, 10.0
# As the page asks, s: points and health, pictures, and the trace of a minute, which live rows go on with.
ASKED_S, PICTURE_S, TRACE_S, TRACE_NS = 30.0, 1.0, 100.0, 60 * NANOSECONDS
# Published rows may be this much later beside viewers, ms: a tenth of what they take; less is chance.
UNCHANGED_MS = 25.0
GOAL_A_VIEWER, GOAL_ALL, GOAL_LATE_S, GOAL_STALLED_MB = 0.002, 0.1, 1.0, 10.0


def token_of(site: RunningSite) -> str:
    """A token that may look."""
    asked = command("access", site.store, "add-token", f"viewer-{time.time_ns()}", "--scope", "read", "--json")
    return str(json.loads(subprocess.run(asked, capture_output=True, check=True).stdout)["token"])


def server_of(site: RunningSite) -> int:
    """The process that serves."""
    assert site.process is not None
    for pid in children(site.process.pid):
        if b"midspan.serve.process" in Path(f"/proc/{pid}/cmdline").read_bytes():
            return pid
    raise RuntimeError("no server")


async def watching(port: int, token: str, late_s: list[float], until_s: float) -> None:
    """A viewer of all points' live rows, which notes how old the newest row of each message is."""
    from websockets.asyncio.client import connect

    headers, address = {"Authorization": f"Bearer {token}"}, f"ws://127.0.0.1:{port}/api/v1/live"
    async with connect(address, additional_headers=headers, open_timeout=60.0, ping_timeout=None) as socket:
        while time.monotonic() < until_s:
            with contextlib.suppress(TimeoutError):
                tree = json.loads(await asyncio.wait_for(socket.recv(), 1.0))
                if "sequence" in tree:
                    late_s.append(time.time() - tree["time"][-1] / NANOSECONDS)


async def asking(port: int, token: str, paths: list[tuple[str, float]], begin_s: float, until_s: float) -> None:
    """A viewer that asks for each path every so many seconds, over one connection each as a browser does."""
    import httpx

    headers = {"Authorization": f"Bearer {token}"}
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}", headers=headers, timeout=30.0) as client:

        async def again(path: str, every_s: float) -> None:
            await asyncio.sleep(begin_s)
            while time.monotonic() < until_s:
                to_ns = time.time_ns()
                answer = await client.get(path.format(to_ns - TRACE_NS, to_ns))
                # Too many at once are told to come again, as the page does.
                if answer.status_code != TRY_LATER:
                    answer.raise_for_status()
                await asyncio.sleep(every_s)

        await asyncio.gather(*(again(*one) for one in paths))


async def viewed(port: int, token: str, length_s: float, count: int) -> list[float]:
    """Viewers for a while; how late they saw rows, s."""
    late_s: list[float] = []
    until_s = time.monotonic() + length_s
    polled = [("/api/v1/points", ASKED_S), ("/api/v1/health", ASKED_S)]
    picture = [*polled, ("/api/v1/sources/p0.camera/picture", PICTURE_S)]
    # 1000 px of buckets.
    span = "from={}&to={}"
    trace = [(f"/api/v1/points/p1/series?buckets=1000&{span}", TRACE_S), (f"/api/v1/points/p1/events?{span}", TRACE_S)]
    trace += polled
    work = []
    for number in range(count):
        begin_s = number / max(count, 1) * ASKED_S
        work += [watching(port, token, late_s, until_s)]
        work += [asking(port, token, picture if number % 2 else trace, begin_s, until_s)]
    await asyncio.gather(*work)
    return late_s


@contextlib.contextmanager
def slow_clients(port: int, token: str) -> Any:
    """Half requests, and answers of megabytes that are not taken."""
    with contextlib.ExitStack() as stack:
        for number in range(SLOW):
            raw = stack.enter_context(socket.socket())
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            raw.connect(("127.0.0.1", port))
            head = f"GET /api/v1/points/p1/series HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {token}\r\n"
            raw.sendall((head + ("\r\n" if number % 2 else "X-Slow: ")).encode())
        yield


@contextlib.contextmanager
def stalled_viewers(port: int, token: str, count: int) -> Any:
    """Websockets that take nothing."""
    request = (
        f"GET /api/v1/live HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {token}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )
    with contextlib.ExitStack() as stack:
        for _ in range(count):
            raw = stack.enter_context(socket.socket())
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            raw.connect(("127.0.0.1", port))
            raw.sendall(request.encode())
        yield


def load_of(words: list[str]) -> None:
    """The viewers, in a process of their own: `viewers COUNT PORT TOKEN SECONDS` prints how late each row was, s."""
    count, port, token, length_s = int(words[0]), int(words[1]), words[2], float(words[3])
    with slow_clients(port, token) if count else contextlib.nullcontext():
        print(json.dumps(asyncio.run(viewed(port, token, length_s, count))))


def measured(site: RunningSite, token: str, count: int, length_s: float) -> tuple[float, float, list[float]]:
    """Server's share of a core, p99 of published rows (ms), and how late viewers saw rows (s), with so many viewers."""
    late_ms: list[float] = []
    begun: list[float] = []
    client = listened(site.broker, late_ms, begun)
    words = [sys.executable, "-m", "benchmarks.live.viewers", "load", str(count), str(site.web), token, str(length_s)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE)
    # Connections and imports are none of what lasts.
    time.sleep(5.0)
    pid = server_of(site)
    begun.append(time.monotonic())
    first_s = processor_s(pid)
    time.sleep(length_s - 10.0)
    share = (processor_s(pid) - first_s) / (time.monotonic() - begun[0])
    client.disconnect()  # type: ignore[attr-defined]
    client.loop_stop()  # type: ignore[attr-defined]
    found = json.loads(process.communicate()[0])
    return share, float(np.percentile(late_ms, 99)), found


def stalled_mb(site: RunningSite, token: str, length_s: float) -> float:
    """What a stalled viewer adds to the server's memory, MB."""
    pid = server_of(site)
    before_mb = resident_mb(pid)
    with stalled_viewers(site.web, token, STALLED):
        time.sleep(length_s)
        return (resident_mb(pid) - before_mb) / STALLED


def main(length_s: float = LENGTH_S) -> int:
    """Run the site, and print what its viewers took."""
    if Mosquitto.program() is None or not RtspCamera.is_installed():
        print("Needs mosquitto and GStreamer's RTSP server: sh tools/servers.sh installs them.", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="midspan-viewers-") as name, contextlib.ExitStack() as stack:
        motions = {f"p{number}": motion(number) for number in range(POINTS)}
        films = {"p0": film(motions["p0"], SHAPE, RATE_HZ)}
        site, _ = whole_site(stack, Path(name), motions, films, RATE_HZ)
        stack.callback(site.stop)
        site.until(lambda reasons: not reasons and all(site.rows_s(one) < 30.0 for one in motions), READY_S)
        time.sleep(SETTLED_S)
        token = token_of(site)
        alone, alone_ms, _ = measured(site, token, 0, length_s)
        share, beside_ms, late_s = measured(site, token, VIEWERS, length_s)
        each = (share - alone) / VIEWERS
        goal("server's share of a core, each viewer", 100.0 * each, 100.0 * GOAL_A_VIEWER, unit="%")
        goal(f"server's share of a core, {VIEWERS} viewers", 100.0 * share, 100.0 * GOAL_ALL, unit="%")
        goal("latest row that a viewer saw", max(late_s), GOAL_LATE_S, unit="s")
        middle, late = np.percentile(late_s, (50, 99))
        print(f"        median {middle:.2f} s, p99 {late:.2f} s; server without viewers {100 * alone:.1f} %")
        goal("sample to published row, p99, beside them", beside_ms, alone_ms + UNCHANGED_MS, unit="ms")
        goal("memory of a stalled viewer", stalled_mb(site, token, length_s), GOAL_STALLED_MB, unit="MB")
    return 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["load"]:
        load_of(sys.argv[2:])
        sys.exit(0)
    sys.exit(main(*map(float, sys.argv[1:])))
