"""The part of a recording that it is calibrated on."""

from midspan.errors import UsageError
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.span import inside
from midspan.records import NANOSECONDS

DEFAULT_WINDOW_S = 60.0
LEAST_MEASUREMENTS = 20


def calibration_window(recording: Recording) -> slice:
    """The samples of the calibration window."""
    time_ns = recording.prepared.time_ns
    wanted = recording.settings.calibration.window_s
    if wanted is None:
        # Before the first frames there is nothing to compare. A stream of another day is refused where it is read, with
        # better words.
        firsts = [int(times[0]) for times in recording.frame_times if len(times) and times[0] < time_ns[-1]]
        start = max(int(time_ns[0]), *firsts) if firsts else int(time_ns[0])
        return inside(time_ns, start, start + round(DEFAULT_WINDOW_S * NANOSECONDS))
    window = inside(time_ns, round(wanted[0] * NANOSECONDS), round(wanted[1] * NANOSECONDS))
    if window.stop - window.start < LEAST_MEASUREMENTS:
        raise UsageError(
            f"{recording.file}: calibration.window_s = {list(wanted)}: must overlap the accelerometer, which runs from "
            f"{time_ns[0] / NANOSECONDS:.3f} to {time_ns[-1] / NANOSECONDS:.3f} s."
        )
    return window


def window_ends(recording: Recording) -> tuple[int, int]:
    """First and last stamp (ns) of the calibration window."""
    window, time_ns = calibration_window(recording), recording.prepared.time_ns
    return int(time_ns[window.start]), int(time_ns[window.stop - 1])
