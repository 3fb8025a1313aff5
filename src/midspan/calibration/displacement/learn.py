"""Noise, clock offset and scale of a [displacement] sensor, estimated relative to the accelerometer, or a refusal."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.agreement import clearly_better, compared_by, misfit, offset_variance_factor, unexplained
from midspan.calibration.causes import Cause, cause_of_lateness, disagreement, named_cause
from midspan.calibration.clock_jumps import clock_jumps, lateness, outages
from midspan.calibration.clock_rate import ClockRate, find_clock_rate
from midspan.calibration.direction import Turned, turned
from midspan.calibration.displacement.wrong_values import crowd_of_outliers, held_values
from midspan.calibration.displacement.zero_steps import MAX_STEPS, ZeroStep, steps_taken_out, without_steps, zero_steps
from midspan.calibration.fit import MIN_MEASUREMENTS, Fit, Pair, best_corner, measured_rows
from midspan.calibration.noise import CERTAIN_S, Findings, NoiseCalibration, calibrate_noise, edge_s, without_outliers
from midspan.calibration.own_noise import exceeds_own_noise
from midspan.calibration.scale import MIN_GAIN, is_ambiguous
from midspan.calibration.sensor_scale import calibrate_sensor_scale, unexplained_text
from midspan.calibration.time_offset import (
    BEYOND,
    FARTHER_WINDOW_S,
    OffsetSearch,
    farther,
    farther_s,
    first_part,
    likeliest_beyond,
    stands_alone,
)
from midspan.calibration.unfelt import refuse_unfelt
from midspan.errors import DataError, UntrustedError
from midspan.notices import Notice
from midspan.records import NANOSECONDS, Nanoseconds, TimeOffset, TimeSeries
from midspan.signals.acceleration import PreparedAcceleration
from midspan.signals.health import dominant_frequency
from midspan.signals.medians import white_noise
from midspan.signals.stamps import inside, shown

# Noise levels of a displacement sensor are estimated from this much at most, in one piece, for speed.
NOISE_WINDOW_S = 1800.0
# Measurements within the longest offset of an end are left out: so much of the overlap at most at each end, where the
# offset is only reported, where it is estimated, and where one farther off is looked for.
REPORTED_SHARE, ESTIMATED_SHARE, FARTHER_SHARE = 0.1, 0.25, 0.35
# Fewer samples of acceleration carry no motion between two measurements.
MIN_SAMPLES = 10
# A clock offset that was not wanted is refused when it moves the displacement by more than this many times its noise.
MAX_LATE = 2.0
# A displacement that is so much more likely (logarithm of the likelihood) with the opposite sign has it.
CLEARLY_REVERSED = 20.0
# Of two clock offsets the likelier one leads by this much (logarithm of the likelihood), and by this share of what the
# acceleration brings: alternatives of a tone lead by less than a hundredth of it.
MIN_LEAD, MIN_LEAD_SHARE = 12.0, 0.05
# A motion that brings more tells an offset, so that two that fit alike are refused; with less, none is applied.
TELLING_GAIN = 100.0
# Beyond this share a scale is wrong rather than inexact.
WRONG_SCALE = 0.5


# Beyond this share the values that are left out are more than single outliers; beyond the smaller one they may be those
# after a clock's step, which the motion hides in part.
MANY_LEFT_OUT, FEW_LEFT_OUT = 0.2, 0.05


class LoggerDelayError(UntrustedError):
    """The accelerometer's logger delays what it records, which no clock explains."""


@dataclass(frozen=True, slots=True)
class Given:
    """A displacement sensor compared with the accelerometer, and what is to be estimated of it.

    series: its values as read; wanted_s: the largest clock offset looked for; learns_offset, learns_scale: whether
    these are applied; learns_offset None: the offset is where the motion shows one; noise_std_m: of its values as read,
    None where it is not given; gives_zero: whether its zero is that of the displacement; gain_std: how well the
    accelerometer's gain is known before, relative; 0: it is not estimated; noise_time_s: correlation time of its slow
    error, None where it is not given; gnss: it is a GNSS receiver; exposure_s: time over which it averages, None where
    that is not given.
    """

    prepared: PreparedAcceleration
    series: TimeSeries
    wanted_s: float
    learns_offset: bool | None = False
    learns_scale: bool = False
    noise_std_m: float | None = None
    gives_zero: bool = True
    gain_std: float = 0.0
    noise_time_s: float | None = None
    gnss: bool = False
    exposure_s: float | None = None


class _Overlap:
    """What is compared: a sensor's displacement from `first_ns` to `last_ns`, and the acceleration.

    max_offset_s: the largest offset that can be searched for; reach_s: how far is searched so that this is no edge.
    """

    def __init__(self, given: Given, series: TimeSeries) -> None:
        self.given, self.series = given, series
        prepared = given.prepared
        used = inside(series.time_ns, int(prepared.time_ns[0]), int(prepared.time_ns[-1]))
        self.first_ns = int(series.time_ns[used.start])
        longest_ns = round(NOISE_WINDOW_S * NANOSECONDS)
        self.last_ns = min(int(series.time_ns[used.stop - 1]), self.first_ns + longest_ns)
        self.overlap_s = (self.last_ns - self.first_ns) / NANOSECONDS
        self.one_clock = not given.learns_offset
        self.max_offset_s = min(
            given.wanted_s, (REPORTED_SHARE if self.one_clock else ESTIMATED_SHARE) * self.overlap_s
        )
        reach_s = self.max_offset_s + edge_s(self.max_offset_s, self.overlap_s)
        self.reach_s = reach_s if self.max_offset_s > 0.0 else 0.0

    def pair(self, margin_s: float, until_s: float = np.inf) -> Pair:
        """Both signals, the displacement without a margin at both ends, of `until_s` at most."""
        prepared, series, margin = self.given.prepared, self.series, round(margin_s * NANOSECONDS)
        last = self.last_ns if np.isinf(until_s) else min(self.last_ns, self.first_ns + round(until_s * NANOSECONDS))
        used = inside(series.time_ns, self.first_ns + margin, last - margin)
        _refuse_poor_displacement(self.given.series, series, used)
        window = inside(prepared.time_ns, self.first_ns - NANOSECONDS, last + NANOSECONDS)
        if window.stop - window.start < MIN_SAMPLES:
            raise DataError(
                f"accelerometer: at least {MIN_SAMPLES} samples must lie within the {(last - self.first_ns) / 1e9:.4g} "
                f"s of [displacement]; received {window.stop - window.start}. Check accelerometer.rate_hz, and that "
                "both times are in s."
            )
        rows = measured_rows(series.time_ns[used], series.value[used], np.ones(used.stop - used.start), self.first_ns)
        samples, level = prepared.rows(self.first_ns, window), prepared.level(window)
        cross = prepared.cross_rows(window)
        return Pair(
            samples,
            rows,
            1.0,
            self.given.exposure_s or 0.0,
            level_m_s2=level,
            cross=cross,
            lines=self.given.prepared.lines,
        )


def clock_rate(given: Given) -> ClockRate | None:
    """The rate of the sensor's clock where the motion shows that it is not the accelerometer's."""
    overlap = _Overlap(given, given.series)
    return find_clock_rate(replace(overlap.pair(0.0), cross=None), overlap.max_offset_s, overlap.first_ns)


def learn(
    given: Given, series: TimeSeries, *, clock_steps: bool = True, steps: tuple[ZeroStep, ...] = ()
) -> NoiseCalibration:
    """Noise, clock offset and scale of the sensor, by those of its values that are in `series`, or a refusal.

    clock_steps: where many values would be outliers, a clock that steps is looked for. steps: of the zero, which were
    taken out of the values.
    """
    overlap = _Overlap(given, series)
    prepared, first, max_offset = given.prepared, overlap.first_ns, overlap.max_offset_s
    axis = turned(overlap.pair(overlap.reach_s), 0.0 if overlap.one_clock else max_offset)
    pair, notes = axis.pair, list[Notice]()
    try:
        learned, found = _estimated(overlap, axis, notes)
    except UntrustedError as error:
        if not given.learns_scale:
            raise
        return _without_hiding_steps(overlap, pair, steps, error)
    if not given.learns_scale:
        try:
            _refuse_wrong_scale(learned, found)
        except UntrustedError:
            # A clock that steps by half a period turns the motion round.
            even = _on_one_even_clock(given, series, pair, steps) if clock_steps else None
            if even is None:
                raise
            return even
    held = held_values(found.pair, found.fit, pair.rows)
    if held.any():
        return _without_held(given, series, steps, first + np.rint(NANOSECONDS * pair.rows[held, 0]).astype(np.int64))
    share = _share_left_out(pair, found)
    if clock_steps and (even := _without_clock_steps(given, series, pair, steps, (found, share))) is not None:
        return even
    if _may_step(given, learned, found, steps) and (more := zero_steps(found.pair, found.fit, first)):
        return learn(given, without_steps(series, more), clock_steps=clock_steps, steps=(*steps, *more))
    notes += [steps_taken_out(steps, learned.factor)] if steps else []
    if share > MANY_LEFT_OUT:
        notes.append(many_left_out(pair, found.fit, share))
    along = prepared if axis.direction is None else prepared.along(axis.direction.components)
    _refuse_jumps(along, first, found)
    learned = replace(_widened(learned, axis), warnings=(*learned.warnings, *notes))
    if overlap.one_clock:
        return _on_one_clock(learned, found)
    learned = _accepted_offset(overlap, learned, found)
    return replace(learned, warnings=(*learned.warnings, *_offset_warnings(overlap, learned)))


def _share_left_out(pair: Pair, found: Findings) -> float:
    """Of the usable values the share that was left out as outliers."""
    usable = pair.rows[:, 2] < np.inf
    return float(np.mean(np.isinf(found.pair.rows[usable, 2]))) if usable.any() else 0.0


def _without_clock_steps(
    given: Given, series: TimeSeries, pair: Pair, steps: tuple[ZeroStep, ...], at: tuple[Findings, float]
) -> NoiseCalibration | None:
    """The calibration without steps of the sensor's clock; None where none is suspected or found, or a refusal.

    at: what was found with them, and the share that was left out.
    """
    found, share = at
    noisy = share > FEW_LEFT_OUT or exceeds_own_noise(*found.noise)
    # In a unit that is not known yet only what is noisy all the same shows a step.
    usable = pair.rows[:, 2] < np.inf
    open_clock = len(outages(pair.rows[usable, 0])) > 0 or misfit(*found.noise).factor > 1.0
    if not (noisy or (open_clock and not given.learns_scale)):
        return None
    even = _on_one_even_clock(given, series, pair, steps)
    if even is None and noisy:
        refuse_step(pair, found.fit)
    return even


def _estimated(overlap: _Overlap, axis: Turned, notes: list[Notice]) -> tuple[NoiseCalibration, Findings]:
    """The calibration as it is at first; what is to be reported of the clock is added to `notes`."""
    given, pair = overlap.given, axis.pair
    if given.learns_scale:
        learned = _with_scale(overlap, axis, notes)
        assert learned.findings is not None
        return learned, learned.findings
    rows = pair.rows.copy()
    rows[crowd_of_outliers(pair), 2] = np.inf
    learned = calibrate_noise(
        pair.changed(rows=rows),
        overlap.max_offset_s,
        one_clock=overlap.one_clock,
        length_s=overlap.overlap_s,
        gain_std=given.gain_std,
        noise_time_s=given.noise_time_s,
        exposure_declared=given.exposure_s is not None,
    )
    found = learned.findings
    assert found is not None
    if found.search is not None and (not overlap.one_clock or unexplained(found.pair, found.fit)):
        notes += _refuse_farther(overlap, found.free, axis)
    return learned, found


def _with_scale(overlap: _Overlap, axis: Turned, notes: list[Notice]) -> NoiseCalibration:
    """The calibration with the sensor's scale; what is to be reported of its clock is added to `notes`."""
    return calibrate_sensor_scale(
        axis.pair,
        overlap.max_offset_s,
        one_clock=overlap.one_clock,
        length_s=overlap.overlap_s,
        look=lambda fit: notes.extend(_refuse_farther(overlap, fit, axis)),
        noise_time_s=overlap.given.noise_time_s,
    )


def _may_step(given: Given, learned: NoiseCalibration, found: Findings, steps: tuple[ZeroStep, ...]) -> bool:
    """Whether steps of the zero, besides those taken out, may be in the accelerometer's noise or a slow error."""
    slow = learned.slow_std_m > 0.0 and given.noise_time_s is None
    return len(steps) < MAX_STEPS and (slow or exceeds_own_noise(*found.noise))


def _without_hiding_steps(
    overlap: _Overlap, pair: Pair, steps: tuple[ZeroStep, ...], refusal: UntrustedError
) -> NoiseCalibration:
    """The calibration where steps of the zero hid the scale; the refusal where none are found, or they did not.

    They are looked for where the clocks are one: at a wrong offset what the motion leaves looks like steps.
    """
    if steps:
        raise UntrustedError(f"{refusal} {steps_taken_out(steps)}") from refusal
    free = pair.changed(ratio=None)
    more = zero_steps(free, best_corner(free, 0.0), overlap.first_ns) if overlap.one_clock else ()
    if not more:
        raise refusal
    return learn(overlap.given, without_steps(overlap.series, more), steps=more)


def _without_held(
    given: Given, series: TimeSeries, steps: tuple[ZeroStep, ...], held_ns: Nanoseconds
) -> NoiseCalibration:
    usable = np.where(np.isin(series.time_ns, held_ns), np.nan, series.value)
    learned = learn(given, replace(series, value=usable), steps=steps)
    text = (
        f"displacement: {len(held_ns)} values from {shown(int(held_ns[0]))} to {shown(int(held_ns[-1]))} do not "
        "follow the motion, as with a stuck sensor; they were left out of the calibration. Check the sensor and its "
        "mounting."
    )
    return replace(learned, warnings=(*learned.warnings, Notice("outliers", text)))


def _on_one_even_clock(
    given: Given, series: TimeSeries, pair: Pair, steps: tuple[ZeroStep, ...]
) -> NoiseCalibration | None:
    """The calibration without the steps of the sensor's clock, where both sensors then agree to their own noise."""
    even = on_one_clock(series, _Overlap(given, series).first_ns, pair)
    if even is None:
        return None
    try:
        estimated = learn(given, even, clock_steps=False, steps=steps)
    except UntrustedError:
        return None
    assert estimated.findings is not None
    return None if exceeds_own_noise(*estimated.findings.noise) else estimated


def on_one_clock(series: TimeSeries, origin_ns: int, pair: Pair) -> TimeSeries | None:
    """The values with the steps of their clock taken out of the stamps; None where none is found.

    origin_ns: what the pair's times count from. Values that may lie on either side of a step are NaN.
    """
    # A step leaves one half without any, where the sensors agree; in the other it looks like noise of one of them.
    halves = [without_outliers(pair.changed(rows=rows, ratio=1.0))[1] for rows in np.array_split(pair.rows, 2)]
    fit = min(halves, key=lambda one: np.log(one.noise) + np.mean(np.log(one.whitened.variance)))
    used = pair.used(fit.offset_s)
    jumps = clock_jumps(compared_by(pair, fit, pair.rows[used]))
    if not jumps:
        return None
    late_s, certain = lateness(jumps, len(used)), np.ones(len(used), dtype=bool)
    for jump in jumps:
        certain[jump.first : jump.last] = False
    place = np.searchsorted(origin_ns + np.rint(NANOSECONDS * pair.rows[used, 0]), series.time_ns, side="right") - 1
    place = np.clip(place, 0, len(used) - 1)
    moved = series.time_ns + np.rint(NANOSECONDS * (late_s - late_s[0])[place]).astype(np.int64)
    kept = np.concatenate(([True], moved[1:] > np.maximum.accumulate(moved)[:-1]))
    value = np.where(certain[place], series.value, np.nan)
    return replace(series, time_ns=moved[kept], value=value[kept])


def refuse_step(pair: Pair, fit: Fit) -> None:
    """UntrustedError where a clock that steps explains what the sensors differ by, but could not be taken out.

    None is claimed where the acceleration has gaps: what bridges them parts the sensors from there on as a step does.
    """
    if np.ptp(pair.samples[:, 2]) > 0.0:
        return
    cause = named_cause(pair.changed(ratio=1.0), fit.offset_s)
    if cause is not None and cause.cause is Cause.STEP:
        measured = f"displacement: it differs from the accelerometer by {1e3 * cause.difference_m:.3g} mm rms"
        raise UntrustedError(disagreement(cause, measured))


def many_left_out(pair: Pair, fit: Fit, share: float) -> Notice:
    """What to say of many values that are left out; UntrustedError where one cause explains them."""
    measured = f"displacement: {100 * share:.0f} % of its values contradict the acceleration"
    cause = named_cause(pair, fit.offset_s)
    if cause is not None:
        raise UntrustedError(disagreement(cause, measured))
    text = f"{measured} and were left out of the calibration as outliers. If these are too many, check both sensors."
    return Notice("outliers", text)


def _widened(learned: NoiseCalibration, axis: Turned) -> NoiseCalibration:
    offset = replace(learned.offset, variance=learned.offset.variance + axis.offset_variance)

    def wider(relative_std: float) -> float:
        return float(np.hypot(relative_std, axis.relative_std)) if relative_std > 0.0 else 0.0

    return replace(
        learned,
        offset=offset,
        scale_std=wider(learned.scale_std),
        gain_std=wider(learned.gain_std),
        factor_std=abs(learned.factor) * wider(learned.factor_std / abs(learned.factor)),
        direction=axis.direction,
    )


def _refuse_farther(overlap: _Overlap, near: Fit, axis: Turned) -> list[Notice]:
    reach = overlap.reach_s
    until = min(reach + farther_s(overlap.max_offset_s), FARTHER_SHARE * overlap.overlap_s)
    try:
        pair = axis.turning(overlap.pair(until, FARTHER_WINDOW_S + 2.0 * until))
    except DataError:
        text = (
            f"displacement: no clock offset beyond ±{overlap.max_offset_s:.3g} s was searched: the overlap of "
            f"{overlap.overlap_s:.3g} s has too few measurements or too little motion. Record longer."
        )
        return [Notice("clock-uncertain", text)]
    other = farther(pair, near, reach, until)
    if other is not None:
        raise _beyond(overlap, other.offset_s)
    return []


def _beyond(overlap: _Overlap, offset_s: float) -> UntrustedError:
    learn_it = "set displacement.estimate_offset = true, and " if overlap.one_clock else ""
    return UntrustedError(
        f"displacement: its clock seems to differ from the accelerometer's by {offset_s:+.3g} s, but only "
        f"±{overlap.max_offset_s:.3g} s were searched (calibration.max_offset_s = {overlap.given.wanted_s:g}, overlap "
        f"{overlap.overlap_s:.3g} s). Correct its time column or displacement.start_s, or {learn_it}raise "
        "calibration.max_offset_s, to at most a quarter of the overlap."
    )


def _refuse_wrong_scale(learned: NoiseCalibration, found: Findings) -> None:
    size = 1.0 / abs(found.free.ratio)
    times = "" if abs(size - 1.0) < WRONG_SCALE else f" and multiplied by {size:.3g}"
    if learned.reversed_gain > CLEARLY_REVERSED:
        cause = named_cause(found.pair, found.free.offset_s)
        if cause is not None and cause.cause is not Cause.UNIT:
            measured = f"displacement: with the opposite sign{times} it fits the accelerometer better"
            raise UntrustedError(disagreement(cause, measured))
        raise UntrustedError(
            f"displacement: its sign is reversed: with the opposite sign{times} it fits the accelerometer far better. "
            "Its second derivative must be positive where the structure accelerates along the sensor's positive axis. "
            "Reverse the sign of the column or of the accelerometer's, or set displacement.estimate_scale = true."
        )
    if times and found.free.gain > MIN_GAIN and found.free.ratio > 0.0 and clearly_better(found.free, found.likeliest):
        measured = (
            f"displacement: follows the accelerometer with a factor of {found.free.ratio:.3g} ± "
            f"{np.sqrt(found.free.ratio_variance):.2g} where 1 is expected"
        )
        raise UntrustedError(disagreement(named_cause(found.pair, found.free.offset_s), measured))


def _refuse_jumps(prepared: PreparedAcceleration, origin_ns: int, found: Findings) -> None:
    """UntrustedError where readings that are no outliers move by what the accelerometer did not feel."""
    pair, fit = found.pair, found.fit
    rows = pair.rows[pair.used(fit.offset_s)]
    time_s, moved_m = rows[:, 0] + fit.offset_s, rows[:, 1] / fit.ratio
    # Of each reading; some jumps do not show in the median.
    noise_m = white_noise(moved_m - pair.responses[0].at(time_s))
    time_ns = origin_ns + np.rint(NANOSECONDS * time_s).astype(np.int64)
    refuse_unfelt(prepared, time_ns, moved_m, np.full(len(rows), noise_m**2))


def _accepted_offset(overlap: _Overlap, learned: NoiseCalibration, found: Findings) -> NoiseCalibration:
    """UntrustedError where the clock offset that was asked for is not to be accepted; else with its variance as it is
    where what is left is no noise.
    """
    search, limit = found.search, overlap.max_offset_s
    if search is None:
        return learned
    if not search.offset.variance < CERTAIN_S**2:
        _refuse_anywhere_else(overlap, search)
        return learned
    fit, std = search.fit, float(np.sqrt(search.offset.variance))
    factor = 1.0
    if fit.gain < MIN_GAIN:
        _refuse_anywhere_else(overlap, search)
        if learned.offset.value_s != 0.0:
            raise UntrustedError(unexplained_text(fit.offset_s, limit))
        return learned
    # What a sensor leaves that averages is explained.
    averages = found.pair.exposure_s > 0.0
    if unexplained(*((found.pair, found.fit) if averages else (search.pair, fit))):
        _refuse_anywhere_else(overlap, search)
        if not stands_alone(search.pair, fit):
            raise UntrustedError(unexplained_text(fit.offset_s, limit))
        factor = offset_variance_factor(fit)
    # With little motion a lead that is small compared with a tone's errors decides all the same, where it is a good
    # part of what the motion shows at all.
    decides = max(MIN_LEAD, MIN_LEAD_SHARE * fit.gain)
    if (
        search.runner_up is not None
        and is_ambiguous(search)
        and fit.likelihood - search.runner_up.likelihood < decides
        and (learned.offset.value_s != 0.0 or fit.gain > TELLING_GAIN)
    ):
        raise UntrustedError(
            f"displacement: the clock offset is ambiguous: {fit.offset_s:+.4f} s and {search.runner_up.offset_s:+.4f} "
            f"s fit almost equally well within ±{limit:g} s, as with nearly a single tone, or with a tone whose alias "
            "meets a slower tone. Set a smaller calibration.max_offset_s that excludes one of them, or leave "
            "displacement.estimate_offset out."
        )
    if abs(fit.offset_s) > limit + BEYOND * std:
        raise _beyond(overlap, fit.offset_s)
    return replace(learned, offset=replace(learned.offset, variance=factor * learned.offset.variance))


def _refuse_anywhere_else(overlap: _Overlap, search: OffsetSearch) -> None:
    """UntrustedError where the clocks agree at an offset that is farther off than was searched, and only there."""
    pair = first_part(search.pair)
    rival = likeliest_beyond(pair, search.fit, overlap.reach_s)
    if rival is not None and rival.better and stands_alone(pair, rival.fit):
        raise _beyond(overlap, rival.fit.offset_s)


def _offset_warnings(overlap: _Overlap, learned: NoiseCalibration) -> Iterator[Notice]:
    if overlap.max_offset_s < overlap.given.wanted_s:
        yield Notice(
            "window-moved",
            f"displacement: clock offsets were searched only up to ±{overlap.max_offset_s:.3g} s, a quarter of the "
            f"overlap of {overlap.overlap_s:.3g} s; calibration.max_offset_s is {overlap.given.wanted_s:g} s.",
        )
    search = None if learned.findings is None else learned.findings.search
    # No offset was applied though the one that fits best is not 0.
    left = search is not None and abs(search.fit.offset_s) > 5.0 * float(np.sqrt(search.offset.variance))
    left = left and learned.offset.value_s == 0.0
    if overlap.max_offset_s > 0.0 and (np.isinf(learned.offset.variance) or left):
        yield Notice(
            "clock-uncertain",
            "displacement: the motion does not determine the clock offset; 0 is used. Record more motion.",
        )


def _on_one_clock(learned: NoiseCalibration, found: Findings) -> NoiseCalibration:
    """One clock is taken for granted; an offset that shows all the same is reported and put into the error band."""
    off, late = learned.offset.value_s, late_m(learned, found)
    if off != 0.0 and (cause := named_cause(found.pair)) is not None and cause.cause is Cause.STEP:
        # The offset is a mean of two.
        late = max(late, cause.difference_m)
    if late <= MAX_LATE * np.sqrt(_noise(learned, found)):
        return replace(learned, offset=TimeOffset(0.0, off * off), late_m=late)
    differ = f"by {off:+.4f} s, which is {1e3 * late:.3g} mm rms"
    # A logger's low-pass makes the acceleration late, so that the readings seem early.
    if learned.low_pass is not None and off > 0.0:
        raise LoggerDelayError(
            f"displacement: {learned.low_pass.text()}. The clocks seem to differ {differ}. Use a logger whose "
            "low-pass lies far above the motion. With displacement.estimate_offset = true the low-pass delay counts "
            "as a clock offset: the result is late by it, and the error band includes the attenuation."
        )
    delayed = (
        ("; if the cause is a low-pass in the accelerometer's logger, the result is then late by this offset")
        if off > 0.0
        else ""
    )
    raise UntrustedError(
        f"displacement: its clock seems to differ from the accelerometer's {differ}. "
        f"{cause_of_lateness(found.pair, off)}If it is the clock, set displacement.estimate_offset = true, or correct "
        f"its time column{delayed}."
    )


def _noise(learned: NoiseCalibration, found: Findings) -> float:
    return learned.factor**2 * min(found.fit.noise, found.likeliest.noise)


def late_m(learned: NoiseCalibration, found: Findings) -> float:
    """What the clock offset that was found makes of the displacement, rms."""
    value, samples = found.pair.samples[:, 1], found.pair.samples
    rate = (len(value) - 1) / float(samples[-1, 0] - samples[0, 0])
    shaken = float(np.std(value)) / (2.0 * np.pi * max(dominant_frequency(value, rate), 0.2))
    # The readings' speed beyond their noise.
    rows = found.pair.rows[np.isfinite(found.pair.rows[:, 2])]
    apart = np.diff(rows[:, 0])
    square = (learned.factor * np.diff(rows[:, 1]) / apart) ** 2 - 2.0 * _noise(learned, found) / apart**2
    return abs(learned.offset.value_s) * max(shaken, float(np.sqrt(max(float(np.mean(square)), 0.0))))


def _refuse_poor_displacement(read: TimeSeries, series: TimeSeries, used: slice) -> None:
    """DataError where too few values are left of those `read`, or all are one."""
    value = read.value[used]
    known = value[np.isfinite(value)]
    if len(known) >= MIN_MEASUREMENTS and np.ptp(known) == 0.0:
        raise DataError(
            f"displacement ({read.name}): all values are {1e3 * known[0]:g} mm. Check the sensor, or choose another "
            "column with displacement.value."
        )
    count = int(np.count_nonzero(np.isfinite(series.value[used])))
    if count >= MIN_MEASUREMENTS:
        return
    held = len(known) - count
    frozen = f"; {held} more are frozen (constant while the structure moves) and left out" if held else ""
    raise DataError(
        f"displacement: {count} measurements overlap the accelerometer{frozen}; at least {MIN_MEASUREMENTS} are "
        "needed to estimate the noise. Check its time column, gaps and unit, and calibration.window_s."
    )
