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
from midspan.engine.unseen import Unseen
from midspan.records import (
    Event,
    Frame,
    Measured,
    PhaseMeasurement,
    PixelTranslation,
    Prediction,
    RangeFrame,
    Readings,
    Samples,
    Tracked,
    joined,
)

# The prediction across the measured axis, where nothing predicts: the motion there is small, px.
ACROSS_STD_PX = 2.0
# A prediction is trusted to no better than this, so that the search never narrows to nothing, px.
MIN_STD_PX = 0.5
# A prediction vaguer than this is none, px.
MAX_STD_PX = 100.0
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

    def reached(self, samples: Samples) -> Seen | None:
        """Take the samples that the estimator gets next: a sensor may wait for those that cover its records."""
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


@dataclass(frozen=True, slots=True, eq=False)
class CameraSensorState:
    """What a `CameraSensor` remembers: its chain's state, where each target was seen last, (x, y) in px, and since when
    none could be.
    """

    chain: CameraState
    seen_px: tuple[tuple[float, float], ...]
    unseen: Unseen


SensorState = CameraSensorState | tuple[FollowedState, ...] | PlainState | None
"""What a sensor remembers; a checkpoint keeps nothing else."""


class CameraSensor:
    """A camera: channels[target][axis] are numbers in the estimator's table, directions the image axis of each.

    step_s: the usual interval of its frames; 0: not known, and gaps are not reported. min_std_px: a prediction is
    trusted to no better than this.
    """

    def __init__(
        self,
        name: str,
        chain: CameraChain,
        channels: Sequence[Sequence[int]],
        directions: Sequence[str],
        *,
        step_s: float = 0.0,
        min_std_px: float = MIN_STD_PX,
    ) -> None:
        self._min_std_px = min_std_px
        self.name, self.chain, self._step_s, self._unseen = name, chain, step_s, Unseen()
        self.channels, self.directions = tuple(tuple(row) for row in channels), tuple(directions)
        self._seen_px = [(0.0, 0.0)] * len(self.channels)
        self._numbers = np.array(self.channels, dtype=np.int64).reshape(-1)

    @property
    def unseen(self) -> str:
        """What is reported of frames without the target."""
        return self._unseen.reported

    @property
    def state(self) -> CameraSensorState:
        """Everything that changes from frame to frame."""
        return CameraSensorState(self.chain.state, tuple(self._seen_px), self._unseen)

    def restore(self, state: CameraSensorState) -> None:
        """Go on from a `state` taken earlier."""
        self.chain.restore(state.chain)
        self._seen_px, self._unseen = list(state.seen_px), state.unseen

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
        return Seen(self.name, self._measured(found), found, (*events, *self._told(found)))

    def reached(self, samples: Samples) -> None:
        """A frame is measured when it comes; the estimator waits for the samples that cover it."""

    def _told(self, found: Sequence[PixelTranslation]) -> tuple[Event, ...]:
        """What happened to the targets, with their names."""
        several = len(found) > 1
        return tuple(
            replace(event, text=f"{self.name}{f', target {target.name}' * several}: {event.text}")
            for target, one in zip(self.chain.targets, found, strict=True)
            for event in one.events
        )

    def _prediction(self, target: int, time_ns: int, expect: Expect) -> Prediction | None:
        """Where a target is expected; None while the main axis cannot tell."""
        (x_px, y_px), x_std, y_std = self._seen_px[target], ACROSS_STD_PX, ACROSS_STD_PX
        for number, (channel, direction) in enumerate(zip(self.channels[target], self.directions, strict=True)):
            value, variance = expect(channel, time_ns)
            std = max(math.sqrt(max(variance, 0.0)), self._min_std_px)
            if math.isfinite(value) and std <= MAX_STD_PX:
                if direction == "x":
                    x_px, x_std = value, std
                else:
                    y_px, y_std = value, std
            elif number == 0:
                return None
        return Prediction(x_px, y_px, x_std, y_std)

    def _measured(self, found: Sequence[PixelTranslation]) -> Measured:
        """The translations that were found, along each axis, as measurements."""
        along = [ALONG[direction] for direction in self.directions]
        rows = np.array([read(one) for one in found for read in along], dtype=np.float64)
        time_ns = np.array([one.time_ns for one in found for _ in along], dtype=np.int64)
        return Measured(time_ns, self._numbers, rows[:, 0], rows[:, 1], rows[:, 2])


class RadarSensor:
    """A radar: channels[target] are numbers in the estimator's table, in the order of the chain's targets."""

    def __init__(self, name: str, chain: RadarChain, channels: Sequence[int]) -> None:
        self.name, self.chain, self.channels = name, chain, tuple(channels)

    @property
    def unseen(self) -> str:
        """Whether no target is seen, and that is an event."""
        return "lost" if all(state.told for state in self.chain.state) else ""

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

    def reached(self, samples: Samples) -> None:
        """A frame is measured when it comes; the estimator waits for the samples that cover it."""


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
        self.chain.restore(state)

    def push(self, record: Readings, expect: Expect) -> Seen | None:
        """Take readings, which wait."""
        return self._seen(self.chain.push(record))

    def reached(self, samples: Samples) -> Seen | None:
        """The readings that the samples reach, as measurements."""
        return self._seen(self.chain.push(samples))

    def _seen(self, found: Sequence[Measured | Event]) -> Seen | None:
        measured = [one for one in found if isinstance(one, Measured)]
        events = tuple(one for one in found if isinstance(one, Event))
        return Seen(self.name, joined(measured) if measured else None, (), events) if found else None
