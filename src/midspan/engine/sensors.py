"""The sensors of a measuring point: from a record, and what the estimator expects of it, to measurements.

A sensor knows which channels of the estimator its targets feed. What it measured leaves it in its own unit, target by
target; nothing is merged here.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, Protocol

import numpy as np

from midspan.engine.camera import CameraChain, CameraState
from midspan.engine.plain import PlainChain, PlainState
from midspan.engine.radar import RadarChain
from midspan.engine.radar_target import FollowedState
from midspan.records import (
    NANOSECONDS,
    Event,
    Floats,
    Frame,
    Measured,
    PhaseMeasurement,
    PixelTranslation,
    Prediction,
    RangeFrame,
    Readings,
    Samples,
    Status,
    Tracked,
    unzoomed,
)
from midspan.signals.health import GAP_STEPS
from midspan.signals.stamps import shown

# The prediction across the measured axis, where nothing predicts: the motion there is small, px.
ACROSS_STD_PX = 2.0
# A prediction is trusted to no better than this, so that the search never narrows to nothing, px.
MIN_STD_PX = 0.5
# A prediction vaguer than this is none, px.
MAX_STD_PX = 100.0
# This many seconds, and this many usual intervals, without the target are an event: rows are coasting by then. Shorter
# ones are what a codec or a shutter leaves out.
LOST_S, LOST_INTERVALS = 3.0, 5.0
TEXTS = {
    "dark": "dark from {} on; this camera measures nothing.",
    "frozen": "frozen image from {} on; this camera measures nothing.",
    "lost": (
        "the target is lost from {} on; this camera measures nothing. Check for an obstruction and check its region."
    ),
}
# Of a translation along an image axis: value, its variance and that of its reference.
ALONG = {
    direction: attrgetter(f"{direction}_px", f"variance_{direction}_px2", f"reference_variance_{direction}_px2")
    for direction in "xy"
}

Expect = Callable[[int, int], tuple[float, float]]
"""Expected measurement of a channel (its number) at a stamp (ns) in the channel's unit, and its variance."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What a sensor made of one record: measurements for the estimator, what was found of each target, events."""

    sensor: str
    measured: Measured | None
    found: tuple[PixelTranslation | PhaseMeasurement, ...] = ()
    events: tuple[Event, ...] = ()


class Sensor(Protocol):
    """One sensor of a point."""

    def push(self, record: Any, expect: Expect) -> Seen | None:
        """Take the next record, its stamps on the common clock."""
        ...

    @property
    def reached(self) -> Callable[[Samples], Seen | None] | None:
        """Takes the samples that the estimator gets next, where records wait for those that cover them; else None."""
        ...

    @property
    def unseen(self) -> str:
        """Why nothing is measured with the newest records, once that lasts: dark, frozen, lost; else nothing."""
        ...

    @property
    def state(self) -> Any:
        """Everything that changes from record to record, as a frozen record."""
        ...

    def restore(self, state: Any) -> None:
        """Go on from a `state` taken earlier."""
        ...


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
                text = f"{name}: the target is visible again; no measurement for {lasting_s:.1f} s."
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


@dataclass(frozen=True, slots=True, eq=False)
class CameraSensorState:
    """What a `CameraSensor` remembers: its chain's state, where each target was seen last, (x, y) in px, since when
    none could be, and how far each one's picture had grown.
    """

    chain: CameraState
    seen_px: tuple[tuple[float, float], ...]
    unseen: Unseen
    zoom: tuple[float, ...]


SensorState = CameraSensorState | tuple[FollowedState, ...] | tuple[PhaseMeasurement, ...] | PlainState | None
"""What a sensor remembers; a checkpoint keeps nothing else."""


class CameraSensor:
    """A camera: channels[target][axis] are numbers in the estimator's table, directions the image axis of each.

    step_s: the usual interval of its frames; 0: not known, and gaps are not reported. min_std_px: a prediction is
    trusted to no better than this. levers_px[target][axis]: see `TargetCalibration`.
    """

    reached = None

    def __init__(
        self,
        name: str,
        chain: CameraChain,
        channels: Sequence[Sequence[int]],
        directions: Sequence[str],
        *,
        step_s: float = 0.0,
        min_std_px: float = MIN_STD_PX,
        levers_px: Sequence[Sequence[float]] | None = None,
    ) -> None:
        self._min_std_px = min_std_px
        self._levers_px = np.zeros((len(channels), len(directions))) if levers_px is None else np.array(levers_px)
        self._zoom = [0.0] * len(channels)
        self.name, self.chain, self._step_s, self._unseen = name, chain, step_s, Unseen()
        self.channels, self.directions = tuple(tuple(row) for row in channels), tuple(directions)
        self._seen_px = [(0.0, 0.0)] * len(self.channels)
        self._numbers = np.array(self.channels, dtype=np.int64).reshape(-1)
        self._along = [ALONG[direction] for direction in directions]

    @property
    def unseen(self) -> str:
        """What is reported of frames without the target."""
        return self._unseen.reported

    @property
    def state(self) -> CameraSensorState:
        """Everything that changes from frame to frame."""
        return CameraSensorState(self.chain.state, tuple(self._seen_px), self._unseen, tuple(self._zoom))

    def restore(self, state: CameraSensorState) -> None:
        """Go on from a `state` taken earlier."""
        self.chain.restore(state.chain)
        self._seen_px, self._unseen, self._zoom = list(state.seen_px), state.unseen, list(state.zoom)

    def push(self, record: Frame | Tracked, expect: Expect) -> Seen:
        """Find each target in a frame, where it is expected; a frame that was tracked before is taken as it is."""
        if isinstance(record, Tracked):
            late_ns = record.time_ns - record.own_ns
            found = tuple(one.later(late_ns) for one in record.translations)
        else:
            numbers = range(len(self.channels))
            found = self.chain.push(record, [self._prediction(k, record.time_ns, expect) for k in numbers])
        for k, one in enumerate(found):
            if math.isfinite(one.x_px) and math.isfinite(one.y_px):
                self._seen_px[k] = (one.x_px, one.y_px)
        self._unseen, events = self._unseen.after(record.time_ns, found, self._step_s, self.name)
        several = len(found) > 1
        events += [
            replace(event, text=f"{self.name}{f', target {target.name}' * several}: {event.text}")
            for target, one in zip(self.chain.targets, found, strict=True)
            for event in one.events
        ]
        # Of each target along each axis: value, its variance and that of its reference.
        rows = np.array([read(one) for one in found for read in self._along], dtype=np.float64)
        time_ns = np.array([one.time_ns for one in found for _ in self._along], dtype=np.int64)
        self._take_off_zoom(found, rows)
        measured = Measured(time_ns, self._numbers, rows[:, 0], rows[:, 1], rows[:, 2])
        return Seen(self.name, measured, found, tuple(events))

    def _take_off_zoom(self, found: Sequence[PixelTranslation], rows: Floats) -> None:
        for k, one in enumerate(found):
            self._zoom[k] = one.zoom if math.isfinite(one.variance_zoom) else self._zoom[k]
        levers = self._levers_px.reshape(-1)
        moved = levers != 0.0
        if moved.any():
            zoom, variance = np.repeat([(one.zoom, one.variance_zoom) for one in found], len(self._along), axis=0).T
            seen = rows[moved, 0], rows[moved, 1]
            rows[moved, 0], rows[moved, 1] = unzoomed(seen, (zoom[moved], variance[moved]), levers[moved])

    def _prediction(self, target: int, time_ns: int, expect: Expect) -> Prediction | None:
        """Where a target is expected; None while the main axis cannot tell."""
        (x_px, y_px), x_std, y_std = self._seen_px[target], ACROSS_STD_PX, ACROSS_STD_PX
        for number, (channel, direction) in enumerate(zip(self.channels[target], self.directions, strict=True)):
            value, variance = expect(channel, time_ns)
            if self._levers_px[target, number]:
                value = (1.0 + self._zoom[target]) * value + self._levers_px[target, number] * self._zoom[target]
            std = max(math.sqrt(max(variance, 0.0)), self._min_std_px)
            if math.isfinite(value) and std <= MAX_STD_PX:
                if direction == "x":
                    x_px, x_std = value, std
                else:
                    y_px, y_std = value, std
            elif number == 0:
                return None
        return Prediction(x_px, y_px, x_std, y_std)


class RadarSensor:
    """A radar: channels[target] are numbers in the estimator's table, in the order of the chain's targets."""

    reached = None

    def __init__(self, name: str, chain: RadarChain, channels: Sequence[int]) -> None:
        self.name, self.chain, self.channels = name, chain, tuple(channels)

    @property
    def unseen(self) -> str:
        """Whether no target is seen, and that is an event."""
        return "lost" if all(state.reported for state in self.chain.state) else ""

    @property
    def state(self) -> tuple[FollowedState, ...]:
        """Everything that changes from frame to frame."""
        return self.chain.state

    def restore(self, state: tuple[FollowedState, ...]) -> None:
        """Go on from a `state` taken earlier."""
        self.chain.restore(state)

    def push(self, record: RangeFrame, expect: Expect) -> Seen:
        """The phase of each target in a frame, unwrapped about the one that is expected.

        With the first one come those of the frames before it, unless the estimator has gone past them.
        """
        predicted = [expect(channel, record.time_ns) for channel in self.channels]
        found = self.chain.push(record, predicted)
        rows = [
            (channel, one)
            for channel, (_, variance), last in zip(self.channels, predicted, found, strict=True)
            for one in (*(last.earlier if math.isinf(variance) else ()), last)
        ]
        measured = Measured(
            np.array([one.time_ns for _, one in rows], dtype=np.int64),
            np.array([channel for channel, _ in rows], dtype=np.int64),
            np.array([one.phase_rad for _, one in rows]),
            np.array([one.variance_rad2 for _, one in rows]),
            np.array([one.reference_variance_rad2 for _, one in rows]),
        )
        return Seen(self.name, measured, found, tuple(event for one in found for event in one.events))


class PlainSensor:
    """A displacement sensor: its chain takes readings in m and gives them out with the samples that cover them."""

    def __init__(self, name: str, chain: PlainChain) -> None:
        self.name, self.chain = name, chain

    @property
    def unseen(self) -> str:
        """Whether its value does not change though the structure moves."""
        return "frozen" if self.chain.state.run.stuck else ""

    @property
    def state(self) -> PlainState:
        """Everything that changes from reading to reading."""
        return self.chain.state

    def restore(self, state: PlainState) -> None:
        """Go on from a `state` taken earlier."""
        self.chain.state = state

    def push(self, record: Readings, expect: Expect) -> Seen | None:
        """Take readings, which wait."""
        return self._seen(self.chain.push(record))

    def reached(self, samples: Samples) -> Seen | None:
        """The readings that the samples reach, as measurements."""
        return self._seen(self.chain.push(samples))

    def _seen(self, found: Sequence[Measured | Event]) -> Seen | None:
        measured = next((one for one in found if isinstance(one, Measured)), None)
        return Seen(self.name, measured, (), tuple(one for one in found if isinstance(one, Event))) if found else None
