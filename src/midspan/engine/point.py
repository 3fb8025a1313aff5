"""One measuring point: records of its sensors in, in any interleaving; rows of displacement out.

Everything that decides is a function of the records pushed: there is no clock, no file and no thread in here. A
recording is a loop over `push`, and a live point is the same loop.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, Protocol

import numpy as np

from midspan.engine.auxiliary import AuxiliaryState
from midspan.engine.averaging import Averaging, AveragingState
from midspan.engine.guard import Guard, GuardState
from midspan.engine.merge import Merge, MergeState
from midspan.engine.sensors import Seen, Sensor, SensorState
from midspan.engine.stream import STEPS
from midspan.fusion.blocks import Rows
from midspan.fusion.estimator import BLOCK, Estimator, Lag, State
from midspan.fusion.model import ParameterKind
from midspan.fusion.on_series import OnSeries, OnSeriesState
from midspan.records import (
    NANOSECONDS,
    Arrival,
    ClockOffset,
    Complete,
    Estimate,
    Event,
    Readings,
    Samples,
    Status,
    Tick,
    part,
)
from midspan.signals.stamps import shown

ACCELEROMETER = "accelerometer"

Output = Rows | Seen | Event


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

    def after(self, outputs: Sequence[Rows]) -> "tuple[Support, list[Rows]]":
        """After further rows, which get the events among theirs where no measurement supports them for long."""
        now, out = self, []
        for rows in outputs:
            if not rows.estimates:
                out.append(rows)
                continue
            main, events = rows.estimates[0], list[Event]()
            starts = np.flatnonzero(np.diff(main.status, prepend=np.uint8(len(PointStatus))))
            for time_ns, code in zip(main.time_ns[starts].tolist(), main.status[starts].tolist(), strict=True):
                if code == Status.TRACKING:
                    if now.reported:
                        lasting_s = (time_ns - now.since_ns) / NANOSECONDS
                        text = f"for {lasting_s:.1f} s they were predicted from the acceleration alone."
                        events.append(Event(time_ns, "seen", f"Measurements support the rows again; {text}"))
                    now = Support(Status.TRACKING)
                    continue
                alone = now.status in (Status.COASTING, Status.LOST)
                now = Support(Status(code), now.since_ns if alone else time_ns, now.reported)
                if code == Status.LOST and not now.reported:
                    text = f"from {shown(now.since_ns)} on: they are predicted from the acceleration alone."
                    events.append(Event(now.since_ns, "lost", f"No measurement supports the rows {text}"))
                    now = replace(now, reported=True)
            out.append(replace(rows, events=(*rows.events, *events)) if events else rows)
        return now, out


class Switch(Protocol):
    """Which of two cameras measures, as of `papers.printed.switching`."""

    state: Any

    def switched(self, seen: Seen) -> Seen:
        """What a sensor saw, without measurements where the other camera measures; a switch is among its events."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class PointState:
    """Everything that a point remembers; sensors: the state of each, in the order of their names."""

    merge: MergeState
    guard: GuardState
    estimator: State | OnSeriesState
    sensors: tuple[SensorState | AuxiliaryState, ...]
    support: Support
    averaging: AveragingState | None
    switch: tuple[int, bool, tuple[tuple[tuple[int, float], ...], ...]] | None = None


class Point:
    """An accelerometer and the sensors with it, by their streams' names, and the estimator that they feed."""

    def __init__(
        self,
        merge: Merge,
        guard: Guard,
        sensors: Mapping[str, Sensor],
        estimator: Estimator | Lag | OnSeries,
        unmeasured: Sequence[float] = (),
        switch: Switch | None = None,
    ) -> None:
        """unmeasured: noise density, (m/s²)²/Hz, of the motion along each further axis without an accelerometer.

        switch: tells which of two cameras measures; None: both do.
        """
        self.merge, self.guard, self.sensors, self.estimator = merge, guard, dict(sensors), estimator
        self.unmeasured, self.switch = tuple(unmeasured), switch
        self._support = Support()
        averaging = Averaging(estimator.settings.channels)
        self._averaging = averaging if averaging.channels else None
        self._reached = [reached for sensor in self.sensors.values() if (reached := sensor.reached) is not None]

    @property
    def status(self) -> PointStatus:
        """How the point stands, by its newest row along the main axis."""
        if not self.estimator.settings.channels:
            return PointStatus.CALIBRATING
        status = self._support.status
        return PointStatus.WARMING if status is None else PointStatus(status)

    @property
    def head(self) -> Estimate | None:
        """With `lag` the row of the main axis at the newest sample, before what comes later smooths it; else None."""
        return self.estimator.head

    def unseen(self, stream: str) -> str:
        """Why a sensor's newest records measure nothing, once that lasts: dark, frozen, lost; else nothing."""
        if stream == ACCELEROMETER:
            return self.guard.unseen
        return self.sensors[stream].unseen if stream in self.sensors else ""

    def scale_errors(self) -> dict[str, tuple[float, float]]:
        """Relative error of each sensor's scale, or of the accelerometer's gain relative to sensors whose unit is
        right, as estimated since the beginning, and its standard deviation.
        """
        settings, (values, variances) = self.estimator.settings, self.estimator.parameters
        return {
            settings.channels[one.channels[0]].sensor if one.kind is ParameterKind.SCALE_ERROR else ACCELEROMETER: (
                float(value),
                float(np.sqrt(variance)),
            )
            for one, value, variance in zip(settings.parameters, values, variances, strict=True)
            if one.kind is not ParameterKind.CLOCK_OFFSET
        }

    def clock_offset(self, sensor: str) -> tuple[float, float]:
        """What is to be added to a sensor's stamps to get the accelerometer's clock, s, as calibrated, as set since and
        as estimated, and its standard deviation, NaN where it is not estimated.
        """
        offsets, variances = self.estimator.clock_offsets
        own = self._channel(sensor)
        known_s = self.merge.memory(sensor).offset_ns / NANOSECONDS
        return known_s + float(offsets[own]), float(np.sqrt(variances[own]))

    def clock_set_s(self, sensor: str) -> float:
        """The part of `clock_offset` that is not its slow course: as calibrated, as set since and as found to have
        stepped, s.
        """
        return self.merge.memory(sensor).offset_ns / NANOSECONDS + self.estimator.clock_steps[self._channel(sensor)]

    def interval_s(self, stream: str) -> float:
        """The usual interval between the values of a stream, s; 0 where it is not known."""
        if stream == ACCELEROMETER:
            return 1.0 / self.guard.settings.rate_hz
        return self.estimator.settings.channels[self._channel(stream)].interval_s

    def _channel(self, sensor: str) -> int:
        """The number of the first channel of a sensor."""
        return [one.sensor for one in self.estimator.settings.channels].index(sensor)

    @property
    def state(self) -> PointState:
        """All that has an effect on what comes later."""
        return PointState(
            self.merge.state,
            self.guard.state,
            self.estimator.state,
            tuple(self.sensors[name].state for name in sorted(self.sensors)),
            self._support,
            None if self._averaging is None else self._averaging.state,
            None if self.switch is None else self.switch.state,
        )

    def restore(self, state: PointState) -> None:
        """Go on from where `state` was read."""
        self.merge.restore(state.merge)
        self.guard.restore(state.guard)
        self.estimator.restore(state.estimator)  # type: ignore[arg-type]
        for name, own in zip(sorted(self.sensors), state.sensors, strict=True):
            self.sensors[name].restore(own)
        self._support = state.support
        if self._averaging is not None and state.averaging is not None:
            self._averaging.restore(state.averaging)
        if self.switch is not None and state.switch is not None:
            self.switch.state = state.switch

    def push(self, record: Arrival | Tick | ClockOffset | Complete | None) -> list[Output]:
        """Take a record; returns what is due, in the order of time: rows, what the sensors saw, and events.

        None: no more records come.
        """
        out: list[Output] = []
        for arrival in self.merge.finish() if record is None else self.merge.push(record):
            if isinstance(arrival.record, Event) and arrival.record.kind in STEPS:
                self.estimator.push(arrival.record)
            if arrival.stream == ACCELEROMETER:
                assert isinstance(arrival.record, Readings | Event)
                for samples in self.guard.push(arrival.record):
                    out += self._sampled(samples)
            elif isinstance(arrival.record, Event):
                out.append(arrival.record)
            else:
                seen = self.sensors[arrival.stream].push(arrival.record, self.estimator.predict)
                out += [] if seen is None else self._measured(seen)
        return out

    def finish(self) -> list[Output]:
        """What is held back still, at the end of all records."""
        out = self.push(None)
        for samples in self.guard.finish():
            out += self._sampled(samples)
        if self._averaging is not None:
            complete, rest = self._averaging.finish()
            out += self._estimated(complete, rest)
        self._support, rows = self._support.after(self.estimator.finish())
        return [*out, *rows]

    def _sampled(self, found: Samples | Event) -> list[Output]:
        """Give samples to the estimator, after the measurements that they cover."""
        if isinstance(found, Event):
            return [found]
        if self.unmeasured:
            nothing = np.zeros((len(found.time_ns), len(self.unmeasured)))
            value = np.column_stack((found.value_m_s2, nothing))
            density = np.column_stack((found.noise_density, nothing + self.unmeasured))
            found = Samples(found.time_ns, value, density, found.kind)
        out: list[Output] = []
        blocks, count = [found], len(found.time_ns)
        if count > BLOCK:
            blocks = [part(found, slice(first, first + BLOCK)) for first in range(0, count, BLOCK)]
        for block in blocks:
            for reached in self._reached:
                seen = reached(block)
                out += [] if seen is None else self._measured(seen)
            complete, due = ((), block) if self._averaging is None else self._averaging.sampled(block)
            out += self._estimated(complete, due)
        return out

    def _estimated(self, complete: Sequence[Seen], samples: Samples | None) -> list[Output]:
        """What the estimator makes of complete measurements and the samples after them."""
        for seen in complete:
            if seen.measured is not None:
                self.estimator.push(seen.measured)
        rows = [] if samples is None else self.estimator.push(samples)
        self._support, rows = self._support.after(rows)
        return [*complete, *rows]

    def _measured(self, seen: Seen) -> list[Output]:
        """Give to the estimator what a sensor measured, unless that waits for the acceleration of its exposure."""
        if self.switch is not None:
            seen = self.switch.switched(seen)
        if self._averaging is not None:
            seen = self._averaging.seen(seen)
        if seen.measured is not None:
            self.estimator.push(seen.measured)
        return [seen]
