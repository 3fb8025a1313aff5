"""The stream that the complementary FIR methods share: rates learnt at the start, gaps, rows in time order."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from midspan.fusion.branches import Branches, Rates, StreamSettings, window_of
from midspan.fusion.even import LEAST_JITTER
from midspan.fusion.events import GateEvents
from midspan.fusion.gate import NO_GATE
from midspan.fusion.kalman import Output
from midspan.fusion.missing import is_even
from midspan.fusion.screen import Screen, unscreened
from midspan.fusion.stretch import Method, Stretch
from midspan.records import NANOSECONDS, Acceleration, Displacement, Event, joined, part

# Rates and noise levels are taken from so many first steps and intervals, or from what came within the patience.
STEPS, INTERVALS = 100, 8
PATIENCE_S = 60.0
# A step of the acceleration outside these shares of the usual one ends a stretch.
SHORTEST_STEP, LONGEST_STEP = 0.5, 1.5
# Longer inputs are taken in blocks, so that memory does not grow with them.
BLOCK = 65536
# Where no noise density or variance is given: 1 mg in 100 Hz, 0.1 mm.
USUAL_DENSITY, USUAL_VARIANCE = 1e-6, 1e-8


class ComplementaryFilter:
    """Push blocks of displacement and acceleration in time order, take estimates `delay_s` later; `finish` at the end.

    Displacement must be pushed before the acceleration that covers its time; what comes later is ignored. Any cutting
    of the input into blocks gives the same rows up to rounding. A gap in the acceleration resets the memory and is told
    by an Event, as is a gap of the displacement; rows without a full window (ends, gaps) come from least squares over
    what there is, with its own wider variance. With `gate`, each displacement is judged first (see `Screen`): the
    verdicts come as Innovation records, and a new level that was taken over begins with empty memory.
    """

    def __init__(self, design: Callable[[Rates], Branches], settings: StreamSettings, *, gate: bool = True) -> None:
        self._design, self._settings = design, settings
        self._screen = Screen(settings.edges) if gate and settings.edges.gate != NO_GATE else None
        self._events = GateEvents()
        self._method: Method | None = None
        self._stretch: Stretch | None = None
        self._waiting: list[Acceleration] = []
        self._measured: list[Displacement] = []
        self._last_ns: int | None = None
        self._first_ns = 0

    @property
    def delay_s(self) -> float:
        """Seconds from a sample to its row away from ends and gaps; NaN until the rates are known."""
        if self._method is None:
            return float("nan")
        return window_of(self._method.branches, self._method.rates).delay * self._method.rates.step_s

    def push(self, record: Acceleration | Displacement) -> list[Output]:
        """Take one block; returns the Estimate blocks that are due, and Events."""
        if isinstance(record, Displacement):
            if len(record.time_ns):
                self._measured.append(record)
            return []
        outputs: list[Output] = []
        for start in range(0, len(record.time_ns), BLOCK):
            self._waiting.append(part(record, slice(start, start + BLOCK)))
            outputs.extend(self._run(final=False))
        return outputs

    def finish(self) -> list[Output]:
        """The rows still due. Nothing may be pushed afterwards."""
        outputs = self._run(final=True)
        if self._stretch is not None:
            outputs.extend(self._stretch.finish())
        return [*outputs, *self._events.finish()]

    def _run(self, *, final: bool) -> list[Output]:
        if not self._waiting:
            return []
        outputs: list[Output] = []
        if self._method is None:
            self._waiting = [joined(self._waiting)]
            rates = self._rates(self._waiting[0], final=final)
            if rates is None:
                return []
            self._first_ns = int(self._waiting[0].time_ns[0])
            self._method = Method.make(self._design(rates), rates, self._settings.edges)
            if self._screen is not None:
                self._screen.begin(part(self._waiting[0], slice(STEPS + 1)), rates.every_s)
            told = self._method.branches.warnings
            outputs.extend(Event(self._first_ns, "rate", text) for text in told)
        block, self._waiting = joined(self._waiting), []
        return [*outputs, *self._cut(block, self._method)]

    def _cut(self, block: Acceleration, method: Method) -> list[Output]:
        """Feed a block to the stretch it continues, and to new ones after each gap in it."""
        outputs: list[Output] = []
        before = block.time_ns[0] if self._last_ns is None else self._last_ns
        steps = np.diff(block.time_ns, prepend=before) / (method.rates.step_s * NANOSECONDS)
        odd = (steps < SHORTEST_STEP) | (steps > LONGEST_STEP)
        if self._last_ns is None:
            odd[0] = False
        starts = np.flatnonzero(odd)
        edges = np.unique(np.concatenate(([0], starts, [len(odd)])))
        for start, stop in pairwise(edges):
            piece = part(block, slice(start, stop))
            if odd[start] and self._stretch is not None:
                outputs.extend(self._stretch.finish())
                outputs.append(_gap_event(self._last_ns or 0, float(steps[start]) * method.rates.step_s))
                self._stretch = None
                if self._screen is not None:
                    self._screen.begin(piece, method.rates.every_s)
            outputs.extend(self._judged(piece, self._due(int(piece.time_ns[-1])), method))
            self._last_ns = int(piece.time_ns[-1])
        return outputs

    def _judged(self, piece: Acceleration, due: Displacement, method: Method) -> list[Output]:
        """Feed a piece without gaps and its judged measurements to the stretch, and to a new one from each jump on."""
        screened = unscreened(due) if self._screen is None else self._screen.judge(piece, due)
        told = screened.innovation
        outputs: list[Output] = [told, *self._events.push(told)] if len(told.time_ns) else []
        jumps_ns = due.time_ns[screened.reacquired]
        # Two levels have no common low-frequency branch: what was before a jump is forgotten.
        rows = [0, *np.searchsorted(piece.time_ns, jumps_ns), len(piece.time_ns)]
        for i, ((start, stop), measured) in enumerate(zip(pairwise(rows), screened.pieces(), strict=True)):
            if i > 0 and self._stretch is not None:
                outputs.extend(self._stretch.finish())
                self._stretch = None
            if self._stretch is None:
                self._stretch = Stretch(method, int(piece.time_ns[min(start, len(piece.time_ns) - 1)]))
            outputs.extend(self._stretch.push(part(piece, slice(start, stop)), measured))
        return outputs

    def _due(self, until_ns: int) -> Displacement:
        """The measurements up to `until_ns` in time order; older ones than the last acceleration are left out."""
        measured = joined(self._measured) if self._measured else _nothing()
        if len(self._measured) > 1:
            measured = part(measured, np.argsort(measured.time_ns, kind="stable"))
        due = int(np.searchsorted(measured.time_ns, until_ns, side="right"))
        self._measured = [part(measured, slice(due, None))] if due < len(measured.time_ns) else []
        late = 0 if self._last_ns is None else int(np.searchsorted(measured.time_ns, self._last_ns, side="right"))
        return part(measured, slice(min(late, due), due))

    def _rates(self, block: Acceleration, *, final: bool) -> Rates | None:
        """Rates and noise levels from the start; None while there is too little of it."""
        measured = joined(self._measured) if self._measured else _nothing()
        measured = part(measured, np.isfinite(measured.value_m) & np.isfinite(measured.variance_m2))
        measured = part(measured, np.argsort(measured.time_ns, kind="stable"))
        patient_ns = int(block.time_ns[0]) + round(PATIENCE_S * NANOSECONDS)
        known_ns = min(int(block.time_ns[-1]), patient_ns)
        measured = part(measured, slice(min(INTERVALS + 1, int(np.sum(measured.time_ns <= known_ns)))))
        enough = len(block.time_ns) > STEPS and len(measured.time_ns) > INTERVALS
        if not (enough or final or block.time_ns[-1] >= patient_ns):
            return None
        first = part(block, slice(STEPS + 1))
        step_s = _usual_step(first.time_ns, self._settings.rate_hz, 0.01)
        step_s, jitter_s = _even_step(first.time_ns, step_s, given=self._settings.rate_hz is not None)
        frame_s = _usual_step(measured.time_ns, self._settings.displacement_rate_hz, 1.0)
        return Rates(
            step_s=step_s,
            frame_s=frame_s,
            noise_density=_usual(first.noise_density, USUAL_DENSITY),
            variance_m2=_usual(measured.variance_m2, USUAL_VARIANCE),
            jittered=jitter_s > LEAST_JITTER * step_s,
            even_frames=is_even(measured.time_ns, frame_s),
            longest_steps=self._settings.longest_steps,
        )


def run(stream: ComplementaryFilter, acceleration: Acceleration, displacement: Displacement) -> list[Output]:
    """Everything that a stream gives for a whole record."""
    stream.push(displacement)
    return [*stream.push(acceleration), *stream.finish()]


def _nothing() -> Displacement:
    empty = np.empty(0)
    return Displacement(empty.astype(np.int64), empty, empty, empty.astype(np.uint8))


def _usual_step(
    time_ns: "np.ndarray[tuple[int], np.dtype[np.int64]]", rate_hz: float | None, otherwise: float
) -> float:
    """The usual step in s: from the nominal rate, else the mean of the steps that are no gaps."""
    if rate_hz is not None:
        return 1.0 / rate_hz
    steps = np.diff(time_ns) / NANOSECONDS
    if not len(steps):
        return otherwise
    median = float(np.median(steps))
    near = steps[(steps > SHORTEST_STEP * median) & (steps < LONGEST_STEP * median)]
    return float(np.mean(near)) if len(near) else max(median, 1e-9)


def _even_step(
    time_ns: "np.ndarray[tuple[int], np.dtype[np.int64]]", step_s: float, *, given: bool
) -> tuple[float, float]:
    """The step in s by a straight line through the stamps, gaps counted as whole steps, and the rms jitter about it."""
    time_s = (time_ns - time_ns[0]) / NANOSECONDS
    if len(time_s) < 3:
        return step_s, 0.0
    number = np.cumsum(np.concatenate(([0.0], np.maximum(np.rint(np.diff(time_s) / step_s), 1.0))))
    slope, start = np.polyfit(number, time_s, 1)
    jitter_s = float(np.std(time_s - slope * number - start))
    return (step_s if given else float(slope)), jitter_s


def _usual(values: "np.ndarray[tuple[int], np.dtype[np.float64]]", otherwise: float) -> float:
    """The median of what is finite and above zero."""
    known = values[np.isfinite(values) & (values > 0.0)]
    return float(np.median(known)) if len(known) else otherwise


def _gap_event(time_ns: int, length_s: float) -> Event:
    text = f"No acceleration for {length_s:.3g} s: the filters' memory was reset and fills again."
    return Event(time_ns, "gap", text)
