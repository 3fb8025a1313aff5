"""A sensor that helps others, reading by reading: a velocity, a gyroscope, an inclinometer."""

from dataclasses import dataclass, replace

import numpy as np

from midspan.engine.sensors import Expect, Seen
from midspan.records import NANOSECONDS, Event, Measured, Readings
from midspan.signals.health import GAP_STEPS

# Equal values for this time (s), and this number, are a sensor that has stopped: noise changes the last digit before.
FROZEN_S, FROZEN_COUNT = 0.5, 10


@dataclass(frozen=True, slots=True)
class AuxiliaryState:
    """The newest value, its stamp (None before the first) and the run of equal ones that it ends: its first stamp, how
    many, whether that is reported.
    """

    newest_ns: int | None = None
    value: float = np.nan
    since_ns: int = 0
    count: int = 0
    frozen: bool = False


class AuxiliarySensor:
    """Takes readings and gives measurements of a channel; equal values for long are left out.

    channel: its number in the estimator's table; variance: of a value; step_s: its usual interval, 0: not known.
    """

    reached = None

    def __init__(self, name: str, channel: int, variance: float, step_s: float = 0.0) -> None:
        self.name, self._channel, self._variance = name, channel, variance
        self._gap_s = GAP_STEPS * step_s or np.inf
        self.state = AuxiliaryState()

    @property
    def unseen(self) -> str:
        """Whether its values do not change."""
        return "frozen" if self.state.frozen else ""

    def restore(self, state: AuxiliaryState) -> None:
        """Go on from a `state` taken earlier."""
        self.state = state

    def push(self, record: Readings, expect: Expect) -> Seen | None:
        """Take readings of time_ns (n,) and value (n, 1) in SI units."""
        time_ns, value = record.time_ns, record.value[:, 0]
        used, events = np.isfinite(value), list[Event]()
        for k in np.flatnonzero(used):
            state, stamp = self.state, int(time_ns[k])
            if state.newest_ns is not None and (gap_s := (stamp - state.newest_ns) / NANOSECONDS) > self._gap_s:
                events.append(Event(state.newest_ns, "gap", f"{self.name}: no values for {gap_s:.3g} s."))
            if value[k] != state.value:
                if state.frozen:
                    events.append(Event(stamp, "released", f"{self.name}: its values change again."))
                self.state = AuxiliaryState(stamp, float(value[k]), stamp, 1)
                continue
            self.state = state = replace(state, newest_ns=stamp, count=state.count + 1)
            if state.count >= FROZEN_COUNT and stamp - state.since_ns >= FROZEN_S * NANOSECONDS:
                used[k] = False
                if not state.frozen:
                    self.state = replace(state, frozen=True)
                    text = f"{self.name}: its value does not change; it is left out until it does."
                    events.append(Event(stamp, "frozen", text))
        count = int(np.count_nonzero(used))
        if not count and not events:
            return None
        numbers = np.full(count, self._channel, dtype=np.int64)
        variance = np.full(count, self._variance)
        measured = Measured(time_ns[used], numbers, value[used], variance, np.zeros(count))
        return Seen(self.name, measured if count else None, (), tuple(events))
