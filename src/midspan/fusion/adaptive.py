"""`adaptive-kalman` exactly as printed: the noise of the displacement is learnt from frame to frame.

The adaptive multirate filter of Ma, Choi and Sohn, Computer-Aided Civil and Infrastructure Engineering 37 (2022)
688-703, doi 10.1111/mice.12767, equations 7 to 26: displacement and velocity, the acceleration held over each sample,
and the noise variance by equation 20, which can become negative and runs away under a bias (docs/methods.md). Letters
as there: G the covariance before a frame, K the gain, R the noise variance of a frame, beta the forgetting factor.
The guarded form is the estimator with a memory of as many measurements.
"""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from midspan.fusion.blocks import ACCEPTED
from midspan.fusion.streams import KalmanSettings, MethodSettings, Smoothed
from midspan.records import (
    NANOSECONDS,
    Acceleration,
    Displacement,
    Estimate,
    Floats,
    Innovation,
    Source,
    Status,
    part,
    seconds,
)

# The state vector: displacement, velocity, the bias that is taken off, covariance, time and the acceleration held; the
# noise variance R of a frame, the running mean of the innovation's square beyond the declared noise (m²); how many
# frames were used, when the last one, and its source; the variance of the acceleration of the last interval.
X, V, B, P00, P01, P11, TIME, INPUT, NOISE, BEYOND, COUNT, LAST_ACCEPTED, SOURCE, INPUT_NOISE = range(14)
STATE_SIZE = 14
# What is left for each frame.
MET_INNOVATION, MET_TOTAL, MET_NOISE, MET_USED = range(4)
MET_COLUMNS = 4
# And of each sample.
ROW_X, ROW_VARIANCE, ROW_VELOCITY, ROW_ACCEPTED, ROW_SOURCE = range(5)
# Memory of the error beyond the noise: 20 frames.
MEMORY = 0.95
# Frames in which the band does not take G off: while the start is settling, it is many times the noise's.
SETTLING_FRAMES = 10.0
# So many frames may wait for the samples that cover them; older ones are dropped.
MAX_WAITING = 65536


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


@njit(cache=True, inline="always")
def _follow_beyond(s, eta, g00, declared):  # type: ignore[no-untyped-def]
    """Follow how far innovations exceed what G and the declared noise explain.

    The mean of all so far until the memory is full: what the first frame finds is the start's own error. While the
    start settles, the variance G is too wide to be taken off.
    """
    beyond = eta * eta - declared - g00
    if s[COUNT] <= SETTLING_FRAMES:
        beyond = max(beyond, -declared)
    kept = min(MEMORY, 1.0 - 1.0 / s[COUNT])
    s[BEYOND] = kept * s[BEYOND] + (1.0 - kept) * beyond


@njit(cache=True, error_model="numpy")
def _frames_as_printed(s, frames, j, met, interval, learning):  # type: ignore[no-untyped-def]
    """Type II and III: the frames of an interval (its end, a_k, q), then on to the end by equations 21 to 26.

    W1 and W2 carry what state and acceleration noise at the interval's start have become, N what the frames' own noise
    has; for one frame they are equations 23 to 25, and more frames in one interval go on from there. The position is
    known no better before the first frame than a frame's noise. learning: beta, and the frames in which R stays.
    """
    t1, a, q = interval
    beta, first_frames = learning
    if s[COUNT] == 0.0:
        s[P00] += s[NOISE]
    p00, p01, p11 = s[P00], s[P01], s[P11]
    w00, w01, w10, w11 = 1.0, 0.0, 0.0, 1.0
    b0, b1 = 0.0, 0.0
    n = (0.0, 0.0, 0.0)
    reached = s[TIME]
    while True:
        frame = j < len(frames) and frames[j, 0] <= t1
        if frame and (frames[j, 0] < reached or not frames[j, 2] < np.inf):
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
        s[COUNT] += 1.0
        r = s[NOISE]
        if s[COUNT] > first_frames:
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
        met[j, MET_USED] = 1.0
        j += 1


@njit(cache=True, error_model="numpy")
def printed_block(samples, frames, s, learning, rows, met):  # type: ignore[no-untyped-def]
    """Equations 7 to 26 over one block, as printed; the state vector `s` carries over to the next block.

    samples (n, 3): time in s, acceleration and its noise density; the state's bias is taken off the acceleration.
    frames (m, 4): time in s, displacement, declared variance (infinite: ignored), source, in time order. learning: the
    factor beta and the number of frames in which R stays. rows (n, 5) and met (m, 4), see the column names, take the
    result. Returns how many frames are done.
    """
    j = 0
    for k in range(len(samples)):
        t1 = samples[k, 0]
        dt = t1 - s[TIME]
        q = samples[k, 2] / dt if dt > 0.0 else 0.0
        # Frames before the last sample, and those to be ignored, are no frames of this interval.
        while j < len(frames) and (frames[j, 0] < s[TIME] or not frames[j, 2] < np.inf):
            j += 1
        if j < len(frames) and frames[j, 0] <= t1:
            j = _frames_as_printed(s, frames, j, met, (t1, s[INPUT], q), learning)
        else:
            _held(s, dt, s[INPUT])
            s[P00], s[P01], s[P11] = _moved((s[P00], s[P01], s[P11]), dt, q)
        s[TIME], s[INPUT], s[INPUT_NOISE] = t1, samples[k, 1] - s[B], q
        rows[k, ROW_X], rows[k, ROW_VARIANCE] = s[X], max(s[P00], 0.0) + max(s[BEYOND], 0.0)
        rows[k, ROW_VELOCITY], rows[k, ROW_ACCEPTED], rows[k, ROW_SOURCE] = s[V], s[LAST_ACCEPTED], s[SOURCE]
    return j


@dataclass(frozen=True, slots=True)
class PrintedState:
    """What a `PrintedFilter` remembers: the state vector, and the frames that wait (k, 4)."""

    vector: Floats
    waiting: Floats


class PrintedFilter:
    """Equations 7 to 26 as a stream: displacement is pushed ahead of the acceleration that covers it.

    Any cutting of the input gives the same rows. Without bias, gate and limits; only the expected bias is taken off the
    acceleration, and a displacement before the first sample is ignored. The paper leaves the start open. Here it is at
    zero; velocity_std is the velocity's deviation unless `start_velocity_m_s` says it; R stays for `first_frames`
    frames, and is the position's variance, at the square of `start_noise_m`: left out, the first declared variance and
    the error of the held acceleration, see `start_noise`. Q is the square of `input_noise_m_s2`: left out, what the
    samples' noise density says.
    """

    def __init__(self, settings: MethodSettings, origin_ns: int, *, step_s: float, speed_m_s: float) -> None:
        """origin_ns: the first sample's stamp; step_s: the samples' usual interval; speed_m_s: the rms velocity."""
        self.settings, self.origin_ns, self._usual = settings, origin_ns, (step_s, speed_m_s)
        self._vector, self._waiting = state_before(settings), np.empty((0, 4))

    @property
    def state(self) -> PrintedState:
        """All that has an effect on what comes later."""
        return PrintedState(self._vector.copy(), self._waiting.copy())

    def restore(self, state: PrintedState) -> None:
        """Go on from where `state` was read."""
        self._vector, self._waiting = state.vector.copy(), state.waiting.copy()

    def wait(self, met: Displacement) -> None:
        """Take frames that are later than the last sample, all of them finite."""
        frames = (seconds(met.time_ns, self.origin_ns), met.value_m, met.variance_m2, met.source.astype(np.float64))
        self._waiting = np.concatenate((self._waiting, np.column_stack(frames)))[-MAX_WAITING:]

    def push(self, acceleration: Acceleration) -> tuple[Floats, Floats]:
        """Rows (n, 5) of the samples, and of the frames that they cover what they met (m, 4), see the column names."""
        time_s = seconds(acceleration.time_ns, self.origin_ns)
        density, (step_s, _) = acceleration.noise_density, self._usual
        if self.settings.input_noise_m_s2 is not None:
            density = np.full(len(density), self.settings.input_noise_m_s2**2 * step_s)
        samples = np.column_stack((time_s, acceleration.value_m_s2, density))
        first = int(np.searchsorted(self._waiting[:, 0], self._vector[TIME]))
        if self._vector[COUNT] == 0.0 and first < len(self._waiting):
            self._vector[NOISE] = start_noise(self.settings, float(self._waiting[first, 2]), *self._usual)
        rows, met = np.empty((len(samples), 5)), np.zeros((len(self._waiting), MET_COLUMNS))
        learning = (self.settings.forgetting, float(self.settings.first_frames))
        done = printed_block(samples, self._waiting, self._vector, learning, rows, met)
        self._waiting = self._waiting[done:]
        return rows, met[:done]

    def predict(self, time_ns: int) -> tuple[float, float]:
        """Displacement (m) and variance (m²) at a time after the last sample, before a frame there: equations 7 and 8.

        Infinite variance before the first frame, which the zero belongs to.
        """
        s, dt = self._vector, (time_ns - self.origin_ns) / NANOSECONDS - self._vector[TIME]
        variance = _moved((s[P00], s[P01], s[P11]), dt, s[INPUT_NOISE])[0] if s[COUNT] > 0.0 else np.inf
        return float(s[X] + dt * s[V] + 0.5 * dt * dt * s[INPUT]), float(max(variance, 0.0))


def run_printed(
    acceleration: Acceleration, displacement: Displacement, settings: MethodSettings, path: Smoothed | None
) -> Smoothed:
    """`printed` as `on_series` of METHODS: it begins at zero, so the series is counted from its first value."""
    level_m = float(displacement.value_m[np.argmax(np.isfinite(displacement.value_m))])
    found = printed(acceleration, replace(displacement, value_m=displacement.value_m - level_m), settings)
    return replace(found, estimate=replace(found.estimate, displacement_m=found.estimate.displacement_m + level_m))


def printed(acceleration: Acceleration, displacement: Displacement, settings: MethodSettings) -> Smoothed:
    """Equations 7 to 26 over a whole record: one row a sample, see `PrintedFilter`.

    `variance_m2` tells the noise that each measurement was taken with.
    """
    usable = np.isfinite(displacement.value_m) & np.isfinite(displacement.variance_m2)
    met_by = part(displacement, usable)
    time_s = seconds(acceleration.time_ns, int(acceleration.time_ns[0]))
    step_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    filtered = PrintedFilter(settings, int(acceleration.time_ns[0]), step_s=step_s, speed_m_s=speed_of(met_by))
    filtered.wait(met_by)
    rows, met = filtered.push(acceleration)
    used = np.flatnonzero(met[:, MET_USED] > 0.0)
    verdict = np.full(len(used), ACCEPTED, dtype=np.int8)
    innovation = Innovation(met_by.time_ns[used], met[used, MET_INNOVATION], met[used, MET_TOTAL], verdict)
    estimate = _estimate(acceleration, rows, time_s - rows[:, ROW_ACCEPTED], settings.kalman)
    return Smoothed(estimate, innovation, (), met[used, MET_NOISE])


def start_noise(settings: MethodSettings, declared_m2: float, step_s: float, speed_m_s: float) -> float:
    """The variance R (m²) of the first frames.

    A held acceleration lags by half a step, and its displacement is off by the velocity (rms `speed_m_s`) over that
    time: where R holds no more than the declared variance of a fine camera, the first frames fix a velocity that is
    wrong by it, and equation 20 takes what follows for noise.
    """
    if settings.start_noise_m is not None:
        return settings.start_noise_m**2
    return declared_m2 + (0.5 * step_s * speed_m_s) ** 2


def state_before(settings: MethodSettings) -> Floats:
    """The state vector at the first sample."""
    state, kalman = np.zeros(STATE_SIZE), settings.kalman
    # The printed equations know no bias: what is known of it is taken off the acceleration, gravity above all.
    state[B], state[LAST_ACCEPTED] = kalman.bias, -np.inf
    velocity_std = kalman.velocity_std if settings.start_velocity_m_s is None else settings.start_velocity_m_s
    state[P11] = velocity_std**2
    # Until the first frame nothing is known of the position that the printed start puts to zero.
    state[BEYOND] = kalman.displacement_std**2
    return state


def speed_of(series: Displacement) -> float:
    """Rms of the speed of a series, m/s."""
    known = np.isfinite(series.value_m)
    step_s, moved_m = np.diff(seconds(series.time_ns[known], 0)), np.diff(series.value_m[known])
    later = step_s > 0.0
    return float(np.sqrt(np.mean((moved_m[later] / step_s[later]) ** 2))) if later.any() else 0.0


def _estimate(acceleration: Acceleration, rows: Floats, age_s: Floats, kalman: KalmanSettings) -> Estimate:
    """The rows; `coasting` or `lost` by the age (n,) of their last frame."""
    status = np.where(age_s <= kalman.coasting_s, np.uint8(Status.TRACKING), np.uint8(Status.COASTING))
    status = np.where(age_s <= kalman.lost_s, status, np.uint8(Status.LOST))
    source = np.where(status == Status.TRACKING, rows[:, ROW_SOURCE], Source.PREDICTION).astype(np.uint8)
    displacement, variance, velocity = rows[:, [ROW_X, ROW_VARIANCE, ROW_VELOCITY]].T.copy()
    return Estimate(acceleration.time_ns, displacement, variance, velocity, source, status)
