"""From a channel as it was read to acceleration that a filter can use: missing samples bridged, marked and reported."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.notices import Notice
from midspan.records import NANOSECONDS, Acceleration, Event, Floats, Nanoseconds, TimeSeries, part, seconds
from midspan.signals.clipping import clipped, with_crests
from midspan.signals.health import (
    GAP_STEPS,
    LONG_SHARE,
    MIN_HZ,
    Clock,
    Mask,
    bridged,
    clock,
    dominant_frequency,
    frozen,
    lone_spikes,
    mean_square,
    missed_share,
    runs,
    unknown_density,
)
from midspan.signals.lines import Line, unresolved
from midspan.signals.stamps import inside, shown

# Standard gravity, m/s².
GRAVITY_M_S2 = 9.80665
# Above this share of the rate the motion is so fast that integration errs by 1 % and more.
FASTEST_SHARE = 0.2
# White noise crosses zero as often. It is motion where samples next to each other or but one are correlated by more:
# a tone above that share by 0.8 and more where it is all there is.
MIN_CORRELATED = 0.3
# Values are held where nearly all their changes lie a multiple of the usual number of samples apart: by chance, as in a
# coarse resolution, half of them do at most.
MIN_CHANGES, HELD_SHARE = 20, 0.9
# Share of samples that may be missing, frozen or clipped before the channel is refused.
MAX_MISSING = 0.2
MAX_CLIPPED = 0.05


@dataclass(frozen=True, slots=True)
class PreparedAcceleration:
    """Acceleration with its missing samples bridged.

    time_ns, value_m_s2 (n,); bridging_density (n,): extra noise density in (m/s²)²/Hz of the interval that ends at each
    sample, above zero where something had to be bridged; missing (n,): samples that carry no measurement.
    cross_m_s2 (n, k): acceleration along the accelerometer's other axes where these were recorded. lines: narrow ones
    that are no motion.
    """

    time_ns: Nanoseconds
    value_m_s2: Floats
    bridging_density: Floats
    missing: Mask
    rate_hz: float
    events: tuple[Event, ...]
    warnings: tuple[Notice, ...]
    cross_m_s2: Floats | None = None
    lines: tuple[Line, ...] = ()

    def with_noise(self, density: float, motion_s: float = 0.0) -> Acceleration:
        """The acceleration for the filter, with white noise of `density` (m/s²)²/Hz besides what bridging adds, and
        noise of `motion_s` times the mean square of the motion.

        A long gap in time gets a sample of the mean acceleration shortly after its start and before its end: a straight
        line between the values on both sides would move the structure by metres. These samples are no rows of a result.
        """
        noise = density + self.bridging_density
        if motion_s > 0.0:
            noise = noise + motion_s * self.mean_square()
        gaps = clock(self.time_ns, GAP_STEPS).gaps
        most = float(np.max(self.bridging_density, initial=0.0))
        long = gaps[self.bridging_density[gaps + 1] > LONG_SHARE * most]
        if not len(long):
            return Acceleration(self.time_ns, self.value_m_s2, noise)
        step = round(NANOSECONDS / self.rate_hz)
        time_ns = np.concatenate((self.time_ns[long] + step, self.time_ns[long + 1] - step))
        value = np.full(len(time_ns), np.mean(self.value_m_s2))
        order = np.argsort(np.concatenate((self.time_ns, time_ns)), kind="stable")
        return Acceleration(
            np.concatenate((self.time_ns, time_ns))[order],
            np.concatenate((self.value_m_s2, value))[order],
            np.concatenate((noise, np.tile(noise[long + 1], 2)))[order],
        )

    def of_lines(self, lines: tuple[Line, ...]) -> "PreparedAcceleration":
        """The same of an acceleration that had these lines; with noise where one that is taken out is not resolved."""
        density = self.bridging_density + span_density(self.time_ns, unresolved(self.time_ns, lines))
        return replace(self, bridging_density=density, lines=lines) if lines else self

    def mean_square(self) -> Floats:
        """Mean square (n,) of the motion's acceleration over the half second up to each sample, m²/s⁴."""
        value = self.value_m_s2
        return mean_square(value, float(np.mean(value)), float(np.var(value)), self.rate_hz)

    @property
    def unmeasured_ns(self) -> NDArray[np.int64]:
        """Stamps (k, 2) of the last sample before and the first one after each segment that had to be bridged."""
        last = len(self.time_ns) - 1
        spans = [(max(int(a) - 1, 0), min(int(b), last)) for a, b in runs(self.missing)]
        spans += [(int(k), int(k) + 1) for k in clock(self.time_ns, GAP_STEPS).gaps]
        return self.time_ns[np.array(sorted(spans), dtype=np.int64).reshape(-1, 2)]

    def level(self, which: slice) -> float:
        """Mean acceleration (m/s²) of the samples `which`."""
        return float(np.mean(self.value_m_s2[which]))

    def rows(self, origin_ns: int, which: slice) -> Floats:
        """Rows (n, 3) for calibration: time (s), acceleration without its `level`, relative noise density."""
        usual = max(1e-4 * float(np.var(self.value_m_s2[which])) / self.rate_hz, 1e-12)
        block, ends = self.with_noise(usual), self.time_ns[which][[0, -1]].tolist()
        block = part(block, inside(block.time_ns, *ends))
        value = block.value_m_s2 - self.level(which)
        return np.column_stack((seconds(block.time_ns, origin_ns), value, block.noise_density / usual))

    def cross_rows(self, which: slice) -> tuple[Floats, Floats] | None:
        """Acceleration (m, k) along the other axes at the rows of `rows`, without its means (k,), and these."""
        if self.cross_m_s2 is None:
            return None
        own = [replace(self, value_m_s2=value, cross_m_s2=None) for value in self.cross_m_s2.T]
        origin_ns = int(self.time_ns[which.start])
        levels = np.array([one.level(which) for one in own])
        return np.column_stack([one.rows(origin_ns, which)[:, 1] for one in own]), levels

    def along(self, components: Sequence[float] | Floats) -> "PreparedAcceleration":
        """The acceleration along an axis of these components, see `along`."""
        if self.cross_m_s2 is None:
            return self
        return replace(self, value_m_s2=along(self.value_m_s2, self.cross_m_s2, components), cross_m_s2=None)


def span_density(time_ns: Nanoseconds, spans: Sequence[tuple[int, int, float]]) -> Floats:
    """Noise density (n,) at stamps (n,) that spans from one stamp (ns) to another add up to."""
    density = np.zeros(len(time_ns))
    for first, last, more in spans:
        density[inside(time_ns, first, last)] += more
    return density


def along(main: Floats, cross: Floats, components: Sequence[float] | Floats) -> Floats:
    """Acceleration (n,) along an axis that has these components (k,) along the cross axes for each one along the main.

    main (n,), cross (n, k): along the accelerometer's axes, which are at right angles.
    """
    own = np.asarray(components)
    return np.asarray((main + cross @ own) / np.sqrt(1.0 + own @ own))


def with_cross(main: PreparedAcceleration, cross: Sequence[PreparedAcceleration]) -> PreparedAcceleration:
    """The main axis with the others: what had to be bridged along one of them is so along all."""
    if not cross:
        return main
    every = (main, *cross)
    return replace(
        main,
        cross_m_s2=np.column_stack([one.value_m_s2 for one in cross]),
        bridging_density=np.max([one.bridging_density for one in every], axis=0),
        missing=np.any([one.missing for one in every], axis=0),
        events=tuple(event for one in every for event in one.events),
        warnings=tuple(line for one in every for line in one.warnings),
    )


def prepare_acceleration(series: TimeSeries, where: str) -> PreparedAcceleration:
    """Check and bridge a channel; `where` names file and channel in messages.

    Raises DataError when the channel is frozen, clipped or empty beyond what can be bridged.
    """
    usual = clock(series.time_ns, GAP_STEPS)
    absent, still, held, alone = unusable = _unusable(series)
    _refuse(where, still & ~absent, "frozen", (MAX_MISSING, "is constant"))
    _refuse(where, held, "clipped", (MAX_CLIPPED, "is clipped at the end of its range"))
    missing = absent | still | held | alone
    _refuse(where, missing, "missing", (MAX_MISSING, "is not a number, frozen or clipped"))
    straight = towards_mean(bridged(series.value, missing), missing, usual.rate_hz)
    value = np.where(held, with_crests(series.value, held), straight)
    density = _bridging_density(value, missing, usual)
    reported = [Notice("file-damaged", f"{where}: {line}.") for line in series.damage]
    reported += [one.worded(f"{where}: {one}.") for one in series.notices]
    bridged_texts = [f"{line}; they were bridged and marked." for line in _in_words(series, unusable)]
    if len(usual.gaps):
        longest = float(np.max(usual.gap_s))
        bridged_texts.append(f"gaps in time: {len(usual.gaps)}, the longest {longest:.3g} s; bridged and marked.")
    reported += [Notice("samples-bridged", f"{where}: {text}") for text in bridged_texts]
    reported += [
        Notice("rate-too-low", f"{where}: {text}") for text in _slow_sampling(value, series.value, usual.rate_hz)
    ]
    events = [Event(int(series.time_ns[a]), "bridged", f"{where}: {b - a} samples bridged.") for a, b in runs(missing)]
    events += [
        Event(int(series.time_ns[i]), "gap", f"{where}: no samples for {s:.3g} s.")
        for i, s in zip(usual.gaps, usual.gap_s, strict=True)
    ]
    return PreparedAcceleration(series.time_ns, value, density, missing, usual.rate_hz, tuple(events), tuple(reported))


def _slow_sampling(value: Floats, read: Floats, rate_hz: float) -> list[str]:
    """What shows in values (n,), bridged and as read, that they were sampled too slowly for their motion."""
    found, fastest, left = [], dominant_frequency(value, rate_hz), value - np.mean(value)
    power = max(float(np.sum(left**2)), 1e-300)
    # No white noise, by the correlation of samples with the next one and the next but one.
    correlated = max(abs(float(np.sum(left[k:] * left[:-k]))) for k in (1, 2)) > MIN_CORRELATED * power
    if fastest > FASTEST_SHARE * rate_hz and correlated:
        found.append(
            f"most of the acceleration lies near {fastest:.3g} Hz, too close to the rate of {rate_hz:.4g} Hz: "
            "integration then errs by more than 1 %. Record at ten times the highest frequency or more."
        )
    if (step := held_samples(read)) > 1:
        found.append(
            f"its values change only every {step}th sample: data at {rate_hz / step:.4g} Hz were repeated to a higher "
            "rate, which delays and distorts fast motion. Export it at its original sample rate."
        )
    return found


def held_samples(value: Floats) -> int:
    """Over how many samples (n,) each value is held where all are held alike; 1 where they are not."""
    places = np.flatnonzero(np.diff(value))
    if len(places) < MIN_CHANGES:
        return 1
    steps = np.diff(places)
    usual = int(np.median(steps))
    return usual if usual > 1 and np.mean(steps % usual == 0) >= HELD_SHARE else 1


def _unusable(series: TimeSeries) -> tuple[Mask, Mask, Mask, Mask]:
    """Samples (n,) that are no numbers, frozen, clipped, spikes: each is one of them at most."""
    alone = lone_spikes(series.value)
    value = np.where(alone, np.nan, series.value)
    still = frozen(value, clock(series.time_ns, GAP_STEPS).rate_hz)
    return ~np.isfinite(series.value), still, clipped(value) & ~still, alone


def unusable_samples(series: TimeSeries) -> list[str]:
    """How many samples of a channel are no numbers, frozen, clipped or spikes, and where the longest block lies."""
    return _in_words(series, _unusable(series))


def _in_words(series: TimeSeries, unusable: Sequence[Mask]) -> list[str]:
    kinds = ("are not numbers", "are frozen", "are clipped", "are spikes far beyond all others")
    rate_hz, found = clock(series.time_ns, GAP_STEPS).rate_hz, []
    for mask, what in zip(unusable, kinds, strict=True):
        if mask.any():
            first, end = max(runs(mask).tolist(), key=lambda block: block[1] - block[0])
            longest = f"for {(end - first) / rate_hz:.3g} s from {shown(int(series.time_ns[first]))} on"
            share = f"{np.count_nonzero(mask)} samples ({100 * np.mean(mask):.2g} %)"
            found.append(f"{share} {what}, the longest block {longest}")
    return found


def still(like: PreparedAcceleration) -> PreparedAcceleration:
    """No acceleration at all at the instants of another channel, for an axis without a sensor."""
    n = len(like.time_ns)
    return PreparedAcceleration(
        like.time_ns, np.zeros(n), np.zeros(n), np.zeros(n, dtype=bool), like.rate_hz, events=(), warnings=()
    )


def _refuse(where: str, mask: Mask, kind: str, rule: tuple[float, str]) -> None:
    share, most = float(np.mean(mask)), rule[0]
    if share > most:
        raise DataError(
            f"{where}: {100 * share:.1f} % of the samples are {kind} (the channel {rule[1]}); at most {100 * most:g} % "
            "can be bridged. Check the sensor, its range and its cable, or choose another channel."
        )


def towards_mean(value: Floats, missing: Mask, rate_hz: float) -> Floats:
    """`value` (n,) with long bridged segments drawn from their straight line to the mean of what was seen."""
    if not missing.any():
        return value
    seen = value[~missing]
    mean, frequency = float(np.mean(seen)), max(dominant_frequency(seen, rate_hz), MIN_HZ)
    drawn = value.copy()
    for start, end in runs(missing):
        share = missed_share((end - start + 1) / rate_hz, frequency)
        drawn[start:end] += share * (mean - drawn[start:end])
    return drawn


def _bridging_density(value: Floats, missing: Mask, gaps: Clock) -> Floats:
    """Noise density (n,) that stands for the motion that was not seen: its variance spread over its bandwidth."""
    density = np.zeros(len(value))
    if not missing.any() and not len(gaps.gaps):
        return density
    seen, rate_hz = value[~missing], gaps.rate_hz
    frequency, unknown = max(dominant_frequency(seen, rate_hz), MIN_HZ), unknown_density(seen, rate_hz)
    for start, end in runs(missing):
        density[start : end + 1] = unknown * missed_share((end - start + 1) / rate_hz, frequency) ** 2
    for index, length_s in zip(gaps.gaps, gaps.gap_s, strict=True):
        density[index + 1] = max(density[index + 1], unknown * missed_share(float(length_s), frequency) ** 2)
    return density
