"""Acceleration from outside made fit for the estimator, sample by sample: finite, its holes covered."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.checks import positive, refuse
from midspan.engine.axis import AxisFigures, AxisLimits, AxisMemory, Bridged, bridge, passed
from midspan.engine.stream import FIRST_NS, STEPS
from midspan.records import NANOSECONDS, Event, Floats, Nanoseconds, Readings, SampleKind, Samples, joined, part
from midspan.signals.acceleration import span_density
from midspan.signals.health import GAP_STEPS, LONG_SHARE, Mask

MEASURED = int(SampleKind.MEASURED)


@dataclass(frozen=True, slots=True)
class GuardSettings:
    """rate_hz of the samples, the usual figures of each axis, and for how long (s) samples are held back at most.

    hold_s: a hole that lasts longer is bridged by the mean, as one of which nothing is known; longer waits for its end.
    doubtful: first and last stamp (ns) of spans, and the noise density, (m/s²)²/Hz, that the first axis has there in
    addition.
    """

    rate_hz: float
    axes: tuple[AxisFigures, ...]
    hold_s: float = 1.0
    doubtful: tuple[tuple[int, int, float], ...] = ()


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
        self._gap_s = GAP_STEPS / settings.rate_hz
        self._noise = np.array([axis.noise_density for axis in settings.axes])
        self._gain = np.array([axis.gain for axis in settings.axes])
        self._limits = [AxisLimits.of(axis, settings.rate_hz, settings.hold_s) for axis in settings.axes]
        nothing = Bridged(np.empty(0), np.empty(0), np.empty(0, dtype=bool))
        none = Stamps(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0, dtype=bool))
        memories = tuple(AxisMemory.before(axis) for axis in settings.axes)
        # All that has an effect on what comes later.
        self.state = GuardState(None, False, none, memories, tuple(nothing for _ in settings.axes))

    @property
    def unseen(self) -> str:
        """Whether the newest samples are one value over and over, and have been for longer than they are held back."""
        return "frozen" if any(axis.lost and axis.equal > axis.lost for axis in self.state.axes) else ""

    def restore(self, state: GuardState) -> None:
        """Go on from where `state` was read."""
        if len(state.axes) != len(self.settings.axes):
            raise refuse("state", f"of {len(self.settings.axes)} axes", len(state.axes))
        self.state = state

    def push(self, record: Readings | Event) -> list[Samples | Event]:
        """Take readings, time_ns (n,) and value (n, axes), or what was found wrong with the stream before it came here.

        Returns Samples, where any are decided, and events. An event of one of `STEPS` counts as the clock's step.
        """
        if isinstance(record, Event):
            self.state = replace(self.state, broken=self.state.broken or record.kind in STEPS)
            return [record]
        count = len(self.settings.axes)
        if record.value.shape != (len(record.time_ns), count):
            raise refuse("value", f"of shape ({len(record.time_ns)}, {count})", record.value.shape)
        if (samples := self._passed(record)) is not None:
            return [samples]
        kept, events = self._in_order(record.time_ns)
        return self._join(record.time_ns[kept], record.value[kept], events, end=False)

    def _passed(self, record: Readings) -> Samples | None:
        """Readings that are plainly good while nothing waits, as they are: the usual case, and the short way to what
        the others go through; None of others.
        """
        state, time_ns = self.state, record.time_ns
        if not len(time_ns) or state.used_ns is None or state.broken or len(state.stamps.time_ns):
            return None
        longest_ns = max(int(time_ns[0]) - state.used_ns, int((time_ns[1:] - time_ns[:-1]).max(initial=0)))
        if longest_ns / NANOSECONDS > self._gap_s:
            return None
        noise, memories = np.empty(record.value.shape), []
        for k, (memory, figures) in enumerate(zip(state.axes, self.settings.axes, strict=True)):
            found = passed(memory, (time_ns, record.value[:, k]), figures, self._limits[k])
            if found is None:
                return None
            noise[:, k] = found[1]
            memories.append(found[0])
        noise[:, 0] += span_density(time_ns, self.settings.doubtful)
        self.state = GuardState(int(time_ns[-1]), False, state.stamps, tuple(memories), state.decided)
        value, density = record.value / self._gain, (noise + self._noise) / self._gain**2
        return Samples(time_ns, value, density, np.full(len(time_ns), MEASURED, dtype=np.uint8))

    def finish(self) -> list[Samples | Event]:
        """What still waits; the record ends here."""
        none = np.empty((0, len(self.settings.axes)))
        return self._join(np.empty(0, dtype=np.int64), none, [], end=True)

    def _in_order(self, time_ns: Nanoseconds) -> tuple[Mask, list[Event]]:
        """Which of the rising stamps (n,) are used, and events of gaps; those used are put to the ones that wait."""
        state = self.state
        kept, marks = np.ones(len(time_ns), dtype=bool), np.zeros(len(time_ns), dtype=bool)
        if state.broken:
            # After a step of the clock, of an interval much shorter than usual no motion could be reported.
            half_ns = round(0.5 * NANOSECONDS / self.settings.rate_hz)
            kept = time_ns >= (FIRST_NS if state.used_ns is None else state.used_ns + half_ns)
            marks[np.flatnonzero(kept)[:1]] = state.used_ns is not None
        time_ns, marks = time_ns[kept], marks[kept]
        if not len(time_ns):
            return kept, []
        first_ns = int(time_ns[0]) if state.used_ns is None else state.used_ns
        before_ns = np.concatenate(([first_ns], time_ns[:-1]))
        step_s = (time_ns - before_ns) / NANOSECONDS
        stamps = joined([state.stamps, Stamps(time_ns, step_s, marks)])
        self.state = replace(state, used_ns=int(time_ns[-1]), broken=False, stamps=stamps)
        name = self.settings.axes[0].name
        gaps = np.flatnonzero(step_s > self._gap_s)
        return kept, [Event(int(before_ns[k]), "gap", f"{name}: no samples for {step_s[k]:.3g} s.") for k in gaps]

    def _join(self, time_ns: Nanoseconds, value: Floats, events: list[Event], *, end: bool) -> list[Samples | Event]:
        """Give out what all axes have decided, after new samples: time_ns (n,), value (n, axes)."""
        state, memories, decided = self.state, [], []
        for number, figures in enumerate(self.settings.axes):
            new = (time_ns, value[:, number])
            memory, found, reported = bridge(state.axes[number], new, figures, self._limits[number], end=end)
            memories.append(memory)
            events += reported
            decided.append(joined([state.decided[number], found]))
        count = min(len(axis.value) for axis in decided)
        block = self._samples(decided, count)
        rest = slice(count, None)
        left = tuple(part(axis, rest) for axis in decided)
        self.state = replace(state, stamps=part(state.stamps, rest), axes=tuple(memories), decided=left)
        if not count:
            return [*events]
        # Without what the accelerometer measures too much.
        value, noise = block.value_m_s2 / self._gain, block.noise_density / self._gain**2
        return [Samples(block.time_ns, value, noise, block.kind), *events]

    def _samples(self, decided: Sequence[Bridged], count: int) -> Samples:
        """The first `count` samples of all axes, with the density that gaps and steps of the clock add."""
        stamps, axes = self.state.stamps, self.settings.axes
        value = np.column_stack([axis.value[:count] for axis in decided])
        extra = np.column_stack([axis.density[:count] for axis in decided])
        step_s, broken = stamps.step_s[:count], stamps.broken[:count]
        gap = step_s > self._gap_s
        for k in np.flatnonzero(gap | broken):
            for number, axis in enumerate(axes):
                unseen = axis.unseen(float(step_s[k])) if gap[k] else 0.0
                unmoved = axis.unmoved(float(step_s[k])) if broken[k] else 0.0
                extra[k, number] = max(extra[k, number], unseen, unmoved)
        extra[:, 0] += span_density(stamps.time_ns[:count], self.settings.doubtful)
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
