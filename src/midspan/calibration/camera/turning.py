"""The rotation that a gyroscope measures: its readings checked and integrated, with their noise and gaps."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.whitening import NODES, WEIGHTS
from midspan.errors import UntrustedError
from midspan.notices import Notice
from midspan.records import NANOSECONDS, Floats, Nanoseconds, TimeSeries
from midspan.signals.clipping import clipped, with_crests
from midspan.signals.health import GAP_STEPS, bridged, clock, frozen, lone_spikes, runs
from midspan.signals.stamps import inside, shown

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline, PPoly

# Above this frequency, Hz, a gyroscope sees a camera's tilt in spite of its noise.
SEEN_HZ = 0.3
# Readings over this time, s, may be missing: a straight line errs by less than the noise. What is longer is a gap, of
# which there may be this many, with this share of the readings.
BRIDGED_S = 0.03
MAX_GAPS, MAX_MISSING = 20, 0.25
# Share of the readings that may be clipped.
MAX_CLIPPED = 0.01
# Slower readings alias the rotation of a camera that vibrates.
MIN_RATE_HZ = 20.0
# The noise of readings is the least of this many bands between these shares of their rate: below is motion, above what
# an anti-alias filter leaves.
ALIKE = 4.0
BANDS, FROM_SHARE, TO_SHARE = 3, 0.1, 0.4
# Draws of the integrated noise; the same ones each time.
DRAWS, SEED = 16, 1
# Seconds of readings on either side of what is looked at.
MARGIN_S = 1.0


@dataclass(frozen=True, eq=False)
class Turning:
    """A gyroscope's readings (n,), rad/s, without their mean; time_s (n,): after the window's begin.

    bias: that mean; density: of the white noise, two-sided, (rad/s)²/Hz; gaps (k, 2): times between which nothing was
    measured; notices: what is worth reporting.
    """

    time_s: Floats
    rate: Floats
    rate_hz: float
    bias: float
    density: float
    gaps: Floats
    notices: tuple[Notice, ...] = ()

    @property
    def drift(self) -> float:
        """By how much the mean of the second half exceeds that of the first, rad/s."""
        middle = len(self.rate) // 2
        return float(np.mean(self.rate[middle:]) - np.mean(self.rate[:middle]))

    @cached_property
    def _spline(self) -> "CubicHermiteSpline":
        return _through(self.time_s, self.rate)

    @cached_property
    def _integral(self) -> "PPoly":
        return _integrated(self.time_s, self.rate)

    def angle(self, time_s: Floats, exposure_s: float = 0.0) -> Floats:
        """The angle (m,), rad, the mean over an exposure about each instant (m,)."""
        return _mean(self._integral, self._within(time_s), exposure_s)

    def speed(self, time_s: Floats, exposure_s: float = 0.0) -> Floats:
        """Its derivative (m,), rad/s."""
        return _mean(self._spline, self._within(time_s), exposure_s)

    def _within(self, time_s: Floats) -> Floats:
        return np.clip(time_s, self.time_s[0], self.time_s[-1])

    @cached_property
    def _walks(self) -> "list[PPoly]":
        # Integrated as the readings are: between two of them the integral is smoother than a random walk.
        drawn = np.random.default_rng(SEED).normal(0.0, np.sqrt(self.density * self.rate_hz), (DRAWS, len(self.time_s)))
        return [_integrated(self.time_s, one) for one in drawn]

    def walk(self, time_s: Floats, number: int) -> Floats:
        """A draw of the angle's noise at instants (m,), rad."""
        return np.asarray(self._walks[number](self._within(time_s)))

    def jumped(self, time_s: Floats, number: int) -> Floats:
        """1 (m,) after a gap and 0 before it: by how much the box has turned meanwhile is unknown."""
        return np.asarray(time_s > np.mean(self.gaps[number]), dtype=np.float64)

    def seen(self, time_s: Floats, margin_s: float) -> NDArray[np.bool_]:
        """Which instants (m,) are farther than a margin from what was not measured."""
        found = (time_s >= self.time_s[0] + margin_s) & (time_s <= self.time_s[-1] - margin_s)
        for begin, end in self.gaps:
            found &= (time_s < begin - margin_s) | (time_s > end + margin_s)
        return np.asarray(found)

    def fast(self, density: float) -> tuple[float, float]:
        """Rms of the angle above SEEN_HZ without its noise of this density, and that of the noise, rad."""
        n = len(self.rate)
        window = np.hanning(n)
        turned = (self.rate - np.mean(self.rate)) * window
        hertz = np.fft.rfftfreq(n, 1.0 / self.rate_hz)
        # Two-sided density of the rate over the square of the angular frequency is that of the angle.
        power = np.abs(np.fft.rfft(turned)) ** 2 / (np.sum(window**2) * self.rate_hz)
        above = hertz >= SEEN_HZ
        per = 2.0 * self.rate_hz / n / (2.0 * np.pi * hertz[above]) ** 2
        noise = density * float(np.sum(per))
        return float(np.sqrt(max(float(power[above] @ per) - noise, 0.0))), float(np.sqrt(noise))


def _through(time_s: Floats, value: Floats) -> "CubicHermiteSpline":
    from scipy.interpolate import CubicHermiteSpline

    return CubicHermiteSpline(time_s, value, np.gradient(value, time_s))


def _integrated(time_s: Floats, value: Floats) -> "PPoly":
    return _through(time_s, value).antiderivative()


def _mean(function: "CubicHermiteSpline | PPoly", time_s: Floats, exposure_s: float) -> Floats:
    if exposure_s == 0.0:
        return np.asarray(function(time_s))
    return np.asarray(sum(w * function(time_s + n * exposure_s) for n, w in zip(NODES, WEIGHTS, strict=True)))


def turning_of(series: TimeSeries, window_ns: tuple[int, int], noise_density: float | None = None) -> Turning:
    """A gyroscope's readings about a window as a rotation; noise_density: one-sided, rad/s/√Hz, where it is known.

    Raises UntrustedError where too few of them are usable.
    """
    margin = round(MARGIN_S * NANOSECONDS)
    which = inside(series.time_ns, window_ns[0] - margin, window_ns[1] + margin)
    time_ns, value = series.time_ns[which], series.value[which]
    if len(time_ns) < 2 or not np.isfinite(value).any():
        raise UntrustedError(
            "gyroscope: no reading lies in the calibration window. Check its time stamps, gyroscope.start_s and column."
        )
    usual = clock(time_ns, GAP_STEPS)
    if usual.rate_hz < MIN_RATE_HZ:
        raise UntrustedError(
            f"gyroscope: {usual.rate_hz:.3g} readings a second are too few for a camera's tilt; at least "
            f"{MIN_RATE_HZ:g} are needed. Record it faster."
        )
    held, missing = _unusable(value, usual.rate_hz)
    value = bridged(with_crests(value, held), missing)
    time_s = (time_ns - window_ns[0]) / NANOSECONDS
    gaps = _gaps(time_s, missing, usual.gaps)
    _refuse_missing(time_s, gaps)
    known = value[~missing]
    bias = float(np.mean(known))
    density = noise_floor(known, usual.rate_hz) if noise_density is None else 0.5 * noise_density**2
    # A resolution that is coarse makes noise of its own, and none no noise at all.
    density = max(density, 1e-12 * float(np.var(known)) / usual.rate_hz)
    figures = (time_s, value - bias, usual.rate_hz, bias, density, gaps)
    return Turning(*figures, _reported(time_ns, time_s, gaps, int(np.count_nonzero(held))))


def _unusable(value: Floats, rate_hz: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Readings (n,) that are clipped, and those that are none, frozen or spikes."""
    alone = lone_spikes(value)
    cleaned = np.where(alone, np.nan, value)
    still = frozen(cleaned, rate_hz)
    if still.all():
        raise UntrustedError(
            "gyroscope: all readings of the calibration window are equal; it is frozen, or the column is not the "
            "gyroscope's. Check gyroscope.value_x, value_y and value_z and its cable."
        )
    held = clipped(cleaned) & ~still
    if (share := float(np.mean(held))) > MAX_CLIPPED:
        raise UntrustedError(
            f"gyroscope: {100 * share:.2g} % of its readings are clipped at the end of its range; at most "
            f"{100 * MAX_CLIPPED:g} % are accepted. Set a larger range of the gyroscope."
        )
    return held, ~np.isfinite(value) | alone | still


def _gaps(time_s: Floats, missing: NDArray[np.bool_], holes: NDArray[np.int64]) -> Floats:
    """Times (k, 2) between which readings are missing for too long to be bridged."""
    last = len(time_s) - 1
    spans = [(time_s[max(a - 1, 0)], time_s[min(b, last)]) for a, b in runs(missing).tolist()]
    spans += [(time_s[k], time_s[k + 1]) for k in holes.tolist()]
    long = sorted(span for span in spans if span[1] - span[0] > BRIDGED_S)
    joined: list[tuple[float, float]] = []
    for begin, end in long:
        if joined and begin <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(end, joined[-1][1])
        else:
            joined.append((begin, end))
    return np.array(joined, dtype=np.float64).reshape(-1, 2)


def _refuse_missing(time_s: Floats, gaps: Floats) -> None:
    share = float(np.sum(gaps[:, 1] - gaps[:, 0])) / float(time_s[-1] - time_s[0])
    if share > MAX_MISSING or len(gaps) > MAX_GAPS:
        raise UntrustedError(
            f"gyroscope: readings are missing or frozen for {100 * share:.2g} % of the calibration window, "
            f"gaps: {len(gaps)}; at most {100 * MAX_MISSING:g} % in {MAX_GAPS} gaps are accepted. Check its cable and "
            "logger, or choose another calibration.window_s."
        )


def _reported(time_ns: Nanoseconds, time_s: Floats, gaps: Floats, held: int) -> tuple[Notice, ...]:
    notices = []
    if len(gaps):
        begin, end = max(gaps.tolist(), key=lambda gap: gap[1] - gap[0])
        at = shown(int(time_ns[np.searchsorted(time_s, begin)]))
        text = f"gaps: {len(gaps)}, the longest {end - begin:.3g} s from {at} on; frames in them are not used."
        notices.append(Notice("samples-bridged", f"gyroscope: {text}"))
    if held:
        text = f"{held} readings are clipped at the end of its range; their crests were bridged."
        notices.append(Notice("samples-bridged", f"gyroscope: {text}"))
    return tuple(notices)


def noise_floor(value: Floats, rate_hz: float) -> float:
    """Density of the white noise of evenly spaced readings (n,), two-sided, in their unit squared per Hz.

    Of bands, each by the median of its ordinates, those that may be as low as the least: motion adds to white noise,
    lines do so in few ordinates.
    """
    n = len(value)
    window = np.hanning(n)
    power = np.abs(np.fft.rfft(window * (value - np.mean(value)))) ** 2 / (np.sum(window**2) * rate_hz)
    bands = np.array_split(power[int(FROM_SHARE * n) : int(TO_SHARE * n)], BANDS)
    level = np.array([np.median(band) for band in bands if len(band)]) / np.log(2.0)
    # A median of k exponential ordinates scatters by 1 / (ln 2 · √k) of itself; the least one of some lies low.
    scatter = 1.0 / (np.log(2.0) * np.sqrt(min(len(band) for band in bands if len(band))))
    return float(np.mean(level[level <= np.min(level) * (1.0 + ALIKE * scatter)]))
