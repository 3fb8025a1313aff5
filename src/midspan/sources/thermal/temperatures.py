"""Pictures and stacks as frames in °C without holes: how they are read, their units, and what of them is mended.

16 bits become °C by their scale, floats are taken as they are, 8 bits stay grey levels with a note.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.checks import positive, refuse
from midspan.errors import DataError
from midspan.records import Floats32, Frame, Nanoseconds
from midspan.sources.camera.frames import MAX_MISSING, FrameRequest, named, passed_over
from midspan.thermal.dead_pixels import filled, stuck_pixels
from midspan.thermal.radiometry import ICE_K
from midspan.vision.frame_source import FrameInfo, FrameSource

# Temperatures that a camera can meet outdoors; a median in this range of kelvin is no temperature in °C.
OUTDOOR_K = (200.0, 400.0)
# Kelvin per count of common 16-bit files. What they make of one median differs so much that at most one is outdoors.
USUAL_SCALES = (0.01, 0.04, 0.1)
_COLDEST_C, _HOTTEST_C = -ICE_K, 3000.0
_KELVIN_IN_C = (220.0, 350.0)
# A first frame whose middle is above this, °C, may be in another unit.
WARMEST_WALL_C = 45.0
# A frame follows the one before in another unit where its middle fits to this, K, after a change of more than the next,
# and its contrast to this share.
_SAME_K, _MIN_CHANGE_K, _SAME_SHARE = 1.0, 10.0, 0.25

AGC_NOTE = (
    "8-bit grey levels, not temperatures: the camera's automatic gain changes with what comes into view; "
    "record radiometric data where the camera can"
)
# Frames spread over the file that tell which pixels are stuck, and the memory they may take.
_LOOKED_AT = 32
_MAX_BYTES = 200_000_000

Quartiles = tuple[float, float, float]


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
    low, middle, high = np.percentile(sample, (1.0, 50.0, 99.0)).tolist()
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


class ThermalPictures(FrameSource):
    """Frames of another source as float32 in °C; grey levels of 8 bits stay as they are, with a note."""

    def __init__(self, source: FrameSource, request: ThermalRequest, name: str) -> None:
        self._source, self._name = source, name
        first = next(iter(source.frames()), None)
        if first is None:
            raise DataError(f"{name} holds no frame that can be read. Check that the file is whole.")
        self._shape, self._dtype = first.pixels.shape, first.pixels.dtype
        self._scale: tuple[float, float] | None = None
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
        for first, then, reported in ((before, now, "from °C to °F"), (now, before, "from °F to °C")):
            fits = abs(then[1] - (1.8 * first[1] + 32.0)) < _SAME_K and abs(then[1] - first[1]) > _MIN_CHANGE_K
            wide, wider = first[2] - first[0], then[2] - then[0]
            if fits and wide > 0.0 and abs(wider / wide - 1.8) < _SAME_SHARE:
                raise DataError(
                    f"{self._name}: frame {number} must be in the unit of the frames before; its middle goes from "
                    f"{before[1]:.4g} to {now[1]:.4g}, and its contrast with it, as {reported}. Convert it to °C, "
                    "or split the sequence."
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
        low, middle, high = _quartiles(pixels) or (0.0, 0.0, 0.0)
        kelvin = zero_k + kelvin_per_count * middle
        # By the scale of the first frame; blank ones are flat.
        if high > low and not OUTDOOR_K[0] <= kelvin <= OUTDOOR_K[1]:
            raise DataError(
                f"{name} must hold counts of {kelvin_per_count:g} K as the first one does; its middle, {middle:g}, "
                f"would mean {kelvin:.4g} K, and {OUTDOOR_K[0]:g} to {OUTDOOR_K[1]:g} K are expected. Split the "
                "sequence where the camera's range changed."
            )
        return checked_celsius(celsius_of(pixels, kelvin_per_count, zero_k), name)


def celsius_of(counts: NDArray[np.generic], kelvin_per_count: float, zero_k: float) -> Floats32:
    """Temperatures in °C of counts (rows, columns)."""
    # In double precision: a count of 0.01 K is below float32's steps at 30 000 counts after a product with 0.01.
    return (counts.astype(np.float64) * kelvin_per_count + (zero_k - ICE_K)).astype(np.float32)


def _quartiles(values: NDArray[Any]) -> Quartiles | None:
    """The quartiles of every this many pixels; None where all are missing."""
    step = max(min(values.shape) // 60, 1)
    known = values[::step, ::step]
    known = known[np.isfinite(known)]
    if not known.size:
        return None
    low, middle, high = np.percentile(known, (25.0, 50.0, 75.0)).tolist()
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


class RepairedFrames(FrameSource):
    """Frames in °C of another source, every value a number; `info.damage` tells what was filled and passed over."""

    def __init__(self, source: FrameSource, name: str) -> None:
        """`name`: of the file, for messages. Raises DataError where no frame that is looked at can be used."""
        self._source, self._name = source, name
        self._passed: set[int] = set()
        self._holes: dict[int, int] = {}
        first = next(iter(source.frames(0, 1)), None)
        if first is None or _missing_share(first.pixels) > MAX_MISSING:
            _ = self._stuck

    @property
    def info(self) -> FrameInfo:
        """What is known of the source, and so far of its damage."""
        known = self._source.info
        return replace(known, damage=(*known.damage, *self._damage()))

    def times_ns(self) -> Nanoseconds:
        """Time stamps of the source."""
        return self._source.times_ns()

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """The frames in °C without holes; those of which more than a fifth is missing are passed over."""
        stuck = self._stuck
        for frame in self._source.frames(start, stop):
            holes = ~np.isfinite(frame.pixels)
            missing = int(np.count_nonzero(holes))
            if missing > MAX_MISSING * holes.size:
                self._passed.add(frame.index)
                continue
            if missing:
                self._holes[frame.index] = missing
            dead = holes | stuck
            yield replace(frame, pixels=filled(frame.pixels, dead)) if dead.any() else frame

    @cached_property
    def _stuck(self) -> NDArray[np.bool_]:
        """Pixels (rows, columns) that are stuck, by frames from all over the file."""
        known = self._source.info
        count = min(_LOOKED_AT, max(_MAX_BYTES // max(4 * known.width * known.height, 1), 1))
        places = np.unique(np.linspace(0, len(self.times_ns()) - 1, count).astype(int))
        usable = []
        refused: DataError | None = None
        for k in places:
            try:
                seen = next(iter(self._source.frames(int(k), int(k) + 1)), None)
            except DataError as error:
                # Reported where the frames are read in their order: the first that is wrong counts.
                refused = refused or error
                continue
            if seen is not None and _missing_share(seen.pixels) <= MAX_MISSING:
                usable.append(seen.pixels)
        if not usable and refused is not None:
            raise refused
        if not usable:
            raise DataError(
                f"{self._name} must hold temperatures in °C; of the {len(places)} frames looked at all have more than "
                f"{100 * MAX_MISSING:g} % of their values missing (all its values are missing, or most). Check how "
                "it was written."
            )
        return stuck_pixels(np.stack(usable).astype(np.float32, copy=False))

    def _damage(self) -> list[str]:
        reported = []
        # Not before they were looked for: opening a file reads its first frame only.
        stuck = self.__dict__.get("_stuck")
        if stuck is not None and stuck.any():
            places = np.argwhere(stuck)
            where = named([f"({x}, {y})" for y, x in places])
            reported.append(f"{len(places)} stuck pixels, at (x, y) = {where}, are filled from their neighbours")
        if self._holes:
            reported.append(
                f"{len(self._holes)} frames have missing values (NaN), at most {max(self._holes.values())} a frame, "
                "filled from their neighbours"
            )
        return reported + passed_over(self._passed)


def _missing_share(pixels: NDArray[np.generic]) -> float:
    return float(np.mean(~np.isfinite(pixels)))
