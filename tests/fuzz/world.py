"""The motion that is behind every seed, what sensors make of it, and what a seed is."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

AMPLITUDES_M = np.array([1.2e-3, 0.7e-3, 0.5e-3])
RATES_HZ = np.array([1.3, 2.1, 3.4])
TABLE_HZ, TABLE_ROWS = 128.0, 200
SCALE_M_PER_PX = -1.5e-3
FRAMES = 12
START_NS = 1_714_564_800_123_456_789
CARRIER_HZ = 60.5e9
SPEED_OF_LIGHT_M_S = 299_792_458.0

# In every command: the damaged file, whatever the seed calls it.
FILE = "{file}"
RECORDING = (("inspect", ".", "--all-frames", "--json"),)
SINGLE = (("inspect", FILE), *RECORDING)


@dataclass(frozen=True)
class Seed:
    """A folder with a whole recording, the one file of it that is damaged, and what is run on it.

    reader: what the table of results calls it; text: whether its numbers and words can be changed as such; file: its
    name in the folder; commands: arguments, run in the folder one after the other.
    """

    name: str
    reader: str
    file: str
    make: Callable[[Path], None] = field(repr=False)
    text: bool = False
    commands: tuple[tuple[str, ...], ...] = SINGLE


def moved_m(time_s):
    """Displacement at times (n,), m."""
    return np.sin(2 * np.pi * np.multiply.outer(time_s, RATES_HZ)) @ AMPLITUDES_M


def accelerated(time_s):
    """Acceleration at times (n,), m/s²."""
    return -np.sin(2 * np.pi * np.multiply.outer(time_s, RATES_HZ)) @ (AMPLITUDES_M * (2 * np.pi * RATES_HZ) ** 2)


TIME_S = np.arange(TABLE_ROWS) / TABLE_HZ
TIME_NS = np.arange(TABLE_ROWS, dtype=np.int64) * 7_812_500
ACCEL = accelerated(TIME_S) + np.random.default_rng(7).normal(0.0, 5e-3, TABLE_ROWS)


def pictures(count=FRAMES, rate_hz=10.0, rows=48, columns=64, start_s=0.0):
    """Frames (count, rows, columns) of a smooth pattern that goes down as the structure goes up, 0 to 1."""
    rng = np.random.default_rng(11)
    y, x = np.mgrid[0:rows, 0:columns].astype(float)
    shift_px = moved_m(start_s + np.arange(count) / rate_hz) / SCALE_M_PER_PX
    waves = rng.normal(0.0, 0.35, (40, 2))
    phases = rng.uniform(0.0, 2 * np.pi, 40)
    stack = np.zeros((count, rows, columns))
    for (ky, kx), phase in zip(waves, phases, strict=True):
        stack += np.cos(ky * (y - shift_px[:, None, None]) + kx * x + phase)
    stack = 0.5 + stack / 30.0 + rng.normal(0.0, 0.004, stack.shape)
    return np.clip(stack, 0.0, 1.0)


def grey(bits=8, **keys):
    """The same frames as whole numbers."""
    return np.rint(pictures(**keys) * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)


def celsius(**keys):
    """The same frames as temperatures, °C."""
    return 10.0 + 15.0 * pictures(**keys)


def recording(folder, sections, time_s=TIME_S, value=ACCEL):
    """recording.toml with lines for the sections, and accel.npy."""
    if "[accelerometer]" not in sections:
        # A binary file, which is read in no time: it is not what is damaged.
        np.save(folder / "accel.npy", np.column_stack((time_s, value)))
        sections = '[accelerometer]\nfile = "accel.npy"\nunit = "m/s^2"\n' + sections
    (folder / "recording.toml").write_text(sections)
