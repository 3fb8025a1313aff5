"""How a point's rows stand: the newest one, its deviation relative to the usual one, whether a clock spoils them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.records import Estimate, Event, Status

# The usual deviation is the geometric mean over about so many of the newest rows that rest on measurements.
USUAL_ROWS = 60_000
# While rows are less certain than usual by this factor after a clock stepped, the clock is why.
WIDENED = 3.0


@dataclass(frozen=True, slots=True)
class RowHealth:
    """newest_ns: stamp of the newest row, None before the first; std_m: its standard deviation; usual_m: the usual one
    of rows that rest on measurements, NaN before the first; count: of these, up to USUAL_ROWS; stepped: a clock
    stepped, and the rows are less certain since.
    """

    newest_ns: int | None = None
    std_m: float = math.nan
    usual_m: float = math.nan
    count: int = 0
    stepped: bool = False

    def after_events(self, events: Sequence[Event]) -> "RowHealth":
        """After events of the engine."""
        return replace(self, stepped=True) if any(event.kind == "clock" for event in events) else self

    def after_rows(self, rows: Estimate) -> "RowHealth":
        """After rows (n,) of the main axis."""
        if not len(rows.time_ns):
            return self
        std_m = np.sqrt(rows.variance_m2)
        good = std_m[(rows.status == Status.TRACKING) & (std_m > 0.0) & np.isfinite(std_m)]
        newest_m = float(std_m[-1])
        now = replace(self, newest_ns=int(rows.time_ns[-1]), std_m=newest_m)
        if self.stepped and newest_m > WIDENED * self.usual_m:
            return now
        if not len(good):
            return replace(now, stepped=False)
        count = self.count + len(good)
        usual = math.log(self.usual_m) if self.count else 0.0
        usual += (float(np.mean(np.log(good))) - usual) * len(good) / count
        return replace(now, stepped=False, usual_m=math.exp(usual), count=min(count, USUAL_ROWS))
