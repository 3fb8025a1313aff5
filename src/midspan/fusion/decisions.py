"""What the estimator reports of its decisions, in the words of the field."""

from collections.abc import Sequence
from enum import IntEnum

from midspan.records import Channel, Event

# Of the core: what happened, when (ns), to which channel, its size and the standard deviation of that (mm), and of
# outliers in a row how many and how long (s).
Report = tuple[int, int, int, float, float, int, float]


class Kind(IntEnum):
    """What is reported, by the core's code."""

    LATE = 0
    OVERFLOW = 1
    REJECTED = 2
    WILD = 3
    SHIFTED = 4
    RETURNED = 5
    WRONG = 6
    LOST = 7
    NOISE = 8
    CLOCK = 9


EVENT_KINDS = {
    Kind.LATE: "late",
    Kind.OVERFLOW: "overflow",
    Kind.REJECTED: "rejected",
    Kind.WILD: "rejected",
    Kind.SHIFTED: "level_shift",
    Kind.RETURNED: "level_shift",
    Kind.WRONG: "acceleration",
    Kind.LOST: "reacquired",
    Kind.NOISE: "noise",
    Kind.CLOCK: "clock",
}
# Of these the whole point is told, not one of its axes.
OF_THE_POINT = (Kind.LATE, Kind.OVERFLOW)


def event_of(report: Report, channels: Sequence[Channel], max_waiting: int) -> Event:
    """A report as an event; max_waiting: so many measurements may wait for samples."""
    kind, time_ns = Kind(report[0]), report[1]
    if kind is Kind.OVERFLOW:
        text = f"More than {max_waiting} measurements wait for samples of acceleration; the oldest are left out."
        return Event(time_ns, EVENT_KINDS[kind], text)
    channel = channels[report[2]]
    axis = 0 if kind in OF_THE_POINT else channel.axis
    return Event(time_ns, EVENT_KINDS[kind], _text(kind, report, channel), axis)


def _text(kind: Kind, report: Report, channel: Channel) -> str:
    _, _, _, size_mm, std_mm, count, lasting_s = report
    name, off = f"{channel.sensor}, target {channel.target}", f"{size_mm:.2f} ± {std_mm:.2f} mm"
    return {
        Kind.LATE: f"Measurements of {channel.sensor} came too late and are left out.",
        Kind.REJECTED: f"{count} measurements in a row ({name}) were rejected over {lasting_s:.2f} s, the first "
        f"{size_mm:.2f} mm off: they contradict the other sensors. Something may have stood in front of the target, or "
        "the tracker held on to something else.",
        Kind.WILD: f"A measurement of {name} lies {off} off and is left out: nothing moves so fast. Check the sensor "
        "and its connection.",
        Kind.SHIFTED: f"The zero of {name} shifted by {off}; the displacement keeps its own. Check whether the target "
        "or the sensor has moved.",
        Kind.RETURNED: f"The zero of {name} went back to where it was before its shift, or its clock to where it was.",
        Kind.WRONG: f"The predicted displacement was off by {off} where {name} measured: the acceleration was wrong, "
        "and its band is widened there. Check the accelerometer's range and mounting.",
        Kind.LOST: f"The predicted displacement had been led away: {name} measured {off} off, and the estimator "
        "started anew from it.",
        Kind.NOISE: f"The noise of {name} rose suddenly: a measurement lies {off} off, and its variance is raised.",
        Kind.CLOCK: f"The clocks of {channel.sensor} and of the accelerometer have stepped against each other: "
        f"measurements (target {channel.target}) contradict the acceleration, the first by {off}. They bound only the "
        "slow motion from here on. Calibrate the clock offset again.",
    }[kind]
