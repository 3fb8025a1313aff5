"""The frames of a radar in the calibration window, and the acceleration at the same time."""

from dataclasses import dataclass

import numpy as np

from midspan.radar.frames import RadarFrames
from midspan.records import NANOSECONDS, Floats
from midspan.signals.acceleration import PreparedAcceleration

# Fewer frames tell no conversion factor.
LEAST_FRAMES = 100
# Where acceleration is missing for longer than this, s, the longest part without it is used if it is this share of the
# window at least: a double integral over a guess fits no phase.
LEAST_GAP_S, LEAST_UNBROKEN = 0.05, 0.25


@dataclass(frozen=True, slots=True)
class OpenedWindow:
    """The frames of the calibration window, their stamps from its first one on, and the `samples_of` beside them.

    told: sentences; clock: stamp of the first frame, ns, and the largest clock offset, s.
    """

    frames: RadarFrames
    samples: Floats
    told: list[str]
    clock: tuple[int, float]


def unbroken(prepared: PreparedAcceleration, frames: RadarFrames, known: tuple[int, float]) -> slice | None:
    """The longest stretch of frames beside which no acceleration is missing at any clock offset that is tried.

    known: what the frames' stamps count from (ns), and the largest clock offset (s). None where there is no gap worth
    it, or too little is left.
    """
    margin = round(known[1] * NANOSECONDS)
    gaps = prepared.unmeasured_ns - known[0]
    gaps = gaps[(gaps[:, 1] - gaps[:, 0]) > LEAST_GAP_S * NANOSECONDS] + np.array([-margin, margin])
    within = gaps[(gaps[:, 1] > frames.time_ns[0]) & (gaps[:, 0] < frames.time_ns[-1])]
    if not len(within):
        return None
    starts = np.concatenate(([0], np.searchsorted(frames.time_ns, within[:, 1])))
    ends = np.concatenate((np.searchsorted(frames.time_ns, within[:, 0]), [len(frames.time_ns)]))
    k = int(np.argmax(ends - starts))
    enough = ends[k] - starts[k] >= max(LEAST_FRAMES, LEAST_UNBROKEN * len(frames.time_ns))
    return slice(int(starts[k]), int(ends[k])) if enough else None
