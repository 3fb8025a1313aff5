"""What of a signal lies in a band of frequencies, without delay."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats

ORDER = 4  # of the Butterworth filter, which runs forth and back
# Columns that are filtered together.
COLUMNS = 1024


def band_passed(values: NDArray[Any], rate_hz: float, band_hz: tuple[float, float]) -> Floats:
    """What of `values` (n,) or (n, k), evenly spaced, lies in a band; from 0 Hz on it is a low-pass.

    Butterworth, forth and back: no delay, half the amplitude at the band's edges. At least 30 values.
    """
    from scipy.signal import butter, sosfiltfilt

    low, high = band_hz[0], min(band_hz[1], 0.49 * rate_hz)
    kind, edges = ("bandpass", [low, high]) if low > 0 else ("lowpass", high)
    sections = butter(ORDER, edges, kind, fs=rate_hz, output="sos")
    if values.ndim == 1:
        return np.asarray(sosfiltfilt(sections, values))
    out = np.empty(values.shape)
    for first in range(0, values.shape[1], COLUMNS):
        part = np.s_[:, first : first + COLUMNS]
        out[part] = sosfiltfilt(sections, values[part].astype(np.float64), axis=0)
    return out
