"""How long a site of three calibrated points takes from its start to the first row of each.

`python -m benchmarks.live.start [ROUNDS]`: accelerometers of 100 Hz and displacement sensors by MQTT. The points
calibrate themselves once; then the site is stopped and killed in turns, and started again.
"""

import contextlib
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.live.sensors import motion
from benchmarks.live.servers import Mosquitto
from benchmarks.live.site import RunningSite, whole_site
from benchmarks.table import goal

POINTS, ROUNDS, READY_S, LONGEST_S, GOAL_S = 3, 4, 300.0, 60.0, 5.0


def first_rows_s(site: RunningSite) -> dict[str, float]:
    """Start the site; when the first row of each point is published, s."""
    import paho.mqtt.client as mqtt

    found: dict[str, float] = {}

    def taken(_client: object, _data: object, message: mqtt.MQTTMessage) -> None:
        found.setdefault(message.topic.split("/")[-2], time.monotonic() - begun_s)

    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="listener")
    client.on_message = taken
    client.connect("127.0.0.1", site.broker)
    client.subscribe("midspan/v1/site/+/displacement")
    client.loop_start()
    begun_s = time.monotonic()
    site.start()
    while len(found) < len(site.motions) and time.monotonic() - begun_s < LONGEST_S:
        time.sleep(0.02)
    client.disconnect()
    client.loop_stop()
    return found


def main(rounds: float = ROUNDS) -> int:
    """Run the site, start it again and again, and print how long that took."""
    if Mosquitto.program() is None:
        print("Needs mosquitto: sh tools/servers.sh installs it.", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="midspan-start-") as name, contextlib.ExitStack() as stack:
        motions = {f"p{number}": motion(number) for number in range(POINTS)}
        site, _ = whole_site(stack, Path(name), motions, {}, 1)
        stack.callback(site.stop)
        site.until(lambda reasons: not reasons and all(site.rows_s(one) < 30.0 for one in motions), READY_S)
        time.sleep(10.0)
        for number in range(round(rounds)):
            site.stop(kill=bool(number % 2))
            time.sleep(2.0)
            found = first_rows_s(site)
            how = "after a kill" if number % 2 else "after a stop"
            latest_s = max(found.values()) if len(found) == POINTS else float("inf")
            goal(f"start to the first row of each point, {how}", latest_s, GOAL_S, unit="s")
            time.sleep(5.0)
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(float, sys.argv[1:])))
