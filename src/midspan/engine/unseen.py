"""When a camera gives no frames, dark ones, the same one over and over, or none with the target: events."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from midspan.records import NANOSECONDS, Event, PixelTranslation, Status
from midspan.signals.bridging import GAP_STEPS
from midspan.signals.stamps import shown

# This many seconds, and this many usual intervals, without the target are an event: rows are coasting by then. Shorter
# ones are what a codec or a shutter leaves out.
LOST_S, LOST_INTERVALS = 3.0, 5.0
TEXTS = {
    "dark": "it is dark from {} on; nothing is measured with this camera.",
    "frozen": "the picture does not change (frozen) from {} on; nothing is measured with this camera.",
    "lost": "the target is lost from {} on; nothing is measured with this camera. Look at what stands in front of it, "
    "and at its region.",
}


@dataclass(frozen=True, slots=True)
class Unseen:
    """What was last seen of a camera: last_ns, the newest frame's stamp; since_ns: of the first frame without the
    target, None where it is seen; reported: why, once that is an event; otherwise_ns: of the first of the newest frames
    that are without it for another reason than that; again_ns: of the newest frame, where it shows the target and the
    one before did not. A single one between others is no return: a codec makes a frozen picture anew now and then.
    """

    last_ns: int | None = None
    since_ns: int | None = None
    reported: str = ""
    otherwise_ns: int | None = None
    again_ns: int | None = None

    def after(
        self, time_ns: int, found: Sequence[PixelTranslation], step_s: float, name: str
    ) -> "tuple[Unseen, list[Event]]":
        """After a frame with what was `found` of each target; and events. step_s: usual interval of frames."""
        events: list[Event] = []
        if self.last_ns is not None and (gap_s := (time_ns - self.last_ns) / NANOSECONDS) > GAP_STEPS * step_s > 0.0:
            events.append(Event(self.last_ns, "gap", f"{name}: no frames for {gap_s:.3g} s."))
        reasons = [one.unseen or ("lost" if one.status is Status.LOST else "") for one in found]
        if not all(reasons):
            if self.since_ns is not None and self.again_ns is None:
                return replace(self, last_ns=time_ns, again_ns=time_ns), events
            if self.reported and self.since_ns is not None and self.again_ns is not None:
                lasting_s = (self.again_ns - self.since_ns) / NANOSECONDS
                text = f"{name}: the target is seen again; nothing was measured for {lasting_s:.1f} s."
                events.append(Event(self.again_ns, "seen", text))
            return Unseen(time_ns), events
        reason, now = max(reasons), replace(self, last_ns=time_ns, again_ns=None)
        if self.since_ns is None:
            now = replace(now, since_ns=time_ns)
        if reason == self.reported:
            return replace(now, otherwise_ns=None), events
        otherwise_ns = time_ns if self.otherwise_ns is None else self.otherwise_ns
        if time_ns - otherwise_ns < NANOSECONDS * max(LOST_S, LOST_INTERVALS * step_s):
            return replace(now, otherwise_ns=otherwise_ns), events
        events.append(Event(otherwise_ns, reason, f"{name}: {TEXTS[reason].format(shown(otherwise_ns))}"))
        return replace(now, reported=reason, otherwise_ns=None), events
