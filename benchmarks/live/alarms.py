"""How long an alarm takes from its sample to MQTT and to the page, through the whole of `midspan run`.

`python -m benchmarks.live.alarms [SECONDS]`: a point with an accelerometer of 100 Hz in blocks of 0.2 s and a
displacement sensor, whose crests exceed a limit again and again; its alarm has no delay, and goes to a webhook that
never answers as well.
"""

import contextlib
import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from datetime import datetime
from pathlib import Path

import numpy as np

from benchmarks.live.sensors import Transmitter, motion
from benchmarks.live.servers import Mosquitto, command
from benchmarks.live.site import RunningSite
from benchmarks.table import goal

LENGTH_S, READY_S, GOAL_S = 60.0, 120.0, 1.0
ALARM = """
[[point.alarm]]
name = "crest"
on = "displacement"
limit_mm = {limit}
keep_firing_s = 0.0
[[notify]]
webhook = "http://127.0.0.1:{deaf}/"
"""


def listened(port: int, late_s: list[float], states: list[str]) -> object:
    """A client that notes how old the sample is that an alarm fires on."""
    import paho.mqtt.client as mqtt

    def taken(_client: object, _data: object, message: mqtt.MQTTMessage) -> None:
        tree = json.loads(message.payload)
        states.append(tree["state"])
        if tree["state"] == "firing" and not message.retain:
            late_s.append(time.time() - datetime.fromisoformat(tree["time"]).timestamp())

    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="listener")
    client.on_message = taken
    client.connect("127.0.0.1", port)
    client.subscribe("midspan/v1/site/+/alarm", qos=1)
    client.loop_start()
    return client


def watched(site: RunningSite, late_s: list[float], ending: threading.Event) -> threading.Thread:
    """A thread that looks as the page does, and notes how old the sample is that an alarm fires on."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    asked = command("access", site.store, "add-token", "watcher", "--scope", "read", "--json")
    token = json.loads(subprocess.run(asked, capture_output=True, check=True).stdout)["token"]
    headers = {"Authorization": f"Bearer {token}"}

    def watch() -> None:
        address = f"ws://127.0.0.1:{site.web}/api/v1/live"
        with connect(address, additional_headers=headers) as page, contextlib.suppress(ConnectionClosed):
            while not ending.is_set():
                tree = json.loads(page.recv())
                if tree.get("type") == "alarm" and tree["state"] == "firing":
                    late_s.append(time.time() - datetime.fromisoformat(tree["time"]).timestamp())

    thread = threading.Thread(target=watch)
    thread.start()
    return thread


def show(where: str, late_s: list[float]) -> None:
    """Print how late the alarms of a run were."""
    goal(f"sample to alarm on {where}, p99", float(np.percentile(late_s, 99)), GOAL_S, unit="s")
    print(f"        median {np.median(late_s):.2f} s, longest {max(late_s):.2f} s over {len(late_s)} alarms")


def main(length_s: float = LENGTH_S) -> int:
    """Run the site, and print how late its alarms were."""
    if Mosquitto.program() is None:
        print("Needs mosquitto: sh tools/servers.sh installs it.", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="midspan-alarms-") as name, contextlib.ExitStack() as stack:
        folder, moved = Path(name), motion(0)
        limit_mm = 0.5e3 * float(np.abs(moved.displacement(np.arange(0.0, 10.0, 0.01))).max())
        broker = Mosquitto(folder)
        broker.start()
        stack.callback(broker.stop)
        deaf = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        sensors = Transmitter(broker.port, {"p0": moved})
        sensors.start()
        stack.callback(sensors.stop)
        site = RunningSite(folder, broker.port, {"p0": moved}, {})
        with (folder / "SITE.toml").open("a") as settings:
            settings.write(ALARM.format(limit=limit_mm, deaf=deaf.getsockname()[1]))
        late_s: list[float] = []
        states: list[str] = []
        client = listened(broker.port, late_s, states)
        site.start()
        site.until(lambda reasons: not reasons and site.rows_s("p0") < 30.0, READY_S)
        page_s: list[float] = []
        ending = threading.Event()
        page = watched(site, page_s, ending)
        # What the opening of the point gave at once is none of it.
        time.sleep(5.0)
        late_s.clear()
        page_s.clear()
        time.sleep(length_s)
        ending.set()
        page.join(30.0)
        client.disconnect()  # type: ignore[attr-defined]
        client.loop_stop()  # type: ignore[attr-defined]
        site.stop()
        show("MQTT", late_s)
        show("the page's websocket", page_s)
    return 0


if __name__ == "__main__":
    sys.exit(main(*(float(one) for one in sys.argv[1:])))
