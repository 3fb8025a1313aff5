"""Captures as a radar's capture card writes them: 16-bit words, lost packets as zeros, with their settings."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from midspan.radar.chirp import ChirpProfile
from midspan.radar.layout import PACKET_BYTES, Layout, pack
from midspan.simulate.radar.signal import Cubes

# The codes of bits in the settings.
_BITS = {12: 0, 14: 1, 16: 2}


@dataclass(frozen=True, slots=True)
class Capture:
    """How a capture is written: lost packets (by number, from 0) are zeros; `cut_bytes` are missing at the end."""

    layout: Layout
    lost: tuple[int, ...] = ()
    cut_bytes: int = 0


def write_capture(path: Path, cubes: Iterable[Cubes], capture: Capture) -> int:
    """Write cubes (frames, chirps, receivers, samples) as a .bin; returns the bytes written."""
    position = 0
    with path.open("wb") as file:
        for cube in cubes:
            data = bytearray(pack(cube, capture.layout).tobytes())
            for packet in capture.lost:
                start = max(packet * PACKET_BYTES - position, 0)
                end = min((packet + 1) * PACKET_BYTES - position, len(data))
                if start < end:
                    data[start:end] = bytes(end - start)
            file.write(data)
            position += len(data)
        if capture.cut_bytes:
            position -= capture.cut_bytes
            file.truncate(position)
    return position


def packets(words: "np.ndarray[tuple[int], np.dtype[np.int16]]") -> Iterator[bytes]:
    """The datagrams of a capture card: number from 1, count of bytes before, and up to 1456 bytes of the words."""
    data = words.astype("<i2").tobytes()
    for number, start in enumerate(range(0, len(data), PACKET_BYTES), start=1):
        head = number.to_bytes(4, "little") + start.to_bytes(6, "little")
        yield head + data[start : start + PACKET_BYTES]


def demo_settings(profile: ChirpProfile, *, frames: int = 0, order: str = "QQII", device: str = "xWR1642") -> str:
    """Settings as the demo firmware takes them over its serial line (.cfg); `frames` 0 is without end."""
    slope, ramp_us = profile.slope_hz_s / 1e12, 1e6 * (2.0 * profile.centre_s - profile.adc_start_s) + 2.0
    idle_us = 1e6 * profile.chirp_period_s - ramp_us
    swapped = 1 if order.startswith("Q") else 0
    lines = [
        f"% {device}",
        "sensorStop",
        "flushCfg",
        "dfeDataOutputMode 1",
        f"channelCfg {2**profile.receivers - 1} {_senders(profile)} 0",
        f"adcCfg {_BITS[profile.bits]} {1 if profile.complex_samples else 0}",
        f"adcbufCfg -1 {0 if profile.complex_samples else 1} {swapped} 1 1",
        f"profileCfg 0 {profile.start_frequency_hz / 1e9:.9g} {idle_us:.6g} {1e6 * profile.adc_start_s:.9g} "
        f"{ramp_us:.6g} 0 0 {slope:.9g} 1 {profile.samples} {profile.sample_rate_hz / 1e3:.9g} 0 0 30",
        *(f"chirpCfg {k} {k} 0 0 0 0 0 {mask}" for k, mask in enumerate(profile.transmitters)),
        f"frameCfg 0 {profile.chirps - 1} 1 {frames} {1e3 * profile.frame_period_s:.9g} 1 0",
        "lvdsStreamCfg -1 0 1 0",
        "sensorStart",
    ]
    return "\n".join(lines) + "\n"


def _senders(profile: ChirpProfile) -> int:
    mask = 0
    for one in profile.transmitters:
        mask |= one
    return mask
