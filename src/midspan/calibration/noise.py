"""Noise levels by the innovations of a displacement sensor and the accelerometer, and their clock offset."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from midspan.calibration.agreement import clearly_better, misfit, noise_share, straightened
from midspan.calibration.direction import Direction
from midspan.calibration.fit import (
    Fit,
    Pair,
    aligned,
    best_corner,
    corner_range,
    evaluate,
    refine,
    with_corner_doubt,
    with_input_noise,
)
from midspan.calibration.minimum import minimum
from midspan.calibration.outliers import cleaned, without_lonely_outliers
from midspan.calibration.own_error import OwnError, find_own_error, whose
from midspan.calibration.own_noise import exceeds_own_noise, noise_floor
from midspan.calibration.scale import MIN_GAIN as MIN_AGREEMENT
from midspan.calibration.sensor_response import Exposed, LowPass, Play, find_exposure, find_low_pass
from midspan.calibration.slow_error import NOT_EXCLUDED, find_slow_error, lost
from midspan.calibration.time_offset import BEYOND, OffsetSearch, curvature, search_offset
from midspan.calibration.whitening import NO_SLOW_ERROR
from midspan.checks import instance
from midspan.notices import Notice
from midspan.records import InputNoise, TimeOffset
from midspan.signals.medians import white_noise

# A clock offset is only applied when it is this certain and the likelihood gains this much over none.
CERTAIN_S = 0.02
MIN_GAIN = 10.0
# One farther from 0 than this many of its standard deviations is one of hundreds tried, of which pure noise gains more.
NEAR, MIN_FAR_GAIN = 20.0, 20.0
# Where one clock is meant, an offset is first sought this near to none.
NEXT_TO_NONE_S = 0.05
# So much more than the largest offset is searched, and of a short record this share of its length at most.
EDGE_S, EDGE_SHARE, EDGE_OF_LENGTH = 0.02, 0.05, 0.1
# The accelerometer's gain is taken from the motion where that tells it better than its data sheet does (±5 % where
# nothing is given), and where it is no other unit.
USUAL_GAIN_STD, MAX_GAIN_ERROR = 0.03, 0.2
# A quiet camera sees a motion so well that the two noise levels meet this far above its Nyquist frequency.
FASTEST = 100.0
# Below this frequency, Hz, an accelerometer's drift may exceed a structure's acceleration.
DRIFT_HZ = 0.2
# Offset and exposure are sought in turn, so often.
EXPOSURES = 3
# The corner is raised by this factor until the sensor's noise is no more than its readings show.
HIGHER = 1.05
# A variance of measurements of which nothing is known, m².
NOT_KNOWN = 1e-30
# How well the logarithm of the corner of a motion's noise is found: far better than any record tells it.
MOTION_TOLERANCE = 1e-5


@dataclass(frozen=True, slots=True)
class Findings:
    """What a calibration rests on, for those who decide whether to believe it.

    pair, fit: measurements without outliers and their fit, offset included; search: of the clock offset, None where
    none was made; free: the best fit with any scale; likeliest: the best one with the scale as it is. levelled: pair
    and fit with the levels of the noise and the outliers by these, where it has several.
    """

    pair: Pair
    fit: Fit
    search: OffsetSearch | None
    free: Fit
    likeliest: Fit
    levelled: tuple[Pair, Fit] | None = None

    @property
    def noise(self) -> tuple[Pair, Fit]:
        """Pair and fit that the noise levels are those of."""
        return self.levelled or (self.pair, self.fit)


@dataclass(frozen=True, slots=True)
class NoiseCalibration:
    """Noise levels and clock offset of a displacement sensor.

    variance_factor: estimated variance per unit of the variance given with each measurement; input_noise: of the
    acceleration; offset: of the sensor's clock (zero with infinite variance when the motion does not tell); scale: the
    sensor's apparent scale against the accelerometer (1 when both are right) with its standard deviation. drifts:
    whether the acceleration tells nothing of the displacement because its bias drifts. reversed_gain: how much more
    likely (logarithm) the measurements are with the opposite sign; negative when they are right. factor, factor_std:
    metres in one metre read, where that was estimated as well: the other figures hold for readings times this factor. 1
    and 0: readings are taken as they are. noise_share: of the response to the acceleration that white noise alone would
    make; where it is large the motion tells no scale. gain: of the accelerometer relative to the sensor, where it was
    estimated, and its relative standard deviation, else 0. slow_std_m, slow_time_s, slow_hz: standard deviation,
    correlation time and frequency (0 Hz: first-order Gauss-Markov) of the sensor's slow error; 0: its noise is white.
    sway: an oscillation that only one of both sensors shows. unseen_m: how far the sensor may drift, and step, without
    that showing, see `SlowError`. exposure_s: time over which the sensor averages, as given or found; exposure_doubt,
    open_exposure_s, play: as of `Exposed`. direction: of the
    sensor's axis, None where the accelerometer's other axes were not recorded. warnings: sentences. low_pass: of the
    accelerometer's logger, where one shows: the offset is then that of slow motion. late_m: what clocks that differ,
    and are taken for one, make of the displacement, rms.
    """

    variance_factor: float
    input_noise: InputNoise
    offset: TimeOffset
    scale: float
    scale_std: float
    drifts: bool = False
    reversed_gain: float = -np.inf
    factor: float = 1.0
    factor_std: float = 0.0
    noise_share: float = 0.0
    gain: float = 1.0
    gain_std: float = 0.0
    slow_std_m: float = 0.0
    slow_time_s: float = np.inf
    slow_hz: float = 0.0
    sway: OwnError | None = None
    unseen_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    exposure_s: float = 0.0
    exposure_doubt: float = 1.0
    open_exposure_s: float = 0.0
    play: Play | None = None
    direction: Direction | None = None
    warnings: tuple[Notice, ...] = ()
    low_pass: LowPass | None = None
    late_m: float = 0.0
    findings: Findings | None = field(default=None, repr=False, compare=False)

    @property
    def sway_m(self) -> float:
        """Standard deviation (m) of an oscillation that either of both sensors may have."""
        nobodys = self.sway is not None and not (self.sway.alone and self.sway.taken)
        return abs(self.factor) * self.sway.std if nobodys and self.sway is not None else 0.0


def calibrate_noise(
    pair: Pair,
    max_offset_s: float,
    *,
    one_clock: bool = False,
    length_s: float = np.inf,
    gain_std: float = 0.0,
    noise_time_s: float | None = None,
    exposure_declared: bool = False,
) -> NoiseCalibration:
    """Learn noise levels of a displacement sensor of known unit, and its clock offset where the motion tells it.

    pair: displacement in m (ratio 1) with relative variances, and the acceleration. max_offset_s: 0 leaves the clocks
    be. one_clock: the clocks are one, so that the offset is only reported. length_s: of the record, see `edge_s`.
    gain_std: relative standard deviation of the accelerometer's gain as known before; it is estimated where the motion
    tells it better, and not at all with 0. noise_time_s: correlation time of the sensor's slow error where that is
    known, 0: none. exposure_declared: the pair's exposure is the sensor's own, else it is estimated. Nothing is refused
    here: see `Findings`.
    """
    instance("pair", pair, Pair, "a Pair of acceleration and displacement")
    whole = pair.rows
    edge = edge_s(max_offset_s, length_s)
    used, offset, search, found = _sought(pair, max_offset_s, edge, one_clock=one_clock, declared=exposure_declared)
    pair, fit, low_pass = used.pair, used.fit, None
    if search is not None and offset.value_s != 0.0:
        # Without any delay there is no low-pass.
        low_pass = find_low_pass(pair.changed(rows=search.pair.rows), found)
        if low_pass is not None:
            offset = TimeOffset(low_pass.offset_s, offset.variance)
            fit = fit if one_clock else best_corner(pair, low_pass.offset_s)
    # A wrong gain is no slow error.
    free = pair.changed(ratio=None) if gain_std > 0.0 else pair
    slow = find_slow_error(free, best_corner(free, fit.offset_s), noise_time_s, whole)
    sway = _sway(free, slow.fit) if noise_time_s is None else None
    errs = slow.pair.slow if sway is None else sway.pair.slow if sway.taken else NO_SLOW_ERROR
    if errs[0] > 0.0:
        pair = pair.changed(slow=errs)
        fit = best_corner(pair, fit.offset_s)
    floored_fit = _within_floor(pair, fit)
    estimated = _with_scale(pair, floored_fit, offset, search, max_offset_s, edge, floored=floored_fit is not fit)
    estimated = replace(
        estimated,
        scale_std=float(np.hypot(estimated.scale_std, used.spread)),
        low_pass=low_pass,
        sway=sway,
        unseen_m=slow.unseen,
        exposure_doubt=used.doubt,
        open_exposure_s=used.open_s,
        play=used.play,
    )
    assert estimated.findings is not None
    if slow.pair.rows is not free.rows or slow.pair.level is not None:
        # What is judged stays judged as it was.
        levelled = pair.changed(rows=slow.pair.rows, level=slow.pair.level)
        fit = _within_floor(levelled, best_corner(levelled, floored_fit.offset_s))
        findings = replace(estimated.findings, levelled=(levelled, fit))
        estimated = replace(estimated, **levels_of(levelled, fit), findings=findings)
    return estimated if gain_std == 0.0 else _without_gain(estimated, gain_std, used.spread)


def _sway(pair: Pair, slow: Fit) -> OwnError | None:
    """The oscillation that one of both sensors shows alone, where it is likelier than the slow error of a fit."""
    white = pair.changed(slow=NO_SLOW_ERROR)
    none = best_corner(white, slow.offset_s)
    own, _ = find_own_error(white, none, NOT_KNOWN)
    if own is None or not own.sways or own.fit.likelihood <= slow.likelihood:
        return None
    if lost(white, none, own.fit) > NOT_EXCLUDED:
        # It goes with the motion.
        return None
    return whose(own, none)


def levels_of(pair: Pair, fit: Fit, factor: float = 1.0) -> dict[str, Any]:
    """Noise levels of a calibration by a fit, of readings that are multiplied by a factor."""
    return {
        "variance_factor": fit.noise * factor * factor,
        "input_noise": pair.input_noise(fit.input_density),
        "slow_std_m": abs(factor) * float(np.sqrt(pair.slow[0] * fit.noise)),
    }


def _sought(
    pair: Pair, max_offset_s: float, edge: float, *, one_clock: bool, declared: bool
) -> tuple[Exposed, TimeOffset, OffsetSearch | None, Fit]:
    """What is applied of clock offset and undeclared exposure, each of which seems to be the other; the offset, its
    search, and the fit at the offset that was found.
    """
    pair, still = without_outliers(without_lonely_outliers(pair.changed(ratio=1.0)), steps=one_clock)
    here = Exposed(pair, still) if declared else find_exposure(pair, still, offset_cost=MIN_GAIN)
    if max_offset_s <= 0.0:
        return here, TimeOffset(0.0, np.inf), None, here.fit
    there = here
    for _ in range(EXPOSURES):
        search = search_offset(there.pair, max_offset_s, edge)
        found, variance = nearest(search) if one_clock else (search.fit, search.offset.variance)
        offset = applied(search, found, variance, max_offset_s)
        if offset.value_s == 0.0:
            return here, offset, search, found
        if declared:
            there = Exposed(search.pair, found)
            break
        none = search.pair.changed(exposure_s=0.0)
        own = best_corner(none, found.offset_s)
        before, there = there, find_exposure(none, own, offset_cost=MIN_GAIN)
        if there.pair.exposure_s == before.pair.exposure_s:
            break
    return here if one_clock else there, offset, search, found


def _without_gain(estimated: NoiseCalibration, known_std: float, spread: float) -> NoiseCalibration:
    """The calibration without the accelerometer's gain, where the motion tells it better than `known_std`, relative."""
    assert estimated.findings is not None
    findings = estimated.findings
    unknown = replace(findings.noise[0], ratio=None)
    pair, fit = with_input_noise(unknown, best_corner(unknown, estimated.offset.value_s))
    fit = _within_floor(pair, fit)
    fit = with_corner_doubt(pair, fit, disputed=exceeds_own_noise(pair, fit))
    std = float(np.hypot(fit.relative_std, spread))
    if not (fit.relative_std < known_std and abs(fit.ratio - 1.0) < MAX_GAIN_ERROR):
        return estimated
    # What is known before counts as well: the mean of both, by their variances.
    weight = known_std**2 / (known_std**2 + std**2)
    if findings.levelled is None:
        findings = replace(findings, pair=pair, fit=fit)
    else:
        judged = best_corner(findings.pair.changed(ratio=fit.ratio), findings.fit.offset_s)
        findings = replace(findings, fit=judged, levelled=(pair, fit))
    gain = 1.0 / (1.0 + weight * (fit.ratio - 1.0))
    gain_std = std * float(np.sqrt(weight))
    return replace(estimated, **levels_of(pair, fit), gain=gain, gain_std=gain_std, findings=findings)


def _within_floor(pair: Pair, fit: Fit) -> Fit:
    """The fit with no more noise of the sensor than its readings have, where innovations are not white at any scale."""
    most = noise_floor(pair.rows[fit.whitened.index, 1])
    if fit.noise <= most:
        return fit
    unknown = pair.changed(ratio=None)
    if misfit(unknown, best_corner(unknown, fit.offset_s, fit.corner)).factor <= 1.0:
        return fit
    here, highest = aligned(pair, fit.offset_s), corner_range(pair)[1]
    while fit.noise > most and fit.corner < highest:
        fit = here.fit(HIGHER * fit.corner)
    return fit


def _with_scale(
    pair: Pair,
    fit: Fit,
    offset: TimeOffset,
    search: OffsetSearch | None,
    max_offset_s: float,
    edge: float,
    *,
    floored: bool,
) -> NoiseCalibration:
    unknown = pair.changed(ratio=None)
    local = best_corner(unknown, offset.value_s)
    if floored and local.corner < fit.corner:
        local = aligned(unknown, offset.value_s).fit(fit.corner)
    likeliest = fit if search is None or search.fit.likelihood < fit.likelihood else search.fit
    others = [local]
    if search is not None:
        # With the wrong sign nothing fits but the lowest noise, or a clock offset of half a period.
        found = search_offset(unknown, max_offset_s, edge)
        others += [found.fit, *([] if found.runner_up is None else [found.runner_up])]
    # The same without what a smaller ratio was made to lose: comparable with the ratio as it is.
    others = [evaluate(pair.changed(ratio=one.ratio), one.offset_s, one.corner) for one in others]
    free = max(others, key=lambda one: one.likelihood)
    turned = [one.likelihood for one in others if one.ratio < 0.0 and one.gain > MIN_AGREEMENT]
    upright = [one.likelihood for one in (*others, likeliest) if one.ratio > 0.0]
    scale, std = local.ratio, float(np.sqrt(local.ratio_variance))
    straight = straightened(unknown, local)
    if straight is not None:
        # A clock that drifts takes from the scale.
        scale, std = straight[0].ratio, float(np.sqrt(straight[0].ratio_variance))
    return NoiseCalibration(
        **levels_of(pair, fit),
        offset=offset,
        scale=scale,
        scale_std=std,
        drifts=local.gain < MIN_AGREEMENT and _drifts(pair, offset.value_s),
        reversed_gain=max(turned, default=-np.inf) - max(upright),
        slow_time_s=1.0 / pair.slow[1] if pair.slow[0] > 0.0 else np.inf,
        slow_hz=pair.slow[2] / (2.0 * np.pi),
        exposure_s=pair.exposure_s,
        # What no white noise explains decides the ratio then.
        noise_share=np.inf if floored else noise_share(pair, local, white_noise(pair.samples[:, 1])),
        findings=Findings(pair, fit, search, free, likeliest),
    )


def _drifts(pair: Pair, offset_s: float) -> bool:
    """Whether the displacement follows the acceleration once that below DRIFT_HZ may have any factor."""
    from scipy.signal import butter, sosfiltfilt

    value, rate = pair.samples[:, 1], pair.sample_rate_hz
    if len(value) * DRIFT_HZ < rate or 0.4 * rate < DRIFT_HZ:
        return False
    fast = sosfiltfilt(butter(4, DRIFT_HZ, "highpass", fs=rate, output="sos"), value)
    time_s, density = pair.samples[:, 0], pair.samples[:, 2]
    samples, slow = (np.column_stack((time_s, part, density)) for part in (fast, value - fast))
    fit = best_corner(pair.changed(ratio=None, samples=samples, outside=slow), offset_s)
    return fit.gain > MIN_AGREEMENT and abs(fit.ratio - 1.0) < MAX_GAIN_ERROR


def edge_s(max_offset_s: float, length_s: float = np.inf) -> float:
    """How much farther (s) is searched in a record of `length_s` so that the largest offset is no edge."""
    return min(max(EDGE_SHARE * max_offset_s, EDGE_S), EDGE_OF_LENGTH * length_s)


def nearest(search: OffsetSearch) -> tuple[Fit, float]:
    """The fit next to no offset, unless one farther off is clearly better, and its offset's variance (s²)."""
    near = refine(search.pair, best_corner(search.pair, 0.0), NEXT_TO_NONE_S)
    # At the end of what is searched next to none it is no maximum.
    if abs(near.offset_s) >= 1.5 * NEXT_TO_NONE_S or clearly_better(search.fit, near):
        return search.fit, search.offset.variance
    return near, curvature(search.pair, near)[0]


def applied(search: OffsetSearch, fit: Fit, variance: float, max_offset_s: float) -> TimeOffset:
    """The offset of a fit where the motion tells it well enough to apply it; else 0, with a variance that says why."""
    std = float(np.sqrt(variance))
    if not std < CERTAIN_S:
        return TimeOffset(0.0, np.inf)
    least = MIN_GAIN if abs(fit.offset_s) < NEAR * std else MIN_FAR_GAIN
    if fit.likelihood - best_corner(search.pair, 0.0).likelihood < least:
        return TimeOffset(0.0, variance)
    return TimeOffset(fit.offset_s if abs(fit.offset_s) < max_offset_s + BEYOND * std else 0.0, variance)


def without_outliers(pair: Pair, *, steps: bool = False) -> tuple[Pair, Fit]:
    """The pair without outliers and its fit at no offset; steps: as of `cleaned`."""
    pair, fit = with_input_noise(pair, best_corner(pair, 0.0))
    pair = cleaned(pair, fit, steps=steps)
    return with_input_noise(pair, best_corner(pair, 0.0))


def learn_motion(pair: Pair) -> float:
    """How strongly a motion without an accelerometer is shaken: density of a white acceleration, (m/s²)²/Hz.

    pair: displacement in m with variances that are right, and samples of zero acceleration: the motion itself is the
    noise of the model. By maximum likelihood of the innovations; the noise is not fitted with it, which would take a
    motion faster than the frames follow for noise.
    """
    pair = without_lonely_outliers(pair)
    typical = float(np.median(pair.rows[np.isfinite(pair.rows[:, 2]), 2]))
    here = aligned(pair.changed(rows=pair.rows / np.array([1.0, 1.0, typical])), 0.0)
    low, high = np.log(corner_range(pair))

    def cost(corner: float) -> float:
        w = here.whitened(float(np.exp(corner)))
        return 2.0 * w.entropy + w.product(w.translation, w.translation) / typical

    grid = np.linspace(low, high + np.log(FASTEST), 25)
    best, step = grid[int(np.argmin([cost(corner) for corner in grid]))], grid[1] - grid[0]
    found = minimum(cost, best - step, best + step, MOTION_TOLERANCE)
    return typical * float(np.exp(4.0 * found)) / pair.rate_hz
