"""Narrow lines of the acceleration that a slower sensor does not show: of a machine, not of the structure.

An accelerometer without an anti-alias filter shows a machine near a multiple of its rate as a slow vibration. Both
spectra are compared ordinate by ordinate: a motion is in both, times one factor. Where the accelerometer has a peak of
which the sensor shows next to nothing, while it shows motion at other frequencies, no motion made it. Powers alone are
compared, so that clocks that are apart and a factor that is not known do not matter. Above half the sensor's rate
nothing is compared: lines stay in the noise there.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.errors import UntrustedError
from midspan.notices import Notice, rounded
from midspan.records import Floats
from midspan.signals.health import runs
from midspan.signals.lines import Line

# Lines are looked for from where accelerometers drift, Hz, up to where a strong one (0.1 m/s²) moves by 25 micrometres.
SLOWEST_HZ, FASTEST_HZ = 0.15, 10.0
# Ordinates on either side within this, Hz, tell what is usual next to one.
AROUND_HZ = 1.0
# White noise has an ordinate that counts as a peak with this probability; what belongs to a peak is this many times as
# strong as usual.
PEAK_BY_CHANCE, BELONGS = 1e-4, 3.0
# Noise of mean power N takes four fifths off a motion of power E where it is 0.3 E on its own, in one of a million
# ordinates at this ratio of E to N. The lowest quarter of ordinates, means of three, has this share of N on average.
ABOVE_NOISE, LOWEST, SHARE_OF_LOWEST = 50.0, 0.25, 0.4
# The sensor shows a motion where it has at least the first share of the power that the accelerometer tells (and no more
# than the inverse), and does not show it with less than the second: noise and neighbouring motion are in it as well.
SHOWN, NOT_SHOWN = 0.6, 0.2
# Of what both hold, at least this share must be motion by this rule: else powers do not tell what both share, as
# where a clock steps, something bends a radar's phase, or a gap hides a part (0.79 and less; with machines 0.85).
MIN_MOVING_SHARE = 0.8
# A line is taken out where motion has no more than this share of the power in its band: it is lost with it.
MAX_MOTION = 0.02
# A sensor that averages or follows late shows fast motion less: one that shows all of it at a frequency shows a fifth
# of the power at twice that one at the earliest (a mean over an exposure).
REACH = 2.0
# A wider band is no line, Hz; a line that swings has skirts of at most this many ordinates on either side.
MAX_WIDTH_HZ, MAX_SKIRT = 1.0, 10
# Behind a longer gap than this, s, a motion that comes and goes is another one: only between gaps both see the same.
MAX_GAP_S = 1.0
# Shorter records, or fewer ordinates, do not resolve lines; of longer ones the beginning tells them, s.
MIN_S, MAX_S, MIN_ORDINATES = 20.0, 120.0, 32


class LinesFound(UntrustedError):
    """The acceleration holds lines that a sensor does not show; the record is to be calibrated without them."""

    def __init__(self, lines: tuple[Line, ...], sensor: str) -> None:
        super().__init__(str(lines_text(lines, sensor)))
        self.lines, self.sensor = lines, sensor


@dataclass(frozen=True, slots=True)
class Shown:
    """What a sensor shows: value (n,) at time_s (n,), NaN where it was not measured.

    lag_s: of the second differences that the values are of the displacement, 0: they are the displacement itself.
    """

    time_s: Floats
    value: Floats
    lag_s: float = 0.0

    def per_displacement(self, hertz: Floats) -> Floats:
        """Size (k,) of what a displacement of 1 makes of the values at frequencies (k,)."""
        return 4.0 * np.sin(np.pi * hertz * self.lag_s) ** 2 if self.lag_s else np.ones(len(hertz))


def require_no_lines(samples: Floats, shown: Shown, sensor: str) -> None:
    """LinesFound where samples (n, 2 or more) hold lines that a sensor does not show."""
    if lines := unconfirmed_lines(samples, shown):
        raise LinesFound(lines, sensor)


@dataclass(frozen=True, slots=True)
class _Spectra:
    """Powers (k,) at frequencies (k,), Hz, that both sensors hear.

    felt: of the acceleration; would_move: of the displacement that it is; aliases: of that of faster motion which the
    sensor shows at these frequencies as well; moved: of what the sensor shows, in its own unit. white: of the
    acceleration's own noise.
    """

    hertz: Floats
    felt: Floats
    would_move: Floats
    aliases: Floats
    moved: Floats
    white: float


def unconfirmed_lines(samples: Floats, shown: Shown) -> tuple[Line, ...]:
    """Lines of samples (n, 2 or more: time in s, acceleration) that a sensor does not show."""
    if (both := _spectra(samples, shown)) is None:
        return ()
    hertz, felt, ratio = both.hertz, both.felt, both.moved / np.maximum(both.would_move, 1e-300)
    noise = _floor(both.moved)
    weight = np.where(both.moved > ABOVE_NOISE * noise, np.sqrt(ratio) * felt, 0.0)
    factor = _weighted_median(ratio, weight)
    moves = (weight > 0.0) & (ratio > SHOWN * factor) & (ratio < factor / SHOWN)
    if not np.sum(weight[moves]) > MIN_MOVING_SHARE * np.sum(weight):
        return ()
    alone = felt * np.clip(1.0 - ratio / factor, 0.0, 1.0)
    peak, belongs = _peaks(alone, hertz, both.white)
    would_show = factor * both.would_move > ABOVE_NOISE * (noise + factor * both.aliases)
    inside = np.zeros(len(hertz), dtype=np.bool_)
    for first, stop in runs(belongs & would_show & (hertz < REACH * np.max(hertz[moves]))):
        # Of a motion that a gap or a clock blurs some ordinates are weak, and not their sum.
        share = np.sum(both.moved[first:stop]) / (factor * np.sum(both.would_move[first:stop]))
        if first > 0 and peak[first:stop].any() and share < NOT_SHOWN:
            low, high = _reach((int(first), int(stop)), ratio > SHOWN * factor)
            inside[low : high + 1] = True
    # Both signs of the frequency; a Hann window spreads each ordinate over 1.5.
    return tuple(
        Line(
            float(hertz[first]),
            float(hertz[stop - 1]),
            float(np.sqrt(2.0 * np.sum(alone[first:stop]) / 1.5)),
            taken_out=bool(np.sum((felt - alone)[first:stop]) < MAX_MOTION * np.sum(felt[first:stop])),
        )
        for first, stop in runs(inside)
        if hertz[stop - 1] - hertz[first] < MAX_WIDTH_HZ
    )


def _spectra(samples: Floats, shown: Shown) -> _Spectra | None:
    """The spectra of the time that both share; None where that is too short."""
    if np.count_nonzero(np.isfinite(shown.value)) < MIN_ORDINATES:
        return None
    begin, end = _longest_run(shown.time_s[np.isfinite(shown.value)])
    begin, end = max(samples[0, 0], begin), min(samples[-1, 0], end, begin + MAX_S)
    if end - begin < MIN_S:
        return None
    every_hz, every = _spectrum(samples, (begin, end))
    would_move = every / (2.0 * np.pi * every_hz) ** 4
    frames_hz = 1.0 / float(np.median(np.diff(shown.time_s)))
    heard = (every_hz > SLOWEST_HZ) & (every_hz < min(FASTEST_HZ, 0.5 * frames_hz))
    if np.count_nonzero(heard) < MIN_ORDINATES:
        return None
    hertz = every_hz[heard]
    folds = [np.abs(k * frames_hz + side * hertz) for k in (1, 2) for side in (-1.0, 1.0)]
    aliases = np.sum([np.interp(one, every_hz, would_move, right=0.0) for one in folds], axis=0)
    moved = _shown_power(shown, (begin, end), hertz)
    return _Spectra(hertz, every[heard], would_move[heard], aliases, moved, _floor(every))


def _floor(power: Floats) -> float:
    """Power of the white noise in ordinates (k,) at most: motion only adds to it."""
    return float(np.mean(np.sort(power)[: int(LOWEST * len(power))])) / SHARE_OF_LOWEST


def _longest_run(time_s: Floats) -> tuple[float, float]:
    """First and last of increasing times (n,) between which there is no gap, where these are farthest apart."""
    if not len(time_s):
        return 0.0, 0.0
    breaks = np.flatnonzero(np.diff(time_s) > MAX_GAP_S)
    first, last = time_s[np.r_[0, breaks + 1]], time_s[np.r_[breaks, len(time_s) - 1]]
    longest = int(np.argmax(last - first))
    return float(first[longest]), float(last[longest])


def _spectrum(samples: Floats, span_s: tuple[float, float]) -> tuple[Floats, Floats]:
    """Frequencies (k,) above 0 and the power of the acceleration there, behind a Hann window, as mean of three."""
    rate = (len(samples) - 1) / float(samples[-1, 0] - samples[0, 0])
    even_s = np.arange(*span_s, 1.0 / rate)
    value, window = np.interp(even_s, samples[:, 0], samples[:, 1]), np.hanning(len(even_s))
    power = np.abs(np.fft.rfft(window * (value - np.mean(value))) / np.sum(window)) ** 2
    return np.asarray(np.fft.rfftfreq(len(even_s), 1.0 / rate)[1:], dtype=np.float64), _three(power)[1:]


def _reach(stands_out: tuple[int, int], moves: NDArray[np.bool_]) -> tuple[int, int]:
    """Ordinates between which a line lies: it reaches beyond those that stand out, as far as nothing moves there, and
    by no more than these are.
    """
    first, stop = stands_out
    most = min(stop - first, MAX_SKIRT)
    low = next((k for k in range(first - 1, first - most - 1, -1) if moves[k]), first - most)
    high = next((k for k in range(stop, stop + most) if moves[k]), stop + most - 1)
    return max(low, 0), min(high, len(moves) - 1)


def _peaks(power: Floats, hertz: Floats, white: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which ordinates (k,) are peaks of a power relative to what is usual there and to white noise, and which belong to
    one.
    """
    from scipy.ndimage import median_filter

    around = 2 * int(AROUND_HZ / (hertz[1] - hertz[0])) + 1
    usual = median_filter(power, min(around, len(power)), mode="nearest") / np.log(2.0)
    return power > np.maximum(usual, white) * np.log(len(power) / PEAK_BY_CHANCE), power > BELONGS * usual


def _three(power: Floats) -> Floats:
    """The mean (k,) of each ordinate and its neighbours."""
    return np.asarray(np.convolve(np.pad(power, 1, "edge"), np.ones(3) / 3.0, "valid"))


def _shown_power(shown: Shown, span_s: tuple[float, float], hertz: Floats) -> Floats:
    """Power (k,) of the displacement that a sensor shows at neighbouring frequencies (k,), as mean of three."""
    begin, end = span_s
    used = np.isfinite(shown.value) & (shown.time_s >= begin) & (shown.time_s <= end)
    time_s, value = shown.time_s[used], shown.value[used]
    weight = np.sin(np.pi * (time_s - begin) / (end - begin)) ** 2
    weight /= max(float(np.sum(weight)), 1e-300)
    left = weight * (value - np.sum(weight * value))
    power = np.array([abs(np.exp(-2j * np.pi * f * time_s) @ left) ** 2 for f in hertz])
    power /= np.maximum(shown.per_displacement(hertz), 1e-12) ** 2
    return _three(power)


def _weighted_median(values: Floats, weight: Floats) -> float:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


_TAKEN_OUT = "It is removed from the acceleration (not live, where the band is wider)."
_LEFT_IN = "It is not removed where the structure moves at the same frequency; the band includes it as noise."


def lines_text(lines: tuple[Line, ...], sensor: str) -> Notice:
    """The sentence on lines that were taken out."""
    listed = ", ".join(f"{line.middle_hz:.3g} Hz ({rounded(1e3 * line.std_m_s2)} mm/s² rms)" for line in lines)
    text = (
        f"accelerometer: a narrow line at {listed} that the {sensor} does not show: a machine near a multiple of the "
        "sample rate without an anti-alias filter, a vibrating part of the mounting, or cross motion on an inclined "
        f"axis. {_TAKEN_OUT if all(line.taken_out for line in lines) else _LEFT_IN} Use a logger with an anti-alias "
        "filter; check mounting and axis."
    )
    return Notice("accelerometer-line", text)
