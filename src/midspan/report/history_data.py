"""The numbers behind the time history that can be zoomed: float32 columns in base64."""

import base64
import json

import numpy as np

from midspan.records import Floats, Status
from midspan.report.figures import BAND
from midspan.report.material import Material
from midspan.signals.thinning import PAUSE_STEPS, spans, starts

# Rows that are kept; longer records keep the extremes of this many segments.
MAX_ROWS = 20_000


def history_attributes(material: Material) -> dict[str, str]:
    """Attributes of the figure: `data-history`, the columns one after another, and `data-layout`, what they are."""
    d, s = material.result.displacement_mm, material.result.displacement_std_mm
    t = material.t
    at = starts(len(t), MAX_ROWS // 2)
    columns = {
        "t": t[at] - t[0],
        "low": np.fmin.reduceat(d, at),
        "high": np.fmax.reduceat(d, at),
        "band_low": np.fmin.reduceat(d - BAND * s, at),
        "band_high": np.fmax.reduceat(d + BAND * s, at),
    }
    reference = _reference(material, t[at])
    if reference is not None:
        columns["reference_low"], columns["reference_high"] = reference
    data = np.concatenate(list(columns.values())).astype("<f4").tobytes()
    pause = PAUSE_STEPS * float(np.median(np.diff(t[at]))) if len(at) > 2 else 0.0
    layout = {
        "pause": pause,
        "rows": len(at),
        "names": list(columns),
        "first": float(t[0]),
        "label": material.clock.label,
        "grounds": _grounds(material),
    }
    return {"data-history": base64.b64encode(data).decode(), "data-layout": json.dumps(layout)}


def _grounds(material: Material) -> list[list[float | str]]:
    """Start (s after the first row), length (s) and colour of the segments that no measurement supports."""
    status, first = material.result.estimate.status, float(material.t[0])
    colours = ((Status.COASTING, "rgba(230,159,0,0.28)"), (Status.LOST, "rgba(213,94,0,0.28)"))
    return [
        [round(start - first, 4), round(length, 4), colour]
        for code, colour in colours
        for start, length in spans(material.t, status == code)
    ]


def _reference(material: Material, starts_s: Floats) -> tuple[Floats, Floats] | None:
    """Lowest and highest value of the reference in each segment that begins at `starts_s`; NaN where it has none."""
    reference = material.reference
    if reference is None:
        return None
    value = reference.value + material.reference_moved_mm
    t = material.clock.at(reference.time_ns)
    stretch = np.searchsorted(starts_s, t, side="right") - 1
    # What lies in a pause of the result belongs to no segment.
    known = np.isfinite(value) & (stretch >= 0) & (t - starts_s[stretch] < 2.0 * np.median(np.diff(starts_s)))
    low, high = np.full(len(starts_s), np.inf), np.full(len(starts_s), -np.inf)
    np.fmin.at(low, stretch[known], value[known])
    np.fmax.at(high, stretch[known], value[known])
    empty = ~np.isfinite(low)
    low[empty] = high[empty] = np.nan
    # A slower reference has nothing in most segments; straight lines join what it has.
    if np.mean(empty) > 0.3 and not empty.all():
        middle = np.interp(starts_s, starts_s[~empty], 0.5 * (low + high)[~empty])
        return middle, middle
    return low, high
