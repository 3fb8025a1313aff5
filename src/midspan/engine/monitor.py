"""One camera, one accelerometer and the filter between them: the prediction goes to the tracker, its measurement back.

Only here do vision and fusion meet. The loop closes in data: the filter's prediction is turned into pixels by the scale
factor, the tracker answers with a translation, and that becomes a displacement for the filter.
"""

from dataclasses import dataclass

import numpy as np

from midspan.fusion.kalman import KalmanFilter, Output
from midspan.records import Acceleration, Displacement, Frame, PixelTrack, PixelTranslation, Prediction, Source
from midspan.vision.tracker import Tracker

# Standard deviation of the prediction across the measured axis, where nothing predicts: the motion there is small.
ACROSS_STD_PX = 2.0
# The prediction is trusted to no better than this, so that the search never narrows to nothing.
LEAST_STD_PX = 0.5


@dataclass(frozen=True, slots=True)
class CameraScale:
    """From pixels to metres for one camera.

    scale_m_per_px: signed; direction: image axis "x" or "y"; time_offset_ns: added to the camera's stamps to get the
    accelerometer's clock; variance_factor: learnt variance over the tracker's own; source: how its rows are marked.
    """

    scale_m_per_px: float
    direction: str
    time_offset_ns: int
    variance_factor: float = 1.0
    source: Source = Source.CAMERA

    def displacement(self, track: PixelTrack) -> Displacement:
        """The displacement that a track stands for, on the accelerometer's clock; lost frames are not finite."""
        value, variance = track.along(self.direction)
        return Displacement(
            time_ns=track.time_ns + self.time_offset_ns,
            value_m=self.scale_m_per_px * value,
            variance_m2=self.scale_m_per_px**2 * self.variance_factor * variance,
            source=np.full(len(value), self.source, dtype=np.uint8),
        )


class Monitor:
    """Tracks a camera's target with the filter's prediction and fuses it with acceleration, one record at a time."""

    def __init__(self, tracker: Tracker, scale: CameraScale, kalman: KalmanFilter) -> None:
        self.tracker, self.scale, self.kalman = tracker, scale, kalman
        self._across_px = 0.0

    def push(self, record: Acceleration | Displacement | Frame) -> list[Output | PixelTranslation]:
        """Take one record in time order (acceleration up to a frame's time before the frame).

        A frame gives its PixelTranslation, acceleration gives Estimate, Innovation and Event blocks.
        """
        if not isinstance(record, Frame):
            return list(self.kalman.push(record))
        translation = self.tracker.push(record, self.prediction(record.time_ns + self.scale.time_offset_ns))
        across = translation.x_px if self.scale.direction == "y" else translation.y_px
        if np.isfinite(across):
            self._across_px = across
        self.kalman.push(self.scale.displacement(PixelTrack.stack([translation])))
        return [translation]

    def prediction(self, time_ns: int) -> Prediction | None:
        """Where the filter expects the target at `time_ns` on the accelerometer's clock; None while it cannot tell."""
        displacement, variance = self.kalman.predict(time_ns)
        per_px = self.scale.scale_m_per_px
        std = max(float(np.sqrt(max(variance, 0.0))) / abs(per_px), LEAST_STD_PX)
        if not np.isfinite(std) or std > 100.0:
            return None
        along = displacement / per_px
        if self.scale.direction == "y":
            return Prediction(self._across_px, along, ACROSS_STD_PX, std)
        return Prediction(along, self._across_px, std, ACROSS_STD_PX)
