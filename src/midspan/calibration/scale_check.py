"""Whether a given calibration fits the recording: scale and clock of each sensor against the accelerometer."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from midspan.calibration.agreement import noise_share
from midspan.calibration.fit import MIN_MEASUREMENTS, Fit, Pair, measured_rows
from midspan.calibration.noise import nearest, without_outliers
from midspan.calibration.outliers import without_lonely_outliers
from midspan.calibration.time_offset import search_offset
from midspan.errors import UntrustedError
from midspan.notices import Notice
from midspan.records import NANOSECONDS, Acceleration, Displacement, Floats, Source, part, seconds
from midspan.signals.stamps import inside

# So much of the recording is compared at most, for speed.
COMPARED_S = 300.0
# A scale that is off by this share is reported; beyond the second it is refused. Both only beyond this many deviations.
REPORTED, REFUSED, CERTAIN = 0.005, 0.2, 5.0
# Together with another sensor a scale so far off is refused: two scales in one filter push the velocity to and fro, and
# the gate takes over now one and now the other (10 % off: up to 0.4 m).
REFUSED_NEXT_TO = 0.08
# What it is off by beyond this many deviations goes into the band, however little it is.
EXPECTED = 2.0
# The accelerometer's noise may make this share of the motion that it tells; above it hides the scale.
MAX_NOISE = 0.1
# A clock that is off is reported from this many noise deviations of the displacement on, and refused from this many.
CLOCK_REPORTED, CLOCK_REFUSED = 2.0, 5.0
# Measurements that are searched for a clock offset at most; a faster sensor is thinned.
MAX_ROWS = 6000
# What of the calibration says the scale of a sensor. The clocks of cameras are followed through the recording, those of
# the others are taken from the calibration.
SCALED = {
    Source.CAMERA: "scale_mm_per_px",
    Source.INFRARED: "scale_mm_per_px",
    Source.RADAR: "conversion_factor",
    Source.DISPLACEMENT: "scale, or the unit,",
}
FOLLOWED = "the rows use the accelerometer's scale as far as the motion determines it; the error band includes the rest"
CLOCKED = (Source.RADAR, Source.DISPLACEMENT)


@dataclass(frozen=True, slots=True, eq=False)
class Sensed:
    """What a sensor measured, all of it, and what is uncertain of its calibration: its scale (relative), its clock (s).

    sensor: its name in messages.
    """

    sensor: str
    source: Source
    measured: Displacement
    relative_scale_std: float = 0.0
    clock_std_s: float = 0.0


@dataclass(frozen=True, slots=True)
class ApparentScale:
    """Displacement of a sensor per displacement of the accelerometer (1 when both are right), with its deviation.

    late_s, late_std_s: to be added to its stamps beyond the calibrated clock offset, 0 where that is not looked for;
    moved_m: what this does to the displacement, rms; noise_m: standard deviation of one measurement.
    """

    value: float
    std: float
    late_s: float = 0.0
    late_std_s: float = 0.0
    moved_m: float = 0.0
    noise_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Fitting:
    """What to tell of a calibration that was given, and how uncertain the scale of each sensor is, with what it is off.

    scale_std: relative standard deviations by the sensors' names.
    """

    warnings: list[Notice]
    scale_std: dict[str, float]


def fitting(
    acceleration: Acceleration,
    sensors: Sequence[Sensed],
    along: str = "",
    *,
    max_offset_s: float = 0.0,
    followed: bool = False,
) -> Fitting:
    """How the calibrated scales and clocks fit the recording; along: a second axis in words.

    max_offset_s: largest clock offset looked for; followed: the method estimates the scales on its way. Raises
    UntrustedError where one is wrong beyond doubt.
    """
    found = Fitting([], {})
    refused = REFUSED if len(sensors) < 2 else REFUSED_NEXT_TO
    for sensed in sensors:
        known = sensed.relative_scale_std
        found.scale_std[sensed.sensor] = known
        scale = apparent_scale(acceleration, sensed, max_offset_s)
        if scale is not None:
            found.warnings.extend(_clock_warnings(scale, sensed))
            found.warnings.extend(_scale_warnings(scale, sensed, along, refused, followed=followed))
            # What it is off by beyond what both deviations let expect is in the deviation.
            expected = EXPECTED * float(np.hypot(scale.std, known))
            surplus = max((scale.value - 1.0) ** 2 - expected**2, 0.0)
            found.scale_std[sensed.sensor] = float(np.sqrt(known**2 + surplus))
    return found


def _scale_warnings(
    scale: ApparentScale, sensed: Sensed, along: str, refused: float, *, followed: bool
) -> list[Notice]:
    known = sensed.relative_scale_std
    off, least = abs(scale.value - 1.0), CERTAIN * float(np.hypot(scale.std, known))
    if off <= max(REPORTED, least):
        return []
    text = (
        f"{sensed.sensor}: its displacement{along} is {scale.value:.4g} ± {float(np.hypot(scale.std, known)):.2g} "
        f"times the accelerometer's where 1 is expected: the calibration's {SCALED[sensed.source]} does not belong to "
        "this recording"
    )
    if off <= max(refused, least):
        held = FOLLOWED if followed else f"the error band includes the {100.0 * off:.2g} %"
        return [Notice("calibration-foreign", f"{text}; {held}. Calibrate this recording.")]
    turned = " The sign is reversed." if abs(scale.value + 1.0) < max(refused, least) else ""
    raise UntrustedError(f"{text}.{turned} Calibrate this recording.")


def _clock_warnings(scale: ApparentScale, known: Sensed) -> list[Notice]:
    std = float(np.hypot(scale.late_std_s, known.clock_std_s))
    if not abs(scale.late_s) > CERTAIN * std or scale.moved_m <= CLOCK_REPORTED * scale.noise_m:
        return []
    text = (
        f"{known.sensor}: with the calibration's time_offset_s its clock deviates by {1e3 * scale.late_s:+.3g} ± "
        f"{1e3 * std:.2g} ms from the accelerometer's, {1e3 * scale.moved_m:.2g} mm of displacement (rms; noise "
        f"{1e3 * scale.noise_m:.2g} mm): the offset does not belong to this recording. Calibrate this recording."
    )
    if scale.moved_m > CLOCK_REFUSED * scale.noise_m:
        raise UntrustedError(text)
    return [Notice("calibration-foreign", text)]


def apparent_scale(acceleration: Acceleration, sensed: Sensed, max_offset_s: float = 0.0) -> ApparentScale | None:
    """The scale of a sensor against the accelerometer, where the motion tells it; clocks up to an offset, s."""
    found = _compared(acceleration, sensed.measured)
    if found is None:
        return None
    pair, density, noise_m = found

    def tells(pair: Pair, fit: Fit) -> bool:
        # Whether the accelerometer's own noise leaves the motion to tell the scale.
        return noise_share(pair, fit, float(np.sqrt(density * pair.sample_rate_hz))) < MAX_NOISE

    if sensed.source not in CLOCKED or max_offset_s == 0.0:
        pair, fit = without_outliers(pair)
        return ApparentScale(fit.ratio, float(np.sqrt(fit.ratio_variance))) if tells(pair, fit) else None
    rows = pair.rows
    search = search_offset(pair.changed(rows=rows[:: max(1, -(-len(rows) // MAX_ROWS))]), max_offset_s)
    fit, variance = nearest(search)
    if not tells(search.pair, fit):
        return None
    late_s, moved_m = fit.offset_s, _moved_m(rows, fit.offset_s, noise_m)
    std, late_std_s = float(np.sqrt(fit.ratio_variance)), float(np.sqrt(variance))
    return ApparentScale(fit.ratio, std, late_s, late_std_s, moved_m, noise_m)


def _moved_m(rows: Floats, late_s: float, noise_m: float) -> float:
    """What a clock that is off does to the displacement of rows (m, 3): rms of its change over that time."""
    period = float(np.median(np.diff(rows[:, 0])))
    lag = min(max(1, round(abs(late_s) / period)), len(rows) - 1)
    change = rows[lag:, 1] - rows[:-lag, 1]
    near = rows[lag:, 0] - rows[:-lag, 0] < 1.5 * lag * period
    power = float(np.mean(change[near] ** 2)) - 2.0 * noise_m**2 if near.any() else 0.0
    return float(np.sqrt(max(power, 0.0))) * abs(late_s) / (lag * period)


def _compared(block: Acceleration, measured: Displacement) -> tuple[Pair, float, float] | None:
    """What is compared of a sensor, the density of the acceleration's noise as estimated, and one value's noise, m."""
    usable = np.isfinite(measured.value_m) & np.isfinite(measured.variance_m2)
    usable &= (measured.time_ns >= block.time_ns[0]) & (measured.time_ns <= block.time_ns[-1])
    measured = part(measured, usable)
    if len(measured.time_ns) < MIN_MEASUREMENTS:
        return None
    first = int(measured.time_ns[0])
    measured = part(measured, inside(measured.time_ns, first, first + round(COMPARED_S * NANOSECONDS)))
    block = part(block, inside(block.time_ns, first - NANOSECONDS, int(measured.time_ns[-1]) + NANOSECONDS))
    measured = part(measured, measured.time_ns <= block.time_ns[-1])
    if len(measured.time_ns) < MIN_MEASUREMENTS:
        return None
    density = float(np.median(block.noise_density))
    value = block.value_m_s2 - np.mean(block.value_m_s2)
    samples = np.column_stack((seconds(block.time_ns, first), value, block.noise_density / density))
    variance = measured.variance_m2 / float(np.median(measured.variance_m2))
    pair = Pair(samples, measured_rows(measured.time_ns, measured.value_m, variance, first))
    return without_lonely_outliers(pair), density, float(np.sqrt(np.median(measured.variance_m2)))
