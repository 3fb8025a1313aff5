"""Pictures and stacks as frames in °C: 16 bits by their scale, floats as they are, 8 bits with a warning."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import Frame, Nanoseconds
from midspan.sources.camera.frames import FrameInfo, FrameSource
from midspan.sources.thermal.request import ThermalRequest, checked_celsius, count_scale

AGC_NOTE = (
    "8-bit grey levels, not temperatures: the camera's automatic gain changes with what comes into view; "
    "record radiometric data where the camera can"
)


class ThermalPictures(FrameSource):
    """Frames of another source as float32 in °C; grey levels of 8 bits stay as they are, with a note."""

    def __init__(self, source: FrameSource, request: ThermalRequest, name: str) -> None:
        self._source, self._name = source, name
        first = next(iter(source.frames(0, 1)), None)
        if first is None:
            raise DataError(f"{name} holds no frame that can be read. Check that the file is whole.")
        self._shape, self._dtype = first.pixels.shape, first.pixels.dtype
        self._scale: tuple[float, float] | None = None
        if self._dtype == np.uint16:
            self._scale = count_scale(float(np.median(first.pixels.astype(np.float64))), request, name)
        self._celsius(first)

    @property
    def info(self) -> FrameInfo:
        """What is known of the source, and how its numbers were understood."""
        known = self._source.info
        if self._dtype == np.uint8:
            return replace(known, notes=(*known.notes, AGC_NOTE))
        note = "temperatures in °C"
        if self._scale is not None:
            note = f"16-bit counts of {self._scale[0]:g} K, 0 at {self._scale[1]:g} K"
        return replace(known, bit_depth=32, notes=(*known.notes, note), radiometric=True)

    def times_ns(self) -> Nanoseconds:
        """Time stamps of the source."""
        return self._source.times_ns()

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """The frames in °C; DataError names one of another size or in another unit."""
        for frame in self._source.frames(start, stop):
            yield replace(frame, pixels=self._celsius(frame))

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
        # In double precision: a count of 0.01 K is below float32's steps at 30 000 counts after a product with 0.01.
        celsius = pixels.astype(np.float64) * kelvin_per_count + (zero_k - 273.15)
        return checked_celsius(celsius, name)
