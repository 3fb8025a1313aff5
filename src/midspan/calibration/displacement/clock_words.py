"""What is said of a displacement sensor's clock: its rate and offset where they were corrected, and a refusal."""

from dataclasses import replace

import numpy as np

from midspan.calibration.clock_rate import ClockRate
from midspan.calibration.displacement.cause_words import lateness
from midspan.calibration.noise import NoiseCalibration
from midspan.errors import UntrustedError
from midspan.notices import Notice


def with_rate(learnt: NoiseCalibration, rate: ClockRate | None) -> NoiseCalibration:
    """The calibration with the rate of the clock that was corrected."""
    if rate is None:
        return learnt
    offset = replace(learnt.offset, variance=learnt.offset.variance + rate.offset_variance)
    text = (
        f"displacement: its clock gains {rate.ppm:+.1f} ± {1e6 * rate.std:.1f} ppm on the accelerometer's, "
        f"{1e3 * abs(rate.late) * rate.length_s:.4g} ms in {rate.length_s:.4g} s; this was corrected."
    )
    return replace(learnt, offset=offset, warnings=(*learnt.warnings, Notice("clock-corrected", text)))


def with_offset(learnt: NoiseCalibration) -> NoiseCalibration:
    """The calibration with a sentence on an offset that was not asked for.

    late_m: what it makes of the displacement where it may be a logger's delay.
    """
    assert learnt.findings is not None
    text = (
        f"displacement: its readings come as if its clock differs from the accelerometer's by "
        f"{1e3 * learnt.offset.value_s:+.4g} ± {1e3 * np.sqrt(learnt.offset.variance):.2g} ms; this was corrected. "
        f"{lateness(learnt.findings.pair, learnt.offset.value_s)}"
    )
    if learnt.late_m > 0.0:
        text += (
            "With a low-pass in the accelerometer's logger the result is late by as much: the error band holds what "
            f"that makes, {1e3 * learnt.late_m:.2g} mm rms. displacement.estimate_offset = true says that it is the "
            "clock; "
        )
    else:
        text += "displacement.estimate_offset = true asks for that; "
    text += "false says that both have one clock."
    return replace(learnt, warnings=(*learnt.warnings, Notice("clock-corrected", text)))


def two_rates(rate: ClockRate) -> UntrustedError:
    """The refusal of clocks that are said to be one, and run at two rates."""
    return UntrustedError(
        f"displacement: its clock gains {rate.ppm:+.0f} ± {1e6 * rate.std:.1g} ppm on the accelerometer's, "
        f"{1e3 * abs(rate.late) * rate.length_s:.4g} ms in {rate.length_s:.4g} s, and displacement.estimate_offset "
        "= false says that both have one clock. Leave estimate_offset out to have the clock corrected, or correct "
        "the time column; live, set both clocks by NTP."
    )
