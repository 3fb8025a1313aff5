"""The frames of a radar in the calibration window, and the acceleration beside them."""

from dataclasses import dataclass, replace

import numpy as np

from midspan.errors import DataError
from midspan.recording.radar.frames import RadarFrames, collected, samples_of
from midspan.recording.streams.progress import Progress
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.span import inside, require_overlap
from midspan.recording.streams.window import window_ends
from midspan.records import NANOSECONDS, Floats

# Complex values of range profiles that are kept of the window at most: 128 MB.
MOST_VALUES = 1 << 24
LEAST_FRAMES = 100
# Where acceleration is missing for longer than this, s, the longest part without it is used if it is this share of the
# window at least: a double integral over a guess fits no phase.
LEAST_GAP_S, LEAST_UNBROKEN = 0.05, 0.25
# A larger share of frames with holes is told.
WARNED_LOST = 0.02


@dataclass(frozen=True, slots=True)
class OpenedWindow:
    """The frames of the calibration window, their stamps from its first one on, and the `samples_of` beside them.

    told: sentences; clock: stamp of the first frame, ns, and the largest clock offset, s.
    """

    frames: RadarFrames
    samples: Floats
    told: list[str]
    clock: tuple[int, float]


def opened_window(recording: Recording, progress: Progress) -> OpenedWindow:
    """Read the calibration window of the radar, and the acceleration with a margin for the clock offset."""
    frames, told = _window(recording, progress)
    first, last = window_ends(recording)
    origin = int(frames.time_ns[0])
    frames = replace(frames, time_ns=frames.time_ns - origin)
    max_offset = min(recording.max_offset_s, 0.1 * float(frames.time_ns[-1]) / NANOSECONDS)
    margin = round((max_offset + 1.0) * NANOSECONDS)
    if (kept := _unbroken(recording, frames, (origin, max_offset))) is not None:
        frames = RadarFrames(frames.time_ns[kept], frames.phasors[kept], frames.valid[kept])
        origin, begin = origin + int(frames.time_ns[0]), int(frames.time_ns[0])
        frames = replace(frames, time_ns=frames.time_ns - begin)
        length_s = float(frames.time_ns[-1]) / NANOSECONDS
        told.append(
            "radar: samples of the accelerometer are missing in the calibration window; its longest part without a "
            f"gap, {length_s:.3g} s, was used."
        )
        first, last = origin, origin + int(frames.time_ns[-1])
        margin = round(max_offset * NANOSECONDS)
    samples = samples_of(recording.prepared, origin, (first - margin, last + margin))
    return OpenedWindow(frames, samples, told, (origin, max_offset))


def _unbroken(recording: Recording, frames: RadarFrames, known: tuple[int, float]) -> slice | None:
    """The longest stretch of frames beside which no acceleration is missing at any clock offset that is tried.

    known: what the frames' stamps count from (ns), and the largest clock offset (s). None where there is no gap worth
    it, or too little is left.
    """
    margin = round(known[1] * NANOSECONDS)
    gaps = recording.prepared.unmeasured_ns - known[0]
    gaps = gaps[(gaps[:, 1] - gaps[:, 0]) > LEAST_GAP_S * NANOSECONDS] + np.array([-margin, margin])
    within = gaps[(gaps[:, 1] > frames.time_ns[0]) & (gaps[:, 0] < frames.time_ns[-1])]
    if not len(within):
        return None
    starts = np.concatenate(([0], np.searchsorted(frames.time_ns, within[:, 1])))
    ends = np.concatenate((np.searchsorted(frames.time_ns, within[:, 0]), [len(frames.time_ns)]))
    k = int(np.argmax(ends - starts))
    enough = ends[k] - starts[k] >= max(LEAST_FRAMES, LEAST_UNBROKEN * len(frames.time_ns))
    return slice(int(starts[k]), int(ends[k])) if enough else None


def _window(recording: Recording, progress: Progress) -> tuple[RadarFrames, list[str]]:
    """The range profiles of the calibration window, no more of them than memory allows."""
    source, prepared = recording.radar, recording.prepared
    times = source.times_ns()
    if not len(times):
        raise DataError(f"radar.file = {recording.settings.radar.file!r}: holds no frames.")  # type: ignore[union-attr]
    require_overlap(prepared.time_ns, times, "radar")
    first, last = window_ends(recording)
    # At the largest clock offset the frames must still lie inside the accelerometer's samples.
    margin = round(recording.max_offset_s * NANOSECONDS)
    first = max(first, int(prepared.time_ns[0]) + margin)
    last = min(last, int(prepared.time_ns[-1]) - margin)
    used = inside(times, first, last)
    if used.stop - used.start < LEAST_FRAMES:
        raise DataError(
            f"radar: {max(used.stop - used.start, 0)} frames lie in the calibration window (those within "
            f"calibration.max_offset_s of the accelerometer's ends are left out); at least {LEAST_FRAMES} are needed. "
            "Widen calibration.window_s or bring the clocks together with radar.start_s."
        )
    most = MOST_VALUES // max(source.info.channels * source.info.bins, 1)
    told = []
    if used.stop - used.start > most:
        used = slice(used.start, used.start + max(most, LEAST_FRAMES))
        length_s = (int(times[used.stop - 1]) - int(times[used.start])) / NANOSECONDS
        told.append(f"radar: only the first {length_s:.3g} s of the calibration window are used, to save memory.")
    blocks = source.profiles(used.start, used.stop)
    frames = collected(blocks, used.stop - used.start, progress, "reading the radar's calibration window")
    holes = float(np.mean(~frames.valid.all(axis=1)))
    if holes > WARNED_LOST:
        told.append(f"radar: {100 * holes:.2g} % of the frames in the calibration window have holes (lost packets).")
    return frames, told
