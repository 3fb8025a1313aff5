"""Acceleration from outside made fit for the estimator, sample by sample: finite, its holes covered."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from midspan.checks import positive, refuse
from midspan.engine.axis import AxisFigures, AxisLimits, AxisMemory, Bridged, bridge, is_sound, passed
from midspan.engine.order import FIRST_NS, STEPS
from midspan.records import NANOSECONDS, Event, Floats, Nanoseconds, Readings, SampleKind, Samples
from midspan.signals.bridging import GAP_STEPS, LONG_SHARE
from midspan.signals.health import Mask

MEASURED = int(SampleKind.MEASURED)


@dataclass(frozen=True, slots=True)
class GuardSettings:
    """rate_hz of the samples, the usual figures of each axis, and for how long (s) samples are held back at most.

    hold_s: a hole that lasts longer is bridged by the mean, as one of which nothing is known; longer waits for its end.
    """

    rate_hz: float
    axes: tuple[AxisFigures, ...]
    hold_s: float = 1.0


@dataclass(frozen=True, slots=True)
class Stamps:
    """Samples that not all axes have decided: time_ns, step_s before each, broken: the clock ran back there, (n,)."""

    time_ns: Nanoseconds
    step_s: Floats
    broken: Mask


@dataclass(frozen=True, slots=True)
class GuardState:
    """All that a `Guard` knows.

    used_ns: stamp of the newest sample that is used; broken: the clock stepped since then; stamps: of the samples that
    wait; axes, decided: what each axis knows and has decided.
    """

    used_ns: int | None
    broken: bool
    stamps: Stamps
    axes: tuple[AxisMemory, ...]
    decided: tuple[Bridged, ...]


class Guard:
    """Takes readings of an accelerometer, which may hold anything, and gives samples for the estimator, with events.

    Their stamps rise, as `Merge` gives them out.

    What is not finite, frozen or clipped is held back until the next good sample and bridged by a straight line, the
    longer the hole the more by the mean, and the noise density is raised by the motion that was not seen; after a
    second at most the hole is given out as wholly unknown. Gaps in time are covered in the same way, long ones with two
    inserted samples. Where the clock stepped, the density lets the motion be anywhere.
    """

    def __init__(self, settings: GuardSettings) -> None:
        positive("rate_hz", settings.rate_hz, "Hz")
        positive("hold_s", settings.hold_s, "s")
        self.settings = settings
        self._noise = np.array([axis.noise_density for axis in settings.axes])
        self._gain = np.array([axis.gain for axis in settings.axes])
        self._limits = [AxisLimits.of(axis, settings.rate_hz, settings.hold_s) for axis in settings.axes]
        nothing = Bridged(np.empty(0), np.empty(0), np.empty(0, dtype=bool))
        none = Stamps(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0, dtype=bool))
        memories = tuple(AxisMemory.before(axis) for axis in settings.axes)
        self._state = GuardState(None, False, none, memories, tuple(nothing for _ in settings.axes))

    @property
    def unseen(self) -> str:
        """Whether the newest samples are one value over and over, and have been for longer than they are held back."""
        return "frozen" if any(axis.lost and axis.equal > axis.lost for axis in self._state.axes) else ""

    @property
    def state(self) -> GuardState:
        """All that has an effect on what comes later."""
        return self._state

    def restore(self, state: GuardState) -> None:
        """Go on from where `state` was read."""
        if len(state.axes) != len(self.settings.axes):
            raise refuse("state", f"of {len(self.settings.axes)} axes", len(state.axes))
        self._state = state

    def push(self, record: Readings | Event) -> list[Samples | Event]:
        """Take readings, time_ns (n,) and value (n, axes), or what was found wrong with the stream before it came here.

        Returns Samples, where any are decided, and events. An event of one of `STEPS` counts as the clock's step.
        """
        if isinstance(record, Event):
            self._state = replace(self._state, broken=self._state.broken or record.kind in STEPS)
            return [record]
        count = len(self.settings.axes)
        if record.value.shape != (len(record.time_ns), count):
            raise refuse("value", f"of shape ({len(record.time_ns)}, {count})", record.value.shape)
        if self._is_sound(record):
            return [self._passed(record)]
        kept, events = self._in_order(record.time_ns)
        return self._join(record.time_ns[kept], record.value[kept], events, end=False)

    def _is_sound(self, record: Readings) -> bool:
        """Whether readings are plainly good and nothing waits, which is the usual case."""
        state, time_ns = self._state, record.time_ns
        if not len(time_ns) or state.used_ns is None or state.broken or len(state.stamps.time_ns):
            return False
        first_ns, steps = int(time_ns[0]) - state.used_ns, time_ns[1:] - time_ns[:-1]
        if self._is_gap(max(first_ns, int(steps.max(initial=0))) / NANOSECONDS):
            return False
        axes = zip(state.axes, record.value.T, self.settings.axes, strict=True)
        return all(is_sound(memory, value, figures) for memory, value, figures in axes)

    def _passed(self, record: Readings) -> Samples:
        """Sound readings as they are: the short way to what the others go through."""
        state, count, newest_ns = self._state, len(record.time_ns), int(record.time_ns[-1])
        rate_hz, noise, axes = self.settings.rate_hz, np.empty(record.value.shape), []
        for k, (memory, figures) in enumerate(zip(state.axes, self.settings.axes, strict=True)):
            after, noise[:, k] = passed(memory, (record.time_ns, record.value[:, k]), figures, rate_hz)
            axes.append(after)
        noise += self._noise
        self._state = GuardState(newest_ns, False, state.stamps, tuple(axes), state.decided)
        return self._in_metres(Samples(record.time_ns, record.value, noise, np.full(count, MEASURED, dtype=np.uint8)))

    def _in_metres(self, block: Samples) -> Samples:
        """Samples without what the accelerometer measures too much."""
        value, noise = block.value_m_s2 / self._gain, block.noise_density / self._gain**2
        return Samples(block.time_ns, value, noise, block.kind)

    def finish(self) -> list[Samples | Event]:
        """What still waits; the record ends here."""
        none = np.empty((0, len(self.settings.axes)))
        return self._join(np.empty(0, dtype=np.int64), none, [], end=True)

    def _in_order(self, time_ns: Nanoseconds) -> tuple[Mask, list[Event]]:
        """Which of the rising stamps (n,) are used, and events; those used are put to the ones that wait."""
        state = self._state
        kept, marks = np.ones(len(time_ns), dtype=bool), np.zeros(len(time_ns), dtype=bool)
        if state.broken:
            # After a step of the clock, of an interval much shorter than usual no motion could be told.
            kept = time_ns >= self._least_ns(state.used_ns)
            marks[np.flatnonzero(kept)[:1]] = state.used_ns is not None
        events = self._wait(time_ns[kept], marks[kept])
        if kept.any():
            self._state = replace(self._state, used_ns=int(time_ns[-1]), broken=False)
        return kept, events

    def _least_ns(self, used_ns: int | None) -> int:
        """The earliest stamp that is used after the clock ran back."""
        return FIRST_NS if used_ns is None else used_ns + round(0.5 * NANOSECONDS / self.settings.rate_hz)

    def _wait(self, time_ns: Nanoseconds, broken: Mask) -> list[Event]:
        """Put stamps (n,) to those that wait; returns an event for each gap before them."""
        state, name = self._state, self.settings.axes[0].name
        if not len(time_ns):
            return []
        first_ns = int(time_ns[0]) if state.used_ns is None else state.used_ns
        before_ns = np.concatenate(([first_ns], time_ns[:-1]))
        step_s = (time_ns - before_ns) / NANOSECONDS
        wait = state.stamps
        stamps = Stamps(
            np.concatenate((wait.time_ns, time_ns)),
            np.concatenate((wait.step_s, step_s)),
            np.concatenate((wait.broken, broken)),
        )
        self._state = replace(state, stamps=stamps)
        return [
            Event(int(before_ns[k]), "gap", f"{name}: no samples for {step_s[k]:.3g} s.")
            for k in np.flatnonzero(self._is_gap(step_s))
        ]

    def _is_gap(self, step_s: Any) -> Any:
        return step_s > GAP_STEPS / self.settings.rate_hz

    def _join(self, time_ns: Nanoseconds, value: Floats, events: list[Event], *, end: bool) -> list[Samples | Event]:
        """Give out what all axes have decided, after new samples: time_ns (n,), value (n, axes)."""
        state, memories, decided = self._state, [], []
        for number, figures in enumerate(self.settings.axes):
            new = (time_ns, value[:, number])
            memory, found = bridge(state.axes[number], new, figures, self._limits[number], end=end)
            memories.append(memory)
            events += found.events
            decided.append(_after(state.decided[number], found))
        count = min(len(axis.value) for axis in decided)
        block = self._samples(decided, count)
        wait = state.stamps
        left = Stamps(wait.time_ns[count:], wait.step_s[count:], wait.broken[count:])
        rest = tuple(_rows(axis, slice(count, None)) for axis in decided)
        self._state = replace(state, stamps=left, axes=tuple(memories), decided=rest)
        return [self._in_metres(block), *events] if count else [*events]

    def _samples(self, decided: Sequence[Bridged], count: int) -> Samples:
        """The first `count` samples of all axes, with the density that gaps and steps of the clock add."""
        stamps, axes = self._state.stamps, self.settings.axes
        value = np.column_stack([axis.value[:count] for axis in decided])
        extra = np.column_stack([axis.density[:count] for axis in decided])
        step_s, broken = stamps.step_s[:count], stamps.broken[:count]
        gap = self._is_gap(step_s)
        for k in np.flatnonzero(gap | broken):
            for number, axis in enumerate(axes):
                unseen = axis.unseen(float(step_s[k])) if gap[k] else 0.0
                unmoved = axis.unmoved(float(step_s[k])) if broken[k] else 0.0
                extra[k, number] = max(extra[k, number], unseen, unmoved)
        kind = np.where(
            np.any([axis.bridged[:count] for axis in decided], axis=0), SampleKind.BRIDGED, SampleKind.MEASURED
        )
        block = Samples(stamps.time_ns[:count], value, self._noise + extra, kind.astype(np.uint8))
        unknown = np.array([axis.unknown_density for axis in axes])
        long = np.flatnonzero(gap & np.any(extra > LONG_SHARE * unknown, axis=1))
        return self._inserted(block, long, step_s) if len(long) else block

    def _inserted(self, block: Samples, long: Nanoseconds, step_s: Floats) -> Samples:
        """With two samples of the mean in each long gap that ends at the samples `long` (g,).

        A straight line between the values on both sides of a long gap would move the structure by metres.
        """
        step_ns = round(NANOSECONDS / self.settings.rate_hz)
        start_ns = block.time_ns[long] - np.rint(NANOSECONDS * step_s[long]).astype(np.int64)
        mean = np.array([axis.mean_m_s2 for axis in self.settings.axes])
        twice = np.repeat(long, 2)
        time_ns = np.column_stack((start_ns + step_ns, block.time_ns[long] - step_ns)).ravel()
        return Samples(
            np.insert(block.time_ns, twice, time_ns),
            np.insert(block.value_m_s2, twice, mean, axis=0),
            np.insert(block.noise_density, twice, block.noise_density[twice], axis=0),
            np.insert(block.kind, twice, np.uint8(SampleKind.INSERTED)),
        )


def _after(first: Bridged, second: Bridged) -> Bridged:
    return Bridged(
        np.concatenate((first.value, second.value)),
        np.concatenate((first.density, second.density)),
        np.concatenate((first.bridged, second.bridged)),
    )


def _rows(axis: Bridged, which: slice) -> Bridged:
    return Bridged(axis.value[which].copy(), axis.density[which].copy(), axis.bridged[which].copy())
