"""Linear-phase filters: design from transition bands and ripples, responses.

Taps are symmetric and odd in number, so that a filter delays by a whole number of samples, its half length. A low-pass
made here has the sum 1 and no second moment: it keeps a straight line and a parabola exactly, so that the
complementary high-pass applied to a displacement takes a constant acceleration away exactly.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from midspan.checks import positive, refuse
from midspan.fusion.methods import MAX_TAPS
from midspan.records import Floats

# `flat_at_zero` adds ripple to the pass band only; the exchange leaves room for it. Measured at 0.5 to 1 Hz and 100 Hz:
# with these two 721 taps keep 1e-3, a Blackman window and even weights need 861, no flatness at all 653.
PASS_WEIGHT, CORRECTION_SHAPE = 2.0, 3.0


@dataclass(frozen=True, slots=True)
class Transition:
    """A low-pass: passes up to `pass_hz`, stops from `stop_hz` on, within `ripple` (relative amplitude) in both bands.

    0 < pass_hz < stop_hz, Hz; 0 < ripple < 0.5: smaller makes the filter and its delay longer.
    """

    pass_hz: float
    stop_hz: float
    ripple: float = 1e-3

    def __post_init__(self) -> None:
        positive("pass_hz", self.pass_hz, "Hz")
        if not self.pass_hz < self.stop_hz < np.inf:
            raise refuse("stop_hz", f"above pass_hz ({self.pass_hz:g} Hz)", self.stop_hz)
        if not 0.0 < self.ripple < 0.5:
            raise refuse("ripple", "between 0 and 0.5 (relative amplitude)", self.ripple)


def response(taps: Floats, frequency_hz: Floats, rate_hz: float) -> Floats:
    """Amplitude (m,) of symmetric `taps` (n,) at frequencies (m,) in Hz; its sign is kept, the delay left out."""
    half = len(taps) // 2
    angle = 2.0 * np.pi * np.asarray(frequency_hz, dtype=np.float64) / rate_hz
    result: Floats = taps[half] + 2.0 * np.cos(np.multiply.outer(angle, np.arange(1, half + 1))) @ taps[half + 1 :]
    return result


@lru_cache(maxsize=16)
def equiripple_low_pass(band: Transition, rate_hz: float) -> Floats:
    """The shortest equiripple low-pass (n,), n odd, that keeps `band` at `rate_hz` (Hz); read-only, kept for reuse.

    Reference: J. H. McClellan, T. W. Parks, L. R. Rabiner, A computer program for designing optimum FIR linear phase
    digital filters, IEEE Trans. Audio Electroacoust. 21 (1973) 506-526, doi 10.1109/TAU.1973.1162525. Filters longer
    than the algorithm can make are designed at a lower rate and interpolated: Y. Neuvo, C.-Y. Dong, S. K. Mitra,
    Interpolated finite impulse response filters, IEEE Trans. Acoust. 32 (1984) 563-570.
    """
    _below_nyquist(band, rate_hz)
    fold = int(_tap_estimate(band, rate_hz) / MAX_TAPS) + 1
    if fold > 1 and band.stop_hz < 0.25 * rate_hz / fold:
        slow = equiripple_low_pass(Transition(band.pass_hz, band.stop_hz, 0.7 * band.ripple), rate_hz / fold)
        spread = np.zeros(fold * (len(slow) - 1) + 1)
        spread[::fold] = slow
        images = Transition(band.stop_hz, rate_hz / fold - band.stop_hz, 0.25 * band.ripple)
        return _kept(flat_at_zero(np.convolve(spread, _windowed(images, rate_hz))))
    count = 2 * (int(0.95 * _tap_estimate(band, rate_hz)) // 2) + 1
    while True:
        taps = flat_at_zero(_exchange(band, rate_hz, count))
        worst = _worst_ripple(taps, band, rate_hz)
        if worst <= band.ripple:
            return _kept(taps)
        # The attenuation in dB grows by 14.6 · transition / rate a tap; steps of at least two.
        missing_db = 20.0 * np.log10(worst / band.ripple)
        count += 2 * max(1, int(0.5 * missing_db * rate_hz / (14.6 * (band.stop_hz - band.pass_hz))))


def equiripple_of_length(band: Transition, rate_hz: float, taps: int) -> Floats:
    """The equiripple low-pass (taps,) for the transition of `band` at `rate_hz` (Hz), whatever ripple that leaves.

    taps: odd, at most `MAX_TAPS`, so that the filter delays by (taps - 1) / 2 samples.
    """
    _below_nyquist(band, rate_hz)
    return flat_at_zero(_exchange(band, rate_hz, taps))


def _windowed(band: Transition, rate_hz: float) -> Floats:
    """A low-pass (n,), n odd, with a Kaiser window that keeps `band` at `rate_hz` (Hz); of any length.

    Reference: J. F. Kaiser, Nonrecursive digital filter design using the I0-sinh window function, IEEE Int. Symp.
    Circuits Syst. (1974) 20-23.
    """
    from scipy.signal import firwin, kaiserord

    width = (band.stop_hz - band.pass_hz) / (0.5 * rate_hz)
    count, shape = kaiserord(-20.0 * np.log10(band.ripple), width)
    middle_hz = 0.5 * (band.pass_hz + band.stop_hz)
    taps: Floats = firwin(count | 1, middle_hz, window=("kaiser", shape), fs=rate_hz)
    return taps


def complement(low_pass: Floats) -> Floats:
    """The high-pass (n,) that adds with the symmetric `low_pass` (n,) to a pure delay of its half length."""
    result = -np.asarray(low_pass, dtype=np.float64)
    result[len(result) // 2] += 1.0
    return result


def flat_at_zero(taps: Floats) -> Floats:
    """Symmetric `taps` (n,) of a low-pass, moved so little that their sum is 1 and their second moment 0.

    The correction is a Kaiser window and its product with the square of the index: nearly all of it lies in the pass
    band.
    """
    square = ((np.arange(len(taps)) - len(taps) // 2) / max(len(taps) // 2, 1)) ** 2
    shape = np.kaiser(len(taps), CORRECTION_SHAPE)
    shapes, moments = np.stack((shape, shape * square)), np.stack((np.ones(len(taps)), square))
    even = 0.5 * (taps + taps[::-1])
    result: Floats = even + np.linalg.solve(moments @ shapes.T, np.array([1.0, 0.0]) - moments @ even) @ shapes
    return result


def _kept(taps: Floats) -> Floats:
    taps.flags.writeable = False
    return taps


def _below_nyquist(band: Transition, rate_hz: float) -> None:
    if band.stop_hz >= 0.5 * positive("rate_hz", rate_hz, "Hz"):
        raise refuse("stop_hz", f"below half the rate ({0.5 * rate_hz:g} Hz)", band.stop_hz)


def _tap_estimate(band: Transition, rate_hz: float) -> float:
    """Kaiser's estimate of the number of taps of an equiripple low-pass."""
    attenuation_db = -20.0 * np.log10(band.ripple) - 13.0
    return float(max(attenuation_db / (14.6 * (band.stop_hz - band.pass_hz) / rate_hz), 2.0) + 1.0)


def _exchange(band: Transition, rate_hz: float, count: int) -> Floats:
    from scipy.signal import remez

    edges = [0.0, band.pass_hz, band.stop_hz, 0.5 * rate_hz]
    taps: Floats = remez(count, edges, [1.0, 0.0], weight=[PASS_WEIGHT, 1.0], fs=rate_hz, maxiter=100)
    return taps


def _worst_ripple(taps: Floats, band: Transition, rate_hz: float) -> float:
    """Largest deviation from 1 below the transition and from 0 above it, on a grid 16 times as fine as the taps."""
    from scipy.fft import rfft

    half, count = len(taps) // 2, 1 << int(np.ceil(np.log2(16 * len(taps))))
    ring = np.zeros(count)
    ring[: half + 1], ring[count - half :] = taps[half:], taps[:half]
    amplitude = rfft(ring).real
    frequency = np.arange(len(amplitude)) * rate_hz / count
    passed = np.append(amplitude[frequency <= band.pass_hz], response(taps, np.array([band.pass_hz]), rate_hz))
    stopped = np.append(amplitude[frequency >= band.stop_hz], response(taps, np.array([band.stop_hz]), rate_hz))
    return float(max(np.max(np.abs(passed - 1.0)), np.max(np.abs(stopped))))
