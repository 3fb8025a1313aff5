"""Where a camera sees: the window it is calibrated in moves out of the night when another camera covers that."""

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.errors import UntrustedError
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.window import DEFAULT_WINDOW_S, window_ends
from midspan.records import NANOSECONDS, Floats
from midspan.settings.kinds import CAMERAS
from midspan.signals.health import runs
from midspan.signals.stamps import shown

# So many frames are looked at in the window, and in the whole recording where that is dark.
LOOKED_AT, SEARCHED = 16, 240
MAX_DARK_SHARE = 0.2
# A camera sees well where it is at least so bright beside its bright frames.
FULL_SHARE = 0.7
# Of fewer of the frames looked at in a row the first ones may be headlights, which make a poor reference.
MIN_LIT = 3


def where_it_sees(recording: Recording) -> tuple[Recording, list[str]]:
    """The view with a window in which its camera sees, and a sentence where that is another than the recording's.

    The window is the longest stretch of light; the frames are used from the first one on. Only a camera of light beside
    another camera is looked at. Raises UntrustedError where it is dark all the time.
    """
    alone = not any(sensor.kind in CAMERAS for sensor in recording.beside)
    if recording.kind != "camera" or alone or recording.frames.tracks:
        return recording, []
    times = recording.frames.times_ns()
    first, last = window_ends(recording)
    inside = np.flatnonzero((times + recording.late_ns >= first) & (times + recording.late_ns <= last))
    if not len(inside):
        return recording, []
    brightness = _brightness(recording, _spread(inside, LOOKED_AT))
    if np.mean(brightness == 0.0) <= MAX_DARK_SHARE:
        return recording, []
    looked = _spread(np.arange(len(times)), SEARCHED)
    brightness = _brightness(recording, looked)
    if not brightness.any():
        raise UntrustedError("It is dark in all frames.")
    # Dusk and dawn are left out: a reference frame from there would be a poor one.
    lit = runs(brightness > FULL_SHARE * np.percentile(brightness[brightness > 0.0], 90))
    start, end = max(lit, key=lambda run: run[1] - run[0])
    seen_from = next((run[0] for run in lit if run[1] - run[0] >= min(MIN_LIT, end - start)), start)
    begun = int(times[looked[start]]) + recording.late_ns
    last = int(times[looked[min(end, len(looked)) - 1]]) + recording.late_ns
    ended = min(last, begun + round(DEFAULT_WINDOW_S * NANOSECONDS))
    text = (
        f"camera: it is dark in calibration.window_s; it was calibrated where it sees, from {shown(begun)} to "
        f"{shown(ended)}."
    )
    return recording.seeing(begun, ended, int(times[looked[seen_from]])), [text]


def _spread(indices: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Up to `count` of the indices, evenly."""
    chosen: NDArray[np.int64] = indices[np.unique(np.linspace(0, len(indices) - 1, count).astype(int))]
    return chosen


def _brightness(recording: Recording, indices: NDArray[np.int64]) -> Floats:
    """Mean brightness of these frames; 0 for black ones and for those that cannot be read."""
    found = np.zeros(len(indices))
    for k, index in enumerate(indices):
        frame = next(iter(recording.frames.frames(int(index), int(index) + 1)), None)
        if frame is not None and not _core.is_dark(frame.pixels, 1):
            found[k] = float(np.mean(np.asarray(frame.pixels, dtype=np.float64)))
    return found
