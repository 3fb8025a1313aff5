"""What is estimated of a displacement sensor, what to know of it, and its measurements in metres."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from midspan.calibration.accelerometer_clock import refuse_forward_step
from midspan.calibration.agreement import Misfit, misfit
from midspan.calibration.causes import REMEDIES, Cause, disagreement, likelier_than_offset, named_cause
from midspan.calibration.clock_rate import ClockRate
from midspan.calibration.displacement.learn import Given, LoggerDelayError, clock_rate, late_m, learn
from midspan.calibration.noise import DRIFT_HZ, NoiseCalibration
from midspan.calibration.own_noise import strange_noise
from midspan.calibration.scale_check import MAX_NOISE
from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.calibration.sensors.fit import SensorFit, bias_of
from midspan.errors import DataError, MidspanError, UntrustedError
from midspan.notices import Notice
from midspan.records import NANOSECONDS, TimeSeries, seconds
from midspan.signals.acceleration import PreparedAcceleration
from midspan.signals.averaging import taken_by_averaging
from midspan.signals.clipping import range_limits, resolution
from midspan.signals.health import Mask, runs
from midspan.signals.medians import white_noise
from midspan.signals.stamps import shown
from midspan.signals.stuck import stuck

# A scale that was not estimated is reported when off by this share and this many deviations, refused beyond the third.
REPORTED, CERTAIN, REFUSED = 0.015, 4.5, 0.5
# A gain that was estimated is named when off by more than this many deviations.
NOTICED = 2.0
# A given noise of a displacement sensor is taken unless the sensors differ as if it were this many times larger.
MAX_OPTIMISTIC = 1.5
# The slow error of a GNSS receiver, m and s: multipath, of which a record of minutes shows nothing. It is 2 to 8 mm and
# takes 40 to 300 s to change; what is larger or faster shows.
GNSS_SLOW = (3e-3, 100.0)
# Displacement sensors of this much white noise, m, are GNSS receivers and total stations; wires and lasers have less.
RECEIVER_NOISE_M = 0.5e-3
# Where this many values would count as frozen, the sensor's resolution is coarse compared with the motion.
MAX_FROZEN = 0.5


DisplacementFit = SensorFit[DisplacementCalibration, NoiseCalibration]


def fit_displacement(given: Given) -> DisplacementFit:
    """Noise, clock offset and scale of the sensor, estimated relative to the accelerometer, or a refusal."""
    ends = range_limits(given.series.value)
    held = (given.series.value <= ends[0]) | (given.series.value >= ends[1])
    given = replace(given, series=_without(given.series, held))
    refuse_forward_step(given.prepared, given.series.time_ns, given.series.value, "displacement")
    rate = None if given.learns_offset is False else _clock_rate(given)
    if rate is not None:
        given = replace(given, series=replace(given.series, time_ns=rate.even(given.series.time_ns)))
    given, estimated = _on_its_clock(given, rate)
    assert estimated.findings is not None
    pair, fit = estimated.findings.noise
    low, high = sorted(estimated.factor * end for end in ends)
    part = replace(_part(given, estimated), low_m=low, high_m=high)
    warnings = [*_range_warnings(part, held), *_warnings(given, estimated, part)]
    # A scale that seems wrong is a misfit which the band holds already.
    found = Misfit() if _scale_error(estimated) > 0.0 else misfit(pair, fit)
    causes = "slow errors, or a mounting that moves"
    warnings += found.text("displacement") or strange_noise(pair, fit, "displacement", causes)
    spread = float(np.sqrt(found.factor))
    warnings += _gain_note(estimated, spread * estimated.gain_std)
    part = replace(part, scale_std=spread * part.scale_std)
    if rate is not None:
        part = replace(part, clock_rate=rate.late, clock_reference_s=rate.reference_ns / NANOSECONDS)
    return DisplacementFit(
        part,
        estimated.input_noise,
        bias_of(pair, fit),
        tuple(warnings),
        estimated,
        estimated.gain,
        spread * estimated.gain_std,
        found,
        direction=estimated.direction,
    )


def _clock_rate(given: Given) -> ClockRate | None:
    step_m = 0.0 if given.learns_scale else None
    series = _without(given.series, _frozen_values(given.prepared, given.series, resolution_m=step_m))
    try:
        return clock_rate(replace(given, series=series))
    except DataError:
        # Too few values, or one and the same: it is refused where they are calibrated on.
        return None


def _on_its_clock(given: Given, rate: ClockRate | None) -> tuple[Given, NoiseCalibration]:
    """What is estimated of the sensor on one clock with the accelerometer or on its own, and which of the two it was.

    rate: of its clock, where that was taken out of the stamps. Where it is not said whether the clocks are one, they
    are unless the motion shows an offset that nothing speaks against.
    """
    if given.learns_offset is not None:
        try:
            return given, with_rate(_estimated(given), rate)
        except UntrustedError as error:
            if not given.learns_offset and (other := _clock_rate(given)) is not None:
                raise two_rates(other) from error
            raise
    shared, own = replace(given, learns_offset=False), replace(given, learns_offset=True)
    found, refused = None, None
    if rate is None:
        try:
            found = _estimated(shared)
        except LoggerDelayError:
            raise
        except UntrustedError as error:
            refused = error
        if found is not None and (found.late_m == 0.0 or found.low_pass is not None):
            return shared, found
    try:
        apart = _estimated(own)
    except MidspanError:
        apart = None
    if apart is not None and rate is not None:
        return own, with_rate(apart, rate)
    if apart is not None and apart.offset.value_s != 0.0 and apart.low_pass is None:
        return own, with_offset(apart)
    if refused is not None:
        raise refused
    return (shared, found) if found is not None else (shared, with_rate(_estimated(shared), rate))


def _estimated(given: Given) -> NoiseCalibration:
    """Noise, clock offset, and with displacement.estimate_scale the scale of the sensor, or a refusal."""
    series, prepared = given.series, given.prepared
    if not given.learns_scale:
        return learn(given, _without(series, _frozen_values(prepared, series)))
    # What the values are rounded to is known in metres only with the scale: at first none of it is granted.
    crude = _frozen_values(prepared, series, resolution_m=0.0)
    known = np.isfinite(series.value)
    first = _without(series, crude if np.mean(crude[known]) < MAX_FROZEN else np.zeros_like(crude))
    estimated = learn(given, first)
    offset_ns = round(NANOSECONDS * estimated.offset.value_s)
    scaled = replace(series, time_ns=series.time_ns + offset_ns, value=estimated.factor * series.value)
    held = _frozen_values(prepared, scaled)
    return estimated if np.array_equal(held, np.isnan(first.value) & known) else learn(given, _without(series, held))


def with_rate(estimated: NoiseCalibration, rate: ClockRate | None) -> NoiseCalibration:
    """The calibration with the rate of the clock that was corrected."""
    if rate is None:
        return estimated
    offset = replace(estimated.offset, variance=estimated.offset.variance + rate.offset_variance)
    text = (
        f"displacement: its clock drifts by {rate.ppm:+.1f} ± {1e6 * rate.std:.1f} ppm relative to the "
        f"accelerometer's ({1e3 * abs(rate.late) * rate.length_s:.4g} ms in {rate.length_s:.4g} s); corrected."
    )
    return replace(estimated, offset=offset, warnings=(*estimated.warnings, Notice("clock-corrected", text)))


def with_offset(estimated: NoiseCalibration) -> NoiseCalibration:
    """The calibration with a sentence on an offset that was not asked for.

    A clock that is off is the simplest of what makes readings late: another cause is named where it explains them
    clearly better. Of these only a logger's low-pass makes the result late, by as much as the offset: late_m.
    """
    assert estimated.findings is not None
    cause = named_cause(estimated.findings.pair)
    text = (
        f"displacement: its clock seems to differ from the accelerometer's by {1e3 * estimated.offset.value_s:+.4g} ± "
        f"{1e3 * np.sqrt(estimated.offset.variance):.2g} ms; corrected. "
    )
    if estimated.play is not None and estimated.offset.value_s < 0.0:
        text += "Play (backlash) in its joint makes it late. "
    elif cause is not None:
        text += likelier_than_offset(cause)
    if estimated.offset.value_s > 0.0 and cause is not None and cause.cause is Cause.LOW_PASS:
        estimated = replace(estimated, late_m=late_m(estimated, estimated.findings))
        text += (
            f"In that case the result is late by this offset; the error band includes {1e3 * estimated.late_m:.2g} mm "
            "rms for it. Set displacement.estimate_offset = true if it is the clock; "
        )
    else:
        text += "Set displacement.estimate_offset = true to confirm; "
    text += "false if both share one clock."
    return replace(estimated, warnings=(*estimated.warnings, Notice("clock-corrected", text)))


def two_rates(rate: ClockRate) -> UntrustedError:
    """The refusal of clocks that are said to be one, and run at two rates."""
    return UntrustedError(
        f"displacement: its clock drifts by {rate.ppm:+.0f} ± {1e6 * rate.std:.1g} ppm relative to the "
        f"accelerometer's ({1e3 * abs(rate.late) * rate.length_s:.4g} ms in {rate.length_s:.4g} s), but "
        "displacement.estimate_offset = false declares one common clock. Leave estimate_offset out to correct the "
        "drift, or correct the time column; live, synchronise both clocks with NTP."
    )


def _part(given: Given, estimated: NoiseCalibration) -> DisplacementCalibration:
    std = float(np.sqrt(estimated.variance_factor))
    if given.noise_std_m is not None:
        own = given.noise_std_m * abs(estimated.factor)
        # A given noise far below what the sensors differ by would only make the gate reject right measurements.
        std = own if std < MAX_OPTIMISTIC * own else std
    slow_std_m, slow_time_s, slow_hz = estimated.slow_std_m, estimated.slow_time_s, estimated.slow_hz
    if _has_usual_slow_error(given, estimated):
        slow_std_m, slow_time_s = GNSS_SLOW
    # A slow error that is in the band is not left out of it.
    drift_m, step_m, gap_m = (0.0, 0.0, 0.0) if slow_std_m > 0.0 else estimated.unseen_m
    return DisplacementCalibration(
        std,
        estimated.offset,
        estimated.factor,
        # A scale that seems wrong is left as it is, and the error band holds both.
        float(np.hypot(estimated.factor_std, abs(estimated.factor) * _scale_error(estimated))),
        resolution_m=resolution(estimated.factor * given.series.value),
        slow_std_m=slow_std_m,
        slow_time_s=slow_time_s,
        slow_hz=slow_hz,
        exposure_s=estimated.exposure_s,
        apart_std_m=_lost_m(given, estimated),
        unseen_drift_m=drift_m,
        unseen_step_m=step_m,
        unseen_gap_m=gap_m,
    )


def _has_usual_slow_error(given: Given, estimated: NoiseCalibration) -> bool:
    """Whether it is a GNSS receiver whose slow error neither the record shows nor the settings declare."""
    return given.gnss and given.noise_time_s is None and estimated.slow_std_m == 0.0


def _lost_m(given: Given, estimated: NoiseCalibration) -> float:
    """Motion (m, rms) that one of both may not have seen: late clocks, a logger's low-pass, an undeclared exposure."""
    lost = [estimated.late_m, estimated.sway_m]
    if estimated.low_pass is not None:
        # What it takes away altogether looks like noise of the sensor, of which no more is known than what is given.
        known_m = 0.0 if given.noise_std_m is None else given.noise_std_m * abs(estimated.factor)
        lost += [float(np.sqrt(max(estimated.variance_factor - known_m**2, 0.0))), estimated.low_pass.taken_m]
    if estimated.play is not None:
        lost.append(estimated.play.taken_m)
    exposure_s = estimated.exposure_s or estimated.open_exposure_s
    if given.exposure_s is None and exposure_s > 0.0:
        # An accelerometer that resonates on its mount, or errs with its motion, may look the same.
        shaken = given.prepared.with_noise(1.0)
        taken = taken_by_averaging(shaken.time_ns, shaken.value_m_s2, given.series.time_ns, exposure_s)
        lost.append(estimated.exposure_doubt * float(np.std(taken)))
    return float(np.linalg.norm(lost))


def _scale_error(estimated: NoiseCalibration) -> float:
    """By how much a scale that was not estimated seems wrong, as a share; 0 where it may be right."""
    if estimated.gain_std > 0.0 or estimated.drifts:
        # It is the accelerometer's gain, or its drift, which is in its noise.
        return 0.0
    uncertain = CERTAIN * estimated.scale_std + 0.5 * estimated.noise_share
    if estimated.noise_share > MAX_NOISE or not abs(estimated.scale - 1.0) > max(REPORTED, uncertain):
        return 0.0
    return float(np.hypot(1.0 / estimated.scale - 1.0, estimated.scale_std))


def _frozen_warnings(series: TimeSeries, held: Mask) -> Iterator[Notice]:
    for a, b in runs(held)[:1]:
        more = f"{len(runs(held)) - 1} more segments likewise. " if len(runs(held)) > 1 else ""
        yield Notice(
            "frozen",
            f"displacement: {b - a} values from {shown(int(series.time_ns[a]))} to "
            f"{shown(int(series.time_ns[b - 1]))} are frozen at {1e3 * series.value[a]:.6g} mm while the structure "
            f"moved; they were left out. {more}Check the sensor.",
        )


def _range_warnings(part: DisplacementCalibration, held: Mask) -> Iterator[Notice]:
    if held.any():
        ends = " and ".join(f"{1e3 * end:.6g} mm" for end in (part.low_m, part.high_m) if np.isfinite(end))
        yield Notice(
            "samples-bridged",
            f"displacement: {np.count_nonzero(held)} values are clipped at {ends}, the end of its range; they were "
            "left out. Check the sensor's range.",
        )


def _warnings(given: Given, estimated: NoiseCalibration, part: DisplacementCalibration) -> Iterator[Notice]:
    """What to know of the displacement sensor; UntrustedError where its unit is wrong beyond doubt."""
    series = read_with(given.series, part)
    yield from _frozen_warnings(series, _frozen_values(given.prepared, series))
    yield from _zero_warnings(given, part)
    yield from estimated.warnings
    yield from _lateness_warnings(given, estimated, part)
    if estimated.gain_std > 0.0 and abs(estimated.gain - 1.0) > max(REPORTED, CERTAIN * estimated.gain_std):
        yield Notice(
            "gain-corrected",
            f"displacement: the accelerometer's gain relative to this sensor is {estimated.gain:.4g} ± "
            f"{estimated.gain_std:.2g}; it is corrected, with the displacement sensor's unit taken as right. Check "
            "accelerometer.unit, accelerometer.sensitivity, displacement.unit, and that both sensors measure the "
            "same axis; accelerometer.estimate_scale = false turns the correction off.",
        )
    yield from _exposure_warnings(given, estimated)
    if estimated.drifts:
        yield Notice(
            "accelerometer-noisy",
            f"accelerometer: below {DRIFT_HZ:g} Hz its bias drift exceeds the structure's motion; the displacement "
            "comes mostly from the displacement sensor. Check the accelerometer's temperature, mounting and cable.",
        )
    yield from _slow_warnings(given, estimated, part)
    yield from _factor_warnings(estimated)


def _gain_note(estimated: NoiseCalibration, std: float) -> list[Notice]:
    """A sentence on a gain that changes the result, and is none of a wrong unit or sensitivity."""
    off = abs(estimated.gain - 1.0)
    if not off > NOTICED * std > 0.0 or off > max(REPORTED, CERTAIN * estimated.gain_std):
        return []
    text = (
        f"displacement: relative to it the accelerometer has a gain of {estimated.gain:.5g} ± {std:.2g}, which is "
        "removed; accelerometer.estimate_scale = false keeps it."
    )
    return [Notice("gain-estimated", text)]


def _factor_warnings(estimated: NoiseCalibration) -> Iterator[Notice]:
    """A sentence on a factor that seems wrong; UntrustedError where it is a wrong unit, or a clock explains it."""
    if _scale_error(estimated) == 0.0:
        return
    measured = (
        f"displacement: follows the accelerometer with a factor of {estimated.scale:.3g} ± {estimated.scale_std:.2g}"
    )
    text = (
        f"{measured} where 1 is expected. Check displacement.unit, its sign, accelerometer.unit, that both sensors "
        "measure the same axis, and whether the accelerometer's bias drifts by more than the structure accelerates "
        "(1/f noise)."
    )
    if abs(estimated.scale - 1.0) > REFUSED:
        raise UntrustedError(text)
    assert estimated.findings is not None
    cause = named_cause(estimated.findings.pair, estimated.findings.fit.offset_s)
    # The band of a factor does not hold what a clock makes.
    if cause is not None and cause.cause in (Cause.CLOCK, Cause.STEP):
        raise UntrustedError(disagreement(cause, measured))
    text += " The error band includes the difference; displacement.estimate_scale = true corrects it."
    yield Notice("scale-uncertain", text)


def _exposure_warnings(given: Given, estimated: NoiseCalibration) -> Iterator[Notice]:
    if estimated.play is not None:
        yield Notice(
            "play",
            f"displacement: it shows play (backlash) of {1e3 * estimated.play.width_m:.2g} mm in its joint; the "
            f"error band includes {1e3 * estimated.play.taken_m:.2g} mm rms for it. {REMEDIES[Cause.PLAY]}",
        )
    found_s = estimated.exposure_s or estimated.open_exposure_s
    if given.exposure_s is not None or not found_s > 0.0:
        return
    seems = f"displacement: fast motion is attenuated, as by a sensor that averages over {found_s:.3g}"
    if estimated.exposure_s > 0.0:
        resonance = ", or by a resonating accelerometer mount" if estimated.exposure_doubt > 0.5 else ""
        yield Notice(
            "exposure",
            f"{seems} s{resonance}. {'The first' if resonance else 'That'} is corrected, and its uncertainty is in "
            "the error band; declare displacement.exposure_s.",
        )
    else:
        yield Notice(
            "exposure",
            f"{seems} s, by a slow sensor, or by an accelerometer whose error grows with its motion. The motion "
            "cannot distinguish these: nothing is corrected, and the error band includes the averaging. Set "
            "displacement.exposure_s (0: no averaging).",
        )


def _lateness_warnings(given: Given, estimated: NoiseCalibration, part: DisplacementCalibration) -> Iterator[Notice]:
    if not given.learns_offset and 0.0 < estimated.offset.variance < np.inf:
        yield Notice(
            "clock-differs",
            "displacement: its clock seems to differ from the accelerometer's by "
            f"{1e3 * np.sqrt(estimated.offset.variance):.3g} ms; the error band includes "
            f"{1e3 * estimated.late_m:.2g} mm rms for it. Set displacement.estimate_offset = true to correct it.",
        )
    if estimated.low_pass is not None:
        yield Notice(
            "logger-low-pass",
            f"accelerometer: {estimated.low_pass.text()}. The error band includes {1e3 * part.apart_std_m:.2g} mm "
            "rms for it. The low-pass delay looks like a clock offset: the result is late by the logger's part of "
            f"the {estimated.offset.value_s:+.3g} s found. Use a logger whose low-pass lies far above the motion.",
        )


def _slow_warnings(given: Given, estimated: NoiseCalibration, part: DisplacementCalibration) -> Iterator[Notice]:
    """A sentence on a slow error that is in the band, or may be there and is not."""
    if estimated.sway is not None:
        size_m = abs(estimated.factor) * estimated.sway.std
        yield Notice("motion-not-shared", estimated.sway.text("displacement", size_m))
    elif estimated.slow_std_m > 0.0 and given.noise_time_s is None:
        yield Notice(
            "slow-error-included",
            "displacement: its errors are correlated, as with a GNSS receiver or a total station: the error band "
            f"includes a slow error of {1e3 * estimated.slow_std_m:.2g} mm over {estimated.slow_time_s:.2g} s. Set "
            "displacement.noise_time_s (correlation time; 0: no slow error).",
        )
    elif _has_usual_slow_error(given, estimated):
        yield Notice(
            "slow-error-included",
            f"displacement: the error band includes a slow error of {1e3 * GNSS_SLOW[0]:g} mm over {GNSS_SLOW[1]:g} "
            "s, usual for GNSS receivers, which this record neither shows nor excludes. Set "
            "displacement.noise_time_s (correlation time; 0: no slow error).",
        )
    elif part.slow_std_m == 0.0 and part.noise_std_m >= RECEIVER_NOISE_M and given.noise_time_s is None:
        yield Notice(
            "slow-error",
            f"displacement: noise of {1e3 * part.noise_std_m:.2g} mm is that of a GNSS receiver or a total station. "
            "Its slow errors of some mm over minutes would not show in this record, and the error band does not "
            'contain them. Set displacement.receiver = "gnss" to include them, or displacement.noise_time_s '
            "(correlation time; 0: no slow error).",
        )


def _zero_warnings(given: Given, part: DisplacementCalibration) -> Iterator[Notice]:
    value = part.scale * given.series.value
    level, moved = abs(float(np.nanmedian(value))), float(np.nanstd(value))
    if given.gives_zero and not part.relative_std * level < max(moved, part.noise_std_m):
        yield Notice(
            "zero-uncertain",
            f"displacement: the reading is about {1e3 * level:.4g} mm; the scale's uncertainty of "
            f"{100 * part.relative_std:.2g} % makes {1e3 * part.relative_std * level:.2g} mm of it, which the zero's "
            "uncertainty includes. Subtract the reading at rest from the column to get the band of the motion alone.",
        )


def read_with(series: TimeSeries, estimated: DisplacementCalibration) -> TimeSeries:
    """The channel in metres on the accelerometer's clock."""
    offset_ns = round(NANOSECONDS * estimated.offset.value_s)
    return replace(series, time_ns=estimated.even(series.time_ns) + offset_ns, value=estimated.scale * series.value)


def _without(series: TimeSeries, mask: Mask) -> TimeSeries:
    return replace(series, value=np.where(mask, np.nan, series.value)) if mask.any() else series


def _frozen_values(prepared: PreparedAcceleration, series: TimeSeries, *, resolution_m: float | None = None) -> Mask:
    """Values (n,), in m on the accelerometer's clock, that are static while it says that the structure moves."""
    origin = int(series.time_ns[0])
    shaken = prepared.with_noise(white_noise(prepared.value_m_s2) ** 2 / prepared.rate_hz)
    samples = np.column_stack((seconds(shaken.time_ns, origin), shaken.value_m_s2, shaken.noise_density))
    step = resolution(series.value) if resolution_m is None else resolution_m
    return stuck(seconds(series.time_ns, origin), series.value, samples, resolution_m=step)
