"""What the hypotheses decided, once it is final, and its events in the words of the field."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.fusion.filtering import PARENT_STEP, trace
from midspan.fusion.forward import AT, CHANNEL
from midspan.fusion.hypothesis import (
    CLOCK,
    DATUM,
    KINDS,
    LOST,
    MOST,
    NOISE,
    OUTLIER,
    RETURN,
    SHIFT,
    STEPPED_BEFORE,
    WRONG,
)
from midspan.fusion.weighing import WILD
from midspan.records import NANOSECONDS, Channel, Event, Floats

# The newest measurements, up to this number, may be undecided; what the older ones were the best hypothesis decides.
MAX_UNDECIDED = 2048
# Outliers in a row that are an event; a wild one alone is.
MIN_RUN = 5
# Causes of one kind that are closer (s) are one.
ONE_CAUSE_S = 2.0
EVENT_KINDS = {
    OUTLIER: "rejected",
    SHIFT: "level_shift",
    RETURN: "level_shift",
    WRONG: "acceleration",
    LOST: "reacquired",
    NOISE: "noise",
    CLOCK: "clock",
}


@dataclass(frozen=True, slots=True)
class Undecided:
    """Measurements (m, 5) of which the hypotheses do not say the same yet, and what each of as many hypotheses as there
    were took them for.
    """

    rows: Floats
    survivors: NDArray[np.int16]
    errors: Floats

    def after(self, rows: Floats, survivors: NDArray[np.int16], errors: Floats) -> "Undecided":
        """With further measurements behind."""
        if not len(rows):
            return self
        if not len(self.rows):
            return Undecided(rows, survivors, errors)
        most = max(self.survivors.shape[1], survivors.shape[1])
        return Undecided(
            np.concatenate((self.rows, rows)),
            np.concatenate((widened(self.survivors, most), widened(survivors, most))),
            np.concatenate((widened(self.errors, most), widened(errors, most))),
        )

    def paths(self, count: int) -> NDArray[np.int64]:
        """What each of so many hypotheses took each measurement for, (count, m)."""
        codes, at = np.empty((count, len(self.rows)), dtype=np.int64), np.arange(count)
        for j in range(len(self.rows) - 1, -1, -1):
            codes[:, j] = self.survivors[j, at] % PARENT_STEP
            at = self.survivors[j, at] // PARENT_STEP
        return codes

    def decided(self, count: int, *, all_of_them: bool = False) -> "tuple[Decided, Undecided]":
        """What is final, given so many hypotheses, or what the best one says of all; and what stays open."""
        m = len(self.rows)
        if not m:
            return NOTHING_DECIDED, self
        codes, errors = np.empty(m, dtype=np.int64), np.empty((m, 3))
        final = max(int(trace(self.survivors, count, codes, self.errors, errors)), m - MAX_UNDECIDED)
        final = m if all_of_them else final
        if final == m:
            return Decided(self.rows, codes, errors), ALL_DECIDED
        rest = Undecided(self.rows[final:], self.survivors[final:], self.errors[final:])
        return Decided(self.rows[:final], codes[:final], errors[:final]), rest


def widened(array: NDArray[Any], most: int) -> NDArray[Any]:
    """An array (m, hypotheses, ...) with 0 for more hypotheses."""
    missing = [(0, 0)] * array.ndim
    missing[1] = (0, most - array.shape[1])
    return np.pad(array, missing) if missing[1][1] else array


@dataclass(frozen=True, slots=True)
class Decided:
    """Measurements (m, 5), what they were taken for (m,), and (m, 3) their innovation and its predicted variance, or
    size (m), variance (m²) and age (s) of the step that STEPPED_BEFORE tells.
    """

    rows: Floats
    codes: NDArray[np.int64]
    errors: Floats


ALL_DECIDED = Undecided(np.empty((0, 5)), np.empty((0, MOST), dtype=np.int16), np.empty((0, MOST, 3)))
NOTHING_DECIDED = Decided(np.empty((0, 5)), np.empty(0, dtype=np.int64), np.empty((0, 3)))


@dataclass(frozen=True, slots=True)
class Telling:
    """What the events remember: of each channel the outliers in a row (first time, last time, count, first size in mm);
    the last cause of each kind as (kind, its channel's sensor and axis, time in s).
    """

    runs: tuple[tuple[float, float, int, float], ...]
    causes: tuple[tuple[str, str, int, float], ...] = ()

    @classmethod
    def nothing(cls, channels: tuple[Channel, ...]) -> "Telling":
        """Before the first measurement."""
        return cls(((0.0, 0.0, 0, 0.0),) * len(channels))


def events_of(
    told: Telling, decided: Decided, channels: tuple[Channel, ...], origin_ns: int
) -> tuple[Telling, list[Event]]:
    """Events that final decisions complete, in time order, one for each cause; and what to remember."""
    if not decided.codes.any() and not any(run[2] for run in told.runs):
        return told, []
    runs, causes, events = list(told.runs), told.causes, []
    kinds = np.where(decided.codes == STEPPED_BEFORE, SHIFT, decided.codes % KINDS)
    running = np.array([run[2] > 0 for run in runs])
    channel_of = np.maximum(decided.rows[:, CHANNEL].astype(np.int64), 0)
    counted = (decided.codes != DATUM) & ((kinds != 0) | running[channel_of] | np.any(kinds == OUTLIER))
    for j in np.flatnonzero(counted):
        c, time_s = int(channel_of[j]), float(decided.rows[j, AT])
        before, unit = decided.codes[j] == STEPPED_BEFORE, abs(channels[c].units_per_m)
        size_mm, std_mm = (1e3 * decided.errors[j, :2] ** (1.0, 0.5) / (1.0 if before else unit)).tolist()
        time_s -= float(decided.errors[j, 2]) if before else 0.0
        first_s, _, count, first_mm = runs[c]
        if kinds[j] == OUTLIER:
            runs[c] = (first_s, time_s, count + 1, first_mm) if count else (time_s, time_s, 1, size_mm)
            if count or size_mm**2 <= WILD * std_mm**2:
                continue
        else:
            if count >= MIN_RUN:
                events.append(_rejected(runs[c], channels[c], origin_ns))
            runs[c] = (0.0, 0.0, 0, 0.0)
        if kinds[j] == 0:
            continue
        kind, group = EVENT_KINDS[int(kinds[j])], (channels[c].sensor, channels[c].axis)
        known = [one for one in causes if one[:3] == (kind, *group) and time_s - one[3] < ONE_CAUSE_S]
        causes = (*(one for one in causes if one[:3] != (kind, *group)), (kind, *group, time_s))
        if not known:
            time_ns = origin_ns + round(time_s * NANOSECONDS)
            text = _text(int(kinds[j]), channels[c], (size_mm, std_mm))
            events.append(Event(time_ns, kind, text, channels[c].axis))
    return replace(told, runs=tuple(runs), causes=causes), sorted(events, key=lambda event: event.time_ns)


def runs_left(told: Telling, channels: tuple[Channel, ...], origin_ns: int) -> list[Event]:
    """The runs of outliers that the record's end cut off."""
    return [
        _rejected(run, channel, origin_ns)
        for run, channel in zip(told.runs, channels, strict=True)
        if run[2] >= MIN_RUN
    ]


def _named(channel: Channel) -> str:
    return f"{channel.sensor}, target {channel.target}"


def _rejected(run: tuple[float, float, int, float], channel: Channel, origin_ns: int) -> Event:
    first_s, last_s, count, size_mm = run
    return Event(
        origin_ns + round(first_s * NANOSECONDS),
        "rejected",
        f"{count} measurements in a row ({_named(channel)}) were rejected over {last_s - first_s:.2f} s, the first "
        f"{size_mm:.2f} mm off: they contradict the other sensors. Something may have stood in front of the target, or "
        "the tracker held on to something else.",
        channel.axis,
    )


def _text(kind: int, channel: Channel, size: tuple[float, float]) -> str:
    name, off = _named(channel), f"{size[0]:.2f} ± {size[1]:.2f} mm"
    return {
        OUTLIER: f"A measurement of {name} lies {off} off and is left out: nothing moves so fast. Check the sensor "
        "and its connection.",
        SHIFT: f"The zero of {name} shifted by {off}; the displacement keeps its own. Check whether the target or the "
        "sensor has moved.",
        RETURN: f"The zero of {name} went back to where it was before its shift, or its clock to where it was.",
        WRONG: f"The predicted displacement was off by {off} where {name} measured: the acceleration was wrong, and "
        "its band is widened there. Check the accelerometer's range and mounting.",
        LOST: f"The predicted displacement had been led away: {name} measured {off} off, and the estimator started "
        "anew from it.",
        NOISE: f"The noise of {name} rose suddenly: a measurement lies {off} off, and its variance is raised.",
        CLOCK: f"The clocks of {channel.sensor} and of the accelerometer have stepped against each other: measurements "
        f"(target {channel.target}) contradict the acceleration, the first by {off}. They bound only the slow motion "
        "from here on. Calibrate the clock offset again.",
    }[kind]
