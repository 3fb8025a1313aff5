"""A result in one sentence: how far the structure moved, how surely, and what to look at first.

Terminal, report, notebook and the JSON of a result have the sentence from here.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from midspan.notices import Severity, coded
from midspan.records import Estimate, Status
from midspan.signals.acceleration import GRAVITY_M_S2

# Standard deviations on each side of a band that holds 95 % of the truth.
BAND = 1.96
# What has to be settled before a result with a serious notice of this code is used.
UNSETTLED = {
    "calibration-foreign": "whether the calibration belongs to this recording",
    "channel-doubtful": "which channel lies along the motion",
    "rate-too-low": "whether the accelerometer's rate is high enough",
    "scale-implausible": "why the scale factor contradicts the optics",
    "unit-doubtful": "the accelerometer's unit",
}


@dataclass(frozen=True, slots=True)
class Motion:
    """Rows of one axis; zero_std_m: the part of every row's standard deviation that is the zero's; axis: of the image,
    empty where there is no other.
    """

    rows: Estimate
    zero_std_m: float
    axis: str = ""


def verdict(motions: Sequence[Motion], warnings: Sequence[str], peak_m_s2: float = math.nan) -> str:
    """A sentence on a result, with no more certainty than its band has; motions: one for each axis.

    peak_m_s2: largest acceleration that the calibration rests on, where it is known: a wrong unit, which nothing in a
    recording contradicts, shows in it.

    The extremes are those of the rows that rest on a measurement, or did a short time ago: a displacement that has run
    away (`lost`) is no motion.
    """
    first_axis, *others = map(_moved, motions)
    moved = ", and ".join((first_axis, *(one.removeprefix("the structure moved ") for one in others)))
    if math.isfinite(peak_m_s2):
        moved += f", calibrated on accelerations of up to {peak_m_s2 / GRAVITY_M_S2:.2g} g"
    notices = [coded(one) for one in warnings]
    serious = dict.fromkeys(one.code for one in notices if one.severity is Severity.SERIOUS)
    if serious:
        settled = " and ".join(UNSETTLED[code] for code in serious)
        return f"Do not use this displacement before you have settled {settled}: by its band alone, {moved}."
    doubts = [one for one in notices if one.severity is Severity.WARNING]
    if not doubts:
        return f"{_capital(moved)}; no sensor contradicts it."
    first, count = doubts[0], len(doubts) - 1
    more = f" and {'one' if count == 1 else count} more" if count else ""
    return f"{_capital(moved)}; look first at the warning on the {first.about or 'result'} ({first.code}){more}."


def _moved(motion: Motion) -> str:
    rows, along = motion.rows, f" along {motion.axis}" if motion.axis else ""
    measured = np.flatnonzero(rows.status != Status.LOST)
    if not len(measured):
        return f"no measurement supports any row{along}"
    value, std = 1e3 * rows.displacement_m[measured], 1e3 * np.sqrt(rows.variance_m2[measured])
    low, high = int(np.argmin(value)), int(np.argmax(value))
    ends = f"from {_with_band(value[low], std[low])} to {_with_band(value[high], std[high])} mm (95 % band)"
    if len(measured) < len(rows.status):
        # Never rounded to all of them.
        ends += f" in the {min(100.0 * len(measured) / len(rows.status), 99.9):.3g} % of the rows that are not lost"
    # The zero's error is common to the rows: what they differ by is compared with their own part of the band.
    own_mm = math.sqrt(max(float(np.median(std)) ** 2 - (1e3 * motion.zero_std_m) ** 2, 0.0))
    if float(np.std(value)) < own_mm:
        return f"no significant motion{along}: the rows differ by less than their standard deviation, {ends}"
    return (
        f"the structure moved by {_digits(value[high] - value[low], BAND * max(std[low], std[high]))} mm{along}, {ends}"
    )


def _with_band(value_mm: float, std_mm: float) -> str:
    """A value with the half width of its band, both to the second digit of that."""
    half = BAND * std_mm
    return f"{_digits(value_mm, half, sign=True)} ± {_digits(half, half)}"


def _digits(value: float, precision: float, sign: bool = False) -> str:
    """A number to the second digit of its precision."""
    digits = min(max(1 - math.floor(math.log10(precision)), 0), 9) if 0.0 < precision < math.inf else 3
    return f"{value:{'+' if sign else ''}.{digits}f}"


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]
