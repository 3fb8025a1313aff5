"""The load of a whole site: 4 cameras of 640×480 at 30 frames/s by RTSP, 20 accelerometers at 100 Hz by MQTT.

`python -m benchmarks.live.load [SECONDS]`: processor time of the service and its cameras' processes (not of the broker
and the cameras, which run on the same machine), rows that are missing, and how old a row's sample is when it comes out.
"""

import contextlib
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.live.sensors import film, motion
from benchmarks.live.servers import Mosquitto, RtspCamera
from benchmarks.live.site import RunningSite, whole_site
from benchmarks.table import goal
from midspan.records import NANOSECONDS
from midspan.service.stored_recording import stored_table
from midspan.sources.live.blocks import RESULT, parse
from midspan.store.store import open_store

CAMERAS, POINTS, RATE_HZ, SHAPE, CORES = 4, 20, 30, (480, 640), 2
LENGTH_S, READY_S, SETTLED_S = 600.0, 600.0, 20.0
GOAL_SHARE, GOAL_MS = 0.4, 250.0


def processor_s(pid: int) -> float:
    """Processor time of a process and its children, s."""
    ticks = 0
    for one in [pid, *children(pid)]:
        with contextlib.suppress(OSError):
            fields = Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()
            ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def children(pid: int) -> list[int]:
    """The processes that a process has started."""
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):
            found += [int(one) for one in (task / "children").read_text().split()]
    return found


def listened(port: int, late_ms: list[float], begun_s: list[float]) -> object:
    """A client that notes how old the newest sample of each published block is."""
    import paho.mqtt.client as mqtt

    def taken(_client: object, _data: object, message: mqtt.MQTTMessage) -> None:
        if begun_s:
            block = parse(message.payload, RESULT)
            late_ms.append((time.time_ns() - int(block.time_ns[-1])) / 1e6)

    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="listener")
    client.on_message = taken
    client.connect("127.0.0.1", port)
    client.subscribe("midspan/v1/site/+/displacement")
    client.loop_start()
    return client


def main(length_s: float = LENGTH_S) -> int:
    """Run the site, and print what it took."""
    if Mosquitto.program() is None or not RtspCamera.is_installed():
        print("Needs mosquitto and GStreamer's RTSP server: sh tools/servers.sh installs them.", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="midspan-load-") as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        motions = {f"p{number}": motion(number) for number in range(POINTS)}
        films = {f"p{n}": film(motions[f"p{n}"], SHAPE, RATE_HZ, n) for n in range(CAMERAS)}
        site, _ = whole_site(stack, folder, motions, films, RATE_HZ)
        site.until(lambda reasons: not reasons and all(site.rows_s(one) < 30.0 for one in motions), READY_S)
        time.sleep(SETTLED_S)
        measured(site, site.broker, length_s)
        site.stop()
        whole(site)
    return 0


def measured(site: RunningSite, port: int, length_s: float) -> None:
    """Processor time and latency over a while."""
    late_ms: list[float] = []
    begun_s: list[float] = []
    client = listened(port, late_ms, begun_s)
    assert site.process is not None
    first_s, begun = processor_s(site.process.pid), time.monotonic()
    begun_s.append(begun)
    time.sleep(length_s)
    share = (processor_s(site.process.pid) - first_s) / (time.monotonic() - begun) / CORES
    client.disconnect()  # type: ignore[attr-defined]
    client.loop_stop()  # type: ignore[attr-defined]
    goal("processor time of two cores", share, GOAL_SHARE)
    goal("sample to published row, p99", float(np.percentile(late_ms, 99)), GOAL_MS, unit="ms")
    print(
        f"        median {np.median(late_ms):.0f} ms over {len(late_ms)} blocks; load of the machine {os.getloadavg()}"
    )


def whole(site: RunningSite) -> None:
    """Samples and rows that are missing."""
    store = open_store(site.store, read_only=True)
    lost = missing = 0
    for point in site.motions:
        raw = np.concatenate([one.time_ns for one in store.chunks(point, "accelerometer", 0, 2**62)])
        lost += round((raw[-1] - raw[0]) * 100 / NANOSECONDS) + 1 - len(raw)
        rows = stored_table(store, point, None, None).time_ns
        missing += round((rows[-1] - rows[0]) * 100 / NANOSECONDS) + 1 - len(rows)
        steps_s = np.diff(rows) / NANOSECONDS
        for k in np.flatnonzero(steps_s > 0.015):
            held = int(np.count_nonzero((raw > rows[k]) & (raw < rows[k + 1])))
            gap = f"no row for {steps_s[k]:g} s after {(rows[k] - rows[0]) / NANOSECONDS:g} s"
            print(f"        {point}: {gap}, {held} raw samples")
            for event in store.events(point, int(rows[k]) - NANOSECONDS, int(rows[k + 1]) + NANOSECONDS):
                print(f"            {(event.time_ns - rows[k]) / NANOSECONDS:+.3f} s {event.kind}: {event.text}")
    store.close()
    goal("samples lost", lost, 0)
    goal("rows missing", missing, 0)


if __name__ == "__main__":
    sys.exit(main(*map(float, sys.argv[1:])))
