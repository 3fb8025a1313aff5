"""How to read a radiometric sequence, and the units that its numbers can be in."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from midspan.checks import positive, refuse
from midspan.errors import DataError
from midspan.sources.camera.frames import FrameRequest
from midspan.thermal.radiometry import ICE_K

Floats32 = NDArray[np.float32]

# Temperatures that a camera can meet outdoors; a median in this range of kelvin is no temperature in °C.
OUTDOOR_K = (200.0, 400.0)
# Kelvin per count of common 16-bit files. What they make of one median differs so much that at most one is outdoors.
USUAL_SCALES = (0.01, 0.04, 0.1)
_COLDEST_C, _HOTTEST_C = -ICE_K, 3000.0
_KELVIN_IN_C = (220.0, 350.0)


@dataclass(frozen=True, slots=True)
class ThermalRequest:
    """How to read a radiometric sequence.

    frames: time stamps and `every`, as for any camera. kelvin_per_count, zero_k: temperature in K = zero_k +
    kelvin_per_count · count, for 16-bit pictures; without kelvin_per_count one of USUAL_SCALES that fits is taken.
    emissivity: in place of the one in a FLIR file, above 0, up to 1.
    """

    frames: FrameRequest = field(default_factory=FrameRequest)
    kelvin_per_count: float | None = None
    zero_k: float = 0.0
    emissivity: float | None = None

    def __post_init__(self) -> None:
        if self.kelvin_per_count is not None:
            positive("kelvin_per_count", self.kelvin_per_count, "K per count")
        if not np.isfinite(self.zero_k):
            raise refuse("zero_k", "a finite temperature in K", self.zero_k)
        if self.emissivity is not None and not 0.0 < self.emissivity <= 1.0:
            raise refuse("emissivity", "above 0, up to 1", self.emissivity)


def checked_celsius(image: NDArray[np.generic], name: str) -> Floats32:
    """The picture (rows, columns) as float32 in °C; DataError where its numbers are counts or kelvin.

    `name` says in messages which frame of which file this is.
    """
    values = np.ascontiguousarray(image, dtype=np.float32)
    # Every eighth row shows a unit as well as all of them.
    sample = values[:: max(values.shape[0] // 64, 1)]
    sample = sample[np.isfinite(sample)]
    if sample.size == 0:
        return values
    low, middle, high = (float(v) for v in np.percentile(sample, (1.0, 50.0, 99.0)))
    received = f"received {low:.6g} to {high:.6g}, in the middle {middle:.6g}"
    if _KELVIN_IN_C[0] <= low and high <= _KELVIN_IN_C[1]:
        raise DataError(
            f"{name} must hold temperatures in °C; {received}, which are kelvin. Subtract {ICE_K} and write it again."
        )
    if low < _COLDEST_C or middle > _HOTTEST_C:
        raise DataError(
            f"{name} must hold temperatures in °C; {received}, which look like counts. Convert them to °C, or write "
            "them as 16-bit TIFF and give kelvin_per_count."
        )
    return values


def count_scale(median_count: float, request: ThermalRequest, name: str) -> tuple[float, float]:
    """Kelvin per count and kelvin at count 0 of 16-bit pictures with this median; as stated, else the one that fits.

    Raises DataError where the stated scale, or any usual one, does not give a temperature from 200 to 400 K.
    """
    low, high = OUTDOOR_K
    stated = request.kelvin_per_count
    scales: tuple[float, ...] = USUAL_SCALES if stated is None else (stated,)
    found = [scale for scale in scales if low <= request.zero_k + scale * median_count <= high]
    if not found:
        tried = ", ".join(f"{scale:g} K a count: {request.zero_k + scale * median_count:.5g} K" for scale in scales)
        raise DataError(
            f"{name} must hold counts that mean {low:g} to {high:g} K; its median count is {median_count:g} ({tried}). "
            "Give kelvin_per_count and zero_k as the camera's manual states them."
        )
    return found[0], request.zero_k
