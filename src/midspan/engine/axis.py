"""One axis of acceleration, causal: samples that are missing, frozen or clipped are found, held back and bridged.

What is decided of a sample depends on the samples up to the one that decides it, not on how they are cut into blocks.
"""

from dataclasses import dataclass, replace

import numpy as np

from midspan.records import Event, Floats, Nanoseconds
from midspan.signals.bridging import LOWEST_HZ, missed_share
from midspan.signals.health import (
    CLIPPED_RUN,
    CREST_STEPS,
    FROZEN_S,
    FROZEN_SAMPLES,
    REST_SHARE,
    Mask,
    bridged,
    clipped,
    dominant_frequency,
    frozen,
    overshoot,
    runs,
)
from midspan.signals.lively import mean_square

# Samples already given out that are still looked at: a run counts as reached gently by the five steps before it.
CONTEXT = 6
# No accelerometer reaches this; what is larger is no number.
MAX_M_S2 = 1e7


@dataclass(frozen=True, slots=True)
class AxisFigures:
    """What is usual of an axis, from its calibration.

    mean_m_s2, variance (m²/s⁴), dominant_hz: of what was measured; low_m_s2, high_m_s2: the smallest and largest value
    seen; resolution_m_s2: smallest step of values; moved_m: standard deviation of the displacement. noise_density:
    (m/s²)²/Hz; name: file and channel, for messages; motion_noise_s: what the noise density has besides per mean square
    (m²/s⁴) of the motion, s.
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

    @property
    def frequency_hz(self) -> float:
        """Frequency that a motion has which was not seen."""
        return max(self.dominant_hz, LOWEST_HZ)

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
    still = frozen(value, rate_hz)
    known = np.isfinite(value)
    seen = value[known & ~still & ~(clipped(value) & ~still)]
    return AxisFigures(
        mean_m_s2=float(np.mean(seen)),
        variance=float(np.var(seen)),
        dominant_hz=dominant_frequency(seen, rate_hz),
        low_m_s2=float(value[known].min()),
        high_m_s2=float(value[known].max()),
        resolution_m_s2=float(np.min(np.diff(np.unique(value[known])), initial=np.inf)),
        moved_m=displacement_std(seen, rate_hz),
    )


def displacement_std(value: Floats, rate_hz: float) -> float:
    """Standard deviation (m) of the displacement with the acceleration `value` (n,), of motion that is no slower than
    `LOWEST_HZ`: each line of the spectrum over (2 pi f)⁴. The slowest motion makes most of it.
    """
    window = np.hanning(len(value))
    lines = np.abs(np.fft.rfft(window * (value - np.mean(value)))) ** 2
    hertz = np.fft.rfftfreq(len(value), 1.0 / rate_hz)
    motion = hertz >= LOWEST_HZ
    power = lines[motion] / (2.0 * np.pi * hertz[motion]) ** 4
    return float(np.sqrt(2.0 * np.sum(power) / (len(value) * np.sum(window**2))))


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """Rate, and the numbers of samples after which equal values are frozen and a hole is bridged without its end."""

    rate_hz: float
    frozen: int
    long: int

    @classmethod
    def of(cls, figures: AxisFigures, rate_hz: float, hold_s: float) -> "AxisLimits":
        """The limits at a rate. Once a straight line misses all of the motion, the bridge is the mean: its end is
        no longer needed; nothing waits longer than `hold_s`.
        """
        whole_s = np.sqrt(8.0) / (2.0 * np.pi * figures.frequency_hz)
        long = int(np.ceil(min(whole_s, hold_s) * rate_hz))
        return cls(rate_hz, max(FROZEN_SAMPLES, round(FROZEN_S * rate_hz)), max(long, 1))


@dataclass(frozen=True, slots=True)
class AxisMemory:
    """What an axis knows: the last samples given out (`given` of them) and those held back, time_ns and value (n,).

    Of the last sample given out: equal: length of the run of equal values that ends there; gentle: whether that run, if
    longer than one, was reached gently; low, high: extremes so far; power: mean square of the motion, m²/s⁴; lost,
    lost_from_ns: length and start of the long hole it lies in.
    """

    time_ns: Nanoseconds
    value: Floats
    given: int
    equal: int
    gentle: bool
    low: float
    high: float
    power: float
    lost: int
    lost_from_ns: int

    @classmethod
    def before(cls, figures: AxisFigures) -> "AxisMemory":
        """What is known before the first sample."""
        nothing = np.empty(0, dtype=np.int64)
        return cls(nothing, np.empty(0), 0, 0, True, figures.low_m_s2, figures.high_m_s2, figures.variance, 0, 0)


@dataclass(frozen=True, slots=True)
class Bridged:
    """Samples that are decided, arrays (n,): value, density (what bridging and motion add to the noise), if bridged."""

    value: Floats
    density: Floats
    bridged: Mask
    events: tuple[Event, ...] = ()


def bridge(
    memory: AxisMemory,
    samples: tuple[Nanoseconds, Floats],
    figures: AxisFigures,
    limits: AxisLimits,
    *,
    end: bool = False,
) -> tuple[AxisMemory, Bridged]:
    """Take samples, time (n,) and value (n,); returns those that are decided by now, in their order.

    end: the record ends here, and all is decided.
    """
    time_ns = np.concatenate((memory.time_ns, samples[0]))
    value = np.concatenate((memory.value, samples[1]))
    value[~(np.abs(value) < MAX_M_S2)] = np.nan
    starts, equal = _equal(value, memory)
    still = equal >= limits.frozen
    for start, stop in runs(still):
        still[start:stop] = not _is_rest(value, start - int(equal[start]) + 1, memory, figures)
    held, decided = _clipped(value, starts, memory, (figures, limits), end=end)
    missing = np.isnan(value) | still | held
    missing[: memory.given] = False
    filled, release, lost = _filled(time_ns, value, (missing, decided), memory, (figures, limits), end=end)
    if release == memory.given:
        return _waiting(memory, time_ns, value), filled
    power = mean_square(filled.value, figures.mean_m_s2, memory.power, limits.rate_hz)
    filled = replace(filled, density=filled.density + figures.motion_noise_s * power)
    last, first = release - 1, max(release - CONTEXT, 0)
    known = value[memory.given : release]
    start = last - int(equal[last]) + 1
    after = AxisMemory(
        time_ns=time_ns[first:].copy(),
        value=value[first:].copy(),
        given=release - first,
        equal=int(equal[last]),
        gentle=_is_gentle(value, start, memory, figures),
        low=float(np.fmin.reduce(known, initial=memory.low)),
        high=float(np.fmax.reduce(known, initial=memory.high)),
        power=float(power[-1]),
        lost=lost[0],
        lost_from_ns=lost[1],
    )
    return after, filled


def is_sound(memory: AxisMemory, fresh: Floats) -> bool:
    """Whether new samples (n,) are plainly good and nothing waits: then `passed` is the short way to the same."""
    if memory.lost or not memory.given or memory.given < len(memory.value):
        return False
    within = max(memory.low, -MAX_M_S2) < fresh.min() and fresh.max() < min(memory.high, MAX_M_S2)
    return bool(within and fresh[0] != memory.value[-1] and (fresh[1:] != fresh[:-1]).all())


def passed(
    memory: AxisMemory, samples: tuple[Nanoseconds, Floats], figures: AxisFigures, rate_hz: float
) -> tuple[AxisMemory, Floats]:
    """The memory after sound samples (n,), which are given out as they are, and what the motion adds to their noise."""
    time_ns, fresh = samples
    power = mean_square(fresh, figures.mean_m_s2, memory.power, rate_hz)
    if len(fresh) < CONTEXT:
        time_ns, fresh = np.concatenate((memory.time_ns, time_ns)), np.concatenate((memory.value, fresh))
    last_ns, last = time_ns[-CONTEXT:].copy(), fresh[-CONTEXT:].copy()
    after = AxisMemory(last_ns, last, len(last), 1, False, memory.low, memory.high, float(power[-1]), 0, 0)
    return after, figures.motion_noise_s * power


def _waiting(memory: AxisMemory, time_ns: Nanoseconds, value: Floats) -> AxisMemory:
    """The memory with more samples held back."""
    return AxisMemory(
        time_ns,
        value,
        memory.given,
        memory.equal,
        memory.gentle,
        memory.low,
        memory.high,
        memory.power,
        memory.lost,
        memory.lost_from_ns,
    )


def _equal(value: Floats, memory: AxisMemory) -> tuple[Mask, Nanoseconds]:
    """Which samples (n,) begin a run of equal values, and the length (n,) of the run up to each; 0 for no number."""
    given = memory.given
    starts = np.concatenate(([True], value[1:] != value[:-1]))[: len(value)]
    starts[:given] = False
    index = np.arange(len(value))
    begun = np.maximum.accumulate(np.where(starts, index, given - memory.equal))
    return starts, np.where(np.isnan(value) | (index < given), 0, index - begun + 1)


def _is_gentle(value: Floats, start: int, memory: AxisMemory, figures: AxisFigures) -> bool:
    """Whether the run of equal values that begins at `start` is reached gently, as a structure's rest is."""
    if start < memory.given - 1:
        return memory.gentle
    steps = np.abs(np.diff(value[max(start - CONTEXT + 1, 0) : start + 1]))
    small = REST_SHARE * np.sqrt(figures.variance)
    return bool(np.fmax.reduce(steps, initial=0.0) < small)


def _is_rest(value: Floats, start: int, memory: AxisMemory, figures: AxisFigures) -> bool:
    """Whether the run of equal values from `start` on is rest: at the mean, and reached gently."""
    apart = abs(value[max(start, memory.given)] - figures.mean_m_s2)
    return bool(apart < REST_SHARE * np.sqrt(figures.variance)) and _is_gentle(value, start, memory, figures)


def _clipped(
    value: Floats, starts: Mask, memory: AxisMemory, usual: tuple[AxisFigures, AxisLimits], *, end: bool
) -> tuple[Mask, int]:
    """Samples (n,) held at the largest or smallest value so far, and how many samples are decided."""
    figures, limits = usual
    held, count = np.zeros(len(value), dtype=bool), len(value)
    fresh = value[memory.given :]
    high = np.fmax.accumulate(np.concatenate(([memory.high], fresh)))[:-1]
    low = np.fmin.accumulate(np.concatenate(([memory.low], fresh)))[:-1]
    extreme = np.zeros(len(value), dtype=bool)
    extreme[memory.given :] = (fresh >= high) | (fresh <= low)
    begins = np.flatnonzero(starts)
    for start in map(int, np.flatnonzero(extreme & starts)):
        following = int(np.searchsorted(begins, start, side="right"))
        stop = int(begins[following]) if following < len(begins) else count
        if stop - start >= limits.frozen:
            held[start:stop] = not _is_rest(value, start, memory, figures)
        elif not end and (stop == count or (stop - start >= CLIPPED_RUN and stop + 1 == count)):
            # How the run ends, and how steep the signal is after it, is not yet known.
            return held, start
        elif stop - start >= CLIPPED_RUN:
            held[start:stop] = overshoot(value, start, stop) > CREST_STEPS * figures.resolution_m_s2
    return held, count


def _filled(
    time_ns: Nanoseconds,
    value: Floats,
    known: tuple[Mask, int],
    memory: AxisMemory,
    usual: tuple[AxisFigures, AxisLimits],
    *,
    end: bool,
) -> tuple[Bridged, int, tuple[int, int]]:
    """The samples that can be given out, the end of them, and length and start of the long hole they end in."""
    missing, decided = known
    figures, limits = usual
    drawn, density = value.copy(), np.zeros(len(value))
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
        if count < limits.long:
            _draw(drawn, missing, (start, stop), figures, rate_hz=limits.rate_hz)
            density[start : stop + 1] = figures.unseen((count + 1) / limits.rate_hz)
        else:
            drawn[start:stop], density[start : stop + 1] = figures.mean_m_s2, figures.unknown_density
        if count >= limits.long > before:
            events.append(Event(since, "missing", f"{figures.name}: samples are missing from here on."))
        if not is_open:
            events.append(Event(since, "bridged", f"{figures.name}: {count} samples bridged."))
        lost = (count, since) if is_open else (0, 0)
    given = slice(memory.given, release)
    return Bridged(drawn[given], density[given], missing[given], tuple(events)), release, lost


def _draw(value: Floats, missing: Mask, hole: tuple[int, int], figures: AxisFigures, *, rate_hz: float) -> None:
    """Put a hole (start, end) of `value` (n,) on the line between its ends, drawn to the mean where it is long."""
    start, stop = hole
    near = slice(max(start - 1, 0), stop + 1)
    line = bridged(value[near], missing[near])[start - near.start :][: stop - start]
    share = missed_share((stop - start + 1) / rate_hz, figures.frequency_hz)
    value[start:stop] = line + share * (figures.mean_m_s2 - line)
