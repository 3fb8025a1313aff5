"""A shard of filter-only points at 100 Hz + 10 Hz by MQTT, against a bare subscriber of the same messages.

`python -m benchmarks.shard [--points 1000] [--group-message] [--seconds 30]`: processor time a second of the service
(its process, and those that it starts) and of the subscriber in the same seconds; then the service is killed and
started again, and the rows of all points are looked at: none lost, none doubled, each near its own point's motion.
"""

import argparse
import os
import queue
import signal
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.live.load import processor_s
from benchmarks.live.servers import Mosquitto, command, free_port
from benchmarks.shard_sensors import EPOCH_S, RATE_HZ, Motion
from benchmarks.table import goal, show
from midspan.service.stored_recording import stored_table
from midspan.sources.live.blocks import RESULT, parse
from midspan.store.store import open_store

MAX_ABOVE_MS, MAX_SHARED_MS, MAX_BACK_S = 60.0, 80.0, 2.0
SETTLED_S, AFTER_S = 8.0, 8.0
SITE = """
name = "fleet"
[store]
path = "store"
[mqtt]
port = {port}
[service]
listen = "127.0.0.1:{listen}"
[[group]]
name = "north"
points = {points}
accelerometer = "mqtt:north/{each}acc"
displacement = "mqtt:north/{each}gnss"
accelerometer_noise_std = 0.005
displacement_noise_std = 1.5
"""


def sensors(what: str, port: int, points: int, shared: bool, seconds: int) -> "subprocess.Popen[str]":
    """The sender, or the bare subscriber, as a process of its own."""
    given = (what, port, points, "one" if shared else "each", seconds)
    line = [sys.executable, "-m", "benchmarks.shard_sensors", *map(str, given)]
    return subprocess.Popen(line, stdout=subprocess.PIPE, text=True)


def watching(port: int, came: "queue.Queue[float]") -> Any:
    """A client that notes when each block of the first point's rows comes."""
    import paho.mqtt.client as mqtt
    from paho.mqtt.enums import CallbackAPIVersion

    client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id="watcher")
    client.on_message = lambda _client, _data, message: came.put(parse(bytes(message.payload), RESULT).t0_ns / 1e9)
    client.connect("127.0.0.1", port)
    client.subscribe("midspan/v1/fleet/north-0/displacement")
    client.loop_start()
    return client


def own_s(pid: int) -> float:
    """Processor time of a process alone, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mb(pid: int) -> float:
    """Memory of a process, MB."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def spent(pids: dict[str, int], seconds: float) -> dict[str, float]:
    """Processor time (ms) a second of processes, and of the service with what it started."""

    def now() -> dict[str, float]:
        return {name: own_s(pid) for name, pid in pids.items()} | {"all": processor_s(pids["service"])}

    before, begun_s = now(), time.monotonic()
    time.sleep(seconds)
    passed_s = time.monotonic() - begun_s
    return {name: 1e3 * (value - before[name]) / passed_s for name, value in now().items()}


def looked_at(store: Path, points: int) -> dict[str, Any]:
    """The rows of all points: how many, how many of them are lost or doubled, and how far they are from the motion."""
    motion, rows, lost, doubled, off, outside = Motion(points), 0, 0, 0, np.zeros(points), 0
    step_ns = 10**9 // RATE_HZ
    reader = open_store(store, read_only=True)
    for number in range(points):
        table = stored_table(reader, f"north-{number}", 0, 2**62)
        time_ns = np.asarray(table.time_ns)
        steps = np.diff(time_ns) // step_ns
        rows, lost, doubled = (
            rows + len(time_ns),
            lost + int((steps - 1).clip(0).sum()),
            doubled + int((steps < 1).sum()),
        )
        late = time_ns > time_ns[0] + 5 * 10**9
        time_s = (time_ns[late] // 10**9 % EPOCH_S) + (time_ns[late] % 10**9) / 1e9
        truth_m = Motion.displacement_m(_one(motion, number), time_s)[0]
        error_m = np.asarray(table.columns["displacement_mm"])[late] / 1e3 - truth_m
        off[number] = np.sqrt(np.mean(error_m**2))
        outside += int(np.sum(np.abs(error_m) > 1.96e-3 * np.asarray(table.columns["displacement_std_mm"])[late]))
    reader.close()
    return {"rows": rows, "lost": lost, "doubled": doubled, "worst_mm": 1e3 * off.max(), "rms_mm": 1e3 * off.mean(),
            "inside": 1.0 - outside / max(rows - points * 5 * RATE_HZ, 1)}  # fmt: skip


def _one(motion: Motion, number: int) -> Motion:
    """The motion of one point."""
    one = Motion.__new__(Motion)
    for name, value in vars(motion).items():
        setattr(one, name, value[number : number + 1])
    return one


def run(points: int, shared: bool, seconds: int, *, serve: bool) -> int:
    """Measure; 0 where all goals are met."""
    with tempfile.TemporaryDirectory() as folder:
        broker, site = Mosquitto(Path(folder)), Path(folder) / "SITE.toml"
        broker.start()
        text = SITE.format(port=broker.port, listen=free_port(), points=points, each="" if shared else "{i}/")
        site.write_text(text)
        came = queue.Queue[float]()
        watcher = watching(broker.port, came)
        line = command("run", site, "--serve" if serve else "--no-serve", "-q")
        # As an installed package starts: its byte code is kept, whatever the environment says.
        start = partial(
            subprocess.Popen, line, start_new_session=True, env={**os.environ, "PYTHONDONTWRITEBYTECODE": ""}
        )
        service = start()
        bare = sensors("listen", broker.port, points, shared, 100_000)
        sender = sensors("send", broker.port, points, shared, round(SETTLED_S + seconds + 3 * AFTER_S))
        try:
            came.get(timeout=120.0)
            time.sleep(SETTLED_S)
            pids = {"service": service.pid, "bare": bare.pid, "sender": sender.pid, "broker": broker.pid}
            used = spent(pids, seconds)
            used["memory_mb"] = resident_mb(service.pid)
            os.kill(service.pid, signal.SIGKILL)
            service.wait()
            time.sleep(0.5)
            while not came.empty():
                came.get_nowait()
            begun_s = time.monotonic()
            service = start()
            came.get(timeout=120.0)
            back_s = time.monotonic() - begun_s
            sender.wait()
            time.sleep(4.0)
        finally:
            for one in (sender, bare):
                one.kill()
            service.terminate()
            service.wait(30)
            watcher.loop_stop()
            broker.stop()
        found = looked_at(Path(folder) / "store", points)
        found["bytes"] = sum(one.stat().st_size for one in (Path(folder) / "store").rglob("*") if one.is_file())
    return _verdict(points, shared, used, found, back_s)


def _verdict(points: int, shared: bool, used: dict[str, float], found: dict[str, Any], back_s: float) -> int:
    rows = [[name, f"{used[key]:.0f}"] for name, key in (
        ("service, its process", "service"), ("service with the page's server", "all"), ("bare subscriber", "bare"),
        ("sender", "sender"), ("broker", "broker"),
    )]  # fmt: skip
    show(["processor time a second of", "ms"], rows)
    above_ms = used["all"] - used["bare"]
    print(f"memory of its process: {used['memory_mb']:.0f} MB; store: {found['bytes'] / found['rows']:.2f} bytes a row")
    print(
        f"{points} points, {'one message' if shared else 'two messages a point'}; {found['rows']} rows, rms error "
        f"{found['rms_mm']:.3f} mm (worst point {found['worst_mm']:.3f}), {100 * found['inside']:.1f} % inside 1.96 σ"
    )
    if shared:
        met = [goal("in all", used["all"], MAX_SHARED_MS, unit="ms")]
    else:
        met = [goal("above the bare subscriber", above_ms, MAX_ABOVE_MS, unit="ms")]
    met += [goal("back after the kill", back_s, MAX_BACK_S, unit="s"), goal("rows lost", found["lost"], 0),
            goal("rows doubled", found["doubled"], 0)]  # fmt: skip
    return 0 if all(met) else 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--points", type=int, default=1000)
    parser.add_argument("--seconds", type=int, default=30)
    parser.add_argument("--group-message", action="store_true")
    parser.add_argument("--no-serve", action="store_true")
    given = parser.parse_args()
    sys.exit(run(given.points, given.group_message, given.seconds, serve=not given.no_serve))
