"""The radar's stage: range profiles in, one unwrapped phase a target and frame out.

A target is met where it is predicted to be, and its wrapped phase takes the cycle nearest to the predicted phase. The
estimator predicts; where it does not, or worse than the phase itself, a filter of two numbers (phase and speed) does.
Where neither can name the cycle the zero of the phase is a new one: its variance rises, until the range of the beat
frequency tells by how many cycles the phase is off.

What is uncertain of a phase is reported in two parts. White, new in every frame: the receiver's noise, by the
amplitude; the oscillator's as it was calibrated; and the bend that something else in the bin makes, which is not white
but comes back with the range: its mean over many turns is none, and over a small one it is a part of the conversion
factor's error. Common, the variance of the reference: cycles that may have been lost since the first frame.
"""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.checks import refuse
from midspan.engine.radar_target import FollowedState, FollowedTarget
from midspan.radar.blockage import CLEAR_FRAMES, MAX_SHARE, MIN_SHARE, mean_power, power_gain
from midspan.radar.channels import Phasors
from midspan.radar.following import between, fraction_between, looked_at, noise_between
from midspan.radar.range_gap import MAX_FIRST_FRAMES, MEMORY_FRAMES, MIN_FRAMES, FirstFrames, RangeGap, cycles_lost
from midspan.radar.unwrap import BLIND_RAD, TURN, UNSURE_CYCLES
from midspan.records import NANOSECONDS, Event, Floats, PhaseMeasurement, RangeFrame, Status

# Expected phase of a target in rad, counted as its measurements are, and its variance in rad².
PhasePrediction = tuple[float, float]

UNSURE_RAD2 = (UNSURE_CYCLES * TURN) ** 2
# The variance of a zero that was lost, over that of the prediction: the estimator then keeps its own place, whose
# variance falls by half a percent only.
# No structure moves by more than this many cycles (2 m) in an outage; more would hurt the estimator's arithmetic.
NEW_ZERO_RATIO, MAX_LOST_CYCLES = 100.0, 1000.0
# Gains of the target's own prediction: of the phase, and of the speed of a critically damped filter.
PHASE_GAIN = 0.8
SPEED_GAIN = 2.0 * (2.0 - PHASE_GAIN) - 4.0 * math.sqrt(1.0 - PHASE_GAIN)
# Memory of the mean squares of innovations, frames.
MEMORY = 50.0
# The estimator is not followed while its innovations, over this many frames at least, are larger than those of the
# target's own prediction and than half of what names a cycle: the accelerometer is wrong.
REFUTED_RAD2 = (0.5 * UNSURE_CYCLES * TURN) ** 2
MIN_JUDGED = 15.0
# The amplitude's modulation is the mean over these frames; noise alone makes it this many times as large as its own
# mean once in 30 000 frames (chi squared of 19). Something else with two thirds of a target's amplitude bends its phase
# by this variance, rad²; with as much it would lead it away.
MODULATED_FRAMES, NOISY, MAX_BENT_RAD2 = 10.0, 2.7, 0.2
# A frame whose amplitude is this many times as far (square) from the mean as noise and the last frames make it holds
# something else: noise alone is once in 500 million frames.
SUDDEN = 36.0
# Shorter times without a target are no events, s.
MIN_REPORTED_S = 0.1
# A target's swing has more power at its frequency than the process by which it is modelled: it is taken for this many
# times as large, with its corner at this share of the frequency. Two deviations then hold a swing at one frequency.
OWN_RATIO, OWN_CORNER = 2.0, 0.25


@dataclass(frozen=True, slots=True)
class _Seen:
    """A target in one frame: wrapped phase, its variance, amplitude over the calibrated one, fractional bin."""

    phase_rad: float
    variance_rad2: float
    strength: float
    place_bin: float


class RadarChain:
    """The radar's targets, one frame at a time; `bins` (k,) are those that the frames must hold, in this order.

    targets: each becomes a channel of its own. sensor: the radar's name, with which the texts of events begin.
    """

    def __init__(self, targets: Sequence[FollowedTarget], sensor: str = "radar") -> None:
        self.targets = tuple(targets)
        self.bins: Floats = np.unique(np.concatenate([item.bins for item in targets]))
        which = [f" {item.target.place}" if len(targets) > 1 else "" for item in targets]
        self._followers = [
            _Follower(item, int(np.searchsorted(self.bins, item.bins[0])), f"{sensor}: the target{where}")
            for item, where in zip(targets, which, strict=True)
        ]

    def push(
        self, frame: RangeFrame, predictions: Sequence[PhasePrediction | None] | None = None
    ) -> tuple[PhaseMeasurement, ...]:
        """The phase of each target in a frame of phasors (channels, k) at `bins`.

        predictions: expected phase in rad and its variance in rad² of each target's channel at the frame's instant;
        None, or a variance that is not finite, where there is none: then only changes of the expected phase are used.
        """
        if frame.phasors.shape[1] != len(self.bins):
            raise refuse("phasors", f"(channels, {len(self.bins)} bins)", frame.phasors.shape)
        given = [None] * len(self._followers) if predictions is None else predictions
        whole, valid = frame.phasors.astype(np.complex128), None if frame.valid.all() else frame.valid
        every = zip(self._followers, given, strict=True)
        return tuple(one.push(frame.time_ns, whole, valid, predicted) for one, predicted in every)

    @property
    def state(self) -> tuple[FollowedState, ...]:
        """A copy of what the chain remembers of each target."""
        return tuple(replace(one.state) for one in self._followers)

    def restore(self, state: tuple[FollowedState, ...]) -> None:
        """Go on from a state of a chain of the same targets."""
        for one, own in zip(self._followers, state, strict=True):
            one.state = replace(own)


class _Follower:
    """One target: met in each frame, unwrapped, and watched.

    column: its first one in the frames; name: of it, in the texts of events.
    """

    def __init__(self, item: FollowedTarget, column: int, name: str) -> None:
        target = item.target
        self.item, self.name = item, name
        self.state = FollowedState(clear=CLEAR_FRAMES)  # calibrated means seen
        self.columns = slice(column, column + len(item.bins))
        self.row = target.weights.conj() / math.sqrt(len(target.weights))
        self.first_bin, followed = float(item.bins[0]), len(item.bins) > 1
        # Of the phase; 0 where it is not followed.
        self.cycles_per_bin = item.bin_m * item.phase_per_m / TURN if followed else 0.0
        # Of the displacement.
        self.cycles_per_m = abs(item.phase_per_m / target.conversion_factor) / TURN
        self.amplitude, self.noise = target.amplitude, target.noise_variance
        self.still = np.full(len(item.bins), target.leak, dtype=np.complex128)
        if target.background is not None:
            self.still = target.background.at(item.bins)
        elif followed:
            # It was calibrated between two bins, where less of it is seen than at its peak.
            self.amplitude /= between(target.place_bin - math.floor(target.place_bin))
        self.noise_share = self.noise / self.amplitude**2
        self.gain = power_gain(self.noise_share)
        self.bent_rad2 = target.bent_rad**2
        self.white_rad2 = target.phase_noise_rad2 + self.bent_rad2
        own_m = OWN_RATIO * target.own_m if target.own_hz > 0.0 else 0.0
        self.own_rad2 = (own_m * TURN * self.cycles_per_m) ** 2
        self.forgets_per_ns = 2.0 * TURN * OWN_CORNER * target.own_hz / NANOSECONDS

    def push(
        self, time_ns: int, phasors: Phasors, valid: NDArray[np.bool_] | None, given: PhasePrediction | None
    ) -> PhaseMeasurement:
        """The measurement of a frame; valid (channels,): None where all were received."""
        state, alone_rad = self.state, math.nan
        if given is not None:
            alone_rad = math.nan if given[1] < math.inf else given[0]
            # Rounding may leave a variance below 0 where a channel's zero is hardly known.
            given = (given[0], max(given[1], 0.0)) if given[1] < math.inf else None
        self._moved_alone(time_ns, alone_rad)
        own = self._own_prediction(time_ns)
        base = own if given is None else given
        if given is not None and own[1] < UNSURE_RAD2:
            # The given prediction is followed while it can name the cycle and is the closer one.
            refuted = state.given_count >= MIN_JUDGED and state.given_rad2 > max(state.own_rad2, REFUTED_RAD2)
            base = own if refuted or not given[1] < UNSURE_RAD2 else given
        seen = self._seen(phasors, valid, self._place(base))
        if seen is None:
            return self._unseen(time_ns, base, 0.0, "lost frames")
        state.power = mean_power(state.power, seen.strength, self.noise_share, self.gain)
        good = state.power >= MIN_SHARE**2 and seen.strength <= MAX_SHARE
        bent_rad2 = self._modulated(seen.strength) if good else 0.0
        state.clear = min(state.clear + 1, CLEAR_FRAMES) if good and bent_rad2 < MAX_BENT_RAD2 else 0
        blind = not seen.variance_rad2 < BLIND_RAD**2
        # Of the first frames a faint one tells more than none: without it zero and speed would be sought anew.
        if state.clear < CLEAR_FRAMES or (blind and (state.first is None or not seen.strength > 0.0)):
            return self._unseen(time_ns, base, seen.strength, "blocked")
        seen = replace(seen, variance_rad2=seen.variance_rad2 + max(bent_rad2 - self.bent_rad2, 0.0))
        if state.first is not None:
            return self._begun(time_ns, seen, own, alone_rad)
        return self._used(time_ns, seen, (base, own, given))

    def _moved_alone(self, time_ns: int, alone_rad: float) -> None:
        """Take what the acceleration alone tells of the phase; NaN: it does not, and the own prediction does without.

        It is in use from the first frame on or not at all.
        """
        state = self.state
        if math.isnan(state.alone_rad):
            return
        if math.isnan(alone_rad):
            since_s = (state.alone_ns - state.last_ns) / NANOSECONDS
            state.phase_rad += state.alone_rad - state.alone_rad_s * since_s
            state.speed_rad_s += state.alone_rad_s
        elif time_ns > state.alone_ns:
            state.alone_rad_s = (alone_rad - state.alone_rad) / (time_ns - state.alone_ns) * NANOSECONDS
        state.alone_rad, state.alone_ns = alone_rad, time_ns

    def _own_prediction(self, time_ns: int) -> PhasePrediction:
        """Phase and variance by what was measured up to the last used frame."""
        state = self.state
        late_s = (time_ns - state.last_ns) / NANOSECONDS
        frames = max(round(late_s / self.item.period_s), 1)
        # Innovations are second differences: over n frames n (n + 1) / 2 of them add up.
        phase = state.phase_rad + late_s * state.speed_rad_s + (0.0 if math.isnan(state.alone_rad) else state.alone_rad)
        return phase, state.own_rad2 * (0.5 * frames * (frames + 1.0)) ** 2

    def _place(self, base: PhasePrediction) -> tuple[float, float]:
        """Fractional bin at which the target is expected, and how far from it it may be, bins."""
        state, target = self.state, self.item.target
        if not self.cycles_per_bin:
            return target.place_bin, 0.0
        if state.first is not None:
            return target.place_bin, target.reach_bins
        gap = state.before if state.before is not None and not state.gap.count else state.gap
        return (
            (gap.mean + base[0] / TURN) / self.cycles_per_bin,
            2.0 * math.sqrt(base[1]) / (TURN * self.cycles_per_bin),
        )

    def _seen(self, phasors: Phasors, valid: NDArray[np.bool_] | None, place: tuple[float, float]) -> _Seen | None:
        """The target at an expected place, receivers combined; None where nothing was received."""
        row, noise, mine = self.row, self.noise, phasors[:, self.columns]
        if valid is not None:
            share = float(np.sum(np.abs(self.item.target.weights[valid]) ** 2))
            if not share > 0.0:
                return None
            row, noise, mine = row[valid] / share, noise / share, mine[valid]
        z: list[complex] = (row @ mine - self.still).tolist()
        value, gain, at = z[0], 1.0, place[0]
        if len(z) > 1:
            at = looked_at(z, self.first_bin, place) - self.first_bin
            low = min(max(math.floor(at), 0), len(z) - 2)
            part = min(max(at - low, 0.0), 1.0)
            value, gain = (1.0 - part) * z[low] + part * z[low + 1], between(part)
            noise *= noise_between(part)
            at = self.first_bin + low + fraction_between(z[low], z[low + 1], value)
        size = abs(value)
        if not 0.0 < size < math.inf:
            return _Seen(0.0, math.inf, 0.0, at)
        return _Seen(cmath.phase(value), noise / (2.0 * size * size), size / gain / self.amplitude, at)

    def _modulated(self, strength: float) -> float:
        """Variance (rad²) by which something else that turns in the bin bends the phase: as it does the amplitude.

        About the mean of the last frames, so that what changes slowly is none; 0 where noise explains it, infinite
        where neither noise nor the frames before explain it: interference begins from one frame to the next. A target
        that is followed over bins changes its amplitude as fast, and other bins tell interference.
        """
        state, own = self.state, 0.5 * self.noise_share
        away = 0.0 if math.isnan(state.strength) else strength - state.strength
        is_sudden = not self.cycles_per_bin and away * away > SUDDEN * max(own, state.modulated)
        state.strength = strength if math.isnan(state.strength) else state.strength + away / MEMORY
        state.modulated += (away * away - state.modulated) / MODULATED_FRAMES
        if is_sudden:
            return math.inf
        return state.modulated - own if state.modulated > NOISY * own else 0.0

    def _unseen(self, time_ns: int, base: PhasePrediction, strength: float, kind: str) -> PhaseMeasurement:
        """A frame in which the target is not used; kind: of the event."""
        state, events = self.state, tuple[Event, ...]()
        if state.unseen_ns < 0:
            state.unseen_ns = time_ns
        if not state.reported and time_ns - state.unseen_ns >= MIN_REPORTED_S * NANOSECONDS:
            text = "no complete frame without interference arrives" if kind == "lost frames" else "not visible"
            state.reported, events = True, (Event(state.unseen_ns, kind, f"{self.name}: {text} from here on."),)
        sure = state.first is None and base[1] < UNSURE_RAD2
        common = state.lost_rad2 + state.doubt_rad2
        status = Status.COASTING if sure else Status.LOST
        return PhaseMeasurement(time_ns, math.nan, math.inf, common, status, strength, events)

    def _measured(self, time_ns: int, phase_rad: float, seen: _Seen, events: list[Event]) -> PhaseMeasurement:
        """A phase with what is uncertain of it; the target is seen again."""
        state = self.state
        if state.reported:
            lasting_s = (time_ns - state.unseen_ns) / NANOSECONDS
            events.insert(0, Event(time_ns, "seen", f"{self.name}: visible again after {lasting_s:.1f} s."))
        state.unseen_ns, state.reported = -1, False
        white = seen.variance_rad2 + self.white_rad2
        common = state.lost_rad2 + state.doubt_rad2 + self._own_motion(time_ns)
        return PhaseMeasurement(time_ns, phase_rad, white, common, Status.TRACKING, seen.strength, tuple(events))

    def _own_motion(self, time_ns: int) -> float:
        """Variance of the target's own motion (rad²): stationary, and forgotten at the rate of its frequency.

        In every second frame it falls to what is left of the last one, and in the next one it is whole again.
        """
        state = self.state
        if not self.own_rad2:
            return 0.0
        state.fallen = not state.fallen
        if not state.fallen:
            state.forgotten_ns = state.forgotten_ns or time_ns
            return self.own_rad2
        left = math.exp(-self.forgets_per_ns * (time_ns - state.forgotten_ns))
        state.forgotten_ns = time_ns
        return self.own_rad2 * left

    def _begun(self, time_ns: int, seen: _Seen, own: PhasePrediction, alone_rad: float) -> PhaseMeasurement:
        """One of the first frames: none is used before range and phase tell the target's speed alike.

        The phase counts from the first of them.
        """
        state, first, phase = self.state, self.state.first, 0.0
        if first is None or not first.count or time_ns - state.last_ns > 1.5 * self.item.period_s * NANOSECONDS:
            first = FirstFrames(math.nan if self.cycles_per_bin else self.item.moved_m * self.cycles_per_m)
            state.first_rad, state.speed_rad_s, state.last_ns = seen.phase_rad, 0.0, time_ns
            state.begun = ()
            # The calibrated zero has the noise of a usual frame, not of one that is hardly seen.
            state.zero_rad2 = min(seen.variance_rad2, TURN**2) if seen.variance_rad2 > BLIND_RAD**2 else 0.0
            state.alone_rad, state.alone_ns, state.alone_rad_s = alone_rad, time_ns, 0.0
            state.phase_rad = 0.0 if math.isnan(alone_rad) else -alone_rad
        else:
            phase = own[0] + math.remainder(seen.phase_rad - state.first_rad - own[0], TURN)
            self._follow(time_ns, phase, own)
            state.zero_rad2 += _slips(state.own_rad2)
        place = seen.place_bin * self.cycles_per_bin
        state.first = first.met(place - phase / TURN)
        speed = state.first.cycles_per_frame
        if speed is None:
            mine = (time_ns, phase, seen.variance_rad2 + self.white_rad2, seen.strength)
            # Where the range is not measured there may be thousands.
            state.begun = (*state.begun, mine)[-MAX_FIRST_FRAMES:]
            return PhaseMeasurement(time_ns, math.nan, math.inf, 0.0, Status.LOST, seen.strength)
        turns = TURN * (state.first.count - 1)
        raised, state.lost_rad2 = turns * speed[0], turns**2 * speed[1] + state.zero_rad2
        # The phases of those before, raised by the speed.
        number, common = state.first.count - 1 - len(state.begun), state.lost_rad2 + state.doubt_rad2 + self.own_rad2
        earlier = tuple(
            PhaseMeasurement(one_ns, own_rad + TURN * speed[0] * k, white, common, Status.TRACKING, strength)
            for k, (one_ns, own_rad, white, strength) in enumerate(state.begun, start=number)
        )
        state.first, state.begun = None, ()
        phase, state.phase_rad = phase + raised, state.phase_rad + raised
        state.speed_rad_s += TURN * speed[0] / self.item.period_s
        state.gap = RangeGap().met(place - phase / TURN, phase)
        return replace(self._measured(time_ns, phase, seen, []), earlier=earlier)

    def _used(
        self, time_ns: int, seen: _Seen, predicted: tuple[PhasePrediction, PhasePrediction, PhasePrediction | None]
    ) -> PhaseMeasurement:
        """A frame that shows the target; predicted: as it is unwrapped, its own prediction, and the given one."""
        state, (base, own, given), events = self.state, predicted, []
        wrapped = seen.phase_rad - state.first_rad
        phase = base[0] + math.remainder(wrapped - base[0], TURN)
        refuted = base is own and given is not None and given[1] < UNSURE_RAD2
        if base is given and own[1] < UNSURE_RAD2 and abs(phase - own[0]) > 0.5 * TURN:
            state.astray_ns = time_ns
        lost = 0.0 if base[1] < UNSURE_RAD2 else base[1]
        if refuted and not state.refuted:
            text = "its phase contradicts the accelerometer and is unwrapped without it from here on."
            events.append(Event(time_ns, "contradiction", f"{self.name}: {text} Cycle slips may go undetected."))
            # Before the estimator was found wrong, its predictions may have led the phase to another cycle.
            if state.astray_ns >= 0 and time_ns - state.astray_ns < MEMORY * self.item.period_s * NANOSECONDS:
                lost = state.given_rad2
        if given is not None and given[1] < UNSURE_RAD2:
            state.refuted = refuted
        if lost > 0.0 and state.before is None:
            known_mm = 1e3 * math.sqrt(lost) / (TURN * self.cycles_per_m)
            text = f"The prediction has a standard deviation of {known_mm:.3g} mm there."
            events.append(
                Event(time_ns, "new datum", f"{self.name}: its phase cycle was lost; a new datum starts. {text}")
            )
        if lost > 0.0:
            self._doubt(lost)
        self._follow(time_ns, phase, own)
        if base is not given:
            state.lost_rad2 += _slips(state.own_rad2)
        if given is not None and given[1] < UNSURE_RAD2:
            away = math.remainder(wrapped - given[0], TURN)
            state.given_rad2, state.given_count = _averaged(state.given_rad2, state.given_count, away)
        if self.cycles_per_bin:
            state.gap = state.gap.met(seen.place_bin * self.cycles_per_bin - phase / TURN, phase)
            if state.before is not None and (cycles := self._verified(state.before)) is not None:
                phase += TURN * cycles
                text = f"corrects the cycle by {cycles:+d}" if cycles else "confirms the cycle"
                events.append(Event(time_ns, "cycle", f"{self.name}: its range {text} after the outage."))
        return self._measured(time_ns, phase, seen, events)

    def _follow(self, time_ns: int, phase_rad: float, own: PhasePrediction) -> None:
        """Correct the target's own prediction by a phase, which may lie whole cycles from its own way of counting."""
        state = self.state
        late_s = (time_ns - state.last_ns) / NANOSECONDS
        rest = math.remainder(phase_rad - own[0], TURN)
        state.phase_rad = (
            phase_rad - (1.0 - PHASE_GAIN) * rest - (0.0 if math.isnan(state.alone_rad) else state.alone_rad)
        )
        state.speed_rad_s += SPEED_GAIN * rest / late_s
        state.last_ns = time_ns
        if late_s <= 1.5 * self.item.period_s:
            state.own_rad2, state.own_count = _averaged(state.own_rad2, state.own_count, rest)

    def _doubt(self, variance_rad2: float) -> None:
        """The zero of the phase is a new one; where the range was known before, it may tell the cycle later."""
        state, rise = self.state, min(NEW_ZERO_RATIO * variance_rad2, (MAX_LOST_CYCLES * TURN) ** 2)
        if state.before is None and state.gap.count < MIN_FRAMES:
            state.lost_rad2 += rise
            return
        state.before = state.gap if state.before is None else state.before
        state.gap = RangeGap()
        state.doubt_rad2 += rise

    def _verified(self, before: RangeGap) -> int | None:
        """By how many cycles the phase must be raised after an outage; None where the range does not tell by now."""
        state = self.state
        cycles = cycles_lost(before, state.gap)
        if cycles is not None:
            state.phase_rad += TURN * cycles
            state.gap, state.before, state.doubt_rad2 = state.gap.shifted(cycles), None, 0.0
        elif state.gap.count >= MEMORY_FRAMES:
            state.lost_rad2 += state.doubt_rad2
            state.before, state.doubt_rad2 = None, 0.0
        return cycles


def _slips(own_rad2: float) -> float:
    """Variance (rad²) that a frame adds by the cycle that may be lost: the chance of an innovation of half of one."""
    return TURN**2 * math.erfc(math.pi / math.sqrt(2.0 * own_rad2)) if own_rad2 > 0.0 else 0.0


def _averaged(mean: float, count: float, value: float) -> tuple[float, float]:
    """A running mean square with one value more."""
    count = min(count + 1.0, MEMORY)
    return (mean + (value * value - mean) / count if count > 0.0 else mean), count
