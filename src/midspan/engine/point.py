"""One measuring point: records of its sensors in, in any interleaving; rows of displacement out.

Everything that decides is a function of the records pushed: there is no clock, no file and no thread in here. A
recording is a loop over `push`, and a live point is the same loop.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from midspan.engine.guard import Guard, GuardState
from midspan.engine.merge import Merge, MergeState
from midspan.engine.sensors import Seen, Sensor
from midspan.fusion.estimator import Estimator, EstimatorState, Rows
from midspan.records import Arrival, ClockOffset, Event, Samples, Tick

ACCELEROMETER = "accelerometer"

Output = Rows | Seen | Event


@dataclass(frozen=True, slots=True, eq=False)
class PointState:
    """Everything that a point remembers; sensors: the state of each, in the order of their names."""

    merge: MergeState
    guard: GuardState
    estimator: EstimatorState
    sensors: tuple[Any, ...]


class Point:
    """An accelerometer and the sensors beside it, by their streams' names, and the estimator that they feed."""

    def __init__(self, merge: Merge, guard: Guard, sensors: Mapping[str, Sensor], estimator: Estimator) -> None:
        self.merge, self.guard, self.sensors, self.estimator = merge, guard, dict(sensors), estimator

    @property
    def state(self) -> PointState:
        """All that has an effect on what comes later."""
        own = tuple(self.sensors[name].state for name in sorted(self.sensors))
        return PointState(self.merge.state, self.guard.state, self.estimator.state, own)

    def restore(self, state: PointState) -> None:
        """Go on from where `state` was read."""
        self.merge.restore(state.merge)
        self.guard.restore(state.guard)
        self.estimator.restore(state.estimator)
        for name, own in zip(sorted(self.sensors), state.sensors, strict=True):
            self.sensors[name].restore(own)

    def push(self, record: Arrival | Tick | ClockOffset) -> list[Output]:
        """Take a record; returns what is due: rows, what the sensors saw, and events."""
        return [output for due in self.merge.push(record) for output in self._take(due)]

    def finish(self) -> list[Output]:
        """What is held back still, at the end of all records."""
        out = [output for due in self.merge.finish() for output in self._take(due)]
        for found in self.guard.finish():
            out += self._sampled(found)
        return [*out, *self.estimator.finish()]

    def _take(self, due: Arrival) -> list[Output]:
        """Give a record, in its turn, to what it is for."""
        if due.stream == ACCELEROMETER:
            return [output for found in self.guard.push(due.record) for output in self._sampled(found)]
        if isinstance(due.record, Event):
            return [due.record]
        seen = self.sensors[due.stream].push(due.record, self.estimator.predict)
        self.estimator.push(seen.measured)
        return [seen]

    def _sampled(self, found: Samples | Event) -> list[Output]:
        return [found] if isinstance(found, Event) else list(self.estimator.push(found))
