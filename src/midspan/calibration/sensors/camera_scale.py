"""From a target's pixels to metres."""

from dataclasses import dataclass

import numpy as np

from midspan.records import Displacement, PixelTrack, Source


@dataclass(frozen=True, slots=True)
class CameraScale:
    """From pixels to metres for one target along one image axis.

    scale_m_per_px: signed; direction: image axis "x" or "y"; time_offset_ns: added to the camera's stamps to get the
    accelerometer's clock; variance_factor: estimated variance over the tracker's own; source: how its rows are marked;
    relative_std: of the scale factor, by which targets may differ as the motion grows.
    """

    scale_m_per_px: float
    direction: str
    time_offset_ns: int
    variance_factor: float = 1.0
    source: Source = Source.CAMERA
    relative_std: float = 0.0

    def displacement(self, track: PixelTrack) -> Displacement:
        """The displacement that a track stands for, on the accelerometer's clock; lost frames are not finite."""
        value, variance = track.along(self.direction)
        return Displacement(
            time_ns=track.time_ns + self.time_offset_ns,
            value_m=self.scale_m_per_px * value,
            variance_m2=self.scale_m_per_px**2 * self.variance_factor * variance,
            source=np.full(len(value), self.source, dtype=np.uint8),
        )
