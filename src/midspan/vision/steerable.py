"""Steerable quadrature filters: second derivative of a Gaussian and its Hilbert transform, along x and y.

After Freeman and Adelson, "The design and use of steerable filters", 1991, tables III and V (doi 10.1109/34.93808). The
even filter's sign is turned, so that even + i · odd of cos(θ) is a positive number times exp(i θ): local amplitude and
local phase.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.records import Floats, Floats32

Complex64 = NDArray[np.complex64]

SPACING = 0.67  # of the samples, in widths of the Gaussian exp(-x²): nine taps, as tabulated
MARGIN_PX = 4  # taps on either side


@cache
def filter_taps(spacing: float = SPACING) -> tuple[Floats, Floats, Floats]:
    """Taps (9,) of the even and the odd filter along an axis, and of the Gaussian across it, for a tap every `spacing`.

    Even taps have no mean, so that brightness does not leak into the phase (the tabulated ones keep 0.2 %).
    """
    x = spacing * np.arange(-MARGIN_PX, MARGIN_PX + 1)
    across = np.exp(-(x**2))
    even = -0.9213 * (2.0 * x**2 - 1.0) * across
    odd = 0.9780 * (x**3 - 2.254 * x) * across
    return even - across * (even.sum() / across.sum()), odd, across


def taps_of(spacing: float) -> tuple[list[float], list[float], list[float]]:
    """The same taps as lists."""
    even, odd, across = filter_taps(spacing)
    return even.tolist(), odd.tolist(), across.tolist()


@cache
def noise_power(spacing: float = SPACING) -> tuple[float, float]:
    """Variance of the even and the odd response to white noise of variance 1."""
    even, odd, across = filter_taps(spacing)
    wide = float(np.sum(across**2))
    return float(np.sum(even**2)) * wide, float(np.sum(odd**2)) * wide


def responses(patch: Floats32, axis: str, spacing: float = SPACING) -> tuple[Floats32, Floats32]:
    """Even and odd response of `patch` (rows + 8, columns + 8) along `axis` "x" or "y": two arrays (rows, columns)."""
    return _core.steerable_responses(patch, axis == "y", taps_of(spacing))


def quadrature(patch: Floats32, axis: str, spacing: float = SPACING) -> Complex64:
    """The responses as complex numbers (rows, columns): their size is the local amplitude, their angle the phase."""
    even, odd = responses(patch, axis, spacing)
    return np.asarray(even + 1j * odd, dtype=np.complex64)


def spread_back(weights: Complex64, axis: str, spacing: float = SPACING) -> Floats:
    """How much each pixel (rows + 8, columns + 8) enters Σ Re(weights) · odd - Σ Im(weights) · even of the responses.

    That is the adjoint of `responses`: with weights = response / |response|² · w the sum is the mean phase's change.
    """
    wide = np.pad(weights, 2 * MARGIN_PX)
    of_real = responses(np.ascontiguousarray(wide.real, dtype=np.float32), axis, spacing)
    of_imaginary = responses(np.ascontiguousarray(wide.imag, dtype=np.float32), axis, spacing)
    # Turned round, the even filter stays what it is and the odd one changes its sign.
    return np.asarray(-of_real[1] - of_imaginary[0], dtype=np.float64)
