"""What a shard's benchmark listens to: points of bridges that move in modes of their own, and a bare subscriber.

`python -m benchmarks.shard_sensors send|listen PORT POINTS one|each SECONDS`.
"""

import contextlib
import socket
import struct
import sys
import threading
import time
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

RATE_HZ, SLOW_HZ = 100, 10
# Times are counted from a multiple of this, s: the angles of a mode keep their digits.
EPOCH_S = 10_000_000
ACCELERATION_STD, DISPLACEMENT_STD_MM = 0.005, 1.5
HEAD = struct.Struct("<BBHIqqI")


class Motion:
    """Displacements of points (n,): three modes each, of frequencies, amplitudes (m) and phases of their own."""

    def __init__(self, points: int, seed: int = 5) -> None:
        rng = np.random.default_rng(seed)
        self.frequency_hz = rng.uniform(0.3, 3.0, (points, 3))
        self.amplitude_m = rng.uniform(2e-3, 8e-3, (points, 3)) / (1.0 + self.frequency_hz**2)
        self.phase = rng.uniform(0.0, 2.0 * np.pi, (points, 3))
        self.bias_m_s2 = rng.normal(0.0, 0.02, points)

    def modes(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Each mode's displacement (points, 3, times), m."""
        angle = 2.0 * np.pi * self.frequency_hz[..., None] * time_s + self.phase[..., None]
        return self.amplitude_m[..., None] * np.sin(angle)

    def displacement_m(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """(points, times), m."""
        return np.asarray(np.sum(self.modes(time_s), axis=1))

    def acceleration_m_s2(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """(points, times), m/s²."""
        rate = 2.0 * np.pi * self.frequency_hz[..., None]
        return np.asarray(-np.sum(rate**2 * self.modes(time_s), axis=1))


def blocks(motion: Motion, second: int, rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What the sensors read in a second of UTC: accelerations (points, 100) m/s², displacements (points, 10) mm."""
    points = len(motion.bias_m_s2)
    begin_s = float(second % EPOCH_S)
    fast_s, slow_s = begin_s + np.arange(RATE_HZ) / RATE_HZ, begin_s + np.arange(SLOW_HZ) / SLOW_HZ
    fast = motion.acceleration_m_s2(fast_s) + motion.bias_m_s2[:, None]
    fast += rng.normal(0.0, ACCELERATION_STD, (points, RATE_HZ))
    slow = 1e3 * motion.displacement_m(slow_s) + rng.normal(0.0, DISPLACEMENT_STD_MM, (points, SLOW_HZ))
    return fast.astype("<f4"), slow.astype("<f4")


def topics(points: int, shared: bool) -> list[tuple[str, str]]:
    """Topics of acceleration and displacement: of each point, or of all."""
    return [("north/acc", "north/gnss")] if shared else [(f"north/{i}/acc", f"north/{i}/gnss") for i in range(points)]


class Publisher:
    """A client of MQTT 3.1.1 that publishes with quality of service 1 and leaves the acknowledgements unread: what a
    thousand senders are to a broker, at the cost of a few.
    """

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port))
        self._socket.sendall(b"\x10\x13\x00\x04MQTT\x04\x02\x00\x3c\x00\x07sensors")
        self._socket.recv(4)
        self._number = 0
        self._draining = threading.Thread(target=self._drain, daemon=True)
        self._draining.start()

    def _drain(self) -> None:
        with contextlib.suppress(OSError):
            while self._socket.recv(65_536):
                pass

    def close(self) -> None:
        """Leave."""
        self._socket.shutdown(socket.SHUT_RDWR)
        self._draining.join()
        self._socket.close()

    def publish(self, messages: Iterable[tuple[str, bytes]]) -> None:
        """Send messages, one after another."""
        packets = []
        for topic, payload in messages:
            self._number = self._number % 65_535 + 1
            name = topic.encode()
            length = 4 + len(name) + len(payload)
            head = bytearray(b"\x32")
            while length > 127:
                head.append(length % 128 + 128)
                length //= 128
            head.append(length)
            packets += [bytes(head), struct.pack(">H", len(name)), name, struct.pack(">H", self._number), payload]
        self._socket.sendall(b"".join(packets))


def send(port: int, points: int, shared: bool, seconds: int) -> None:
    """Publish a second of blocks after each second; prints the first one (UTC)."""
    client = Publisher(port)
    motion, rng, names = Motion(points), np.random.default_rng(1), topics(points, shared)
    first = int(time.time())
    print(first, flush=True)
    extra = struct.pack("<I", points) if shared else b""
    for second in range(first, first + seconds):
        values = blocks(motion, second, rng)
        messages = []
        for sensor, (rate_hz, of_all) in enumerate(zip((RATE_HZ, SLOW_HZ), values, strict=True)):
            kind = 1 + sensor + 3 * shared
            head = HEAD.pack(1, kind, 0, second - first, second * 10**9, 10**9 // rate_hz, rate_hz) + extra
            bodies = [of_all.tobytes()] if shared else [row.tobytes() for row in of_all]
            messages += [(name[sensor], head + body) for name, body in zip(names, bodies, strict=True)]
        time.sleep(max(second + 1 - time.time(), 0.0))
        client.publish(messages)
    time.sleep(2.0)


def listen(port: int, points: int, shared: bool, seconds: int) -> None:
    """Receive the same messages as a session of the same kind, and do nothing with them."""
    import paho.mqtt.client as mqtt
    from paho.mqtt.enums import CallbackAPIVersion
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.properties import Properties

    client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id="bare", protocol=mqtt.MQTTv5)
    session = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    session.SessionExpiryInterval, session.ReceiveMaximum = 3600, 65_535
    client.on_message = lambda _client, _data, _message: None
    client.connect("127.0.0.1", port, clean_start=False, properties=session)
    wanted = [(name, 1) for both in topics(points, shared) for name in both]
    for start in range(0, len(wanted), 1000):
        client.subscribe(wanted[start : start + 1000])
    client.loop_start()
    time.sleep(seconds)
    client.loop_stop()


if __name__ == "__main__":
    _, what, port, points, shared, seconds = sys.argv
    {"send": send, "listen": listen}[what](int(port), int(points), shared == "one", int(seconds))
