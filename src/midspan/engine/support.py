"""What a point's rows rest on: its status, and events where no measurement supports the rows for long."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from midspan.fusion.blocks import Rows
from midspan.records import NANOSECONDS, Estimate, Event, Status
from midspan.signals.stamps import shown


class PointStatus(IntEnum):
    """How a point stands. TRACKING, COASTING, LOST: as its newest row; WARMING: there is no row yet, the first
    measurements are waited for; CALIBRATING: none of its sensors is calibrated, so that nothing is measured.
    """

    TRACKING = Status.TRACKING.value
    COASTING = Status.COASTING.value
    LOST = Status.LOST.value
    WARMING = 3
    CALIBRATING = 4


@dataclass(frozen=True, slots=True)
class Support:
    """What was last seen of the rows of a main axis: the newest one's status, None before the first; since_ns: of the
    first of the newest rows that are not TRACKING; reported: whether that they came to be LOST is an event already.
    """

    status: Status | None = None
    since_ns: int = 0
    reported: bool = False

    def after(self, found: Sequence[Rows]) -> "tuple[Support, list[Rows]]":
        """After further rows, which get the events among theirs."""
        now, out = self, []
        for rows in found:
            now, events = now.over(rows.estimates[0]) if rows.estimates else (now, [])
            out.append(replace(rows, events=(*rows.events, *events)) if events else rows)
        return now, out

    def over(self, rows: Estimate) -> "tuple[Support, list[Event]]":
        """The same of the rows (n,) of one axis; and their events."""
        now, events = self, list[Event]()
        starts = np.flatnonzero(np.diff(rows.status, prepend=np.uint8(len(PointStatus))))
        for time_ns, code in zip(rows.time_ns[starts].tolist(), rows.status[starts].tolist(), strict=True):
            now, told = now._next(time_ns, Status(code))
            events += told
        return now, events

    def _next(self, time_ns: int, status: Status) -> "tuple[Support, list[Event]]":
        """After a row that may have another status."""
        if status is Status.TRACKING:
            lasting_s = (time_ns - self.since_ns) / NANOSECONDS
            text = f"Measurements support the rows again; the acceleration alone carried them for {lasting_s:.1f} s."
            return Support(status), [Event(time_ns, "seen", text)] if self.reported else []
        alone = self.status in (Status.COASTING, Status.LOST)
        now = replace(self, status=status, since_ns=self.since_ns if alone else time_ns)
        if status is Status.COASTING or self.reported:
            return now, []
        text = f"No measurement supports the rows from {shown(now.since_ns)} on: the acceleration alone carries them."
        return replace(now, reported=True), [Event(now.since_ns, "lost", text)]
