"""Structures that move, their sensors on MQTT, and what can go wrong with them."""

import threading
import time
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from midspan.records import NANOSECONDS, Floats
from midspan.simulate.motion.motion import Sines
from midspan.simulate.scene.texture import textured_scene
from midspan.sources.live.blocks import ACCELERATION, DISPLACEMENT, Block, pack

# All motions begin again after this time, so that a film of it is short, s.
PERIOD_S = 10.0
NOISE_M_S2, NOISE_M = 2e-3, 1e-4
FAST_S, SLOW_S, BLOCK_S = 0.01, 0.1, 0.2
M_PER_PX = 1e-3


def motion(seed: int) -> Sines:
    """Three tones of some millimetres, each of a whole number of cycles in the period."""
    rng = np.random.default_rng(seed)
    cycles = rng.choice(np.arange(4, 30), 3, replace=False)
    return Sines(rng.uniform(0.8e-3, 2.5e-3, 3), cycles / PERIOD_S, phase_rad=rng.uniform(0, 2 * np.pi, 3))


def film(moved: Sines, shape: tuple[int, int], rate_hz: int, seed: int = 0) -> NDArray[np.uint8]:
    """A period of what a camera on the structure sees (frames, rows, columns), moving down as the structure goes up."""
    rng = np.random.default_rng(seed)
    scene = textured_scene("natural", shape, rng=rng, reach_px=10.0)
    shift_px = moved.displacement(np.arange(round(PERIOD_S * rate_hz)) / rate_hz) / M_PER_PX
    frames = [scene.render(0.0, float(y)) + rng.normal(0.0, 1.0, shape) for y in shift_px]
    return np.clip(np.rint(frames), 0, 255).astype(np.uint8)


@dataclass
class Faults:
    """What is wrong with one sensor: silent; nothing but NaN; twice the interval; blocks to leave out; stamps off."""

    silent: bool = False
    nothing: bool = False
    slower: bool = False
    skipped: int = 0
    clock_s: float = 0.0


@dataclass
class Transmitter:
    """Sends acceleration (topic acc/NAME) and displacement (topic dis/NAME) of structures in real time.

    faults: by the topic.
    """

    port: int
    motions: dict[str, Sines]
    faults: dict[str, Faults] = field(default_factory=dict)
    sent: int = 0

    def __post_init__(self) -> None:
        self.faults = {f"{kind}/{name}": Faults() for name in self.motions for kind in ("acc", "dis")}
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._rng = np.random.default_rng(0)

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def stop(self) -> None:
        """End; returns when the last block is on its way."""
        self._ending.set()
        self._thread.join(timeout=10.0)

    def _send(self) -> None:
        import paho.mqtt.client as mqtt

        client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id="sensors", clean_session=False)
        client.max_queued_messages_set(0)
        client.reconnect_delay_set(1, 1)
        client.connect("127.0.0.1", self.port)
        client.loop_start()
        step_ns = round(BLOCK_S * NANOSECONDS)
        number = time.time_ns() // step_ns
        while not self._ending.is_set():
            number += 1
            self._ending.wait(max((number + 1) * step_ns - time.time_ns(), 0) / NANOSECONDS)
            for name, moved in self.motions.items():
                for kind in ("acc", "dis"):
                    self._send_one(client, f"{kind}/{name}", moved, number * step_ns)
            self.sent += 1
        client.disconnect()
        client.loop_stop()

    def _send_one(self, client: object, topic: str, moved: Sines, begin_ns: int) -> None:
        fault, fast = self.faults[topic], topic.startswith("acc/")
        if fault.silent:
            return
        if fault.skipped:
            fault.skipped -= 1
            return
        step_s = (FAST_S if fast else SLOW_S) * (2.0 if fault.slower else 1.0)
        at = begin_ns / NANOSECONDS % PERIOD_S + step_s * np.arange(round(BLOCK_S / step_s))
        exact: Floats = moved.acceleration(at) if fast else 1e3 * moved.displacement(at)
        value = exact + self._rng.normal(0.0, NOISE_M_S2 if fast else 1e3 * NOISE_M, len(at))
        value = np.full_like(value, np.nan) if fault.nothing else value
        t0_ns, dt_ns = begin_ns + round(fault.clock_s * NANOSECONDS), round(step_s * NANOSECONDS)
        # The sequence counts what was sent, and what was left out on purpose.
        sequence = begin_ns // round(BLOCK_S * NANOSECONDS)
        block = Block(ACCELERATION if fast else DISPLACEMENT, sequence, t0_ns, dt_ns, value)
        client.publish(topic, pack(block), qos=1)  # type: ignore[attr-defined]
