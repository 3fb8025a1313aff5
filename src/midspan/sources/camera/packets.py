"""The packets of a video stream without decoding: how many frames, their stamps, where the key frames are."""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from midspan.errors import DataError
from midspan.records import Nanoseconds

# Containers whose clock starts anywhere: their first stamp counts as zero.
_FREE_RUNNING = ("mpegts", "mpeg")


@dataclass(frozen=True, slots=True)
class Packets:
    """`count` frames; `ticks` (count,) their stamps in order of presentation in units of `time_base` s, or None.

    `keys` are the numbers of key frames in that order, `rates` the frame rates in Hz that the container states;
    `free_running` says that the container's clock starts anywhere. `length_s` is the length that the header declares,
    in s (0: it does not).
    """

    count: int
    ticks: Nanoseconds | None
    keys: tuple[int, ...]
    time_base: Fraction
    rates: tuple[Fraction, ...]
    free_running: bool
    length_s: float

    @property
    def last_s(self) -> float:
        """The last stamp in s; 0 without stamps."""
        return 0.0 if self.ticks is None else float(int(self.ticks[-1]) * self.time_base)

    def key_before(self, number: int) -> int | None:
        """The number of the last key frame at or before frame `number`; None where there is none."""
        place = int(np.searchsorted(np.asarray(self.keys), number, side="right")) - 1
        return self.keys[place] if place >= 0 else None


def scan(path: Path, container: Any) -> Packets:
    """Walk through the packets of an open container; DataError where there are none."""
    stream = container.streams.video[0]
    stamps, keys = _walk(container, stream)
    if not stamps:
        raise DataError(f"{path} holds no frames. Check that the file is whole.")
    rates = tuple(dict.fromkeys(r for r in (stream.average_rate, stream.base_rate, stream.guessed_rate) if r))
    base = Fraction(stream.time_base or 1)
    formats = str(container.format.name).split(",")
    free = any(name in _FREE_RUNNING for name in formats)
    length_s = _length_s(container, stream, formats)
    known = [stamp for stamp in stamps if stamp is not None]
    ticks = np.sort(np.array(known, dtype=np.int64))
    if len(known) < len(stamps) or ticks.size < 1 or np.any(ticks[1:] <= ticks[:-1]):
        return Packets(len(stamps), None, (), base, rates, free, length_s)
    order = np.sort(np.searchsorted(ticks, np.array([stamps[k] for k in keys], dtype=np.int64)))
    return Packets(len(stamps), ticks, tuple(order.tolist()), base, rates, free, length_s)


def _length_s(container: Any, stream: Any, formats: list[str]) -> float:
    """The length that the header declares, s; 0 where it does not."""
    if "avi" in formats and stream.frames and stream.average_rate:
        # FFmpeg shortens an AVI's length to what is in the file; its header counts frames.
        return float(stream.frames / stream.average_rate)
    # The stream's own length, too: sound can be longer.
    own_s = float(stream.duration * stream.time_base) if stream.duration else 0.0
    return min((length_s for length_s in ((container.duration or 0) * 1e-6, own_s) if length_s), default=0.0)


def _walk(container: Any, stream: Any) -> tuple[list[int | None], list[int]]:
    import av

    stamps: list[int | None] = []
    keys: list[int] = []
    try:
        for packet in container.demux(stream):
            if packet.size == 0 or packet.is_discard:
                continue
            if packet.is_keyframe:
                keys.append(len(stamps))
            stamps.append(packet.pts if packet.pts is not None else packet.dts)
    except av.error.FFmpegError:
        # A damaged tail: what was found before it counts.
        pass
    return stamps, keys
