"""One axis of acceleration, causal: samples that are missing, frozen or clipped are found, held back and bridged.

What is decided of a sample depends on the samples up to the one that decides it, not on how they are cut into blocks.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.fusion.entry import MAX_M_S2
from midspan.records import Event, Floats, Nanoseconds
from midspan.signals.clipping import Levels, clipped, is_clipped, range_limits, with_crests
from midspan.signals.health import (
    EQUAL_AT_FIRST,
    MIN_HZ,
    NEIGHBOURS,
    REST_SHARE,
    SPIKE,
    SPIKE_SAMPLES,
    EqualRuns,
    Mask,
    bridged,
    dominant_frequency,
    equal_runs,
    frozen,
    lone_spikes,
    mean_square,
    missed_share,
    runs,
    smallest_step,
    spikes,
)

# Samples already given out that are still looked at: a run counts as reached gently by the five steps before it.
CONTEXT = 6
SPIKE_TEXT = "spike samples, neighbours included, are left out."


@dataclass(frozen=True, slots=True)
class AxisFigures:
    """What is usual of an axis, from its calibration.

    mean_m_s2, variance (m²/s⁴), dominant_hz: of what was measured; low_m_s2, high_m_s2: the smallest and largest value
    seen; range_low_m_s2, range_high_m_s2: the ends of the range where it is held there, ∓ infinite where not;
    resolution_m_s2: smallest step of values; moved_m: standard deviation of the displacement. noise_density:
    (m/s²)²/Hz; name: file and channel, for messages; motion_noise_s: what the noise density has besides per mean square
    (m²/s⁴) of the motion, s. gain: of the accelerometer, by which its samples are divided after all.
    """

    mean_m_s2: float
    variance: float
    dominant_hz: float
    low_m_s2: float = np.inf
    high_m_s2: float = -np.inf
    resolution_m_s2: float = 0.0
    moved_m: float = 0.0
    noise_density: float = 0.0
    name: str = ""
    motion_noise_s: float = 0.0
    gain: float = 1.0
    range_low_m_s2: float = -np.inf
    range_high_m_s2: float = np.inf

    @property
    def peak_m_s2(self) -> float:
        """The largest acceleration that was measured, without its mean; not finite where that is unknown."""
        return max(self.high_m_s2 - self.mean_m_s2, self.mean_m_s2 - self.low_m_s2)

    @property
    def levels(self) -> Levels:
        """By these clipped samples are found."""
        std, ends = float(np.sqrt(self.variance)), (self.range_low_m_s2, self.range_high_m_s2)
        return Levels(self.mean_m_s2, std, self.resolution_m_s2, *ends)

    @property
    def frequency_hz(self) -> float:
        """Frequency that a motion has which was not seen."""
        return max(self.dominant_hz, MIN_HZ)

    @property
    def unknown_density(self) -> float:
        """Noise density, (m/s²)²/Hz, that stands for a motion of which nothing was seen."""
        return self.variance / self.frequency_hz

    @property
    def motion(self) -> tuple[float, float]:
        """Standard deviation (m) of the displacement, and the motion's middle angular frequency (1/s)."""
        return (self.moved_m, self.variance**0.25 / self.moved_m**0.5) if self.moved_m > 0.0 else (0.0, 0.0)

    def unseen(self, length_s: float) -> float:
        """Noise density, (m/s²)²/Hz, that stands for what a straight line over `length_s` misses."""
        return self.unknown_density * missed_share(length_s, self.frequency_hz) ** 2

    def unmoved(self, step_s: float) -> float:
        """Noise density, (m/s²)²/Hz, after which nothing is known of the place in a motion, in a step of `step_s`.

        Density S moves by a variance of S dt³/3; two instants of a motion far apart differ by twice its variance.
        """
        return 6.0 * self.moved_m**2 / step_s**3


def usual_figures(value: Floats, rate_hz: float) -> AxisFigures:
    """The figures of an axis from a record `value` (n,) of it, NaN where there was no number."""
    value = np.where(lone_spikes(value), np.nan, value)
    still = frozen(value, rate_hz)
    known = np.isfinite(value)
    seen = value[known & ~still & ~(clipped(value) & ~still)]
    low, high = range_limits(value)
    return AxisFigures(
        mean_m_s2=float(np.mean(seen)),
        variance=float(np.var(seen)),
        dominant_hz=dominant_frequency(seen, rate_hz),
        low_m_s2=float(value[known].min()),
        high_m_s2=float(value[known].max()),
        range_low_m_s2=low,
        range_high_m_s2=high,
        resolution_m_s2=smallest_step(value),
        moved_m=displacement_std(seen, rate_hz),
    )


def displacement_std(value: Floats, rate_hz: float) -> float:
    """Standard deviation (m) of the displacement with the acceleration `value` (n,), of motion that is no slower than
    `MIN_HZ`: each line of the spectrum over (2 pi f)⁴. The slowest motion makes most of it.
    """
    window = np.hanning(len(value))
    lines = np.abs(np.fft.rfft(window * (value - np.mean(value)))) ** 2
    hertz = np.fft.rfftfreq(len(value), 1.0 / rate_hz)
    motion = hertz >= MIN_HZ
    power = lines[motion] / (2.0 * np.pi * hertz[motion]) ** 4
    return float(np.sqrt(2.0 * np.sum(power) / (len(value) * np.sum(window**2))))


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """Rate, the numbers of samples after which a hole is bridged without its end, and that wait at most, and the
    standard deviation (m/s²) that spikes are judged by.
    """

    rate_hz: float
    long: int
    held: int
    spike_std: float

    @classmethod
    def of(cls, figures: AxisFigures, rate_hz: float, hold_s: float) -> "AxisLimits":
        """The limits at a rate. Once a straight line misses all of the motion, the bridge is the mean: its end is
        no longer needed; nothing waits longer than `hold_s`.
        """
        whole_s = np.sqrt(8.0) / (2.0 * np.pi * figures.frequency_hz)
        long = int(np.ceil(min(whole_s, hold_s) * rate_hz))
        spike_std = float(max(np.sqrt(figures.variance), figures.resolution_m_s2))
        return cls(rate_hz, max(long, 1), round(hold_s * rate_hz), spike_std)


@dataclass(frozen=True, slots=True)
class AxisMemory:
    """What an axis knows: the last samples given out (`given` of them) and those held back, time_ns and value (n,).

    Of the last sample given out: equal: length of the run of equal values that ends there; share: of equal neighbours
    before that run; gentle: whether that run, if longer than one, was reached gently; low, high: extremes so far;
    power: mean square of the motion, m²/s⁴; lost, lost_from_ns: length and start of the long hole it lies in.
    """

    time_ns: Nanoseconds
    value: Floats
    given: int
    equal: int
    share: float
    gentle: bool
    low: float
    high: float
    power: float
    lost: int
    lost_from_ns: int

    @classmethod
    def before(cls, figures: AxisFigures) -> "AxisMemory":
        """What is known before the first sample."""
        nothing, ends = np.empty(0, dtype=np.int64), (figures.low_m_s2, figures.high_m_s2)
        return cls(nothing, np.empty(0), 0, 0, EQUAL_AT_FIRST, True, *ends, figures.variance, 0, 0)


@dataclass(frozen=True, slots=True)
class Bridged:
    """Samples that are decided, arrays (n,): value, density (what bridging and motion add to the noise), if bridged."""

    value: Floats
    density: Floats
    bridged: Mask


def bridge(
    memory: AxisMemory,
    samples: tuple[Nanoseconds, Floats],
    figures: AxisFigures,
    limits: AxisLimits,
    *,
    end: bool = False,
) -> tuple[AxisMemory, Bridged, list[Event]]:
    """Take samples, time (n,) and value (n,); returns those that are decided by now, in their order, and events.

    end: the record ends here, and all is decided.
    """
    time_ns = np.concatenate((memory.time_ns, samples[0]))
    value = np.concatenate((memory.value, samples[1]))
    value[~(np.abs(value) < MAX_M_S2)] = np.nan
    alone, whole = _spikes(value, memory, (figures, limits), end=end)
    value[alone] = np.nan
    last_value = float(memory.value[memory.given - 1]) if memory.given else np.nan
    before = (last_value, memory.equal, memory.share)
    equal = equal_runs(value[memory.given :], limits.rate_hz, figures.resolution_m_s2, before)
    still, settled = _still(value, equal, memory, (figures, limits), end=end)
    held, decided = _clipped(value, equal, memory, figures, end=end)
    decided = min(decided, settled, whole)
    missing = np.isnan(value) | still | held
    missing[: memory.given] = False
    faulty = (missing, held, decided)
    filled, events, release, lost = _filled(time_ns, value, faulty, memory, (figures, limits), end=end)
    reported = [Event(int(time_ns[a]), "spike", f"{figures.name}: {b - a} {SPIKE_TEXT}") for a, b in runs(alone)]
    events = [*reported, *events]
    if release == memory.given:
        return replace(memory, time_ns=time_ns, value=value), filled, events
    power = mean_square(filled.value, figures.mean_m_s2, memory.power, limits.rate_hz)
    filled = replace(filled, density=filled.density + figures.motion_noise_s * power)
    last, first = release - 1, max(release - CONTEXT, 0)
    known = value[memory.given : release]
    length = int(equal.length[last - memory.given])
    after = AxisMemory(
        time_ns=time_ns[first:].copy(),
        value=value[first:].copy(),
        given=release - first,
        equal=length,
        share=float(equal.share[last - memory.given]),
        gentle=_is_gentle(value, last - length + 1, memory, figures),
        low=float(np.fmin.reduce(known, initial=memory.low)),
        high=float(np.fmax.reduce(known, initial=memory.high)),
        power=float(power[-1]),
        lost=lost[0],
        lost_from_ns=lost[1],
    )
    return after, filled, events


def passed(
    memory: AxisMemory, samples: tuple[Nanoseconds, Floats], figures: AxisFigures, limits: AxisLimits
) -> tuple[AxisMemory, Floats] | None:
    """The short way to the same for new samples (n,) that are plainly good while nothing waits: they are given out as
    they are. Returns the memory after them and what the motion adds to their noise; None where the short way is none.
    """
    time_ns, fresh = samples
    if memory.lost or not memory.given or memory.given < len(memory.value):
        return None
    far = min(SPIKE * limits.spike_std, MAX_M_S2)
    low, high = max(memory.low, figures.mean_m_s2 - far), min(memory.high, figures.mean_m_s2 + far)
    within = max(low, -MAX_M_S2) < fresh.min() and fresh.max() < min(high, MAX_M_S2)
    if not within or fresh[0] == memory.value[-1] or (fresh[1:] == fresh[:-1]).any():
        return None
    before = (float(memory.value[-1]), memory.equal, memory.share)
    share = float(equal_runs(fresh, limits.rate_hz, figures.resolution_m_s2, before).share[-1])
    power = mean_square(fresh, figures.mean_m_s2, memory.power, limits.rate_hz)
    if len(fresh) < CONTEXT:
        time_ns, fresh = np.concatenate((memory.time_ns, time_ns)), np.concatenate((memory.value, fresh))
    last_ns, last = time_ns[-CONTEXT:].copy(), fresh[-CONTEXT:].copy()
    after = AxisMemory(last_ns, last, len(last), 1, share, False, memory.low, memory.high, float(power[-1]), 0, 0)
    return after, figures.motion_noise_s * power


def _spikes(value: Floats, memory: AxisMemory, usual: tuple[AxisFigures, AxisLimits], *, end: bool) -> tuple[Mask, int]:
    """Samples (n,) that are spikes, and how many are settled: one that may be a spike waits for what follows."""
    (figures, limits), given, settled = usual, memory.given, len(value)
    far = np.abs(value - figures.mean_m_s2) > SPIKE * limits.spike_std
    if not far[given:].any():
        return np.zeros(settled, dtype=bool), settled
    alone, last = spikes(value, figures.mean_m_s2, limits.spike_std), runs(far)[-1]
    if not end and last[1] + NEIGHBOURS > settled and last[1] - last[0] <= SPIKE_SAMPLES:
        settled = max(int(last[0]), given)
        alone[settled:] = False
    alone[:given] = False
    return alone, settled


def _still(
    value: Floats, equal: EqualRuns, memory: AxisMemory, usual: tuple[AxisFigures, AxisLimits], *, end: bool
) -> tuple[Mask, int]:
    """Samples (n,) that are frozen, and how many are settled: a run waits from its second sample on until it is known
    what it is, where that is known within the time that samples may be held back.
    """
    figures, limits = usual
    given, count = memory.given, len(value)
    still = np.zeros(count, dtype=bool)
    for first, stop in runs(equal.length > 1):
        length, least, stop = int(equal.length[stop - 1]), int(equal.frozen[first]), given + int(stop)
        start = stop - length
        apart = abs(value[max(start, memory.given)] - figures.mean_m_s2)
        if apart < REST_SHARE * np.sqrt(figures.variance) and _is_gentle(value, start, memory, figures):
            # The structure is at rest: at the mean, and reached gently.
            continue
        waits = least <= limits.held
        if length >= least:
            still[max(start + 1 if waits else start + least - 1, given) : stop] = True
        elif stop == count and waits and not end:
            return still, max(start + 1, given)
    return still, count


def _is_gentle(value: Floats, start: int, memory: AxisMemory, figures: AxisFigures) -> bool:
    """Whether the run of equal values that begins at `start` is reached gently, as a structure's rest is."""
    if start < memory.given - 1:
        return memory.gentle
    steps = np.abs(np.diff(value[max(start - CONTEXT + 1, 0) : start + 1]))
    small = REST_SHARE * np.sqrt(figures.variance)
    return bool(np.fmax.reduce(steps, initial=0.0) < small)


def _clipped(
    value: Floats, equal: EqualRuns, memory: AxisMemory, figures: AxisFigures, *, end: bool
) -> tuple[Mask, int]:
    """Samples (n,) held at an end of the range, at whatever level that is, and how many samples are decided.

    The first sample of a run is taken as it is: whether others follow it is not yet known when it comes.
    """
    held, count = np.zeros(len(value), dtype=bool), len(value)
    begins = memory.given + np.flatnonzero(equal.length <= 1)
    if 0 < memory.given < count and (not len(begins) or begins[0] > memory.given):
        # The run that the last sample given out is in goes on.
        begins = np.append(max(memory.given - memory.equal, 0), begins)
    ends = np.append(begins[1:], count)
    levels = figures.levels
    far = np.abs(value[begins] - levels.mean) > levels.std
    for start, stop in zip(begins[far].tolist(), ends[far].tolist(), strict=True):
        if not end and stop - start > 1 and stop + 1 >= count:
            # How the run ends, and how steep the signal is after it, is not yet known.
            return held, start + 1
        held[start + 1 : stop] = is_clipped(value, (start, stop), levels)
    return held, count


def _filled(
    time_ns: Nanoseconds,
    value: Floats,
    known: tuple[Mask, Mask, int],
    memory: AxisMemory,
    usual: tuple[AxisFigures, AxisLimits],
    *,
    end: bool,
) -> tuple[Bridged, list[Event], int, tuple[int, int]]:
    """The samples that can be given out, events, the samples' end, and length and start of the long hole they end in.

    known: which samples are missing, which of them are clipped, and how many are decided.
    """
    missing, held, decided = known
    figures, limits = usual
    drawn, density = value.copy(), np.zeros(len(value))
    crests = with_crests(value, held & (np.arange(len(value)) < decided))
    events: list[Event] = []
    lost, release = (memory.lost, memory.lost_from_ns), decided
    holes = [(int(a), int(b)) for a, b in runs(missing[:decided])]
    goes_on = decided > memory.given and missing[memory.given]
    if lost[0] and not goes_on and (end or decided > memory.given):
        holes.insert(0, (memory.given, memory.given))
    for start, stop in holes:
        before, since = lost if start == memory.given and lost[0] else (0, int(time_ns[start]))
        count, is_open = before + stop - start, stop == decided and not end
        if is_open and count < limits.long:
            release, lost = start, (0, 0)
            break
        if count < limits.long and not before and held[start:stop].all():
            drawn[start:stop] = crests[start:stop]
            density[start : stop + 1] = figures.unseen((count + 1) / limits.rate_hz)
        elif count < limits.long:
            # On the line between its ends, drawn to the mean where it is long.
            near = slice(max(start - 1, 0), stop + 1)
            line = bridged(drawn[near], missing[near])[start - near.start :][: stop - start]
            share = missed_share((count + 1) / limits.rate_hz, figures.frequency_hz)
            drawn[start:stop] = line + share * (figures.mean_m_s2 - line)
            density[start : stop + 1] = figures.unseen((count + 1) / limits.rate_hz)
        else:
            drawn[start:stop], density[start : stop + 1] = figures.mean_m_s2, figures.unknown_density
        if count >= limits.long > before:
            text = f"{figures.name}: samples are missing, frozen or clipped from here on."
            events.append(Event(since, "missing", text))
        if not is_open:
            events.append(Event(since, "bridged", f"{figures.name}: {count} samples bridged."))
        lost = (count, since) if is_open else (0, 0)
    given = slice(memory.given, release)
    return Bridged(drawn[given], density[given], missing[given]), events, release, lost
