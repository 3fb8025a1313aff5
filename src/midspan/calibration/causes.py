"""Which cause explains best what a displacement sensor and the accelerometer differ by.

Each cause is one model of the readings y(t) made of the displacement x(t) that the acceleration says:

    unit          y = g·x(t)
    clock         y = x(t + τ)
    clock step    y = x(t + τ₁) before an instant, x(t + τ₂) after it
    low-pass      x = h_f ∗ y, a low-pass in the accelerometer's logger, on one clock or besides an offset
    slow sensor   y = h_f ∗ x, a first-order low-pass in the sensor
    play          y follows x with a play of width w in its joint (backlash)
    resonance     x is felt through a mounting of one mode, (1 + 2jζr) / (1 − r² + 2jζr) with r = frequency over its own
    tone          y = x(t) + a·sin 2πft + b·cos 2πft: a vibration that only the accelerometer has, or that it aliases

All are compared on the same readings with slow motion left out, by Schwarz's criterion (Annals of Statistics 6, 1978,
461, doi 10.1214/aos/1176344136): n/2·ln(RSS/n) + k/2·ln n. A cause is named where it leads all others clearly and
explains most of the difference; no figure of a calibration rests on it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from midspan import _core
from midspan.calibration.agreement import least_lead
from midspan.calibration.fit import Pair
from midspan.records import Floats
from midspan.signals.health import dominant_frequency

# This many readings are compared, from the first on; many blocks a clock may step between.
MAX_READINGS, BLOCKS = 1500, 16
MIN_READINGS = 60
# Motion slower than this share of the acceleration's main frequency is left out: double integrals drift there.
SLOWEST_SHARE, SLOWEST_HZ = 0.25, 0.05
# Ordinates of the acceleration's spectrum tell its main frequency where white noise is as strong so improbably.
BY_CHANCE = 1e-3
# Frequencies (Hz) of low-passes that are tried, widths of a play in rms of the motion, step of a clock's offsets, s.
LOW_PASSES_HZ, PLAYS = np.geomspace(0.5, 40.0, 30), np.geomspace(0.05, 3.0, 36)
OFFSET_STEP_S = 0.01
# Resonances (Hz) of a mounting, 5 % apart: nearer ones differ by less than noise. Dampings of steel and of concrete.
RESONANCES_HZ, DAMPINGS = np.geomspace(2.0, 40.0, 62), (0.01, 0.03, 0.1)
# Butterworth low-passes of second and fourth order: polynomials in s over the corner frequency.
BUTTERWORTH = (Polynomial([1.0, 1.4142, 1.0]), Polynomial([1.0, 2.6131, 3.4142, 2.6131, 1.0]))
MAX_OFFSET_S, MAX_RAISED = 0.6, 20.0
# A clock that was set, by hand or over a network, steps by this much at most, s.
MAX_STEP_S = 10.0
TONES = 3  # neighbouring frequencies that a tone may spread over: its amplitude changes slowly
# A cause is named where it leaves less than this share of the difference (power).
MAX_LEFT = 0.3


class Cause(StrEnum):
    """What two sensors may differ by, in words."""

    UNIT = "a wrong unit, sign or sensitivity"
    CLOCK = "a clock offset"
    STEP = "a clock step"
    LOW_PASS = "a low-pass in the accelerometer's logger"
    SLOW_SENSOR = "a lag of the displacement sensor"
    RESONANCE = "a resonating accelerometer mount (railing, bracket)"
    PLAY = "play (backlash) in the displacement sensor's joint"
    TONE = "a vibration of the accelerometer alone, or aliased (a machine above its Nyquist frequency)"


def _listed(*without: Cause) -> str:
    """All causes but some, as the end of a sentence."""
    left = [cause.value for cause in Cause if cause not in without]
    return ", ".join(left[:-1]) + " or " + left[-1]


@dataclass(frozen=True, slots=True)
class Explained:
    """The cause that stands out, the share of the difference (power) that it leaves, and that difference, rms."""

    cause: Cause
    left: float
    difference_m: float


def named_cause(pair: Pair, offset_s: float = 0.0) -> Explained | None:
    """The cause of what a displacement (in m, as its unit says) differs by; None where none stands out.

    offset_s: a clock offset that there may be besides any of them.
    """
    if len(pair.rows) < MIN_READINGS:
        return None
    compared = Comparison.of(pair)
    if len(compared.time_s) < MIN_READINGS:
        return None
    found = _named(compared)
    return found if found is not None or offset_s == 0.0 else _named(compared.later(offset_s))


@dataclass(frozen=True, eq=False)
class Comparison:
    """Readings (n,) at times_s (n,), and the acceleration's spectrum on an even grid from start_s on.

    inside (m,): which of the usable rows are compared.
    """

    time_s: Floats
    value_m: Floats
    start_s: float
    rate_hz: float
    spectrum: NDArray[np.complex128]
    slowest_hz: float
    inside: NDArray[np.bool_]

    @staticmethod
    def of(pair: Pair, most: int = MAX_READINGS, slowest_hz: float | None = None) -> "Comparison":
        """The first usable rows, `most` at most, without slow motion: as given, or as the acceleration says."""
        known = pair.rows[np.isfinite(pair.rows[:, 1]) & np.isfinite(pair.rows[:, 2])][:most]
        samples = pair.samples[pair.samples[:, 0] <= known[-1, 0] + 2.0 * MAX_OFFSET_S]
        rate = pair.sample_rate_hz
        even = np.arange(samples[0, 0], samples[-1, 0], 1.0 / rate)
        shaken = np.interp(even, samples[:, 0], samples[:, 1])
        slowest = max(SLOWEST_SHARE * _main_hz(shaken, rate) if slowest_hz is None else slowest_hz, SLOWEST_HZ)
        inside = (known[:, 0] > even[0] + MAX_OFFSET_S) & (known[:, 0] < even[-1] - MAX_OFFSET_S)
        spectrum = np.fft.rfft(shaken - shaken.mean())
        return Comparison(known[inside, 0], known[inside, 1], float(even[0]), rate, spectrum, slowest, inside)

    @cached_property
    def _hertz(self) -> Floats:
        return np.asarray(np.fft.rfftfreq(2 * (len(self.spectrum) - 1), 1.0 / self.rate_hz), dtype=np.float64)

    def path(self, response: NDArray[np.inexact] | float = 1.0) -> Callable[[Floats], Floats]:
        """The acceleration's displacement, of which each frequency is multiplied by a response, at any times."""
        w = 2.0 * np.pi * self._hertz
        # From the slowest frequency on; a sharp edge would ring.
        rise = np.clip(2.0 * self._hertz / self.slowest_hz - 1.0, 0.0, 1.0)
        transfer = np.where(w > 0.0, -rise / np.maximum(w, 1e-9) ** 2, 0.0) * response
        path = np.asarray(np.fft.irfft(self.spectrum * transfer), dtype=np.float64)
        place = self.start_s + np.arange(len(path)) / self.rate_hz
        return lambda time_s: np.interp(time_s, place, path)

    @cached_property
    def _basis(self) -> Floats:
        return slow_motion(self.time_s, self.slowest_hz)

    def free(self, values: Floats) -> Floats:
        """Values (n,) without slow motion."""
        return np.asarray(values - self._basis @ (self._basis.T @ values))

    def later(self, offset_s: float) -> "Comparison":
        """The readings at times that are later by an offset."""
        return replace(self, time_s=self.time_s + offset_s)

    def tried(self) -> dict[Cause, float]:
        """Residual squares of each cause."""
        plain = self.path()
        y, x = self.free(self.value_m), self.free(plain(self.time_s))
        clock, step = self._clocks(y, plain)
        delayed = [1.0 / (1.0 + 1j * self._hertz / f) for f in LOW_PASSES_HZ]
        return {
            Cause.UNIT: _without([x], y),
            Cause.CLOCK: clock,
            Cause.STEP: step,
            Cause.LOW_PASS: min(
                self._least(y, [self._raised(f, filtered, late=late) for f in LOW_PASSES_HZ])
                for filtered in BUTTERWORTH
                for late in (True, False)
            ),
            Cause.SLOW_SENSOR: self._least(y, delayed),
            Cause.RESONANCE: self._least(y, self._unmounted()),
            Cause.PLAY: self._with_play(y, plain),
            Cause.TONE: self._with_tone(y - x),
        }

    def difference(self) -> float:
        """Squares of what has to be explained: the readings less the motion, or the readings if they are less."""
        y = self.free(self.value_m)
        x = self.free(self.path()(self.time_s))
        return max(min(float(np.sum((y - x) ** 2)), float(np.sum(y**2))), 1e-300)

    def _least(self, y: Floats, responses: Sequence[NDArray[np.inexact]]) -> float:
        squares = [float(np.sum((y - self.free(self.path(one)(self.time_s))) ** 2)) for one in responses]
        return _lowest(np.array(squares))

    def _raised(self, frequency_hz: float, filtered: Polynomial, *, late: bool) -> NDArray[np.complex128]:
        """What undoes a low-pass, as far as it does not raise noise; late False: but for its delay of slow motion."""
        s = 1j * self._hertz / frequency_hz
        return _bounded(filtered(s) if late else filtered(s) * np.exp(-s * filtered.coef[1]))

    def _unmounted(self) -> list[NDArray[np.complex128]]:
        """What undoes the transmissibility of a mounting (A. K. Chopra, Dynamics of structures, section 3.6)."""
        below_nyquist = RESONANCES_HZ[: np.searchsorted(RESONANCES_HZ, 0.5 * self.rate_hz)]
        shapes = [(self._hertz / f, z) for f in below_nyquist for z in DAMPINGS]
        return [_bounded((1.0 - r**2 + 2j * z * r) / (1.0 + 2j * z * r)) for r, z in shapes]

    def _clocks(self, y: Floats, plain: Callable[[Floats], Floats]) -> tuple[float, float]:
        count = round(MAX_STEP_S / OFFSET_STEP_S)
        offsets = OFFSET_STEP_S * np.arange(-count, count + 1)
        paths = plain(np.add.outer(self.time_s, offsets))
        squares = (y[:, None] - (paths - self._basis @ (self._basis.T @ paths))) ** 2
        edges = np.linspace(0, len(y), BLOCKS, endpoint=False).astype(int)
        before = np.cumsum(np.add.reduceat(squares, edges, axis=0).T, axis=1)
        whole = before[:, -1]
        step = min(float(np.min(before[:, k]) + np.min(whole - before[:, k])) for k in range(BLOCKS - 1))
        return _lowest(whole[np.abs(offsets) < MAX_OFFSET_S + 0.5 * OFFSET_STEP_S]), step

    def _with_play(self, y: Floats, plain: Callable[[Floats], Floats]) -> float:
        even = np.arange(self.start_s, float(self.time_s[-1]) + 1.0, 1.0 / self.rate_hz)
        path = plain(even)
        size = float(np.std(path))
        followed = (np.interp(self.time_s, even, _core.follow_with_play(path, width * size)) for width in PLAYS)
        return _lowest(np.array([float(np.sum((y - self.free(one)) ** 2)) for one in followed]))

    def _with_tone(self, difference: Floats) -> float:
        """Residual squares with the tone that takes most, whatever the acceleration would make of it."""
        length = float(self.time_s[-1] - self.time_s[0])
        hertz = np.arange(self.slowest_hz, 0.5 * self.rate_hz, 0.5 / length)
        limit = 0.5 / float(np.median(np.diff(self.time_s)))
        if not np.any(hertz < limit):
            return float(np.sum(difference**2))
        power = [abs(np.exp(-2j * np.pi * f * self.time_s) @ difference) for f in hertz[hertz < limit]]
        at = float(hertz[int(np.argmax(power))])
        columns = []
        for k in range(TONES):
            turn = 2.0 * np.pi * (at + (k - TONES // 2) / length) * self.time_s
            columns += [self.free(np.sin(turn)), self.free(np.cos(turn))]
        return _without(columns, difference)


def _bounded(undone: NDArray[np.complex128]) -> NDArray[np.complex128]:
    return np.asarray(undone * np.minimum(1.0, MAX_RAISED / np.maximum(np.abs(undone), 1e-9)), dtype=np.complex128)


def slow_motion(time_s: Floats, slowest_hz: float) -> Floats:
    """Orthonormal columns (n, k) of motion below a frequency at instants (n,), level and trend included."""
    length = float(time_s[-1] - time_s[0])
    count = min(int(2.0 * length * slowest_hz) + 1, len(time_s) // 3)
    turn = np.pi * (time_s - time_s[0]) / length
    columns = [np.cos(k * turn) for k in range(count + 1)] + [turn]
    return np.linalg.qr(np.column_stack(columns))[0]


def _main_hz(shaken: Floats, rate_hz: float) -> float:
    """Where most of an acceleration's power beyond white noise lies: of its zero crossings, by Rice's formula."""
    power = np.abs(np.fft.rfft(shaken - shaken.mean())) ** 2
    hertz = np.fft.rfftfreq(len(shaken), 1.0 / rate_hz)
    # Powers of white noise are exponentially distributed.
    power = np.where(power > np.median(power) / np.log(2.0) * np.log(len(power) / BY_CHANCE), power, 0.0)
    if not power.any():
        return dominant_frequency(shaken, rate_hz)
    return float(np.sqrt(np.sum(hertz**2 * power) / np.sum(power)))


PARAMETERS = {Cause.STEP: 3, Cause.RESONANCE: 2, Cause.TONE: 1 + 2 * TONES}  # of a model, 1 of any other


def _named(compared: Comparison) -> Explained | None:
    count = len(compared.time_s)
    squares = {cause: max(square, 1e-300) for cause, square in compared.tried().items()}

    def score(cause: Cause) -> float:
        parameters = PARAMETERS.get(cause, 1)
        return -0.5 * count * math.log(squares[cause] / count) - 0.5 * parameters * math.log(count)

    # A constant offset is a step of none: where the step's parameters buy nothing the two are one explanation.
    order = sorted(Cause, key=score, reverse=True)
    first, *others = (cause for cause in order if order[0] is not Cause.CLOCK or cause is not Cause.STEP)
    second = others[0]
    difference = compared.difference()
    left = squares[first] / difference
    named = left < MAX_LEFT and score(first) - score(second) > least_lead(count)
    return Explained(first, left, math.sqrt(difference / count)) if named else None


def _lowest(values: Floats) -> float:
    """The lowest value of a parabola through the least of values (k,) and its neighbours."""
    k = int(np.argmin(values))
    if not 0 < k < len(values) - 1:
        return float(values[k])
    a, b, c = values[k - 1 : k + 2]
    bend = a - 2.0 * b + c
    return float(max(b - (a - c) ** 2 / (8.0 * bend), 0.0)) if bend > 0.0 else float(b)


def _without(columns: list[Floats], values: Floats) -> float:
    """Residual squares of values (n,) by least squares on columns (n,)."""
    matrix = np.column_stack(columns)
    return float(np.sum((values - matrix @ np.linalg.lstsq(matrix, values, rcond=None)[0]) ** 2))


REMEDIES = {
    Cause.UNIT: "Check displacement.unit, accelerometer.unit and that both sensors measure the same axis, or have it "
    "estimated: displacement.estimate_scale = true.",
    Cause.CLOCK: "Correct its time column or displacement.start_s, or set displacement.estimate_offset = true.",
    Cause.STEP: "Cut the recording where the clock steps, or correct the time column.",
    Cause.LOW_PASS: "Use a logger whose low-pass lies far above the motion.",
    Cause.SLOW_SENSOR: "Use a faster sensor, or declare its averaging time: exposure_s.",
    Cause.RESONANCE: "Mount the accelerometer on the structure itself.",
    Cause.PLAY: "Tighten the sensor's rod, wire or joint.",
    Cause.TONE: "Use a logger with an anti-alias filter, or mount the accelerometer away from the machine.",
}


def disagreement(cause: Explained | None, measured: str) -> str:
    """The sentence on sensors that differ: what was measured, and the cause that explains it or all that may."""
    if cause is None:
        return f"{measured}. No single cause stands out among: {_listed()}. Check both sensors for these."
    if cause.cause is Cause.UNIT:
        return f"{measured}. {REMEDIES[Cause.UNIT]}"
    return (
        f"{measured}; the best explanation is {cause.cause.value}, which leaves {100 * cause.left:.2g} % of the "
        f"difference. {REMEDIES[cause.cause]}"
    )


def cause_of_lateness(pair: Pair, offset_s: float) -> str:
    """What may make readings come late or early by an offset, as a sentence; empty where it is the clock."""
    found = named_cause(pair)
    if found is None:
        # Late readings need a negative offset, which a logger's low-pass does not make.
        excluded = (Cause.SLOW_SENSOR, Cause.PLAY) if offset_s > 0.0 else (Cause.LOW_PASS,)
        others = _listed(Cause.CLOCK, Cause.UNIT, Cause.RESONANCE, Cause.TONE, *excluded)
        return f"The readings cannot distinguish a clock offset from {others}. "
    return likelier_than_offset(found)


def likelier_than_offset(found: Explained) -> str:
    """A sentence on a cause that explains readings which are late better than a constant offset; empty for that."""
    if found.cause is Cause.CLOCK:
        return ""
    return f"The best explanation is {found.cause.value}, not a constant clock offset. {REMEDIES[found.cause]} "
