"""What an alarm watches: its limit in the value's unit, and what has to hold before it fires and ends."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from midspan.records import NANOSECONDS, Floats, Nanoseconds
from midspan.settings.alarms import AlarmSettings

# 95 % of a normal distribution lie within this many standard deviations.
BAND = 1.96
# Rows further apart than this are a gap: what was between them is not known, and a delay begins anew. Ten times the
# interval of the slowest accelerometers.
MAX_STEP_NS = NANOSECONDS
Reason = Literal["limit", "band", "no_data"]


@dataclass(frozen=True, slots=True)
class Samples:
    """Values of a quantity: time_ns (n,) UTC, increasing; value and std (n,) in the unit of the rule."""

    time_ns: Nanoseconds
    value: Floats
    std: Floats

    def after(self, time_ns: int) -> "Samples":
        """Those that are finite and after an instant."""
        keep = (self.time_ns > time_ns) & np.isfinite(self.value) & np.isfinite(self.std)
        return self if keep.all() else Samples(self.time_ns[keep], self.value[keep], self.std[keep])


def sample(time_ns: int, value: float, std: float = 0.0) -> Samples:
    """A single value."""
    return Samples(np.array([time_ns], dtype=np.int64), np.array([value]), np.array([std]))


@dataclass(frozen=True, slots=True)
class Rule:
    """One limit of a point. limit, hysteresis: in `unit`; times in ns; max_step_ns: samples further apart are a gap,
    None where there is none, as of values that are looked at now and then. is_no_data: of rows that do not come.
    """

    point: str
    name: str
    on: str
    unit: str
    limit: float
    hysteresis: float
    level: str
    delay_ns: int
    keep_ns: int
    repeat_ns: int
    max_step_ns: int | None = None
    is_no_data: bool = False

    @property
    def key(self) -> str:
        """What it is kept under."""
        return f"{self.point}/{self.name}" + "/no_data" * self.is_no_data


def rules_of(point: str, alarm: AlarmSettings) -> list[Rule]:
    """The rule of an alarm, and of rows that do not come where it has one."""
    of_rows = alarm.on in ("displacement", "velocity", "std")
    keep_ns, repeat_ns = _ns(alarm.keep_firing_s), _ns(alarm.repeat_s)
    # The delay of a silent source is its limit.
    delay_ns = 0 if alarm.on == "silent" else _ns(alarm.delay_s)
    made = [
        Rule(point, alarm.name, alarm.on, alarm.unit, alarm.limit, alarm.hysteresis, alarm.level, delay_ns,
             keep_ns, repeat_ns, MAX_STEP_NS if of_rows else None)
    ]  # fmt: skip
    if alarm.no_data_s is not None:
        made.append(Rule(point, alarm.name, "no_data", "s", alarm.no_data_s, 0.0, alarm.level, 0, keep_ns, repeat_ns,
                         is_no_data=True))  # fmt: skip
    return made


def _ns(seconds: float) -> int:
    return round(seconds * NANOSECONDS)
