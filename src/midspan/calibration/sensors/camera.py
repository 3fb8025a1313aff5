"""The camera's part of a calibration: scale factor, clock offset, region and noise, target by target."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from midspan.calibration.scale import ScaleCalibration
from midspan.records import Displacement, PixelTrack, Region, ScaleFactor, Source, TimeOffset
from midspan.vision.lens import Lens

# A camera that sways tilts slowly as well, with its structure and in the sun, which neither the accelerometer nor one
# distance shows: by this many times what it sways by at its own frequency. Footbridges of the kind of the scenario
# `tilting-footbridge` need 1.6 to 3.
SLOW_TILT = 3.0


@dataclass(frozen=True, slots=True)
class CameraScale:
    """From pixels to metres for one target along one image axis.

    scale_m_per_px: signed; direction: image axis "x" or "y"; time_offset_ns: added to the camera's stamps to get the
    accelerometer's clock; variance_factor: estimated variance over the tracker's own; source: how its rows are marked;
    relative_std: of the scale factor, by which targets may differ as the motion grows; lever_px: see
    `TargetCalibration`, for tracks that still hold the zoom's motion.
    """

    scale_m_per_px: float
    direction: str
    time_offset_ns: int
    variance_factor: float = 1.0
    source: Source = Source.CAMERA
    relative_std: float = 0.0
    lever_px: float = 0.0

    def displacement(self, track: PixelTrack) -> Displacement:
        """The displacement that a track stands for, on the accelerometer's clock; lost frames are not finite."""
        value, variance = track.along(self.direction)
        return Displacement(
            time_ns=track.time_ns + self.time_offset_ns,
            value_m=self.scale_m_per_px * value,
            variance_m2=self.scale_m_per_px**2 * self.variance_factor * variance,
            source=np.full(len(value), self.source, dtype=np.uint8),
        )


@dataclass(frozen=True, slots=True)
class TargetCalibration:
    """What was estimated of one of several targets; scale None where it was refused.

    used: whether the result rests on it; reason: why not. variance_factor: the estimated variance over the tracker's
    own. lever_px: by which the picture's zoom moves it, which is taken off; 0: no zoom shows.
    """

    region: Region
    name: str
    scale: ScaleFactor | None
    noise_std_px: float = math.nan
    variance_factor: float = math.nan
    used: bool = True
    reason: str = ""
    lever_px: float = 0.0


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """Scale factor, clock offset, region, axis and noise of the camera; with several targets those of the best one.

    variance_factor: the estimated variance over the tracker's own. phase_scale_m_per_rad: displacement per radian of
    the active pixels' mean phase, with the trackers that use it. targets: all of them. fused: whether this axis has an
    accelerometer; without one the scale factor is the other axis's. relative_scale_std: of all targets together. lens:
    what the pixels were corrected by; the scale factor holds for that lens only. source: which camera it is.
    temperature_range_c: of a thermal camera what its tracker saw, °C. exposure_s: its exposure as the motion shows it,
    0 where it is declared or does not show. apart_std_m: what it and the accelerometer contradict each other by, rms,
    where nothing tells which is wrong. slow_std_m, slow_time_s, slow_hz: of its slow error, see `records.Channel`.
    tilt_std_px: standard deviation of its tilt in the image, where targets at several distances show it; else 0.
    tilt_walk_px2_s: density of the random walk that it goes on by. tilt_of: name of the camera on the same box whose
    tilt that is, "": its own; tilt_ratio: pixels of this one for a pixel of that one by a tilt.
    name: where there are several sensors of a kind. literal: scale and offset are as printed (see
    `papers/printed/camera.py`). diagnostics: what the best target's values rest on, for the report; not in the file.
    """

    scale: ScaleFactor
    offset: TimeOffset
    region: Region
    direction: str
    tracker: str
    noise_std_px: float
    variance_factor: float
    phase_scale_m_per_rad: float | None = None
    targets: tuple[TargetCalibration, ...] = ()
    fused: bool = True
    relative_scale_std: float | None = None
    lens: Lens | None = None
    source: Source = Source.CAMERA
    temperature_range_c: tuple[float, float] | None = None
    exposure_s: float = 0.0
    apart_std_m: float = 0.0
    slow_std_m: float = 0.0
    slow_time_s: float = math.inf
    slow_hz: float = 0.0
    tilt_std_px: float = 0.0
    tilt_walk_px2_s: float = 0.0
    tilt_of: str = ""
    tilt_ratio: float = 1.0
    name: str | None = None
    literal: bool = False
    diagnostics: ScaleCalibration | None = field(default=None, compare=False, repr=False)

    @property
    def kind(self) -> str:
        """The section that it stands in, "camera" or "infrared"."""
        return self.source.word

    @property
    def used(self) -> tuple[TargetCalibration, ...]:
        """The targets that the result rests on."""
        found = tuple(target for target in self.targets if target.used)
        return found or (TargetCalibration(self.region, "1", self.scale, self.noise_std_px, self.variance_factor),)

    @property
    def best_used(self) -> int:
        """Number, among those used, of the target with the least noise, whose zero is that of the displacement."""
        noise = [abs(m.scale_m_per_px) * t.noise_std_px for m, t in zip(self.mappings(), self.used, strict=True)]
        return noise.index(min(noise))

    @property
    def holds_tilt(self) -> bool:
        """Whether the slow tilt of a camera that sways is in `apart_std_m`."""
        return 0.0 < SLOW_TILT * self.slow_std_m <= self.apart_std_m

    @property
    def relative_std(self) -> float:
        """Relative standard deviation of the scale factor of all targets together."""
        if self.relative_scale_std is not None:
            return self.relative_scale_std
        return math.sqrt(self.scale.variance) / abs(self.scale.value_m_per_px)

    def without_gain(self, gain: float, std: float) -> "CameraCalibration":
        """The same in metres: the scale was estimated from an accelerometer of this gain and relative deviation."""

        def metres(scale: ScaleFactor) -> ScaleFactor:
            return ScaleFactor(scale.value_m_per_px / gain, scale.variance / gain**2).wider(std)

        phase = self.phase_scale_m_per_rad
        known = (one if one.scale is None else replace(one, scale=metres(one.scale)) for one in self.targets)
        return replace(
            self,
            scale=metres(self.scale),
            phase_scale_m_per_rad=None if phase is None else phase / gain,
            slow_std_m=self.slow_std_m / gain,
            targets=tuple(known),
            relative_scale_std=math.hypot(self.relative_std, std),
        )

    def mappings(self) -> tuple[CameraScale, ...]:
        """What turns the pixels of each used target into metres."""
        return tuple(self._mapping(target) for target in self.used)

    def _mapping(self, target: TargetCalibration) -> CameraScale:
        assert target.scale is not None
        value = target.scale.value_m_per_px
        return CameraScale(
            scale_m_per_px=value,
            direction=self.direction,
            time_offset_ns=round(1e9 * self.offset.value_s),
            variance_factor=target.variance_factor,
            relative_std=math.sqrt(target.scale.variance) / abs(value),
            source=self.source,
            lever_px=target.lever_px,
        )
