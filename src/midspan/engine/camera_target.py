"""One target of a camera, from a frame to its translation with the variance that the frames up to it allow."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.engine.rolling_shutter import row_of, rows_share
from midspan.engine.target_opening import Opening
from midspan.records import NANOSECONDS, Frame, PixelTranslation, Prediction, Region, Status
from midspan.vision.fair_variance import FairVariance, UsualVariances
from midspan.vision.lens import ideal_translation, shown_prediction
from midspan.vision.light import LightState, LightWatch
from midspan.vision.picture_quality import PictureState, PictureWatch
from midspan.vision.target import lost


@dataclass(frozen=True, slots=True)
class Target:
    """A target to be tracked: its region in the reference frame and what it is called."""

    region: Region
    name: str = "1"


@dataclass(frozen=True, slots=True)
class ChainSettings:
    """How a camera's frames become translations.

    opening: what each target is tracked with. readout_s: rolling shutter, s from the first row (which the stamps belong
    to) to the last: translations are dated by the row of the target's middle. lossless: whether the frames come from a
    file which leaves nothing out. quarter_turns: by which the sensor's rows were turned with the picture.
    """

    opening: Opening
    readout_s: float = 0.0
    lossless: bool = False
    quarter_turns: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class TargetState:
    """What a `TargetChain` remembers: its stages' states, the region's pixels in the frame before, and how
    many frames only repeated them.
    """

    tracker: Any
    usual: UsualVariances
    picture: PictureState | None
    light: LightState | None
    seen: NDArray[np.generic] | None = None
    frozen_frames: int = 0


class TargetChain:
    """Tracks one target; every frame's variances rest on the frames up to it.

    What of the frames is worth reporting stands in `picture` and `light` (None where they do not apply: temperatures
    have no codec, no full scale and no shadows, and trackers whose reference changes know themselves what that makes)
    and in `frozen_frames`.
    """

    def __init__(self, reference: Frame, target: Target, settings: ChainSettings) -> None:
        self.region, self.name = target.region, target.name
        self._settings = settings
        opening = settings.opening
        self.tracker = opening.opened(reference, target.region)
        self.picture: PictureWatch | None = None
        self.light: LightWatch | None = None
        if not opening.radiometric(reference):
            self.picture = PictureWatch(reference, target.region, lossless=settings.lossless)
            self.light = LightWatch(reference, target.region) if opening.reference == "first" else None
        self._fair = FairVariance()
        self._seen: NDArray[np.generic] | None = None
        self.frozen_frames = 0

    @property
    def state(self) -> TargetState:
        """Everything that changes from frame to frame."""
        return TargetState(
            self.tracker.state,
            self._fair.state,
            None if self.picture is None else self.picture.state,
            None if self.light is None else self.light.state,
            self._seen,
            self.frozen_frames,
        )

    def restore(self, state: TargetState) -> None:
        """Continue from a `state` taken earlier."""
        self.tracker.restore(state.tracker)
        self._fair.restore(state.usual)
        if self.picture is not None and state.picture is not None:
            self.picture.restore(state.picture)
        if self.light is not None and state.light is not None:
            self.light.restore(state.light)
        self._seen, self.frozen_frames = state.seen, state.frozen_frames

    def push(self, frame: Frame, prediction: Prediction | None = None, *, dark: bool = False) -> PixelTranslation:
        """The translation in `frame` in pixels of the ideal camera, dated by the row that the target lies in.

        prediction: the same, of this frame. dark: that nothing is to be looked for. The target is LOST in the dark and
        where the picture is the one before once more.
        """
        lens = self._settings.opening.lens
        if dark:
            found = replace(lost(frame.time_ns), unseen="dark")
        else:
            found = self._fair.push(self.tracker.push(frame, shown_prediction(prediction, self.region, lens)))
            if self._frozen(frame):
                found = replace(lost(frame.time_ns, found.events), unseen="frozen")
        if self.light is not None and not dark:
            found = _with_reference_variance(found, self.light.push(frame, found))
        if self.picture is not None:
            found = self.picture.push(frame, found).of(found)
        late_ns = self._late_ns(frame, found)
        found = ideal_translation(found, self.region, lens)
        return replace(found, time_ns=frame.time_ns + late_ns) if late_ns else found

    def blur_s(self, exposure_s: float | None) -> float:
        """The time a translation is averaged over: the exposure, and the read-out of the region's rows.

        Both are box averages; their widths add as squares.
        """
        shape, turns = self.tracker.reference.pixels.shape, self._settings.quarter_turns
        share = rows_share(self.region.width, self.region.height, shape, turns)
        return math.hypot(exposure_s or 0.0, self._settings.readout_s * share)

    @property
    def first_late_ns(self) -> int:
        """How long after the reference frame's stamp the row of the target's middle was read out, ns."""
        return self._row_ns(0.0, 0.0, self.tracker.reference.pixels.shape)

    def _frozen(self, frame: Frame) -> bool:
        """Whether the region's picture is bit for bit the one before: a frozen camera, or a codec that skipped it.

        Even the second equal picture tells nothing of its own time, by which the target has moved on.
        """
        region = self.region
        now = _core.changed(frame.pixels, (region.x, region.y, region.width, region.height), self._seen)
        if now is None:
            self.frozen_frames += 1
            return True
        self._seen = now
        return False

    def _late_ns(self, frame: Frame, found: PixelTranslation) -> int:
        """How long after a frame's stamp the row of the target's middle was read out, ns."""
        if self._settings.readout_s == 0.0:
            return 0
        seen = math.isfinite(found.x_px) and math.isfinite(found.y_px)
        return self._row_ns(*((found.x_px, found.y_px) if seen else (0.0, 0.0)), frame.pixels.shape)

    def _row_ns(self, right_px: float, down_px: float, shape: tuple[int, ...]) -> int:
        """How long after the first of the sensor's rows that of the target's middle is read out, ns."""
        x_px = self.region.x + 0.5 * (self.region.width - 1) + right_px
        y_px = self.region.y + 0.5 * (self.region.height - 1) + down_px
        row, rows = row_of(x_px, y_px, (shape[0], shape[1]), self._settings.quarter_turns)
        return round(self._settings.readout_s * NANOSECONDS * row / max(rows - 1, 1))


def _with_reference_variance(found: PixelTranslation, more_px2: float) -> PixelTranslation:
    """A translation with more variance (px²) of its reference; one that is LOST has none."""
    if found.status is not Status.TRACKING or more_px2 == 0.0:
        return found
    return replace(
        found,
        reference_variance_x_px2=found.reference_variance_x_px2 + more_px2,
        reference_variance_y_px2=found.reference_variance_y_px2 + more_px2,
    )
