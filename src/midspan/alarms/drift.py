"""Drift of the daily mean: the newest 24 hourly means relative to those of the first day, hour of day by hour of day.

The same hours are compared, so that a day that is only partly there does not show the daily course of temperature as a
drift. A new zero begins a new first day.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from midspan.records import NANOSECONDS, Floats, Nanoseconds

HOUR_NS, DAY_HOURS = 3600 * NANOSECONDS, 24
# Hours that both days have at least: half a day, the longest that a camera's night is.
MIN_HOURS = 12

Hours = dict[int, tuple[int, float, float]]
"""By the hour (whole hours since 1970): rows, sum of the values, sum of their variances."""


@dataclass(slots=True)
class DailyMean:
    """first: hours of the first day, whose mean is the zero of the drift; newest: those of the newest day and the hour
    that is not over; datum_ns: rows before count from another zero.
    """

    first: Hours = field(default_factory=dict)
    newest: Hours = field(default_factory=dict)
    datum_ns: int = 0

    @property
    def hour(self) -> int:
        """The newest hour of which rows came; 0 before any."""
        return max(self.newest, default=0)

    def add(self, time_ns: Nanoseconds, value: Floats, variance: Floats) -> tuple[int, float, float] | None:
        """Take rows (n,): stamps, values, variances without the zero's. Where an hour ended: its end in ns, the drift
        and its standard deviation, in the unit of the values; None where too few hours are there.
        """
        begun = self.hour
        for hour in np.unique(time_ns // HOUR_NS).tolist():
            rows = time_ns // HOUR_NS == hour
            count, total, spread = self.newest.get(hour, (0, 0.0, 0.0))
            own = (int(rows.sum()), float(value[rows].sum()), float(variance[rows].sum()))
            self.newest[hour] = (count + own[0], total + own[1], spread + own[2])
        last = self.hour
        return self._drift(last) if begun and last > begun else None

    def restart(self, datum_ns: int) -> None:
        """Rows from an instant on count from a new zero."""
        self.first, self.newest, self.datum_ns = {}, {}, datum_ns

    def _drift(self, hour: int) -> tuple[int, float, float] | None:
        """At the begin of an hour, of the 24 before it."""
        self.newest = {one: sums for one, sums in self.newest.items() if one >= hour - DAY_HOURS}
        whole = {one: sums for one, sums in self.newest.items() if one < hour}
        if not self.first or min(self.first) + DAY_HOURS >= hour:
            # The first day is not over.
            self.first |= {one: sums for one, sums in whole.items() if one < min(self.first | whole) + DAY_HOURS}
            return None
        before = {one % DAY_HOURS: sums for one, sums in self.first.items()}
        pairs = [(before[one % DAY_HOURS], sums) for one, sums in whole.items() if one % DAY_HOURS in before]
        if len(pairs) < MIN_HOURS:
            return None
        drift = float(np.mean([now[1] / now[0] - then[1] / then[0] for then, now in pairs]))
        # What is slow stays within a day: a mean is no better than its rows, which is more than it could be.
        variance = float(np.mean([now[2] / now[0] + then[2] / then[0] for then, now in pairs]))
        return hour * HOUR_NS, drift, variance**0.5

    def to_tree(self) -> dict[str, Any]:
        """As it is kept."""
        return {"first": list(self.first.items()), "newest": list(self.newest.items()), "datum_ns": self.datum_ns}

    @classmethod
    def of_tree(cls, tree: dict[str, Any]) -> "DailyMean":
        """What `to_tree` gave, through JSON."""
        hours = [
            {int(hour): (int(n), float(s), float(v)) for hour, (n, s, v) in tree[key]} for key in ("first", "newest")
        ]
        return cls(hours[0], hours[1], int(tree["datum_ns"]))
