"""Pictures and stacks as frames in °C: 16 bits by their scale, floats as they are, 8 bits with a warning."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import Frame, Nanoseconds
from midspan.sources.thermal.request import OUTDOOR_K, ThermalRequest, checked_celsius, count_scale
from midspan.vision.frame_source import FrameInfo, FrameSource

Quartiles = tuple[float, float, float]

# A first frame whose middle is above this, °C, may be in another unit.
WARMEST_WALL_C = 45.0
# A frame follows the one before in another unit where its middle fits to this, K, after a change of more than the next,
# and its contrast to this share.
_SAME_K, _MIN_CHANGE_K, _SAME_SHARE = 1.0, 10.0, 0.25

AGC_NOTE = (
    "8-bit grey levels, not temperatures: the camera's automatic gain changes with what comes into view; "
    "record radiometric data where the camera can"
)


class ThermalPictures(FrameSource):
    """Frames of another source as float32 in °C; grey levels of 8 bits stay as they are, with a note."""

    def __init__(self, source: FrameSource, request: ThermalRequest, name: str) -> None:
        self._source, self._name = source, name
        first = next(iter(source.frames()), None)
        if first is None:
            raise DataError(f"{name} holds no frame that can be read. Check that the file is whole.")
        self._shape, self._dtype = first.pixels.shape, first.pixels.dtype
        self._scale: tuple[float, float] | None = None
        self._doubt = ""
        if self._dtype == np.uint16:
            self._scale = count_scale(float(np.median(first.pixels.astype(np.float64))), request, name)
        self._doubt = _doubt(self._celsius(first)) if self._dtype.kind == "f" else ""

    @property
    def info(self) -> FrameInfo:
        """What is known of the source, and how its numbers were understood."""
        known = self._source.info
        if self._dtype == np.uint8:
            return replace(known, notes=(*known.notes, AGC_NOTE))
        note = "temperatures in °C"
        if self._scale is not None:
            note = f"16-bit counts of {self._scale[0]:g} K, 0 at {self._scale[1]:g} K"
        damage = (*known.damage, self._doubt) if self._doubt else known.damage
        return replace(known, bit_depth=32, notes=(*known.notes, note), radiometric=True, damage=damage)

    def times_ns(self) -> Nanoseconds:
        """Time stamps of the source."""
        return self._source.times_ns()

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """The frames in °C; DataError names one of another size or in another unit."""
        before: Quartiles | None = None
        for frame in self._source.frames(start, stop):
            celsius = self._celsius(frame)
            if self._dtype.kind == "f":
                before = self._same_unit(frame.index, before, _quartiles(celsius))
            yield replace(frame, pixels=celsius)

    def _same_unit(self, number: int, before: Quartiles | None, now: Quartiles | None) -> Quartiles | None:
        """The quartiles of a frame; DataError where it is the one before in °F, or the other way round."""
        if before is None or now is None:
            return now or before
        for first, then, told in ((before, now, "from °C to °F"), (now, before, "from °F to °C")):
            fits = abs(then[1] - (1.8 * first[1] + 32.0)) < _SAME_K and abs(then[1] - first[1]) > _MIN_CHANGE_K
            wide, wider = first[2] - first[0], then[2] - then[0]
            if fits and wide > 0.0 and abs(wider / wide - 1.8) < _SAME_SHARE:
                raise DataError(
                    f"{self._name}: frame {number} must be in the unit of the frames before; its middle goes from "
                    f"{before[1]:.4g} to {now[1]:.4g}, and its contrast with it, as {told}. Convert it to °C, or split "
                    "the sequence."
                )
        return now

    def _celsius(self, frame: Frame) -> NDArray[np.generic]:
        pixels, name = frame.pixels, f"{self._name}: frame {frame.index}"
        if pixels.shape != self._shape or pixels.dtype != self._dtype:
            raise DataError(
                f"{name} must have the size and depth of the first, {self._shape[1]}x{self._shape[0]} px of "
                f"{self._dtype}; received {pixels.shape[1]}x{pixels.shape[0]} px of {pixels.dtype}. Split the sequence."
            )
        if pixels.dtype == np.uint8:
            return pixels
        if self._scale is None:
            return checked_celsius(pixels, name)
        kelvin_per_count, zero_k = self._scale
        self._same_scale(pixels, name)
        # In double precision: a count of 0.01 K is below float32's steps at 30 000 counts after a product with 0.01.
        celsius = pixels.astype(np.float64) * kelvin_per_count + (zero_k - 273.15)
        return checked_celsius(celsius, name)

    def _same_scale(self, counts: NDArray[np.generic], name: str) -> None:
        """DataError where counts mean no outdoor temperature by the scale of the first frame; blank ones are flat."""
        assert self._scale is not None
        low, middle, high = _quartiles(counts) or (0.0, 0.0, 0.0)
        kelvin = self._scale[1] + self._scale[0] * middle
        if high > low and not OUTDOOR_K[0] <= kelvin <= OUTDOOR_K[1]:
            raise DataError(
                f"{name} must hold counts of {self._scale[0]:g} K as the first one does; its middle, {middle:g}, would "
                f"mean {kelvin:.4g} K, and {OUTDOOR_K[0]:g} to {OUTDOOR_K[1]:g} K are expected. Split the sequence "
                "where the camera's range changed."
            )


def _quartiles(values: NDArray[Any]) -> Quartiles | None:
    """The quartiles of every so many pixels; None where all are missing."""
    step = max(min(values.shape) // 60, 1)
    known = values[::step, ::step]
    known = known[np.isfinite(known)]
    if not known.size:
        return None
    low, middle, high = (float(v) for v in np.percentile(known, (25.0, 50.0, 75.0)))
    return low, middle, high


def _doubt(celsius: NDArray[Any]) -> str:
    """What is to be said of a first frame that is hotter than walls are."""
    found = _quartiles(celsius)
    if found is None or found[1] <= WARMEST_WALL_C:
        return ""
    return (
        f"the middle of the first frame is {found[1]:.4g} °C, more than a wall usually reaches: if the numbers are °F "
        "or tenths, convert them; the displacement hardly changes, stated temperatures and limits in K do"
    )
