"""`adaptive-kalman` exactly as printed: the noise of the displacement is estimated from frame to frame.

The adaptive multirate filter of Ma, Choi and Sohn, Computer-Aided Civil and Infrastructure Engineering 37 (2022)
688-703, doi 10.1111/mice.12767, equations 7 to 26: displacement and velocity, the acceleration held over each sample,
and the noise variance by equation 20, which can become negative and runs away under a bias (docs/methods.md). Letters
as there: G the covariance before a frame, K the gain, R the noise variance of a frame, beta the forgetting factor.
The guarded form is the estimator with a memory of as many measurements.
"""

from dataclasses import replace

import numpy as np

from midspan import _core
from midspan.fusion.blocks import ACCEPTED
from midspan.fusion.estimator import State, restore
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

# This many frames may wait for the samples that cover them; older ones are dropped.
MAX_WAITING = 65536
# Columns of what is given of each sample: displacement, its variance, velocity; time (s) and source of the last frame.
ROW_X, ROW_VARIANCE, ROW_VELOCITY, ROW_ACCEPTED, ROW_SOURCE = range(5)
# And of each frame: the innovation, its variance, the noise R, and whether it was used.
MET_INNOVATION, MET_TOTAL, MET_NOISE, MET_USED = range(4)


class PrintedFilter:
    """Equations 7 to 26 as a stream: displacement is pushed ahead of the acceleration that covers it.

    Any cutting of the input gives the same rows. Without bias, gate and limits; only the expected bias is taken off the
    acceleration, and a displacement before the first sample is ignored. The paper leaves the start open. Here it is at
    zero; velocity_std is the velocity's deviation unless `start_velocity_m_s` says it; R stays for `first_frames`
    frames, and is the position's variance, at the square of `start_noise_m`: left out, the first declared variance and
    the error of a held acceleration, see `held_noise`. Q is the square of `input_noise_m_s2`: left out, what the
    samples' noise density says. input_rule: between two samples acts the first one, as equation 7 is printed, or the
    mean of both.
    """

    def __init__(self, settings: MethodSettings, origin_ns: int, *, step_s: float, speed_m_s: float) -> None:
        """origin_ns: the first sample's stamp; step_s: the samples' usual interval; speed_m_s: the rms velocity."""
        self.settings, self.origin_ns, self._step_s = settings, origin_ns, step_s
        kalman, start_velocity = settings.kalman, settings.start_velocity_m_s
        self._core = _core.PrintedFilter(
            # The printed equations know no bias: what is known of it is taken off the acceleration, gravity above all.
            bias=kalman.bias,
            velocity_std=kalman.velocity_std if start_velocity is None else start_velocity,
            displacement_std=kalman.displacement_std,
            beta=settings.forgetting,
            first_frames=float(settings.first_frames),
            mean_input=settings.input_rule == "mean",
            start_noise=None if settings.start_noise_m is None else settings.start_noise_m**2,
            held_noise=0.0 if settings.input_rule == "mean" else held_noise(step_s, speed_m_s),
            waiting=MAX_WAITING,
        )

    @property
    def state(self) -> State:
        """All that has an effect on what comes later."""
        return np.frombuffer(self._core.state(), dtype=np.uint8)

    def restore(self, state: State) -> None:
        """Go on from where `state` was read."""
        restore(self._core, state)

    def wait(self, met: Displacement) -> None:
        """Take frames that are later than the last sample, all of them finite."""
        self._core.wait(
            seconds(met.time_ns, self.origin_ns),
            np.ascontiguousarray(met.value_m, dtype=np.float64),
            np.ascontiguousarray(met.variance_m2, dtype=np.float64),
            np.ascontiguousarray(met.source, dtype=np.uint8),
        )

    def push(self, acceleration: Acceleration) -> tuple[Floats, Floats]:
        """Rows (n, 5) of the samples, and of the frames that they cover what they met (m, 4), see the column names."""
        density = acceleration.noise_density
        if self.settings.input_noise_m_s2 is not None:
            density = np.full(len(density), self.settings.input_noise_m_s2**2 * self._step_s)
        rows, met = self._core.push(
            seconds(acceleration.time_ns, self.origin_ns),
            np.ascontiguousarray(acceleration.value_m_s2, dtype=np.float64),
            np.ascontiguousarray(density, dtype=np.float64),
        )
        return np.column_stack(rows), np.column_stack(met)

    def predict(self, time_ns: int) -> tuple[float, float]:
        """Displacement (m) and variance (m²) at a time after the last sample, before a frame there: equations 7 and 8.

        Infinite variance before the first frame, which the zero belongs to.
        """
        return self._core.predict((time_ns - self.origin_ns) / NANOSECONDS)


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


def held_noise(step_s: float, speed_m_s: float) -> float:
    """What is added to the variance R (m²) of the first frames.

    A held acceleration lags by half a step, and its displacement is off by the velocity (rms `speed_m_s`) over that
    time: where R holds no more than the declared variance of a fine camera, the first frames fix a velocity that is
    wrong by it, and equation 20 takes what follows for noise.
    """
    return float((0.5 * step_s * speed_m_s) ** 2)


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
