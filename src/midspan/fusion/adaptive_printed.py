"""The compiled recursion of `adaptive-kalman` exactly as printed: equations 7 to 26.

Ma, Choi and Sohn, doi 10.1111/mice.12767. Letters as there: G the covariance before a frame, K the gain, R the noise
variance of a frame, beta the forgetting factor.
"""

import numpy as np
from numba import njit

from midspan.fusion.adaptive_recursion import (
    BEYOND,
    MEMORY,
    MET_INNOVATION,
    MET_NOISE,
    MET_TOTAL,
    MET_VERDICT,
    NOISE,
    UNUSED,
    keep_row,
    label_row,
)
from midspan.fusion.gate import ACCEPTED
from midspan.fusion.state_space import (
    ACCEPTED_COUNT,
    INPUT,
    LAST_ACCEPTED,
    P00,
    P01,
    P11,
    SOURCE,
    TIME,
    B,
    V,
    X,
)

# Equation 20 as printed begins with this frame: while the start is settling, its variance is many times the noise's.
FIRST_FRAMES = 10.0


@njit(cache=True, inline="always")
def _held(s, dt, a):  # type: ignore[no-untyped-def]
    """Equation 7: A(dt) x + B(dt) a."""
    s[X] += dt * s[V] + 0.5 * dt * dt * a
    s[V] += dt * a


@njit(cache=True, inline="always")
def _moved(p, dt, noise):  # type: ignore[no-untyped-def]
    """Equation 8: A(dt) P A(dt)' + noise B(dt) B(dt)' of P = (P11, P12, P22)."""
    half = 0.5 * dt * dt
    p01 = p[1] + dt * p[2]
    return (
        p[0] + dt * (p[1] + p01) + noise * half * half,
        p01 + noise * half * dt,
        p[2] + noise * dt * dt,
    )


@njit(cache=True, error_model="numpy")
def _declare(s, frames, j):  # type: ignore[no-untyped-def]
    """The first usable frame's declared variance starts the noise; the first position is known no better than that."""
    for i in range(j, len(frames)):
        if frames[i, 2] < np.inf:
            s[NOISE] = frames[i, 2]
            s[P00] += frames[i, 2]
            return


@njit(cache=True, inline="always")
def _follow_beyond(s, eta, g00, declared):  # type: ignore[no-untyped-def]
    """Follow how far innovations exceed what G and the declared noise explain.

    The mean of all so far until the memory is full: what the first frame finds is the start's own error. While the
    start settles, the variance G is too wide to be taken off.
    """
    beyond = eta * eta - declared - g00
    if s[ACCEPTED_COUNT] <= FIRST_FRAMES:
        beyond = max(beyond, -declared)
    kept = min(MEMORY, 1.0 - 1.0 / s[ACCEPTED_COUNT])
    s[BEYOND] = kept * s[BEYOND] + (1.0 - kept) * beyond


@njit(cache=True, error_model="numpy")
def _frames_as_printed(s, frames, j, met, interval, beta):  # type: ignore[no-untyped-def]
    """Type II and III: the frames of an interval (its end, a_k, q), then on to the end by equations 21 to 26.

    W1 and W2 carry what state and acceleration noise at the interval's start have become, N what the frames' own noise
    has; for one frame they are equations 23 to 25, and more frames in one interval go on from there.
    """
    t1, a, q = interval
    if np.isnan(s[NOISE]):
        _declare(s, frames, j)
    p00, p01, p11 = s[P00], s[P01], s[P11]
    w00, w01, w10, w11 = 1.0, 0.0, 0.0, 1.0
    b0, b1 = 0.0, 0.0
    n = (0.0, 0.0, 0.0)
    reached = s[TIME]
    while True:
        frame = j < len(frames) and frames[j, 0] <= t1
        if frame and (frames[j, 0] < reached or not frames[j, 2] < np.inf):
            met[j, MET_VERDICT] = UNUSED
            j += 1
            continue
        until = frames[j, 0] if frame else t1
        dt = until - reached
        _held(s, dt, a)
        w00, w01 = w00 + dt * w10, w01 + dt * w11
        b0, b1 = b0 + dt * b1 + 0.5 * dt * dt, b1 + dt
        n = _moved(n, dt, 0.0)
        g00 = w00 * w00 * p00 + 2.0 * w00 * w01 * p01 + w01 * w01 * p11 + q * b0 * b0 + n[0]
        g01 = w00 * w10 * p00 + (w00 * w11 + w01 * w10) * p01 + w01 * w11 * p11 + q * b0 * b1 + n[1]
        g11 = w10 * w10 * p00 + 2.0 * w10 * w11 * p01 + w11 * w11 * p11 + q * b1 * b1 + n[2]
        reached = until
        if not frame:
            s[P00], s[P01], s[P11] = g00, g01, g11
            return j
        eta = frames[j, 1] - s[X]
        s[ACCEPTED_COUNT] += 1.0
        r = s[NOISE]
        if s[ACCEPTED_COUNT] > FIRST_FRAMES:
            r = beta * r + (1.0 - beta) * (eta * eta - g00)
        s[NOISE] = r
        k0, k1 = g00 / (g00 + r), g01 / (g00 + r)
        s[X] += k0 * eta
        s[V] += k1 * eta
        w10, w11, w00, w01 = w10 - k1 * w00, w11 - k1 * w01, (1.0 - k0) * w00, (1.0 - k0) * w01
        b1, b0 = b1 - k1 * b0, (1.0 - k0) * b0
        rest = 1.0 - k0
        n = (
            rest * rest * n[0] + r * k0 * k0,
            rest * (n[1] - k1 * n[0]) + r * k0 * k1,
            n[2] - 2.0 * k1 * n[1] + k1 * k1 * n[0] + r * k1 * k1,
        )
        _follow_beyond(s, eta, max(g00, 0.0), frames[j, 2])
        s[LAST_ACCEPTED], s[SOURCE] = frames[j, 0], frames[j, 3]
        met[j, MET_INNOVATION], met[j, MET_TOTAL], met[j, MET_NOISE] = eta, max(g00, 0.0) + max(r, 0.0), r
        met[j, MET_VERDICT] = ACCEPTED
        j += 1


@njit(cache=True, error_model="numpy")
def printed_block(samples, frames, s, beta, rows, labels, met):  # type: ignore[no-untyped-def]
    """Equations 7 to 26 over one block, as printed; the state vector `s` carries over to the next block.

    samples = time stamps (n,) and their origin in ns, acceleration (n,) and noise density (n,); the state's bias is
    taken off the acceleration. frames (m, 4): time in s, displacement, declared variance (infinite: ignored), source,
    in time order. rows and labels as in `_keep` and `_label`, and met (m, 4), take the result. Returns how many frames
    were consumed.
    """
    time_ns, origin_ns, values, densities = samples
    j = 0
    for k in range(len(time_ns)):
        t1 = (time_ns[k] - origin_ns) / 1e9
        dt = t1 - s[TIME]
        q = densities[k] / dt if dt > 0.0 else 0.0
        if j < len(frames) and frames[j, 0] <= t1:
            j = _frames_as_printed(s, frames, j, met, (t1, s[INPUT], q), beta)
        else:
            _held(s, dt, s[INPUT])
            s[P00], s[P01], s[P11] = _moved((s[P00], s[P01], s[P11]), dt, q)
        s[TIME], s[INPUT] = t1, values[k] - s[B]
        keep_row(rows, k, s[X], max(s[P00], 0.0) + max(s[BEYOND], 0.0), s[V])
        label_row(labels, k, t1, s[LAST_ACCEPTED], s[SOURCE])
    return j
