"""The sensors of a measuring point: from a record, and what the estimator expects of it, to measurements.

A sensor knows which channels of the estimator its targets feed. What it measured leaves it in its own unit, target by
target; nothing is merged here.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from midspan.engine.camera import CameraChain, CameraState
from midspan.engine.plain import PlainChain, PlainState
from midspan.engine.radar import RadarChain
from midspan.engine.radar_target import FollowedState
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
    def state(self) -> Any:
        """Everything that changes from record to record, as a frozen record."""
        ...

    def restore(self, state: Any) -> None:
        """Go on from a `state` taken earlier."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class CameraSensorState:
    """What a `CameraSensor` remembers: its chain's state, and where each target was seen last, (x, y) in px."""

    chain: CameraState
    seen_px: tuple[tuple[float, float], ...]


class CameraSensor:
    """A camera: channels[target][axis] are numbers in the estimator's table, directions the image axis of each."""

    def __init__(
        self, name: str, chain: CameraChain, channels: Sequence[Sequence[int]], directions: Sequence[str]
    ) -> None:
        self.name, self.chain = name, chain
        self.channels, self.directions = tuple(tuple(row) for row in channels), tuple(directions)
        self._seen_px = [(0.0, 0.0)] * len(self.channels)

    @property
    def state(self) -> CameraSensorState:
        """Everything that changes from frame to frame."""
        return CameraSensorState(self.chain.state, tuple(self._seen_px))

    def restore(self, state: CameraSensorState) -> None:
        """Go on from a `state` taken earlier."""
        self.chain.restore(state.chain)
        self._seen_px = list(state.seen_px)

    def push(self, record: Frame | Tracked, expect: Expect) -> Seen:
        """Find each target in a frame, where it is expected; a frame that was tracked before is taken as it is."""
        if isinstance(record, Tracked):
            late_ns = record.time_ns - record.own_ns
            found = tuple(one.later(late_ns) for one in record.translations)
        else:
            numbers = range(len(self.channels))
            found = self.chain.push(record, [self._prediction(k, record.time_ns, expect) for k in numbers])
        for k, one in enumerate(found):
            if np.isfinite(one.x_px) and np.isfinite(one.y_px):
                self._seen_px[k] = (one.x_px, one.y_px)
        return Seen(self.name, self._measured(found), found, tuple(self._told(found)))

    def reached(self, samples: Samples) -> None:
        """A frame is measured when it comes; the estimator waits for the samples that cover it."""

    def _told(self, found: Sequence[PixelTranslation]) -> Iterator[Event]:
        """What happened to the targets, with their names."""
        for target, one in zip(self.chain.targets, found, strict=True):
            whose = f"{self.name}, target {target.name}" if len(found) > 1 else self.name
            yield from (replace(event, text=f"{whose}: {event.text}") for event in one.events)

    def _prediction(self, target: int, time_ns: int, expect: Expect) -> Prediction | None:
        """Where a target is expected; None while the main axis cannot tell."""
        place = dict(zip("xy", ((value, ACROSS_STD_PX) for value in self._seen_px[target]), strict=True))
        for number, (channel, direction) in enumerate(zip(self.channels[target], self.directions, strict=True)):
            value, variance = expect(channel, time_ns)
            std = max(float(np.sqrt(max(variance, 0.0))), MIN_STD_PX)
            if np.isfinite(value) and std <= MAX_STD_PX:
                place[direction] = (value, std)
            elif number == 0:
                return None
        return Prediction(place["x"][0], place["y"][0], place["x"][1], place["y"][1])

    def _measured(self, found: Sequence[PixelTranslation]) -> Measured:
        """The translations that were found, along each axis, as measurements."""
        rows = [
            (
                one.time_ns,
                channel,
                getattr(one, f"{direction}_px"),
                getattr(one, f"variance_{direction}_px2"),
                getattr(one, f"reference_variance_{direction}_px2"),
            )
            for one, channels in zip(found, self.channels, strict=True)
            for channel, direction in zip(channels, self.directions, strict=True)
        ]
        time_ns, channel, *values = zip(*rows, strict=True)
        value, variance, reference = (np.array(column, dtype=np.float64) for column in values)
        return Measured(
            np.array(time_ns, dtype=np.int64), np.array(channel, dtype=np.int64), value, variance, reference
        )


class RadarSensor:
    """A radar: channels[target] are numbers in the estimator's table, in the order of the chain's targets."""

    def __init__(self, name: str, chain: RadarChain, channels: Sequence[int]) -> None:
        self.name, self.chain, self.channels = name, chain, tuple(channels)

    @property
    def state(self) -> tuple[FollowedState, ...]:
        """Everything that changes from frame to frame."""
        return self.chain.state

    def restore(self, state: tuple[FollowedState, ...]) -> None:
        """Go on from a `state` taken earlier."""
        self.chain.restore(state)

    def push(self, record: RangeFrame, expect: Expect) -> Seen:
        """The phase of each target in a frame, unwrapped about the one that is expected."""
        found = self.chain.push(record, [expect(channel, record.time_ns) for channel in self.channels])
        # The chain calls its sensor by its kind.
        told = [event for one in found for event in one.events]
        events = tuple(replace(event, text=event.text.replace("radar", self.name, 1)) for event in told)
        rows = [
            (*row, channel, one.reference_variance_rad2)
            for one, channel in zip(found, self.channels, strict=True)
            for row in (*one.before, (one.time_ns, one.phase_rad, one.variance_rad2))
        ]
        time_ns, phase, variance, channel, reference = zip(*rows, strict=True)
        measured = Measured(
            np.array(time_ns, dtype=np.int64),
            np.array(channel, dtype=np.int64),
            np.array(phase),
            np.array(variance),
            np.array(reference),
        )
        return Seen(self.name, measured, found, events)

    def reached(self, samples: Samples) -> None:
        """A frame is measured when it comes; the estimator waits for the samples that cover it."""


class PlainSensor:
    """A displacement sensor: its chain takes readings in m and gives them out with the samples that cover them."""

    def __init__(self, name: str, chain: PlainChain) -> None:
        self.name, self.chain = name, chain

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
