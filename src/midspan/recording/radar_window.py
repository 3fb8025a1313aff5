"""The frames of a radar in the calibration window, and the acceleration at the same time."""

import numpy as np

from midspan.calibration.radar.window import MIN_FRAMES, OpenedWindow, opened
from midspan.errors import DataError
from midspan.notices import Notice
from midspan.progress import Progress
from midspan.radar.frames import RadarFrames, collected
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.window import require_overlap, window_ends
from midspan.records import NANOSECONDS
from midspan.signals.stamps import inside

# Complex values of range profiles that are kept of the window at most: 128 MB.
MAX_VALUES = 1 << 24
# A larger share of frames with holes is reported.
WARNED_LOST = 0.02


def opened_window(recording: Recording, progress: Progress) -> OpenedWindow:
    """Read the calibration window of the radar, and the acceleration with a margin for the clock offset."""
    frames, told = _window(recording, progress)
    return opened(frames, recording.prepared, window_ends(recording), recording.max_offset_s, told)


def _window(recording: Recording, progress: Progress) -> tuple[RadarFrames, list[Notice]]:
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
    if used.stop - used.start < MIN_FRAMES:
        raise DataError(
            f"radar: {max(used.stop - used.start, 0)} frames lie in the calibration window (those within "
            f"calibration.max_offset_s of the accelerometer's ends are left out); at least {MIN_FRAMES} are needed. "
            "Widen calibration.window_s or bring the clocks together with radar.start_s."
        )
    most = MAX_VALUES // max(source.info.channels * source.info.bins, 1)
    told = []
    if used.stop - used.start > most:
        used = slice(used.start, used.start + max(most, MIN_FRAMES))
        length_s = (int(times[used.stop - 1]) - int(times[used.start])) / NANOSECONDS
        told.append(
            Notice(
                "window-moved",
                f"radar: only the first {length_s:.3g} s of the calibration window are used, to save memory.",
            )
        )
    blocks = source.profiles(used.start, used.stop)
    frames = collected(blocks, used.stop - used.start, progress, "reading the radar's calibration window")
    holes = float(np.mean(~frames.valid.all(axis=1)))
    if holes > WARNED_LOST:
        told.append(
            Notice(
                "radar-data",
                f"radar: {100 * holes:.2g} % of the frames in the calibration window have holes (lost packets).",
            )
        )
    return frames, told
