"""The gate before the FIR branches: a causal filter runs beside them and judges each displacement as `kalman` does.

What it rejects is replaced by what it predicts, as long as that is about as good as a measurement; afterwards there is
a hole. So is what is missing. The branches need no state for it and their delay stays.
"""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from midspan.fusion.adaptive import AdaptiveSettings, state_before
from midspan.fusion.adaptive_recursion import (
    ADAPTIVE_SIZE,
    MEDIAN_STEP,
    MET_COLUMNS,
    MET_INNOVATION,
    MET_NOISE,
    MET_TOTAL,
    MET_VERDICT,
    NOISE,
    SIXTH,
    SPREAD,
    THIRD,
    UNUSED,
    meet,
    stamp_before,
)
from midspan.fusion.gate import ACCEPTED, REACQUIRED, REJECTED
from midspan.fusion.kalman import KalmanSettings
from midspan.fusion.missing import MissingFrames
from midspan.fusion.state_space import (
    GAP_STEPS,
    INPUT,
    LAST_ACCEPTED,
    LEAD,
    P00,
    P22,
    REJECTIONS,
    SLOPE,
    STEP,
    TIME,
    B,
    V,
    X,
    advance_covariance,
    begin_interval,
)
from midspan.records import Acceleration, Displacement, Floats, Innovation, part, seconds

# Behind the state vector of `adaptive_recursion`: the time that the covariance belongs to, and the acceleration's noise
# density from there on; the variance that the last measurement declared.
SPREAD_AT, DENSITY, DECLARED = ADAPTIVE_SIZE, ADAPTIVE_SIZE + 1, ADAPTIVE_SIZE + 2
SCREEN_SIZE = ADAPTIVE_SIZE + 3
# What is left for each missing measurement: what was predicted, its variance, a measurement's, and the seconds since
# the last accepted one.
TOLD_VALUE, TOLD_AHEAD, TOLD_DECLARED, TOLD_AGE = range(4)
TOLD_COLUMNS = 4
# An expected bias this many of its deviations from the first samples' mean is not believed: gravity, mostly.
FARTHEST_BIAS = 3.0
# A prediction stands in for a rejected measurement while its variance is below this many of the measurement's. It then
# counts as a measurement with so many of its own variance more: its error is alike to those of the ones before it.
BELIEVED_VARIANCES, ALIKE = 1.0, 2.0
# Of missing ones several come in a row, and their predictions share one error: with this many the bands near them hold
# 94 % instead of 92 %.
ALIKE_IN_A_ROW = 4.0


@dataclass(frozen=True, slots=True)
class Screened:
    """Measurements (m,) after the gate.

    believed: those not to be used have an infinite variance. bridged: instead of rejected ones what was predicted, or
    no number where no prediction was good enough: a hole that must not be bridged. missing (q,): the same for instants
    without a measurement, which do not count beside one. reacquired: indices of the measurements whose new level was
    taken over.
    """

    believed: Displacement
    bridged: Displacement
    missing: Displacement
    reacquired: NDArray[np.int64]
    innovation: Innovation

    def pieces(self) -> list["Screened"]:
        """The measurements before the first new level, and those from each new level on, with no verdicts."""
        count, jumps_ns = len(self.believed.time_ns), self.believed.time_ns[self.reacquired]
        met = [0, *self.reacquired, count]
        gone = [0, *np.searchsorted(self.missing.time_ns, jumps_ns), len(self.missing.time_ns)]
        found = []
        for i in range(len(met) - 1):
            which, absent = slice(met[i], met[i + 1]), slice(gone[i], gone[i + 1])
            alone = unscreened(part(self.believed, which), part(self.bridged, which))
            found.append(replace(alone, missing=part(self.missing, absent)))
        return found


class Screen:
    """The gate of one stream. Acceleration and the measurements that it covers are taken in time order."""

    def __init__(self, settings: KalmanSettings) -> None:
        self._settings = AdaptiveSettings(kalman=settings)
        self._state = np.zeros(SCREEN_SIZE)
        self._missing = MissingFrames()
        self._origin_ns = 0
        self._begun = False

    def begin(self, first: Acceleration, every_s: float = np.inf) -> None:
        """A stretch without gaps begins with the samples `first`; what is known of the bias and the noise is kept.

        every_s: interval of an even series of measurements, s; infinite: nothing is known to be left out.
        """
        self._missing.begin(every_s, self._settings.kalman.coasting_s)
        before, self._origin_ns = self._state, int(first.time_ns[0])
        self._state = np.zeros(SCREEN_SIZE)
        self._state[:ADAPTIVE_SIZE] = state_before(first, self._settings)
        self._state[[SPREAD_AT, DENSITY]] = self._state[TIME], first.noise_density[0]
        if self._begun:
            kept = [B, P22, NOISE, MEDIAN_STEP, SPREAD]
            self._state[kept] = before[kept]
            return
        self._begun = True
        kalman, mean = self._settings.kalman, float(np.mean(first.value_m_s2))
        if abs(mean - kalman.bias) > FARTHEST_BIAS * kalman.bias_std:
            self._state[B] = mean

    def judge(self, block: Acceleration, due: Displacement) -> Screened:
        """Run on over a block of acceleration (n,) and judge the measurements (m,) in it."""
        due = _usable(due)
        time_s = seconds(due.time_ns, self._origin_ns)
        rows = np.column_stack((time_s, due.value_m, due.variance_m2, due.source))
        met = np.zeros((len(rows), MET_COLUMNS))
        met[:, MET_VERDICT] = UNUSED
        samples = (block.time_ns, self._origin_ns, block.value_m_s2, block.noise_density)
        gone = self._missing.until(due, int(block.time_ns[-1]))
        told = np.full((len(gone.time_ns), TOLD_COLUMNS), np.nan)
        asked = seconds(gone.time_ns, self._origin_ns)
        screen_block(samples, (rows, asked), self._state, self._settings.options, (met, told))
        # Before a stretch's first sample nothing is predicted: what is measured there is used, and told as the level.
        early = (met[:, MET_VERDICT] == UNUSED) & (due.variance_m2 < np.inf)
        if early.any():
            met[early, MET_VERDICT], met[early, MET_NOISE] = ACCEPTED, due.variance_m2[early]
            met[early, MET_TOTAL] = self._settings.kalman.displacement_std**2 + due.variance_m2[early]
        return _screened(due, met, _predicted(gone, told, self._settings.kalman.coasting_s))


def unscreened(believed: Displacement, bridged: Displacement | None = None) -> Screened:
    """Measurements that no gate has judged, or whose verdicts are told already."""
    nobody = Innovation(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0), np.empty(0, dtype=np.int8))
    if bridged is None:
        believed = bridged = _usable(believed)
    return Screened(believed, bridged, part(believed, slice(0)), np.empty(0, dtype=np.int64), nobody)


def _usable(measured: Displacement) -> Displacement:
    """The same measurements, infinite the variance of those not to be used."""
    usable = np.isfinite(measured.value_m) & np.isfinite(measured.variance_m2) & (measured.variance_m2 > 0.0)
    return measured if usable.all() else replace(measured, variance_m2=np.where(usable, measured.variance_m2, np.inf))


def _predicted(gone: Displacement, told: Floats, longest_s: float) -> Displacement:
    """What stands in for missing measurements (q,): a prediction that is sharp and young enough, else a hole."""
    known = np.isfinite(told[:, TOLD_AHEAD])
    ahead, declared = told[:, TOLD_AHEAD], told[:, TOLD_DECLARED]
    good = (ahead <= BELIEVED_VARIANCES * declared) & (told[:, TOLD_AGE] <= longest_s)
    variance = declared + np.where(good, ALIKE_IN_A_ROW * ahead, 0.0)
    return part(replace(gone, value_m=np.where(good, told[:, TOLD_VALUE], np.nan), variance_m2=variance), known)


def _screened(due: Displacement, met: Floats, missing: Displacement) -> Screened:
    """The usable measurements as the gate leaves them."""
    verdict, total = met[:, MET_VERDICT], met[:, MET_TOTAL]
    told = Innovation(due.time_ns, met[:, MET_INNOVATION].copy(), total.copy(), verdict.astype(np.int8))
    used = verdict != UNUSED
    told = told if used.all() else part(told, used)
    believed = bridged = due
    rejected = verdict == REJECTED
    if rejected.any():
        ahead = total - met[:, MET_NOISE]
        good = ahead <= BELIEVED_VARIANCES * due.variance_m2
        predicted = np.where(good, due.value_m - met[:, MET_INNOVATION], np.nan)
        believed = replace(due, variance_m2=np.where(rejected, np.inf, due.variance_m2))
        variance = due.variance_m2 + np.where(rejected, ALIKE * ahead, 0.0)
        bridged = replace(due, value_m=np.where(rejected, predicted, due.value_m), variance_m2=variance)
    return Screened(believed, bridged, missing, np.flatnonzero(verdict == REACQUIRED), told)


@njit(cache=True, inline="always")
def _spread(s, until, walk):  # type: ignore[no-untyped-def]
    """Bring the covariance to the time `until`, over as many samples as that takes: their noise is the same."""
    advance_covariance(s, until - s[SPREAD_AT], s[DENSITY] * s[SPREAD], walk)
    s[SPREAD_AT] = until


@njit(cache=True, inline="always")
def _coast(samples, k, until, s, walk):  # type: ignore[no-untyped-def]
    """Samples k up to the first at or just before the time `until`, without measurements; returns where it stopped.

    As in `adaptive_recursion`, but for the covariance, which is brought forward only where it is needed.
    """
    time_ns, origin_ns, values, densities = samples
    x, v, b, a0, t1 = s[X], s[V], s[B], s[INPUT], s[TIME]
    step, lead, slope, density = s[STEP], s[LEAD], s[SLOPE], s[DENSITY]
    last_ns, stop_ns = origin_ns + np.int64(np.rint(t1 * 1e9)), stamp_before(until, origin_ns)
    step_ns, dt, inverse, half, twelfth, rise = np.int64(-1), 0.0, 0.0, 0.0, 0.0, 0.0
    while k < len(time_ns) and time_ns[k] < stop_ns:
        if densities[k] != density:
            _spread(s, (last_ns - origin_ns) / 1e9, walk)
            s[DENSITY] = density = densities[k]
        if time_ns[k] - last_ns != step_ns or step < dt:
            step_ns = time_ns[k] - last_ns
            dt = step_ns / 1e9
            inverse, half = 1.0 / dt, 0.5 * dt * dt
            twelfth = half * SIXTH * inverse if dt <= GAP_STEPS * step else 0.0
            v += (twelfth * dt - lead) * 0.5 * (slope + (values[k] - a0) * inverse)
            step, lead = min(dt, GAP_STEPS * step), twelfth * dt
        last_ns = time_ns[k]
        rise = values[k] - a0
        x += dt * (v - twelfth * rise) + half * (a0 + THIRD * rise - b)
        v += dt * (a0 + 0.5 * rise - b)
        a0, slope = values[k], rise * inverse
        k += 1
    s[X], s[V], s[INPUT], s[TIME] = x, v, a0, (last_ns - origin_ns) / 1e9
    s[STEP], s[LEAD], s[SLOPE] = step, lead, slope
    return k


@njit(cache=True, inline="always")
def _glide(s, dt, force):  # type: ignore[no-untyped-def]
    """Move the mean by `dt` within an interval; force = (acceleration now, its slope, the velocity state's lead)."""
    a, slope, lead = force
    half = 0.5 * dt * dt
    s[X] += dt * (s[V] - lead * slope) + half * (a + THIRD * dt * slope - s[B])
    s[V] += dt * (a - s[B]) + half * slope


@njit(cache=True, error_model="numpy")
def _foretell(samples, k, asked, i, s, walk, told):  # type: ignore[no-untyped-def]
    """What is predicted at the instants asked for (i and on) up to sample k; returns the first one after it.

    The state stays as it is to the last digit: that an instant was asked for may turn out to be for nothing.
    """
    time_ns, origin_ns, values, densities = samples
    t0, a0, t1 = s[TIME], s[INPUT], (time_ns[k] - origin_ns) / 1e9
    while i < len(asked) and asked[i] <= t1:
        if asked[i] >= t0 and s[LAST_ACCEPTED] > -np.inf:
            c = s.copy()
            if densities[k] != c[DENSITY]:
                _spread(c, t0, walk)
                c[DENSITY] = densities[k]
            lead = begin_interval(c, t1 - t0, a0, values[k])
            _glide(c, asked[i] - t0, (a0, c[SLOPE], lead))
            _spread(c, asked[i], walk)
            told[i, TOLD_VALUE], told[i, TOLD_AHEAD] = c[X], c[P00]
            told[i, TOLD_DECLARED], told[i, TOLD_AGE] = c[DECLARED], asked[i] - c[LAST_ACCEPTED]
        i += 1
    return i


@njit(cache=True, error_model="numpy")
def screen_block(samples, due, s, options, found):  # type: ignore[no-untyped-def]
    """Judge the measurements of one block; the state vector `s` carries over to the next block.

    samples and options as in `guarded_block`. due = measurements (m, 4): time in s, displacement, variance (infinite:
    ignored), source; and the times (q,) of missing ones; both in time order. found = met (m, 4) as there, and told
    (q, 4), which takes what is predicted for the missing ones and keeps its numbers where nothing is.
    """
    time_ns, origin_ns, values, densities = samples
    walk, limits, rule = options
    measurements, asked = due
    met, told = found
    i = j = k = 0
    while k < len(time_ns):
        until = measurements[j, 0] if j < len(measurements) else np.inf
        wanted = asked[i] if i < len(asked) else np.inf
        k = _coast(samples, k, min(until, wanted), s, walk)
        if k == len(time_ns):
            return
        t0, a0, t1 = s[TIME], s[INPUT], (time_ns[k] - origin_ns) / 1e9
        if wanted <= t1:
            i = _foretell(samples, k, asked, i, s, walk, told)
            continue
        if densities[k] != s[DENSITY]:
            _spread(s, t0, walk)
            s[DENSITY] = densities[k]
        lead = begin_interval(s, t1 - t0, a0, values[k])
        reached, slope = t0, s[SLOPE]
        while j < len(measurements) and measurements[j, 0] <= t1:
            time, value, declared, source = measurements[j]
            if time < reached or not declared < np.inf:
                met[j, MET_VERDICT] = UNUSED
            else:
                _glide(s, time - reached, (a0 + (reached - t0) * slope, slope, lead))
                _spread(s, time, walk)
                reached = time
                if s[LAST_ACCEPTED] == -np.inf and s[REJECTIONS] == 0.0:
                    # The level is the first measurement's, however high.
                    s[X] = value
                s[DECLARED] = declared
                meet(s, met, j, (time, value, declared, source), limits, rule)
            j += 1
        if reached < t1:
            _glide(s, t1 - reached, (a0 + (reached - t0) * slope, slope, lead))
        s[TIME], s[INPUT] = t1, values[k]
        k += 1
