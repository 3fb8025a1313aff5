"""What averaging over an exposure takes from a motion, by its acceleration."""

from dataclasses import replace

import numpy as np

from midspan.records import NANOSECONDS, Acceleration, Displacement, Floats, Nanoseconds

# Nodes of the integral on each side of the instant: exact for polynomials of degree 31.
NODES = 16


def taken_by_averaging(
    time_ns: Nanoseconds,
    acceleration: Floats,
    at_ns: Nanoseconds,
    exposure_s: float,
    *,
    beyond_first_term: bool = False,
) -> Floats:
    """By how much (m,), m, the mean displacement over an exposure around each instant is more than that at the instant.

    acceleration (n,): samples at `time_ns`, m/s², between which it is taken as straight, and beyond which as constant;
    at_ns (m,): middles of the exposures; exposure_s: T, s. By Taylor's theorem with the remainder as an integral

        mean d − d(t) = ∫ K(s) a(t + s) ds,   K(s) = (T/2 − |s|)² / (2 T),   |s| ≤ T/2,   ∫ K = T²/24

    beyond_first_term: without T²/24 a(t). Each value depends on the samples of its own exposure alone, bit for bit.
    """
    half = exposure_s / 2.0
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    away = half * (nodes + 1.0) / 2.0
    weights = weights * half / 2.0 * (half - away) ** 2 / (2.0 * exposure_s)
    at = np.concatenate((-away[::-1], away))
    weights = np.concatenate((weights[::-1], weights))
    reach_ns = round(half * NANOSECONDS)
    first = np.maximum(np.searchsorted(time_ns, at_ns - reach_ns, side="right") - 1, 0)
    last = np.searchsorted(time_ns, at_ns + reach_ns, side="left") + 1
    taken = np.empty(len(at_ns))
    for k, instant in enumerate(at_ns.tolist()):
        own = slice(int(first[k]), int(last[k]))
        t, a = (time_ns[own] - instant) / NANOSECONDS, acceleration[own]
        there = np.interp(0.0, t, a) if beyond_first_term else 0.0
        taken[k] = np.sum(weights * (np.interp(at, t, a) - there))
    return taken


def at_instants(
    averaged: Displacement, exposure_s: float, acceleration: Acceleration, *, first_term: bool = False
) -> Displacement:
    """Measurements that are means over exposures as the displacement at their middles.

    The mean of the acceleration is taken for its bias. first_term: T²/24 a(t) alone is taken away.
    """
    if exposure_s == 0.0:
        return averaged
    shaken = acceleration.value_m_s2 - np.mean(acceleration.value_m_s2)
    if first_term:
        taken = exposure_s**2 / 24.0 * np.interp(averaged.time_ns, acceleration.time_ns, shaken)
    else:
        taken = taken_by_averaging(acceleration.time_ns, shaken, averaged.time_ns, exposure_s)
    return replace(averaged, value_m=averaged.value_m - taken)
