"""The frames of a radar in the calibration window, and the acceleration at the same time."""

from dataclasses import dataclass, replace

import numpy as np

from midspan.notices import Notice
from midspan.radar.frames import RadarFrames, samples_of
from midspan.records import NANOSECONDS, Floats
from midspan.signals.acceleration import PreparedAcceleration

# Fewer frames determine no conversion factor.
MIN_FRAMES = 100
# Where acceleration is missing for longer than this, s, the longest part without it is used if it is this share of the
# window at least: a double integral over a guess fits no phase.
MIN_GAP_S, MIN_UNBROKEN = 0.05, 0.25


@dataclass(frozen=True, slots=True)
class OpenedWindow:
    """The frames of the calibration window, their stamps from its first one on, and their `samples_of`.

    told: sentences; clock: stamp of the first frame, ns, and the largest clock offset, s.
    """

    frames: RadarFrames
    samples: Floats
    told: list[Notice]
    clock: tuple[int, float]


def opened(
    frames: RadarFrames, prepared: PreparedAcceleration, ends: tuple[int, int], max_offset_s: float, told: list[Notice]
) -> OpenedWindow:
    """The frames of a window, and the acceleration with a margin for the clock offset, without long gaps.

    ends: first and last stamp (ns) of the window's acceleration; told: what there is to report of the frames.
    """
    origin = int(frames.time_ns[0])
    frames = replace(frames, time_ns=frames.time_ns - origin)
    max_offset = min(max_offset_s, 0.1 * float(frames.time_ns[-1]) / NANOSECONDS)
    margin = round((max_offset + 1.0) * NANOSECONDS)
    if (kept := _unbroken(prepared, frames, (origin, max_offset))) is not None:
        begin = int(frames.time_ns[kept][0])
        frames = RadarFrames(frames.time_ns[kept] - begin, frames.phasors[kept], frames.valid[kept])
        origin, last = origin + begin, int(frames.time_ns[-1])
        told = [
            *told,
            Notice(
                "window-moved",
                "radar: samples of the accelerometer are missing in the calibration window; its longest part without a "
                f"gap, {last / NANOSECONDS:.3g} s, was used.",
            ),
        ]
        ends, margin = (origin, origin + last), round(max_offset * NANOSECONDS)
    samples = samples_of(prepared, origin, (ends[0] - margin, ends[1] + margin))
    return OpenedWindow(frames, samples, told, (origin, max_offset))


def _unbroken(prepared: PreparedAcceleration, frames: RadarFrames, known: tuple[int, float]) -> slice | None:
    """The longest segment of frames in which no acceleration is missing at any clock offset that is tried.

    known: what the frames' stamps count from (ns), and the largest clock offset (s). None where there is no gap worth
    it, or too little is left.
    """
    margin = round(known[1] * NANOSECONDS)
    gaps = prepared.unmeasured_ns - known[0]
    gaps = gaps[(gaps[:, 1] - gaps[:, 0]) > MIN_GAP_S * NANOSECONDS] + np.array([-margin, margin])
    within = gaps[(gaps[:, 1] > frames.time_ns[0]) & (gaps[:, 0] < frames.time_ns[-1])]
    if not len(within):
        return None
    starts = np.concatenate(([0], np.searchsorted(frames.time_ns, within[:, 1])))
    ends = np.concatenate((np.searchsorted(frames.time_ns, within[:, 0]), [len(frames.time_ns)]))
    k = int(np.argmax(ends - starts))
    enough = ends[k] - starts[k] >= max(MIN_FRAMES, MIN_UNBROKEN * len(frames.time_ns))
    return slice(int(starts[k]), int(ends[k])) if enough else None
