"""Which frame of a camera is the first that can be used as a reference: what is dark, closed or covered is skipped."""

from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.errors import DataError
from midspan.records import NANOSECONDS, Floats, Frame, Nanoseconds, Region
from midspan.thermal.shutter import FLAT_SHARE
from midspan.vision.frame_source import FrameSource

# At most this many dark frames are skipped at the start.
MAX_SKIPPED = 1000
# What a thermal camera usually sees is taken from this many frames of its first minutes.
LOOKED_AT = 16
LOOKED_AT_S = 300.0
# A shutter or a cloth goes within this many frames, while fog lifts slowly and is no reason to skip anything.
SUDDEN_FRAMES = 3
# A target is free of bodies where less than the first share of it is far from its temperatures; it waits for that where
# more than the second is, for this many seconds.
FREE_SHARE, COVERED_SHARE = 0.02, 0.1
MAX_WAIT_S = 60.0
# A body lies on one side of the wall's temperatures, but for its soft edge; a wall that fades lies on both alike.
MAX_OF_BOTH = 0.1
MIN_APART_K = 1.0


@dataclass(frozen=True, slots=True)
class Begun:
    """How many frames are skipped, why in words (empty: none is), and the frames from there on."""

    skipped: int
    reason: str
    frames: Generator[Frame]


def begun(source: FrameSource, first: int, last: int | None, regions: Sequence[Region] = ()) -> Begun:
    """The frames from the first usable one on, of those from index `first` up to `last`.

    Dark pictures are skipped; of temperatures those with a closed shutter or a cover, and those with something over a
    target (`regions`, none: not looked at) that soon is gone. Where nothing better comes none is skipped.
    """
    frames = source.frames(first, last)
    opening = next(frames, None)
    if opening is None:
        return Begun(0, "", _closing(frames))
    if opening.pixels.dtype.kind == "f":
        skipped, reason = _unusable_temperatures(source, slice(first, last), regions, opening)
        return Begun(skipped, reason, _closing(source.frames(first + skipped, last)))
    for skipped, frame in enumerate(islice(chain((opening,), frames), MAX_SKIPPED)):
        if not _core.is_dark(np.asarray(frame.pixels), 1):
            reported = f"the first {skipped} frames are dark and were skipped; the zero is at the first bright frame"
            return Begun(skipped, reported if skipped else "", _closing(chain((frame,), frames)))
    return Begun(0, "", _closing(source.frames(first, last)))


# Pixels that are not finite leave none of what is computed here finite, and such a frame is not skipped.
@np.errstate(invalid="ignore")
def _unusable_temperatures(
    source: FrameSource, used: slice, regions: Sequence[Region], opening: Frame
) -> tuple[int, str]:
    """How many frames in °C are skipped, and why."""
    times = source.times_ns()[used]
    until = int(np.searchsorted(times, times[0] + round(LOOKED_AT_S * NANOSECONDS)))
    places = used.start + np.unique(np.linspace(0, until - 1, LOOKED_AT).astype(int))
    seen = []
    for k in places.tolist():
        # What is wrong with one is reported where frames are read in their order.
        with suppress(DataError):
            seen += [frame.pixels for frame in source.frames(k, k + 1)]
    seen = seen or [opening.pixels]
    usual_k = float(np.median([_contrast(pixels) for pixels in seen]))
    closed = _closed(source, used, usual_k) if _contrast(opening.pixels) < FLAT_SHARE * usual_k else 0
    begin = slice(used.start + closed, used.stop)
    covered, share = _covered(source, begin, regions, (times[closed:], np.median(np.stack(seen), axis=0)))
    reported = []
    if closed:
        reported.append(f"the first {closed} frames show a closed shutter or a cover")
    if covered:
        which = "then" if reported else "the first"
        reported.append(f"{which} {covered} frames have {100.0 * share:.0f} % of a target occluded")
    text = " and ".join(reported)
    return (
        closed + covered,
        f"{text}; they were skipped; the zero is at the next frame" if reported else "",
    )


def _closed(source: FrameSource, used: slice, usual_k: float) -> int:
    """Number of frames (from the first of `used` on) before a shutter or a cover opens; 0 where none does suddenly."""
    after: int | None = None
    for frame in islice(source.frames(used.start, used.stop), MAX_SKIPPED):
        contrast_k = _contrast(frame.pixels)
        if after is not None or contrast_k >= FLAT_SHARE * usual_k:
            after = frame.index if after is None else after
            if contrast_k >= 2.0 * FLAT_SHARE * usual_k:
                return int(after - used.start)
            if frame.index - after >= SUDDEN_FRAMES:
                return 0
    return 0


def _covered(
    source: FrameSource, used: slice, regions: Sequence[Region], known: tuple[Nanoseconds, Floats]
) -> tuple[int, float]:
    """How many frames are waited for until the targets are free, and which share of one is covered in the first.

    known: the stamps of the frames used, and the middle over time of what is usually seen (rows, columns).
    """
    times, usual = known
    regions = [region for region in regions if region.inside(usual.shape[1], usual.shape[0])]
    last, share = times[0] + round(MAX_WAIT_S * NANOSECONDS), 0.0
    for number, frame in enumerate(islice(source.frames(used.start, used.stop), MAX_SKIPPED)):
        # The whole picture warms and cools with the day, and its middle with it.
        celsius = frame.pixels.astype(np.float32)
        seen = celsius - np.float32(np.median(celsius) - np.median(usual))
        now = max((_far_share(seen[region.slices], usual[region.slices]) for region in regions), default=0.0)
        share = share if number else now
        if share < COVERED_SHARE or frame.time_ns > last:
            return 0, 0.0
        if now < FREE_SHARE:
            return frame.index - used.start, share
    return 0, 0.0


def _far_share(now: NDArray[Any], usual: NDArray[Any]) -> float:
    """Share of a target's pixels that lie outside its usual temperatures by more than these are wide, on one side."""
    low, high = (float(v) for v in np.percentile(usual, (1.0, 99.0)))
    apart = max(high - low, MIN_APART_K)
    warmer, colder = float(np.mean(now > high + apart)), float(np.mean(now < low - apart))
    # A body is warmer than the wall or colder; a wall whose contrast fades or turns is both.
    return 0.0 if min(warmer, colder) > MAX_OF_BOTH * max(warmer, colder) else warmer + colder


def _contrast(pixels: NDArray[Any]) -> float:
    """From quartile to quartile of every this many pixels, K."""
    step = max(min(pixels.shape) // 60, 1)
    low, high = np.percentile(pixels[::step, ::step], (25.0, 75.0))
    return float(high - low)


def _closing(frames: Iterator[Frame]) -> Generator[Frame]:
    """Frames that can be closed."""
    yield from frames
