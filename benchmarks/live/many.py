"""Thousands of points: an estimator each, at 100 Hz of acceleration and 10 Hz of displacement.

`python -m benchmarks.live.many`: processor time of 10 000 points from memory, and of 2000 points whose blocks of a
second come by MQTT, parsing included (not the broker's and the sender's own, which is another process).
"""

import multiprocessing
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.live.servers import Mosquitto
from benchmarks.table import goal
from midspan.fusion.estimator import Estimator
from midspan.fusion.model import EstimatorSettings
from midspan.records import NANOSECONDS, Channel, Floats, Measured, Samples, Source, nanoseconds
from midspan.service.mqtt import Broker
from midspan.settings.site import MqttSettings
from midspan.sources.live.blocks import ACCELERATION, DISPLACEMENT, Block, pack, parse

FAST_HZ, SLOW_HZ = 100, 10
MANY, MANY_S = 10_000, 10
BY_MQTT, BY_MQTT_S, WAIT_S = 2000, 20, 30.0
NOISE_M_S2, NOISE_M, TONE_HZ, SIZE_M = 2e-3, 1e-4, 1.0, 2e-3
GOAL_SHARE = 0.25


def second(number: int, points: int, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Times (s,) of a second's samples, acceleration (p, s) and displacement (p, m): a tone of 2 mm."""
    fast, slow = (number + np.arange(1, rate + 1) / rate for rate in (FAST_HZ, SLOW_HZ))
    speed = 2 * np.pi * TONE_HZ
    pull = -SIZE_M * speed**2 * np.sin(speed * fast) + rng.normal(0.0, NOISE_M_S2, (points, FAST_HZ))
    moved = SIZE_M * np.sin(speed * slow) + rng.normal(0.0, NOISE_M, (points, SLOW_HZ))
    return fast, pull, moved


class Points:
    """An estimator for each point."""

    def __init__(self, points: int) -> None:
        settings = EstimatorSettings((Channel("level", Source.DISPLACEMENT, 1.0),), zero_ns=0)
        self._estimators = [Estimator(settings) for _ in range(points)]

    def push(self, number: int, pull: Floats, moved: Floats) -> Floats:
        """Displacement (p, s) in m of a second's rows; NaN where they are held back still."""
        fast_ns, slow_ns = (nanoseconds(number + np.arange(1, rate + 1) / rate) for rate in (FAST_HZ, SLOW_HZ))
        noise, kind = np.full((FAST_HZ, 1), NOISE_M_S2**2 / FAST_HZ), np.zeros(FAST_HZ, dtype=np.uint8)
        none, variance = np.zeros(SLOW_HZ), np.full(SLOW_HZ, NOISE_M**2)
        channel = np.zeros(SLOW_HZ, dtype=np.int64)
        rows = np.full((len(pull), FAST_HZ), np.nan)
        for point, estimator in enumerate(self._estimators):
            estimator.push(Measured(slow_ns, channel, moved[point], variance, none))
            for found in estimator.push(Samples(fast_ns, pull[point][:, None], noise, kind)):
                if found.estimates and len(found.estimates[0].time_ns) == FAST_HZ:
                    rows[point] = found.estimates[0].displacement_m
        return rows


def error_m(rows: Floats, fast: Floats) -> float:
    """Error (rms, m) of a second's rows (p, s)."""
    return float(np.sqrt(np.nanmean((rows - SIZE_M * np.sin(2 * np.pi * TONE_HZ * fast)) ** 2)))


def from_memory() -> None:
    """10 000 points."""
    points, rng, busy_s = Points(MANY), np.random.default_rng(0), 0.0
    for number in range(MANY_S + 1):
        fast, pull, moved = second(number, MANY, rng)
        begun_s = time.process_time()
        rows = points.push(number, pull, moved)
        # In the first second the rows are held back.
        busy_s += time.process_time() - begun_s if number else 0.0
    print(f"        {MANY} points from memory: {1e3 * error_m(rows, fast):.3f} mm rms in the last second")
    goal("10 000 points: share of one core", busy_s / MANY_S, GOAL_SHARE)


def send(port: int, begin_s: float) -> None:
    """Send the blocks of all points once a second, in a process of its own."""
    import paho.mqtt.client as mqtt

    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="sensors")
    client.max_queued_messages_set(0)
    client.max_inflight_messages_set(0)
    client.connect("127.0.0.1", port)
    client.loop_start()
    rng = np.random.default_rng(1)
    for number in range(BY_MQTT_S):
        _, pull, moved = second(number, BY_MQTT, rng)
        time.sleep(max(begin_s + number + 1 - time.time(), 0.0))
        for kind, values, rate in ((ACCELERATION, pull, FAST_HZ), (DISPLACEMENT, moved, SLOW_HZ)):
            t0_ns = round((begin_s + number + 1 / rate) * NANOSECONDS)
            for point, own in enumerate(values):
                block = Block(kind, number, t0_ns, NANOSECONDS // rate, own)
                client.publish(f"{kind}/{point}", pack(block), qos=1)
    time.sleep(WAIT_S)
    client.disconnect()
    client.loop_stop()


class Gathered:
    """Blocks by the second that they are of; a second that is whole goes to the estimators."""

    def __init__(self, begin_s: float) -> None:
        self.points, self.begin_s, self.done, self.late_s = Points(BY_MQTT), begin_s, 0, 0.0
        self.error_m = np.nan
        self._pull: dict[int, dict[int, Floats]] = {}
        self._moved: dict[int, dict[int, Floats]] = {}

    def taken(self, topic: str, payload: bytes, acknowledge: object) -> None:
        """A block."""
        kind, point = map(int, topic.split("/"))
        block = parse(payload, kind)
        own = self._pull if kind == ACCELERATION else self._moved
        own.setdefault(block.sequence, {})[point] = block.values
        number = block.sequence
        if len(self._pull.get(number, ())) == len(self._moved.get(number, ())) == BY_MQTT:
            self._push(number)
        acknowledge()  # type: ignore[operator]

    def _push(self, number: int) -> None:
        pull, moved = (
            np.stack([own[point] for point in range(BY_MQTT)])
            for own in (self._pull.pop(number), self._moved.pop(number))
        )
        fast = number + np.arange(1, FAST_HZ + 1) / FAST_HZ
        self.error_m = error_m(self.points.push(number, pull, moved), fast)
        self.done, self.late_s = self.done + 1, max(self.late_s, time.time() - self.begin_s - number - 1)


def by_mqtt() -> None:
    """2000 points through a broker."""
    with tempfile.TemporaryDirectory(prefix="midspan-many-") as name:
        server = Mosquitto(Path(name))
        server.start()
        begin_s = float(int(time.time()) + 5)
        found = Gathered(begin_s)
        topics = {f"{kind}/+": 1 for kind in (ACCELERATION, DISPLACEMENT)}
        broker = Broker(MqttSettings(port=server.port), "many", topics, found.taken)
        broker.start()
        sender = multiprocessing.get_context("spawn").Process(target=send, args=(server.port, begin_s))
        sender.start()
        begun_s = time.process_time()
        until_s = begin_s + BY_MQTT_S + WAIT_S
        while found.done < BY_MQTT_S and time.time() < until_s:
            time.sleep(0.1)
        share = (time.process_time() - begun_s) / BY_MQTT_S
        broker.stop()
        sender.terminate()
        sender.join(timeout=10.0)
        server.stop()
    print(f"        {BY_MQTT} points by MQTT: {1e3 * found.error_m:.3f} mm rms in the last second")
    goal("2000 points by MQTT: seconds that came whole", found.done, BY_MQTT_S, at_least=True)
    goal("and at the latest after their end", found.late_s, 1.0, unit="s")
    print(f"        {100 * share:.0f} % of one core, parsing included")


def main() -> int:
    """Measure both."""
    from_memory()
    if Mosquitto.program() is None:
        print("Needs mosquitto: sh tools/servers.sh installs it.", file=sys.stderr)
        return 2
    by_mqtt()
    return 0


if __name__ == "__main__":
    sys.exit(main())
