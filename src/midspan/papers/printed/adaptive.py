"""`adaptive-kalman` exactly as printed: the noise of the displacement is estimated from frame to frame.

The adaptive multirate filter of Ma, Choi and Sohn, Computer-Aided Civil and Infrastructure Engineering 37 (2022)
688-703, doi 10.1111/mice.12767, equations 7 to 26: displacement and velocity, the acceleration held over each sample,
and the noise variance by equation 20, which can become negative and runs away under a bias (docs/methods.md). Letters
as there: G the covariance before a frame, K the gain, R the noise variance of a frame, beta the forgetting factor.
The guarded form is the estimator with a memory of as many measurements.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from midspan import _core
from midspan.fusion.blocks import VELOCITY_WITHIN
from midspan.fusion.entry import MAX_M
from midspan.fusion.estimator import State, restore
from midspan.fusion.on_series import MethodRows, SampleBuffer, Usual
from midspan.fusion.streams import MethodSettings
from midspan.records import NANOSECONDS, Acceleration, Displacement, Event, Floats, Nanoseconds, joined, part, seconds

# This many frames may wait for the samples that cover them; older ones are dropped.
MAX_WAITING = 65536


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
        )

    def push(self, acceleration: Acceleration) -> tuple[Floats, Floats, Floats]:
        """Displacement (m) and velocity (m/s) at samples (n,); R (m²) of covered frames (m,), NaN of unused ones."""
        density = acceleration.noise_density
        if self.settings.input_noise_m_s2 is not None:
            density = np.full(len(density), self.settings.input_noise_m_s2**2 * self._step_s)
        displacement, velocity, noise = self._core.push(
            seconds(acceleration.time_ns, self.origin_ns),
            np.ascontiguousarray(acceleration.value_m_s2, dtype=np.float64),
            np.ascontiguousarray(density, dtype=np.float64),
        )
        return displacement, velocity, noise

    def predict(self, time_ns: int) -> tuple[float, float]:
        """Displacement (m) and variance (m²) at a time after the last sample, before a frame there: equations 7 and 8.

        Infinite variance before the first frame, which the zero belongs to.
        """
        return self._core.predict((time_ns - self.origin_ns) / NANOSECONDS)


# Estimated noise over that of the start beyond which it runs away.
RUN_AWAY = 10.0
AS_PRINTED = (
    "fusion.literal: the rows are those of the filter exactly as printed, without bias, gate and limits. Its own "
    "covariance does not hold its error: the band is the guarded filter's and what the two differ by."
)
GROWN = (
    "fusion.literal: the estimated noise grew to {:.3g} times that of the start: it runs away, most often under a bias "
    "of the accelerometer. Leave fusion.literal out."
)
NOTHING = Displacement(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0), np.empty(0, dtype=np.uint8))


class AdaptiveRows:
    """The filter as a method over a series, counted from its first displacement."""

    delay_samples = 0

    def __init__(self, settings: MethodSettings, usual: Usual) -> None:
        """See `fusion.on_series`."""
        self._settings, self._usual = settings, usual
        self._filter: PrintedFilter | None = None
        self._level_m, self._early, self._rows = np.nan, NOTHING, SampleBuffer(2)
        # Stamps of the frames that wait. Variance R of the start: NaN before it, infinite once its growth is an event.
        self._frames_ns, self._start_m2 = NOTHING.time_ns, np.nan
        self._events: tuple[Event, ...] = ()

    def wait(self, met: Displacement) -> None:
        """Take displacements that are later than the last sample; those before the first sample do not count."""
        if self._filter is None:
            # Some may be of the first samples' instants, which the guard held.
            early = joined([self._early, met])
            self._early = part(early, slice(-max(MAX_WAITING, len(met.time_ns)), None))
            return
        if np.isnan(self._level_m) and len(met.time_ns):
            self._level_m = float(met.value_m[0])
        self._frames_ns = np.append(self._frames_ns, met.time_ns)
        self._filter.wait(replace(met, value_m=met.value_m - self._level_m))

    def push(self, acceleration: Acceleration) -> None:
        """Take further samples."""
        if self._filter is None:
            self._filter = self._begun(int(acceleration.time_ns[0]))
            self.wait(part(self._early, self._early.time_ns >= acceleration.time_ns[0]))
        displacement, velocity, noise = self._filter.push(acceleration)
        self._watch(noise)
        self._rows.add(acceleration.time_ns, displacement, velocity)

    def rows(self, time_ns: Nanoseconds) -> MethodRows:
        """The rows at samples (n,), as far as they are finite: beyond that the filter ran away."""
        place, kept = self._rows.at(time_ns)
        found = np.full((2, len(time_ns)), np.nan)
        for row, column in zip(found, self._rows.columns, strict=True):
            row[kept] = column[place[kept]]
        self._rows.drop_first(int(place[-1]))
        displacement = found[0] + np.nan_to_num(self._level_m)
        events, self._events = self._events, ()
        valid = (np.abs(displacement) <= MAX_M) & np.isfinite(found[1])
        return MethodRows(displacement, found[1], valid, events)

    def _watch(self, noise_m2: Floats) -> None:
        """Report with the first frame what the rows are, and once that R has grown far beyond that of the start."""
        stamps, self._frames_ns = self._frames_ns[: len(noise_m2)], self._frames_ns[len(noise_m2) :]
        used = np.isfinite(noise_m2)
        if np.isnan(self._start_m2) and used.any():
            first = int(np.argmax(used))
            self._start_m2, self._events = float(noise_m2[first]), (Event(int(stamps[first]), "literal", AS_PRINTED),)
        beyond = noise_m2 > RUN_AWAY**2 * self._start_m2
        if beyond.any():
            first = int(np.argmax(beyond))
            grown, self._start_m2 = np.sqrt(noise_m2[first] / self._start_m2), np.inf
            self._events += (Event(int(stamps[first]), "literal", GROWN.format(grown)),)

    def predict(self, time_ns: int) -> tuple[float, float] | None:
        """Of `PrintedFilter`, counted as the series is."""
        if self._filter is None:
            return None
        value_m, variance_m2 = self._filter.predict(time_ns)
        return value_m + float(np.nan_to_num(self._level_m)), variance_m2

    @property
    def state(self) -> tuple[Any, ...]:
        """All that has an effect on what comes later."""
        one, early = self._filter, self._early
        waiting = early.time_ns, early.value_m, early.variance_m2, early.source
        own = None if one is None else (one.state, one.origin_ns)
        return own, self._level_m, waiting, self._rows.state, self._frames_ns, self._start_m2, self._events

    @state.setter
    def state(self, state: tuple[Any, ...]) -> None:
        own, self._level_m, waiting, self._rows.state, self._frames_ns, self._start_m2, self._events = state
        self._early, self._filter = Displacement(*waiting), None
        if own is not None:
            self._filter = self._begun(own[1])
            self._filter.restore(own[0])

    def _begun(self, origin_ns: int) -> PrintedFilter:
        usual, kalman = self._usual, self._settings.kalman
        settings = replace(self._settings, kalman=replace(kalman, velocity_std=VELOCITY_WITHIN * usual.speed_m_s))
        return PrintedFilter(settings, origin_ns, step_s=usual.step_s, speed_m_s=usual.speed_m_s)


def held_noise(step_s: float, speed_m_s: float) -> float:
    """What is added to the variance R (m²) of the first frames.

    A held acceleration lags by half a step, and its displacement is off by the velocity (rms `speed_m_s`) over that
    time: where R holds no more than the declared variance of a fine camera, the first frames fix a velocity that is
    wrong by it, and equation 20 takes what follows for noise.
    """
    return float((0.5 * step_s * speed_m_s) ** 2)
