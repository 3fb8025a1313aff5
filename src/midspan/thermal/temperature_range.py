"""The temperature range that a thermal picture of 8 bits shows, and how the best one is found.

J. Choi, Z. Ma, K. Kim, H. Sohn, "Continuous Structural Displacement Monitoring Using Accelerometer, Vision, and
Infrared (IR) Cameras", Sensors 23 (2023) 5241, doi 10.3390/s23115241, section 2.1.2. The range of the field of view
makes the target pale, that of its own region shows the noise; in between the one is taken whose displacement agrees
best with the accelerometer's (equations 1 and 2).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.checks import finite, refuse
from midspan.errors import UntrustedError, UsageError
from midspan.records import NANOSECONDS, Floats, Frame, PixelTrack, Region
from midspan.thermal.limits import Limits

Follow = Callable[[Sequence[Frame]], PixelTrack]
"""Tracks frames from the first one on, in px."""

# M of the paper: its section 3.1.1 names nine parts, l = 0.857 K and h = 0.604 K.
DIVISIONS = 9
ROUGH, THINNED = 16, 3  # this many frames, every this many, show which ranges are worth all frames
REFINED = 9  # ranges that are compared once more with all frames
MAX_MISSING = 0.2  # share of lost frames above which a range is no candidate


@dataclass(frozen=True, slots=True, eq=False)
class RangeSurface:
    """The error by range: `error_px` (M + 1, M + 1), rows m by falling lower limit and columns n by rising upper limit;
    NaN where too many frames were lost. `low_c` and `high_c` (M + 1,) are the limits; `lost` (M + 1, M + 1) the share
    of frames lost, 0 to 1; `best` the range chosen.
    """

    low_c: Floats
    high_c: Floats
    error_px: Floats
    lost: Floats
    best: Limits


def field_range(frames: Sequence[Frame]) -> Limits:
    """Least and largest temperature of whole frames, °C."""
    return _extent([frame.pixels for frame in frames])


def region_range(frames: Sequence[Frame], region: Region) -> Limits:
    """Least and largest temperature inside `region` (px) of all frames, °C."""
    return _extent([frame.pixels[region.slices] for frame in frames])


def _extent(pictures: Sequence[NDArray[np.generic]]) -> Limits:
    if not pictures:
        raise UsageError("frames must be one or more; received none. Give the frames of the calibration.")
    low = min(float(np.nanmin(p.astype(np.float64))) for p in pictures)
    return Limits(low, max(float(np.nanmax(p.astype(np.float64))) for p in pictures))


def grey(celsius: NDArray[np.generic], limits: Limits) -> NDArray[np.uint8]:
    """The picture in 256 grey levels from the lower limit (0) to the upper one (255); what lies outside is clipped."""
    scaled = (np.asarray(celsius, dtype=np.float32) - np.float32(limits.low_c)) * np.float32(127.5 / limits.half_k)
    return np.asarray(np.clip(np.rint(np.nan_to_num(scaled)), 0, 255), dtype=np.uint8)


def in_grey(frames: Sequence[Frame], limits: Limits) -> list[Frame]:
    """The frames in grey levels of a range."""
    return [replace(frame, pixels=grey(frame.pixels, limits)) for frame in frames]


def candidates(region: Limits, field: Limits, divisions: int = DIVISIONS) -> tuple[Floats, Floats]:
    """Lower and upper limits (M + 1,) from the region's to the field of view's in equal steps: equations 1 and 2."""
    if divisions < 1:
        raise refuse("divisions", "1 or more", divisions)
    if field.low_c > region.low_c or field.high_c < region.high_c:
        raise refuse("the range of the field of view", "wider than the region's", (field, region))
    steps = np.arange(divisions + 1) / divisions
    low = region.low_c - (region.low_c - field.low_c) * steps
    return low, region.high_c + (field.high_c - region.high_c) * steps


@dataclass(frozen=True, slots=True)
class Expected:
    """What the accelerometer says: translation (n,) in px at each frame, along "x" or "y", and its band in Hz.

    Only what lies in the band is compared; it should leave out the slow drift of the double integral.
    """

    translation_px: Floats
    direction: str
    band_hz: tuple[float, float]


def optimise_range(
    frames: Sequence[Frame], region: Region, follow: Follow, expected: Expected, divisions: int = DIVISIONS
) -> RangeSurface:
    """The range whose translation agrees best with the expected one, out of (M + 1)² between region and field of view.

    frames: n of the calibration, in °C; region: the target's, px; follow: tracks frames in grey levels. All ranges are
    compared on 16 frames, every third, and the best nine and the whole view again on all.
    Raises UntrustedError where no range keeps its target.
    """
    if len(frames) != len(expected.translation_px) or len(frames) < 8:
        raise refuse("frames and expected.translation_px", "equally many, 8 or more", len(frames))
    low, high = candidates(region_range(frames, region), field_range(frames), divisions)
    few = np.s_[: ROUGH * THINNED : THINNED] if len(frames) >= ROUGH * THINNED else np.s_[:]
    shape = (divisions + 1, divisions + 1)
    error, lost = np.full(shape, np.nan), np.ones(shape)
    rough = _Trial(frames[few], follow, replace(expected, translation_px=expected.translation_px[few]))
    known: dict[Limits, tuple[float, float]] = {}
    for m, n in np.ndindex(shape):
        limits = Limits(float(low[m]), float(high[n]))
        # Where the region is as cold or as warm as anything in view, rows or columns are all the same range.
        known[limits] = known[limits] if limits in known else rough.judge(limits)
        error[m, n], lost[m, n] = known[limits]
    if not np.isfinite(error).any():
        raise UntrustedError(
            f"No temperature range from {low[-1]:.1f} to {high[-1]:.1f} °C keeps the target: at best "
            f"{100 * lost.min():.0f} % of the frames are lost. Choose another region, or track °C directly."
        )
    order = [divmod(int(flat), shape[1]) for flat in np.argsort(error, axis=None)[:REFINED]]
    # The whole view is always among them: where hardly anything moves 16 frames rank the ranges by chance.
    order += [(divisions, divisions)] if (divisions, divisions) not in order else []
    whole = _Trial(frames, follow, expected)
    for m, n in order:
        error[m, n], lost[m, n] = whole.judge(Limits(float(low[m]), float(high[n])))
    m, n = min(order, key=lambda place: np.nan_to_num(error[place], nan=np.inf))
    return RangeSurface(low, high, error, lost, Limits(float(low[m]), float(high[n])))


@dataclass(frozen=True, slots=True)
class _Trial:
    """Frames, how they are tracked, and what their translation should be."""

    frames: Sequence[Frame]
    follow: Follow
    expected: Expected

    def judge(self, limits: Limits) -> tuple[float, float]:
        """Root mean square error in the band, px (NaN with too few frames), and the share of frames lost."""
        try:
            track = self.follow(in_grey(self.frames, limits))
        except UsageError:  # in this range the target has no texture
            return np.nan, 1.0
        translation, _ = track.along(self.expected.direction)
        lost = float(np.mean(~np.isfinite(translation)))
        if lost > MAX_MISSING:
            return np.nan, lost
        time_s = (track.time_ns - track.time_ns[0]) / NANOSECONDS
        return band_error(time_s, translation - self.expected.translation_px, self.expected.band_hz), lost


def band_error(time_s: Floats, difference: Floats, band_hz: tuple[float, float]) -> float:
    """Root mean square of what lies in `band_hz` of a difference (n,) at times (n,) in s, which need not be even.

    Values that are not finite are left out. The part of each band is fitted by cosines of the record's length, the
    slower ones in addition to those of the band, so that drift does not leak into it.
    """
    low, high = finite("band_hz", band_hz)
    if not 0.0 <= low < high:
        raise refuse("band_hz", "two frequencies from low to high (Hz)", band_hz)
    kept = np.isfinite(difference)
    length_s = float(time_s[-1] - time_s[0])
    # More cosines than half the values would follow every value.
    last = min(int(2.0 * length_s * high), int(np.count_nonzero(kept)) // 2 - 1)
    first = max(round(2.0 * length_s * low), 1)
    if last < first:
        raise refuse("band_hz", f"a band that {length_s:.3g} s of frames can show", band_hz, "Use more frames.")
    cosines = np.cos(np.pi * np.outer(time_s - time_s[0], np.arange(last + 1)) / length_s)
    weights = np.linalg.lstsq(cosines[kept], difference[kept], rcond=None)[0]
    return float(np.sqrt(np.mean((cosines[kept, first:] @ weights[first:]) ** 2)))
