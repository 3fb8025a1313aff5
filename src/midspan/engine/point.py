"""One measuring point: records of its sensors in, in any interleaving; rows of displacement out.

Everything that decides is a function of the records pushed: there is no clock, no file and no thread in here. A
recording is a loop over `push`, and a live point is the same loop.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.engine.averaging import Averaging, AveragingState
from midspan.engine.guard import Guard, GuardState
from midspan.engine.merge import Merge, MergeState
from midspan.engine.order import STEPS
from midspan.engine.sensors import Seen, Sensor, SensorState
from midspan.engine.support import PointStatus, Support
from midspan.engine.switching import Switch, SwitchState
from midspan.fusion.blocks import Rows
from midspan.fusion.estimator import BLOCK, Estimator, EstimatorState
from midspan.fusion.model import ParameterKind
from midspan.fusion.printed_prediction import PredictedState
from midspan.fusion.second_pass import Lag, LagState
from midspan.records import (
    Arrival,
    ClockOffset,
    Complete,
    Event,
    PixelTranslation,
    Readings,
    Samples,
    Tick,
    cut,
)

ACCELEROMETER = "accelerometer"

Output = Rows | Seen | Event


@dataclass(frozen=True, slots=True, eq=False)
class PointState:
    """Everything that a point remembers; sensors: the state of each, in the order of their names."""

    merge: MergeState
    guard: GuardState
    estimator: EstimatorState | LagState | PredictedState
    sensors: tuple[SensorState, ...]
    support: Support
    averaging: AveragingState
    switch: SwitchState | None = None


class Point:
    """An accelerometer and the sensors beside it, by their streams' names, and the estimator that they feed."""

    def __init__(
        self,
        merge: Merge,
        guard: Guard,
        sensors: Mapping[str, Sensor],
        estimator: Estimator | Lag,
        unmeasured: Sequence[float] = (),
        switch: Switch | None = None,
    ) -> None:
        """unmeasured: noise density, (m/s²)²/Hz, of the motion along each further axis without an accelerometer.

        switch: tells which of two cameras measures; None: both do.
        """
        self.merge, self.guard, self.sensors, self.estimator = merge, guard, dict(sensors), estimator
        self.unmeasured = tuple(unmeasured)
        self.switch = switch
        self._support = Support()
        self._averaging = Averaging(estimator.settings.channels)

    @property
    def status(self) -> PointStatus:
        """How the point stands, by its newest row along the main axis."""
        if not self.estimator.settings.channels:
            return PointStatus.CALIBRATING
        status = self._support.status
        return PointStatus.WARMING if status is None else PointStatus(status)

    def unseen(self, stream: str) -> str:
        """Why a sensor's newest records measure nothing, once that lasts: dark, frozen, lost; else nothing."""
        if stream == ACCELEROMETER:
            return self.guard.unseen
        return self.sensors[stream].unseen if stream in self.sensors else ""

    def scale_errors(self) -> dict[str, tuple[float, float]]:
        """Relative error of each sensor's scale, or of the accelerometer's gain beside sensors whose unit is right, as
        estimated since the beginning, and its standard deviation.
        """
        settings, (values, variances) = self.estimator.settings, self.estimator.parameters
        return {
            settings.channels[one.channels[0]].sensor if one.kind is ParameterKind.SCALE_ERROR else "accelerometer": (
                float(value),
                float(np.sqrt(variance)),
            )
            for one, value, variance in zip(settings.parameters, values, variances, strict=True)
            if one.kind is not ParameterKind.CLOCK_OFFSET
        }

    @property
    def state(self) -> PointState:
        """All that has an effect on what comes later."""
        own = tuple(self.sensors[name].state for name in sorted(self.sensors))
        switch = None if self.switch is None else self.switch.state
        return PointState(
            self.merge.state,
            self.guard.state,
            self.estimator.state,
            own,
            self._support,
            self._averaging.state,
            switch,
        )

    def restore(self, state: PointState) -> None:
        """Go on from where `state` was read."""
        self.merge.restore(state.merge)
        self.guard.restore(state.guard)
        self.estimator.restore(state.estimator)  # type: ignore[arg-type]
        for name, own in zip(sorted(self.sensors), state.sensors, strict=True):
            self.sensors[name].restore(own)
        self._support = state.support
        self._averaging.restore(state.averaging)
        if self.switch is not None and state.switch is not None:
            self.switch.state = state.switch

    def push(self, record: Arrival | Tick | ClockOffset | Complete) -> list[Output]:
        """Take a record; returns what is due: rows, what the sensors saw, and events."""
        return self._run(self.merge.push(record))

    def finish(self) -> list[Output]:
        """What is held back still, at the end of all records."""
        out = self._run(self.merge.finish())
        for found in self.guard.finish():
            out += self._sampled(found)
        complete, rest = self._averaging.finish()
        if rest is not None:
            out += [*self._measured(complete), *self._given(self.estimator.push(rest))]
        return [*out, *self._given(self.estimator.finish())]

    def _run(self, due: Sequence[Arrival]) -> list[Output]:
        """Give records, in the order of time, to what they are for."""
        out: list[Output] = []
        for arrival in due:
            if isinstance(arrival.record, Event) and arrival.record.kind in STEPS:
                self.estimator.push(arrival.record)
            if arrival.stream == ACCELEROMETER:
                assert isinstance(arrival.record, Readings | Event)
                for found in self.guard.push(arrival.record):
                    out += self._sampled(found)
            elif isinstance(arrival.record, Event):
                out.append(arrival.record)
            else:
                out += self._seen(self.sensors[arrival.stream].push(arrival.record, self.estimator.predict))
        return out

    def _sampled(self, found: Samples | Event) -> list[Output]:
        """Give samples to the estimator, after the measurements that they cover."""
        if isinstance(found, Event):
            return [found]
        if self.unmeasured:
            found = with_unmeasured(found, self.unmeasured)
        out: list[Output] = []
        for block in cut(found, BLOCK):
            out += [output for sensor in self.sensors.values() for output in self._seen(sensor.reached(block))]
            complete, due = self._averaging.sampled(block)
            out += [*self._measured(complete), *self._given(self.estimator.push(due))]
        return out

    def _given(self, found: Sequence[Rows]) -> list[Rows]:
        """What the estimator gave, with events where no measurement supports its rows."""
        self._support, out = self._support.after(found)
        return out

    def _seen(self, seen: Seen | None) -> list[Output]:
        """Give to the estimator what a sensor measured."""
        if seen is None:
            return []
        if self.switch is not None and seen.sensor in self.switch.sensors:
            seen = switched(self.switch, seen)
        return self._measured([self._averaging.seen(seen)])

    def _measured(self, found: Sequence[Seen]) -> list[Output]:
        """Give complete measurements to the estimator."""
        for seen in found:
            if seen.measured is not None:
                self.estimator.push(seen.measured)
        return list(found)


def switched(switch: Switch, seen: Seen) -> Seen:
    """What a camera saw, without measurements where the other one measures; a switch is among its events."""
    found = [one for one in seen.found if isinstance(one, PixelTranslation)]
    told = switch.push(seen.sensor, found[0].time_ns, max(one.strength for one in found))
    measured = seen.measured if seen.sensor == switch.chosen else None
    return replace(seen, measured=measured, events=seen.events if told is None else (*seen.events, told))


def with_unmeasured(samples: Samples, densities: Sequence[float]) -> Samples:
    """The samples with further axes along which no acceleration is measured; densities: of the motion's own there."""
    count = len(samples.time_ns)
    return replace(
        samples,
        value_m_s2=np.column_stack((samples.value_m_s2, np.zeros((count, len(densities))))),
        noise_density=np.column_stack((samples.noise_density, np.tile(densities, (count, 1)))),
    )
