"""The radar's stage: range profiles in, one unwrapped phase a target and frame out.

A target is met where it is predicted to be, and its wrapped phase takes the cycle nearest to the predicted phase. The
estimator predicts; where it does not, or worse than the phase itself, a filter of two numbers (phase and speed) does.
Where neither can name the cycle the zero of the phase is a new one: its variance rises, until the range of the beat
frequency tells by how many cycles the phase is off.

What is uncertain of a phase is told in two parts. New in every frame are the receiver's noise, the oscillator's as it
was calibrated, and the bend that something else in the bin makes. Common to frames that follow each other are that bend
beside its value in the first frame, and cycles that may have been lost.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.checks import refuse
from midspan.radar.blockage import BlockageSettings
from midspan.radar.following import LEAST_EXCURSION_BINS, bins_within
from midspan.radar.range_gap import MEMORY_FRAMES, MIN_FRAMES, FirstFrames, RangeGap, cycles_lost
from midspan.radar.target import Target
from midspan.radar.unwrap import BLIND_RAD, TURN, UNSURE_CYCLES
from midspan.records import NANOSECONDS, Event, Floats, PhaseMeasurement, RangeFrame, Status

# Expected phase of a target in rad, counted as its measurements are, and its variance in rad².
PhasePrediction = tuple[float, float]

UNSURE_RAD2 = (UNSURE_CYCLES * TURN) ** 2
# The variance of a zero that was lost, over that of the prediction: the estimator then keeps its own place, whose
# variance falls by half a percent only.
NEW_ZERO_RATIO = 100.0
# Gains of the target's own prediction: of the phase, and of the speed of a critically damped filter.
PHASE_GAIN = 0.8
SPEED_GAIN = 2.0 * (2.0 - PHASE_GAIN) - 4.0 * math.sqrt(1.0 - PHASE_GAIN)
# Memory of the mean squares of innovations, frames; what the first of them is expected to be (0.05 cycles), rad².
MEMORY, FIRST_RAD2 = 50.0, 0.1
# The first frames tell the speed, and are not judged.
FIRST_COUNT = -2.0
# Frames after which the estimator is judged: it is not followed while its innovations are larger than those of the
# target's own prediction, which are larger by the noise of two phases where the accelerometer tells anything.
MIN_JUDGED = 15.0
# The covariance of neighbouring bins of a Hann window, over the variance of one.
NEIGHBOURS = 2.0 / 3.0
# Shorter times without a target are no events, s.
MIN_TOLD_S = 0.1


@dataclass(frozen=True, slots=True)
class FollowedTarget:
    """A calibrated target and where it is met.

    phase_per_m: rad per m of range; bins (k,): whole bins in which it moves, or the one place (1,) where it stays;
    bin_m: from bin to bin, m (NaN: it stays); period_s: from frame to frame.
    """

    target: Target
    phase_per_m: float
    bins: Floats
    bin_m: float
    period_s: float

    @classmethod
    def of(cls, target: Target, phase_per_m: float, bin_m: float, *, period_s: float, bins: int) -> "FollowedTarget":
        """In the bins that a radar of so many `bins`, `bin_m` apart (NaN: single targets are stored), has around it."""
        some = bins_within(target.place_bin, target.reach_bins, bins) if bin_m > 0 else np.array([target.place_bin])
        return cls(target, phase_per_m, some, bin_m, period_s)


@dataclass(frozen=True, slots=True)
class _View:
    """What is computed once for a target.

    columns of the frames; row (channels,): weights of the receivers; still (k,): what stands still; amplitude of the
    target at its peak; cycles_per_bin: of the phase, 0 where it is not followed; bent_rad: standard deviation of the
    phase by what else is in the bin; name: in events.
    """

    columns: slice
    row: NDArray[np.complex128]
    still: NDArray[np.complex128]
    amplitude: float
    noise: float
    cycles_per_bin: float
    bent_rad: float
    name: str


@dataclass(frozen=True, slots=True)
class TargetState:
    """What a chain remembers of one target.

    first_rad: wrapped phase that counts as zero, NaN before the first used frame; first: the frames before it, by which
    the speed is found, None afterwards; phase_rad, speed_rad_s: the target's
    own prediction at last_ns, the last used frame; own_rad2, given_rad2: mean squares of its innovations and of the
    given predictions'; own_count, given_count: over so many; clear: frames in a row that show the target; unseen_ns:
    the first frame since it was seen last, -1 while it is seen; told: whether an event was given for that; gap: range
    less phase; before: the same before the cycle was lost, while it is in doubt; doubt_rad2: variance of the zero while
    it is in doubt, lost_rad2: for good.
    """

    first_rad: float = math.nan
    first: FirstFrames | None = FirstFrames()
    phase_rad: float = 0.0
    speed_rad_s: float = 0.0
    last_ns: int = 0
    own_rad2: float = FIRST_RAD2
    own_count: float = FIRST_COUNT
    given_rad2: float = 0.0
    given_count: float = FIRST_COUNT
    clear: int = BlockageSettings().frames  # calibrated means seen
    unseen_ns: int = -1
    told: bool = False
    gap: RangeGap = RangeGap(math.nan)
    before: RangeGap | None = None
    doubt_rad2: float = 0.0
    lost_rad2: float = 0.0


@dataclass(frozen=True, slots=True)
class _Seen:
    """A target in one frame: wrapped phase, its variance, amplitude over the calibrated one, fractional bin."""

    phase_rad: float
    variance_rad2: float
    strength: float
    place_bin: float


class RadarChain:
    """The radar's targets, one frame at a time; `bins` (k,) are those that the frames must hold, in this order.

    targets: each becomes a channel of its own. blockage: amplitudes at which a target counts as seen.
    """

    def __init__(self, targets: Sequence[FollowedTarget], blockage: BlockageSettings | None = None) -> None:
        self._blockage = blockage or BlockageSettings()
        self._targets = tuple(targets)
        self.bins: Floats = np.unique(np.concatenate([item.bins for item in targets]))
        self._views = tuple(_view(item, self.bins, len(targets)) for item in targets)
        self._states = tuple(TargetState(clear=self._blockage.frames) for _ in targets)

    def push(
        self, frame: RangeFrame, predictions: Sequence[PhasePrediction | None] | None = None
    ) -> tuple[PhaseMeasurement, ...]:
        """The phase of each target in a frame of phasors (channels, k) at `bins`.

        predictions: expected phase in rad and its variance in rad² of each target's channel at the frame's instant;
        None, or an infinite variance, where there is none.
        """
        if frame.phasors.shape[1] != len(self.bins):
            raise refuse("phasors", f"(channels, {len(self.bins)} bins)", frame.phasors.shape)
        found = []
        for k, item in enumerate(self._targets):
            given = None if predictions is None else predictions[k]
            # Rounding may leave a variance below 0 where the channel's zero is hardly known.
            given = None if given is None or not given[1] < math.inf else (given[0], max(given[1], 0.0))
            found.append(_met((item, self._views[k], self._blockage), self._states[k], frame, given))
        self._states = tuple(state for _, state in found)
        return tuple(measurement for measurement, _ in found)

    @property
    def state(self) -> tuple[TargetState, ...]:
        """What the chain remembers, to be restored later."""
        return self._states

    def restore(self, state: tuple[TargetState, ...]) -> None:
        """Go on from a state."""
        self._states = state


_Known = tuple[FollowedTarget, _View, BlockageSettings]


def _view(item: FollowedTarget, bins: Floats, targets: int) -> _View:
    target, first = item.target, int(np.searchsorted(bins, item.bins[0]))
    followed = len(item.bins) > 1
    still = np.full(len(item.bins), target.leak, dtype=np.complex128)
    amplitude = target.amplitude
    if target.background is not None:
        still = target.background.at(item.bins)
    elif followed:
        # It was calibrated between two bins, where less of it is seen than at its peak.
        amplitude /= _between(target.place_bin - math.floor(target.place_bin))
    return _View(
        columns=slice(first, first + len(item.bins)),
        row=target.weights.conj() / math.sqrt(len(target.weights)),
        still=still,
        amplitude=amplitude,
        noise=target.noise_variance,
        cycles_per_bin=item.bin_m * item.phase_per_m / TURN if followed else 0.0,
        bent_rad=bent_rad(target),
        name="radar: the target" if targets == 1 else f"radar: the target at {target.range_m:.2f} m",
    )


def bent_rad(target: Target) -> float:
    """Standard deviation of a target's phase by what else is in its bin, as it was calibrated, rad."""
    share = 0.0 if math.isnan(target.clutter) or target.leak else target.clutter / math.sqrt(2.0)
    return max(share, 0.0 if math.isnan(target.modulation_rad) else target.modulation_rad)


def _response(distance_bins: float) -> float:
    """`following.response` at one distance."""
    d = abs(distance_bins)
    if d < 1e-9 or abs(d - 1.0) < 1e-9:
        return 1.0 if d < 0.5 else 0.5
    return math.sin(math.pi * d) / (math.pi * d * (1.0 - d * d))


def _between(share: float) -> float:
    """Response of two neighbouring bins, weighed linearly, to a target that lies a share of a bin from the lower."""
    return (1.0 - share) * _response(share) + share * _response(1.0 - share)


def _met(
    known: _Known, state: TargetState, frame: RangeFrame, given: PhasePrediction | None
) -> tuple[PhaseMeasurement, TargetState]:
    """The measurement of one target in a frame, and the state after it."""
    item, view, blockage = known
    own = _own_prediction(item, state, frame.time_ns)
    base = own if given is None else _better(state, own, given)
    seen = _seen(item, view, frame, _place(item, view, state, base))
    if seen is None:
        return _unseen(known, state, frame, (base, 0.0, "lost frames"))
    good = blockage.low <= seen.strength <= blockage.high
    state = replace(state, clear=min(state.clear + 1, blockage.frames) if good else 0)
    if state.clear < blockage.frames or not seen.variance_rad2 < BLIND_RAD**2:
        return _unseen(known, state, frame, (base, seen.strength, "blocked"))
    if state.first is not None:
        return _begun(known, state, (frame.time_ns, seen), own)
    return _used(known, state, (frame.time_ns, seen), (base, own, given))


def _own_prediction(item: FollowedTarget, state: TargetState, time_ns: int) -> PhasePrediction:
    """Phase and variance by what was measured up to the last used frame."""
    if math.isnan(state.first_rad):
        return 0.0, math.inf
    late_s = (time_ns - state.last_ns) / NANOSECONDS
    frames = max(round(late_s / item.period_s), 1)
    # Innovations are second differences: over n frames n (n + 1) / 2 of them add up.
    return state.phase_rad + late_s * state.speed_rad_s, state.own_rad2 * (0.5 * frames * (frames + 1.0)) ** 2


def _better(state: TargetState, own: PhasePrediction, given: PhasePrediction) -> PhasePrediction:
    """The given prediction while it can name the cycle and is not refuted by the target's own; else the surer one."""
    if state.first is not None:
        return own
    refuted = state.given_count >= MIN_JUDGED and state.given_rad2 > state.own_rad2
    if own[1] < UNSURE_RAD2 and (refuted or not given[1] < UNSURE_RAD2):
        return own
    return given


def _place(item: FollowedTarget, view: _View, state: TargetState, base: PhasePrediction) -> tuple[float, float]:
    """Fractional bin at which the target is expected, and how far from it it may be, bins."""
    if not view.cycles_per_bin:
        return item.target.place_bin, 0.0
    if state.first is not None:
        return item.target.place_bin, item.target.reach_bins
    mean = state.gap.mean if state.gap.count else state.before.mean  # type: ignore[union-attr]
    return (mean + base[0] / TURN) / view.cycles_per_bin, 2.0 * math.sqrt(base[1]) / TURN / view.cycles_per_bin


def _seen(item: FollowedTarget, view: _View, frame: RangeFrame, place: tuple[float, float]) -> _Seen | None:
    """The target at an expected place, receivers combined; None where nothing was received."""
    valid = frame.valid
    row, share = view.row, 1.0
    phasors = frame.phasors[:, view.columns]
    if not valid.all():
        share = float(np.sum(np.abs(item.target.weights[valid]) ** 2))
        if not share > 0.0:
            return None
        row, phasors = view.row[valid] / share, phasors[valid]
    z = (row @ phasors - view.still).tolist()
    noise, low, part = view.noise / share, 0, 0.0
    value, gain, at = z[0], 1.0, place[0]
    if len(z) > 1:
        at = _looked_at(z, float(item.bins[0]), place)
        low = min(max(math.floor(at - item.bins[0]), 0), len(z) - 2)
        part = min(max(at - item.bins[0] - low, 0.0), 1.0)
        value, gain = (1.0 - part) * z[low] + part * z[low + 1], _between(part)
        noise *= 1.0 - 2.0 * (1.0 - NEIGHBOURS) * part * (1.0 - part)
        at = float(item.bins[0]) + low + _fraction(z[low], z[low + 1], value)
    size = abs(value)
    if not 0.0 < size < math.inf:
        return _Seen(0.0, math.inf, 0.0, at)
    return _Seen(cmath.phase(value), noise / (2.0 * size * size), size / gain / view.amplitude, at)


def _looked_at(z: list[complex], first_bin: float, place: tuple[float, float]) -> float:
    """Where the target is met: where it is expected, or at the strongest bin where that is not sure."""
    expected, reach = place
    if not reach > LEAST_EXCURSION_BINS:
        return expected
    near = [k for k in range(len(z)) if abs(first_bin + k - expected) <= reach + 0.5] or range(len(z))
    k = max(near, key=lambda bin_: abs(z[bin_]))
    low = k if k + 1 < len(z) and (k == 0 or abs(z[k + 1]) > abs(z[k - 1])) else k - 1
    return first_bin + low + _fraction(z[low], z[low + 1], z[k])


def _fraction(low: complex, high: complex, value: complex) -> float:
    """Where between two bins of a Hann window a target of phasor `value` lies: its responses are as 2 − d to 1 + d."""
    a, b = (low * value.conjugate()).real, (high * value.conjugate()).real
    return min(max((2.0 * b - a) / (a + b), -0.5), 1.5) if a + b > 0.0 else 0.5


def _unseen(
    known: _Known, state: TargetState, frame: RangeFrame, why: tuple[PhasePrediction, float, str]
) -> tuple[PhaseMeasurement, TargetState]:
    """A frame in which a target is not used; why: the prediction, the strength, and the kind of event."""
    base, strength, kind = why
    since = frame.time_ns if state.unseen_ns < 0 else state.unseen_ns
    tell = not state.told and frame.time_ns - since >= MIN_TOLD_S * NANOSECONDS
    text = "no whole frame arrives" if kind == "lost frames" else "is not seen"
    events = (Event(since, kind, f"{known[1].name}: {text} from here on."),) if tell else ()
    measurement = PhaseMeasurement(
        frame.time_ns,
        math.nan,
        math.inf,
        state.lost_rad2 + state.doubt_rad2,
        Status.COASTING if base[1] < UNSURE_RAD2 else Status.LOST,
        strength,
        events,
    )
    return measurement, replace(state, unseen_ns=since, told=state.told or tell)


def _used(
    known: _Known,
    state: TargetState,
    met: tuple[int, _Seen],
    predicted: tuple[PhasePrediction, PhasePrediction, PhasePrediction | None],
) -> tuple[PhaseMeasurement, TargetState]:
    """A frame that shows a target; predicted: as it is unwrapped, the target's own, and the given one."""
    (item, view, _), (time_ns, seen), (base, own, given) = known, met, predicted
    events = [Event(time_ns, "seen", f"{view.name}: seen again.")] if state.told else []
    phase = base[0] + math.remainder(seen.phase_rad - state.first_rad - base[0], TURN)
    if not base[1] < UNSURE_RAD2:
        events.append(Event(time_ns, "new datum", f"{view.name}: its cycle was lost; its zero is a new one."))
        state = _doubted(state, base[1])
    state = _followed(item, state, (time_ns, phase), own)
    if base is not given:
        state = replace(state, lost_rad2=state.lost_rad2 + _slips(state.own_rad2))
    if given is not None and given[1] < UNSURE_RAD2:
        away = math.remainder(seen.phase_rad - state.first_rad - given[0], TURN)
        given_rad2, given_count = _averaged(state.given_rad2, state.given_count, away)
        state = replace(state, given_rad2=given_rad2, given_count=given_count)
    if view.cycles_per_bin:
        gap = state.gap.met(seen.place_bin * view.cycles_per_bin - phase / TURN, phase)
        state, cycles = _verified(replace(state, gap=gap))
        if cycles is not None:
            phase += TURN * cycles
            text = "was right" if cycles == 0 else f"is corrected by {cycles:+d}"
            events.append(Event(time_ns, "cycle", f"{view.name}: by its range the cycle after the outage {text}."))
    return _measured(known, state, (time_ns, seen, phase), tuple(events)), replace(state, unseen_ns=-1, told=False)


def _measured(
    known: _Known, state: TargetState, met: tuple[int, _Seen, float], events: tuple[Event, ...]
) -> PhaseMeasurement:
    """A phase with what is uncertain of it."""
    (item, view, _), (time_ns, seen, phase) = known, met
    white = seen.variance_rad2 + item.target.phase_noise_rad2 + view.bent_rad**2
    common = state.lost_rad2 + state.doubt_rad2
    return PhaseMeasurement(time_ns, phase, white, common, Status.TRACKING, seen.strength, events)


def _begun(
    known: _Known, state: TargetState, met: tuple[int, _Seen], own: PhasePrediction
) -> tuple[PhaseMeasurement, TargetState]:
    """One of the first frames of a target: none is used before range and phase tell its speed alike."""
    (item, view, _), (time_ns, seen) = known, met
    first = state.first
    if first is None or first.count == 0 or time_ns - state.last_ns > 1.5 * item.period_s * NANOSECONDS:
        first, phase = FirstFrames(), 0.0
        state = replace(state, first_rad=seen.phase_rad, phase_rad=0.0, speed_rad_s=0.0, last_ns=time_ns)
    else:
        phase = own[0] + math.remainder(seen.phase_rad - state.first_rad - own[0], TURN)
        state = _followed(item, state, (time_ns, phase), own)
    cycles: int | None = 0
    if view.cycles_per_bin:
        gap = seen.place_bin * view.cycles_per_bin
        first = first.met(gap - phase / TURN)
        cycles = first.cycles_per_frame
        state = replace(state, gap=RangeGap(math.nan).met(gap, 0.0))
    if cycles is None:
        waiting = PhaseMeasurement(time_ns, math.nan, math.inf, 0.0, Status.LOST, seen.strength)
        return waiting, replace(state, first=first)
    state = replace(
        state,
        first=None,
        first_rad=seen.phase_rad,
        phase_rad=state.phase_rad - phase,
        speed_rad_s=state.speed_rad_s + TURN * cycles / item.period_s,
        unseen_ns=-1,
        told=False,
    )
    return _measured(known, state, (time_ns, seen, 0.0), ()), state


def _doubted(state: TargetState, variance_rad2: float) -> TargetState:
    """The zero of the phase is a new one; where the range was known before, it may tell the cycle later."""
    rise = NEW_ZERO_RATIO * variance_rad2
    if state.before is None and state.gap.count < MIN_FRAMES:
        return replace(state, lost_rad2=state.lost_rad2 + rise)
    before = state.gap if state.before is None else state.before
    return replace(state, before=before, gap=RangeGap(math.nan), doubt_rad2=state.doubt_rad2 + rise)


def _verified(state: TargetState) -> tuple[TargetState, int | None]:
    """Whether the range tells the cycle by now: the state, and the cycles by which the phase must be raised."""
    if state.before is None:
        return state, None
    cycles = cycles_lost(state.before, state.gap)
    if cycles is None:
        if state.gap.count < MEMORY_FRAMES:
            return state, None
        return replace(state, before=None, doubt_rad2=0.0, lost_rad2=state.lost_rad2 + state.doubt_rad2), None
    phase = state.phase_rad + TURN * cycles
    return replace(state, phase_rad=phase, gap=state.gap.shifted(cycles), before=None, doubt_rad2=0.0), cycles


def _followed(
    item: FollowedTarget, state: TargetState, met: tuple[int, float], own: PhasePrediction
) -> TargetState:
    """The target's own prediction corrected by a phase, which may lie whole cycles from its own way of counting."""
    time_ns, phase = met
    late_s = (time_ns - state.last_ns) / NANOSECONDS
    rest = math.remainder(phase - own[0], TURN)
    state = replace(
        state,
        phase_rad=phase - (1.0 - PHASE_GAIN) * rest,
        speed_rad_s=state.speed_rad_s + SPEED_GAIN * rest / late_s,
        last_ns=time_ns,
    )
    if late_s > 1.5 * item.period_s:
        return state
    own_rad2, own_count = _averaged(state.own_rad2, state.own_count, rest)
    return replace(state, own_rad2=own_rad2, own_count=own_count)


def _slips(own_rad2: float) -> float:
    """Variance (rad²) that a frame adds by the cycle that may be lost: the chance of an innovation of half of one."""
    return TURN**2 * math.erfc(math.pi / math.sqrt(2.0 * own_rad2)) if own_rad2 > 0.0 else 0.0


def _averaged(mean: float, count: float, value: float) -> tuple[float, float]:
    """A running mean square with one value more."""
    count = min(count + 1.0, MEMORY)
    return (mean + (value * value - mean) / count if count > 0.0 else mean), count
