"""Whether a calibration that was given fits the recording: the camera's scale against the accelerometer's."""

from dataclasses import dataclass

import numpy as np

from midspan.calibration.fit import Pair
from midspan.calibration.noise import without_outliers
from midspan.calibration.time_offset import without_lonely_outliers
from midspan.errors import UntrustedError
from midspan.recording.calibrate_camera import measured_rows
from midspan.recording.fuse import FusionInputs
from midspan.recording.span import inside
from midspan.recording.window import LEAST_MEASUREMENTS
from midspan.records import NANOSECONDS, Displacement, Source, part, seconds

# So much of the recording is compared at most, for speed.
COMPARED_S = 300.0
# A scale that is off by this share is told; beyond the second it is refused. Both only beyond so many deviations.
TOLD, REFUSED, CERTAIN = 0.05, 0.2, 5.0
# The accelerometer's noise may make this share of the motion that it tells; above it hides the scale.
MOST_NOISE = 0.1
SCALED = (Source.CAMERA, Source.INFRARED)


@dataclass(frozen=True, slots=True)
class ApparentScale:
    """Displacement of a camera per displacement of the accelerometer (1 when both are right), with its deviation."""

    source: Source
    value: float
    std: float


def apparent_scales(inputs: FusionInputs) -> list[ApparentScale]:
    """The scale of each camera against the accelerometer, where the motion tells it."""
    measured = inputs.displacement
    found = (_apparent_scale(inputs, part(measured, measured.source == source), source) for source in SCALED)
    return [one for one in found if one is not None]


def scale_warnings(inputs: FusionInputs, along: str = "") -> list[str]:
    """What to tell of cameras whose calibrated scale is not the recording's; along: a second axis in words.

    Raises UntrustedError where it is wrong beyond doubt.
    """
    told = []
    for scale in apparent_scales(inputs):
        known = next((error.relative_scale_std for error in inputs.errors if error.source == scale.source), 0.0)
        off, least = abs(scale.value - 1.0), CERTAIN * float(np.hypot(scale.std, known))
        text = (
            f"{scale.source.word}: its displacement{along} is {scale.value:.3g} ± {max(scale.std, known):.2g} times "
            "the accelerometer's where 1 is expected: the calibration's scale_mm_per_px does not belong to this "
            "recording. Calibrate this recording."
        )
        if off > max(REFUSED, least):
            raise UntrustedError(text)
        if off > max(TOLD, least):
            told.append(text)
    return told


def _apparent_scale(inputs: FusionInputs, measured: Displacement, source: Source) -> ApparentScale | None:
    block = inputs.acceleration if inputs.sampled is None else inputs.sampled
    usable = np.isfinite(measured.value_m) & np.isfinite(measured.variance_m2)
    measured = part(measured, usable & (measured.time_ns >= block.time_ns[0]))
    if len(measured.time_ns) < LEAST_MEASUREMENTS:
        return None
    first = int(measured.time_ns[0])
    measured = part(measured, inside(measured.time_ns, first, first + round(COMPARED_S * NANOSECONDS)))
    block = part(block, inside(block.time_ns, first - NANOSECONDS, int(measured.time_ns[-1]) + NANOSECONDS))
    measured = part(measured, measured.time_ns <= block.time_ns[-1])
    if len(measured.time_ns) < LEAST_MEASUREMENTS:
        return None
    density = float(np.median(block.noise_density))
    value = block.value_m_s2 - np.mean(block.value_m_s2)
    samples = np.column_stack((seconds(block.time_ns, first), value, block.noise_density / density))
    variance = measured.variance_m2 / float(np.median(measured.variance_m2))
    pair = Pair(samples, measured_rows(measured.time_ns, measured.value_m, variance, first))
    pair, fit = without_outliers(without_lonely_outliers(pair))
    whitened = fit.whitened
    power = float(np.sum(whitened.response**2 / whitened.variance))
    assumed = fit.corner**4 / pair.rate_hz
    noise = density / assumed * float(np.sum(whitened.input_part / whitened.variance))
    if not noise < MOST_NOISE * power:
        return None
    return ApparentScale(source, fit.ratio, float(np.sqrt(fit.ratio_variance)))
