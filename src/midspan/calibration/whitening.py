"""Innovations of a measured translation and of the acceleration's response, through one and the same filter.

The translation p of the image (px) follows the displacement divided by the scale factor. In the filter's state-space
model, written in pixels, the translation is driven by s · acceleration with s the inverse scale factor, so the
innovations of the whole are linear in s:

    e_k(s) = e_k[p, no input] − s · e_k[0, acceleration as input]

Both parts share the gains. Scale factor and noise variance therefore follow in closed form for any time offset and any
ratio of the noise levels, whatever the frame rate: nothing is resampled, an aliased camera is treated exactly.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from midspan.fusion.state_space import (
    INPUT,
    P00,
    P01,
    P02,
    P22,
    TIME,
    B,
    V,
    X,
    advance_covariance,
    advance_mean,
    begin_interval,
    initial_state,
    input_response,
    update_covariance,
)
from midspan.records import Floats

# Before the first measurements everything is unknown: variances far above any noise, in units of the noise variance.
DIFFUSE = (1e9, 1e9, 1e9)
# The first innovations only settle the unknown start and say nothing about the noise.
SETTLING = 3
# The bias walk that belongs to an acceleration noise, (rad/s)²: bias errors below 0.01 Hz are left to the displacement.
BIAS_WALK_RATIO = 0.003


@dataclass(frozen=True, slots=True)
class Whitened:
    """Innovations of the translation and of the response to the acceleration, (k,), after the settling ones.

    variance: of the innovation, in units of the noise variance of the translation; input_part: its share that comes
    from accelerometer noise; index: which measurement each belongs to. bias, response_bias: the filter's bias after the
    last sample out of the translation alone (px/s²) and out of the acceleration alone (m/s²); bias_variance: of their
    sum in px/s², in units of the noise variance.
    """

    translation: Floats
    response: Floats
    variance: Floats
    input_part: Floats
    index: Floats
    bias: float
    response_bias: float
    bias_variance: float


@njit(cache=True, inline="always")
def _meet(state, driven, noise, p, variance, blur):  # type: ignore[no-untyped-def]
    """Innovations of both means at one measurement `p`, and the update of means and covariances by it.

    blur: what the exposure's averaging adds to the response to the acceleration.
    """
    total = state[P00] + variance
    gain = (state[P00] / total, state[P01] / total, state[P02] / total)
    first, second = p - state[X], -(driven[X] + blur)
    input_part = noise[P00]
    for mean, innovation in ((state, first), (driven, second)):
        mean[X] += gain[0] * innovation
        mean[V] += gain[1] * innovation
        mean[B] += gain[2] * innovation
    update_covariance(state, gain, variance)
    update_covariance(noise, gain, 0.0)
    return first, -second, total, input_part


@njit(cache=True)
def _whiten(samples, rows, density, blur, states, out):  # type: ignore[no-untyped-def]
    state, driven, noise = states
    walk = density * BIAS_WALK_RATIO
    j = 0
    while j < len(rows) and rows[j, 0] < state[TIME]:
        j += 1
    count = 0
    for k in range(len(samples)):
        t0, a0 = driven[TIME], driven[INPUT]
        t1, a1 = samples[k, 0], samples[k, 1]
        dt = t1 - t0
        lead = begin_interval(driven, dt, a0, a1)
        reached, response = t0, (0.0, 0.0)
        while True:
            due = j < len(rows) and rows[j, 0] <= t1
            if due and not rows[j, 2] < np.inf:
                j += 1
                continue
            until = rows[j, 0] if due else t1
            ahead = input_response((until - t0) / dt, dt, a0, a1, lead)
            step = until - reached
            advance_mean(state, step, (0.0, 0.0), (0.0, 0.0))
            advance_mean(driven, step, response, ahead)
            advance_covariance(state, step, density * samples[k, 2], walk)
            advance_covariance(noise, step, density * samples[k, 2], walk)
            reached, response = until, ahead
            if not due:
                break
            now = a0 + (until - t0) / dt * (a1 - a0)
            out[count, 0], out[count, 1], out[count, 2], out[count, 3] = _meet(
                state, driven, noise, rows[j, 1], rows[j, 2], blur * now
            )
            out[count, 4] = j
            count += 1
            j += 1
        driven[TIME], driven[INPUT] = t1, a1
    return count


def whiten(samples: Floats, rows: Floats, density: float, exposure_s: float = 0.0) -> Whitened:
    """Run both signals through the filter.

    samples (n, 3): time (s), acceleration (m/s²), relative noise density (1 where nothing was missing).
    rows (m, 3): time on the accelerometer's clock (s), translation (px), relative variance (infinite: not used).
    density: noise density of the acceleration times s², in (px/s²)²/Hz, per unit of relative variance.
    exposure_s: the translation is the mean over this time, which adds exposure²/24 of the acceleration to it.
    """
    start = samples[0, 0] - (samples[1, 0] - samples[0, 0])
    states = tuple(initial_state(start, (0.0, 0.0, 0.0), DIFFUSE) for _ in range(3))
    states[1][INPUT] = samples[0, 1]
    states[2][P00:TIME] = 0.0
    out = np.empty((len(rows), 5))
    count = _whiten(samples, rows, density, exposure_s * exposure_s / 24.0, states, out)
    kept = out[SETTLING:count]
    return Whitened(
        translation=kept[:, 0],
        response=kept[:, 1],
        variance=kept[:, 2],
        input_part=kept[:, 3],
        index=kept[:, 4],
        bias=float(states[0][B]),
        response_bias=float(states[1][B]),
        bias_variance=float(states[0][P22]),
    )
