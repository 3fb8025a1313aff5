"""One camera, its accelerometer and the filters between them: predictions go to the trackers, translations back.

Only here do vision and fusion meet. The loop closes in data: a filter's prediction is turned into pixels by each
target's scale factor, the trackers answer with translations, and those become one displacement for the filter. Each
image axis that is measured has a filter of its own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.engine.targets import Used, agreeing, combine
from midspan.fusion.kalman import KalmanFilter, Output
from midspan.records import (
    Acceleration,
    Displacement,
    Floats,
    Frame,
    Nanoseconds,
    PixelTrack,
    PixelTranslation,
    Prediction,
    Source,
)

# Standard deviation of the prediction across the measured axis, where nothing predicts: the motion there is small.
ACROSS_STD_PX = 2.0
# The prediction is trusted to no better than this, so that the search never narrows to nothing.
LEAST_STD_PX = 0.5
# A prediction vaguer than this is none.
MOST_STD_PX = 100.0
# The targets' relative zeros are means over so many frames, and stay as they are from then on.
ZERO_FRAMES = 600


Camera = Callable[[Frame, Sequence[Prediction | None]], Sequence[PixelTranslation]]
"""The translations of all targets in a frame, dated on the camera's clock, from where each is expected."""


@dataclass(frozen=True, slots=True)
class CameraScale:
    """From pixels to metres for one target along one image axis.

    scale_m_per_px: signed; direction: image axis "x" or "y"; time_offset_ns: added to the camera's stamps to get the
    accelerometer's clock; variance_factor: learnt variance over the tracker's own; source: how its rows are marked;
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


class AxisLoop:
    """One image axis: its filter, and the scale of each target (k); `zeros_m` (k,) are the targets' relative zeros."""

    def __init__(self, scales: Sequence[CameraScale], kalman: KalmanFilter) -> None:
        self.scales, self.kalman = tuple(scales), kalman
        self.zeros_m: Floats = np.zeros(len(self.scales))
        self._met: Nanoseconds = np.zeros(len(self.scales), dtype=np.int64)

    @property
    def direction(self) -> str:
        """The image axis."""
        return self.scales[0].direction

    def start(self, measured: Displacement, zeros_m: Floats) -> None:
        """Take over what was measured before this loop began, with the targets' relative zeros (k,) learnt from it."""
        self.kalman.push(measured)
        self.zeros_m = zeros_m.copy()
        self._met[:] = min(len(measured.time_ns), ZERO_FRAMES)

    def expected_px(self, target: int, time_ns: int) -> tuple[float, float] | None:
        """Translation of a target at `time_ns` on the camera's clock with its standard deviation, px; None if vague."""
        scale = self.scales[target]
        displacement, variance = self.kalman.predict(time_ns + scale.time_offset_ns)
        std = max(float(np.sqrt(max(variance, 0.0))) / abs(scale.scale_m_per_px), LEAST_STD_PX)
        if not np.isfinite(std) or std > MOST_STD_PX:
            return None
        return (displacement + float(self.zeros_m[target])) / scale.scale_m_per_px, std

    def meet(self, translations: Sequence[PixelTranslation]) -> None:
        """Take one frame's translation of each target: those that agree become one displacement for the filter."""
        blocks = [
            scale.displacement(PixelTrack.stack([_whole(translation)]))
            for scale, translation in zip(self.scales, translations, strict=True)
        ]
        if len(blocks) == 1:
            self.kalman.push(replace(blocks[0], value_m=blocks[0].value_m - self.zeros_m[0]))
            return
        stamps = np.array([int(block.time_ns[0]) for block in blocks])
        path, path_variance = self._path([int(stamp) for stamp in stamps])
        value = np.array([block.value_m[0] for block in blocks]) - self.zeros_m
        own = np.array([block.variance_m2[0] for block in blocks])[:, None]
        slack = (np.array([scale.relative_std for scale in self.scales]) * path)[:, None]
        residual = (value - path)[:, None]
        used = agreeing(residual, own + slack**2, path_variance)
        found = combine(residual, own, used)
        if not np.isfinite(found.value[0]):
            return
        self._learn_zeros(residual[:, 0] - found.value[0], used[:, 0])
        weight = found.weight[:, 0]
        middle = Displacement(
            time_ns=stamps[:1] + round(float(weight @ (stamps - stamps[0]))),
            value_m=found.value + float(weight @ path),
            variance_m2=found.variance,
            source=blocks[0].source,
        )
        self.kalman.push(middle)

    def _path(self, stamps: Sequence[int]) -> tuple[Floats, Floats]:
        """The expected displacement (k,) at stamps on the accelerometer's clock, and its variance (1,).

        Before the first acceleration nothing is expected, and only the targets can agree with each other.
        """
        expected = np.array([self.kalman.predict(stamp) for stamp in stamps])
        if not np.isfinite(expected).all():
            return np.zeros(len(stamps)), np.array([np.inf])
        return expected[:, 0], expected[:1, 1]

    def _learn_zeros(self, apart_m: Floats, used: Used) -> None:
        """Move the zeros of the targets in use by their share of how far they lie `apart_m` (k,) from the mean."""
        taken = used & (self._met < ZERO_FRAMES)
        self._met[taken] += 1
        self.zeros_m[taken] += apart_m[taken] / self._met[taken]


def _whole(found: PixelTranslation) -> PixelTranslation:
    """A translation whose variances hold those of the reference's place."""
    return replace(
        found,
        variance_x_px2=found.variance_x_px2 + found.reference_variance_x_px2,
        variance_y_px2=found.variance_y_px2 + found.reference_variance_y_px2,
    )


class Monitor:
    """Tracks a camera's targets with the filters' predictions and fuses them with acceleration, one record at a time.

    axes: one or two, the main one first.
    """

    def __init__(self, camera: Camera, axes: Sequence[AxisLoop]) -> None:
        self.camera, self.axes = camera, tuple(axes)
        self._seen_px = [dict.fromkeys("xy", 0.0) for _ in self.axes[0].scales]

    def push(self, record: Acceleration | Displacement | Frame, axis: int = 0) -> list[Output | PixelTranslation]:
        """Take one record in time order (acceleration of each axis up to a frame's time before the frame).

        A frame gives one PixelTranslation a target, acceleration gives Estimate, Innovation and Event blocks.
        """
        if not isinstance(record, Frame):
            return list(self.axes[axis].kalman.push(record))
        targets = range(len(self._seen_px))
        translations = self.camera(record, [self.prediction(record.time_ns, k) for k in targets])
        for seen, translation in zip(self._seen_px, translations, strict=True):
            for name, value in (("x", translation.x_px), ("y", translation.y_px)):
                seen[name] = value if np.isfinite(value) else seen[name]
        for loop in self.axes:
            loop.meet(translations)
        return list(translations)

    def prediction(self, time_ns: int, target: int = 0) -> Prediction | None:
        """Where a target is expected at `time_ns` on the camera's clock; None while the main axis cannot tell.

        Along an axis that nothing predicts the target is expected where it was seen last.
        """
        expected = {name: (value, ACROSS_STD_PX) for name, value in self._seen_px[target].items()}
        for number, loop in enumerate(self.axes):
            found = loop.expected_px(target, time_ns)
            if found is not None:
                expected[loop.direction] = found
            elif number == 0:
                return None
        return Prediction(expected["x"][0], expected["y"][0], expected["x"][1], expected["y"][1])
