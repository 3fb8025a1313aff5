"""Where the streams of a recording overlap, and the part of it that it is calibrated on."""

from dataclasses import replace

import numpy as np

from midspan.calibration.fit import MIN_MEASUREMENTS
from midspan.errors import DataError, UsageError
from midspan.recording.streams.recording import Recording
from midspan.records import NANOSECONDS, Floats, Nanoseconds, TimeSeries
from midspan.signals.stamps import inside, shown

# Segments that begin so far (s) apart are compared.
LOOK_S = 10.0
# Two streams share enough when it lasts this long, or holds this many steps of the slower one: a high-speed camera
# records a quarter of a second.
MIN_OVERLAP_S, MIN_OVERLAP_STEPS = 1.0, 100
DEFAULT_WINDOW_S = 60.0


def liveliest(time_ns: Nanoseconds, value: Floats, span_ns: tuple[int, int], length_s: float) -> int | None:
    """Where the segment of `length_s` begins (ns) in which values (n,) at times (n,) vary most, each about its mean.

    span_ns: first and last instant that it may contain. None where it is the first one, or only one fits.
    """
    length_ns = round(length_s * NANOSECONDS)
    begins = np.arange(span_ns[0], span_ns[1] - length_ns + 1, round(LOOK_S * NANOSECONDS))
    if len(begins) < 2:
        return None
    low, high = np.searchsorted(time_ns, begins), np.searchsorted(time_ns, begins + length_ns)
    # About the whole's mean first: squares of gravity would leave few digits for the motion.
    centred = value - np.mean(value)
    sums = np.cumsum(np.vstack((np.zeros(2), np.column_stack((centred, centred**2)))), axis=0)
    mean = (sums[high] - sums[low]) / np.maximum(high - low, 1)[:, None]
    best = int(np.argmax(mean[:, 1] - mean[:, 0] ** 2))
    return int(begins[best]) if best else None


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
    if window.stop - window.start < MIN_MEASUREMENTS:
        raise UsageError(
            f"{recording.file}: calibration.window_s = {list(wanted)}: must overlap the accelerometer, which runs from "
            f"{time_ns[0] / NANOSECONDS:.3f} to {time_ns[-1] / NANOSECONDS:.3f} s."
        )
    return window


def liveliest_minute(recording: Recording) -> tuple[float, float] | None:
    """The minute (s) in which the acceleration varies most; None where it is the first, or where one is given."""
    if recording.settings.calibration.window_s is not None:
        return None
    streams = [recording.acceleration.time_ns, *(times for times in recording.frame_times if len(times))]
    span_ns = max(int(times[0]) for times in streams), min(int(times[-1]) for times in streams)
    begin_ns = liveliest(streams[0], recording.acceleration.value, span_ns, DEFAULT_WINDOW_S)
    return None if begin_ns is None else (begin_ns / NANOSECONDS, begin_ns / NANOSECONDS + DEFAULT_WINDOW_S)


def window_ends(recording: Recording) -> tuple[int, int]:
    """First and last stamp (ns) of the calibration window."""
    window, time_ns = calibration_window(recording), recording.prepared.time_ns
    return int(time_ns[window.start]), int(time_ns[window.stop - 1])


def within_window(recording: Recording, series: TimeSeries) -> TimeSeries:
    """The values of a displacement sensor that it is calibrated on: all, where calibration.window_s is left out."""
    wanted = recording.settings.calibration.window_s
    if wanted is None:
        return series
    time_ns = series.time_ns
    window = inside(time_ns, round(wanted[0] * NANOSECONDS), round(wanted[1] * NANOSECONDS))
    count = int(np.count_nonzero(np.isfinite(series.value[window])))
    if count < MIN_MEASUREMENTS:
        raise UsageError(
            f"{recording.file}: calibration.window_s = {list(wanted)}: must hold at least {MIN_MEASUREMENTS} values "
            f"of [{recording.sensor}], which runs from {shown(int(time_ns[0]))} to {shown(int(time_ns[-1]))}; received "
            f"{count}. Widen it, or leave it out: then up to half an hour is used."
        )
    return replace(series, time_ns=time_ns[window], value=series.value[window])


def require_overlap(acceleration_ns: Nanoseconds, other_ns: Nanoseconds, section: str) -> None:
    """DataError unless the two streams share a second, or 100 steps of the slower one where that is less.

    section: the other stream's in the settings.
    """
    steps_ns = [float(np.median(np.diff(times))) for times in (acceleration_ns, other_ns) if len(times) > 1]
    least_s = min(MIN_OVERLAP_S, MIN_OVERLAP_STEPS * max(steps_ns, default=np.inf) / NANOSECONDS)
    first = max(int(acceleration_ns[0]), int(other_ns[0]))
    last = min(int(acceleration_ns[-1]), int(other_ns[-1]))
    if last - first >= least_s * NANOSECONDS:
        return
    if other_ns[-1] - other_ns[0] < least_s * NANOSECONDS:
        raise DataError(
            f"{section} must last {least_s:.3g} s or more; it has {len(other_ns)} time stamps from "
            f"{shown(int(other_ns[0]))} to {shown(int(other_ns[-1]))}. Check that its file is complete, and its rate."
        )
    raise DataError(
        f"accelerometer and {section} do not overlap in time: the accelerometer runs from "
        f"{shown(int(acceleration_ns[0]))} to {shown(int(acceleration_ns[-1]))}, {section} from "
        f"{shown(int(other_ns[0]))} to {shown(int(other_ns[-1]))}; at least {least_s:.3g} s must overlap. Correct the "
        f"clocks with {section}.start_s or accelerometer.start_s, or time_offset_s of the given calibration."
    )
