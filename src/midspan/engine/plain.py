"""A sensor of displacement, value by value: finite, and not stuck while the structure moves."""

from dataclasses import dataclass, replace

import numpy as np

from midspan.checks import positive, refuse
from midspan.records import NANOSECONDS, Event, Floats, Measured, Nanoseconds, Readings, Samples, seconds
from midspan.signals.health import GAP_STEPS, Mask
from midspan.signals.stuck import MIN_EQUAL, RESOLUTIONS, at_limits, moved, piece_length

# A run of equal values is judged again when it is longer by this share: the work per value stays the same.
LOOK_SHARE = 0.25


@dataclass(frozen=True, slots=True)
class PlainSettings:
    """How a sensor is read, from its calibration.

    name: for messages; channel: its number in the estimator's table; axis: of the acceleration along it; variance_m2:
    of a value; scale: on its values; step_s: its usual interval; resolution_m: what its values, scaled, are rounded to;
    low_m, high_m: the ends of its range, scaled: values there are left out.
    """

    name: str
    channel: int
    variance_m2: float
    step_s: float
    resolution_m: float = 0.0
    scale: float = 1.0
    axis: int = 0
    low_m: float = -np.inf
    high_m: float = np.inf


@dataclass(frozen=True, slots=True)
class EqualRun:
    """The run of equal values that the newest one ends, m.

    time_ns (k,): of its newest values, as many as are judged together; count: of all; next_look: the count at which it
    is judged next; since_ns: its first stamp; stuck: whether it is left out; left_out: how many values were.
    """

    value: float
    time_ns: Nanoseconds
    count: int
    next_look: int
    since_ns: int
    stuck: bool = False
    left_out: int = 0


@dataclass(frozen=True, slots=True)
class PlainState:
    """All that a `PlainChain` knows.

    finite_ns: stamp of the newest finite value; run: of equal values; time_ns, acceleration, density (m,): of the
    samples that may still be needed; waiting_ns, waiting_m (w,): values that wait for the samples that cover them;
    clipped: whether the newest judged value is at an end of the range.
    """

    finite_ns: int | None
    run: EqualRun
    time_ns: Nanoseconds
    acceleration: Floats
    density: Floats
    waiting_ns: Nanoseconds
    waiting_m: Floats
    clipped: bool = False


class PlainChain:
    """Takes the values of a displacement sensor, and the samples of acceleration before them; gives measurements.

    Stamps rise, as `Merge` gives them out. Values that are not finite are left out. A value that stays exactly the
    same is left out from where the acceleration shows that the structure moved, until it changes.
    """

    def __init__(self, settings: PlainSettings) -> None:
        positive("step_s", settings.step_s, "s")
        positive("variance_m2", settings.variance_m2, "m²")
        self.settings, self._piece = settings, piece_length(settings.step_s)
        nothing = np.empty(0, dtype=np.int64)
        run = EqualRun(np.nan, nothing, 0, MIN_EQUAL, 0)
        self.state = PlainState(None, run, nothing, np.empty(0), np.empty(0), nothing, np.empty(0))

    def push(self, record: Samples | Readings | Event) -> list[Measured | Event]:
        """Take samples, or readings of time_ns (n,) and value (n, 1) in metres; returns measurements and events.

        A value is given out with the samples that reach its time, and judged by those up to it.
        """
        if isinstance(record, Event):
            return [record]
        if isinstance(record, Samples):
            return self._reached(record)
        if record.value.shape != (len(record.time_ns), 1):
            raise refuse("value", f"of shape ({len(record.time_ns)}, 1)", record.value.shape)
        kept, state = np.isfinite(record.value[:, 0]), self.state
        time_ns, value = record.time_ns[kept], self.settings.scale * record.value[kept, 0]
        if not len(time_ns):
            return []
        before_ns = np.concatenate(([time_ns[0] if state.finite_ns is None else state.finite_ns], time_ns[:-1]))
        step_s = (time_ns - before_ns) / NANOSECONDS
        self.state = replace(
            state,
            finite_ns=int(time_ns[-1]),
            waiting_ns=np.concatenate((state.waiting_ns, time_ns)),
            waiting_m=np.concatenate((state.waiting_m, value)),
        )
        return [
            Event(int(before_ns[k]), "gap", f"{self.settings.name}: no values for {step_s[k]:.3g} s.")
            for k in np.flatnonzero(step_s > GAP_STEPS * self.settings.step_s)
        ]

    def _reached(self, samples: Samples) -> list[Measured | Event]:
        """Take samples, and judge the values that they reach; what no later value may need is forgotten."""
        state, axis = self.state, self.settings.axis
        if not len(samples.time_ns):
            return []
        time_ns = np.concatenate((state.time_ns, samples.time_ns))
        acceleration = np.concatenate((state.acceleration, samples.value_m_s2[:, axis]))
        density = np.concatenate((state.density, samples.noise_density[:, axis]))
        self.state = replace(state, time_ns=time_ns, acceleration=acceleration, density=density)
        due = int(np.searchsorted(state.waiting_ns, time_ns[-1], side="right"))
        found = self._judged(state.waiting_ns[:due], state.waiting_m[:due])
        reach_ns = round(2.0 * self._piece * self.settings.step_s * NANOSECONDS)
        first = int(np.searchsorted(time_ns, int(time_ns[-1]) - reach_ns))
        self.state = replace(
            self.state,
            time_ns=time_ns[first:].copy(),
            acceleration=acceleration[first:].copy(),
            density=density[first:].copy(),
            waiting_ns=state.waiting_ns[due:],
            waiting_m=state.waiting_m[due:],
        )
        return found

    def _judged(self, time_ns: Nanoseconds, value: Floats) -> list[Measured | Event]:
        """Values (n,) in metres as measurements, without those that are stuck, and events."""
        if not len(value):
            return []
        known, state = self.settings, self.state
        held = at_limits(value, known.low_m, known.high_m)
        begins = np.flatnonzero(held & ~np.concatenate(([state.clipped], held[:-1])))
        self.state = replace(state, clipped=bool(held[-1]))
        text = f"{known.name}: clipped at {{:.6g}} mm, the end of its range; these values are left out."
        ends = [Event(int(time_ns[k]), "clipped", text.format(1e3 * value[k])) for k in begins]
        time_ns, value = time_ns[~held], value[~held]
        used, found = self._moving(time_ns, value) if len(value) else (held[:0], [])
        count = int(np.count_nonzero(used))
        block = Measured(
            time_ns=time_ns[used],
            channel=np.full(count, self.settings.channel, dtype=np.int64),
            value=value[used],
            variance=np.full(count, self.settings.variance_m2),
            reference_variance=np.zeros(count),
        )
        return [*([block] if count else []), *ends, *found]

    def _moving(self, time_ns: Nanoseconds, value: Floats) -> tuple[Mask, list[Event]]:
        """Which finite values (n,) are used, and events where the sensor gets stuck and where it is free again."""
        run, events = self.state.run, list[Event]()
        used = np.ones(len(value), dtype=bool)
        fresh = np.concatenate(([run.value], value))[: len(value)] != value
        edges = np.concatenate(([0], np.flatnonzero(fresh[1:]) + 1, [len(value)]))
        # Short runs in between have no effect.
        lasting = np.diff(edges) >= MIN_EQUAL
        lasting[[0, -1]] = True
        for k in np.flatnonzero(lasting):
            start, stop = int(edges[k]), int(edges[k + 1])
            if fresh[start]:
                if run.stuck:
                    text = f"{run.count} values were frozen at {1e3 * run.value:.6g} mm while the structure moved"
                    text = f"{self.settings.name}: {text}; {run.left_out} were left out."
                    events.append(Event(int(run.time_ns[-1]), "released", text))
                run = EqualRun(float(value[start]), time_ns[:0], 0, MIN_EQUAL, int(time_ns[start]))
            run, found = self._prolonged(run, time_ns[start:stop])
            events += found
            used[stop - min(run.left_out, stop - start) : stop] = False
        self.state = replace(self.state, run=run)
        return used, events

    def _prolonged(self, run: EqualRun, time_ns: Nanoseconds) -> tuple[EqualRun, list[Event]]:
        """The run with more equal values, at the stamps (n,), and an event where it turns out to be stuck."""
        known = np.concatenate((run.time_ns, time_ns))
        count, next_look, is_stuck, left_out = run.count, run.next_look, run.stuck, run.left_out
        for k in range(len(run.time_ns) + 1, len(known) + 1):
            count += 1
            if not is_stuck and count >= next_look:
                is_stuck = self._moved(known[max(k - self._piece, 0) : k])
                next_look = count + max(1, int(LOOK_SHARE * min(count, self._piece)))
            left_out += is_stuck
        newly = is_stuck and not run.stuck
        run = EqualRun(run.value, known[-self._piece :].copy(), count, next_look, run.since_ns, is_stuck, left_out)
        if not newly:
            return run, []
        begun_ns = int(time_ns[-left_out])
        text = (
            f"the value has been frozen at {1e3 * run.value:.6g} mm for {(begun_ns - run.since_ns) / NANOSECONDS:.3g} s"
        )
        text = f"{text} while the structure moved; it is left out until it changes."
        return run, [Event(begun_ns, "frozen", f"{self.settings.name}: {text}")]

    def _moved(self, time_ns: Nanoseconds) -> bool:
        """Whether the acceleration shows a motion at the stamps (k,) that it has reached."""
        state = self.state
        if not len(state.time_ns):
            return False
        met = time_ns[: int(np.searchsorted(time_ns, state.time_ns[-1], side="right"))]
        if len(met) < MIN_EQUAL:
            return False
        # Up to the sample that reaches the last of them: stamps seldom coincide.
        origin_ns, end = int(met[0]), int(np.searchsorted(state.time_ns, met[-1])) + 1
        samples = np.column_stack(
            (seconds(state.time_ns[:end], origin_ns), state.acceleration[:end], state.density[:end])
        )
        return moved(seconds(met, origin_ns), samples, RESOLUTIONS * self.settings.resolution_m)
