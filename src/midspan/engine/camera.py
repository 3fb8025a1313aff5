"""The camera's stage: a frame and what is expected of it in, a translation of each target out.

Every frame's variances rest on the frames up to it.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.engine.target_opening import Opening
from midspan.errors import DataError
from midspan.records import Event, Frame, PixelTranslation, Prediction, Region
from midspan.thermal.temperature_range import Expected
from midspan.vision.lens import lens_of, shown_prediction
from midspan.vision.picture_report import LightReport, PictureReport, picture_report
from midspan.vision.region import check_size
from midspan.vision.target import translation_of

# What is usual is estimated up to the frame that completes the third check of the codec, see core/src/track/codec.rs.
WARM_UP_FRAMES = 28


@dataclass(frozen=True, slots=True)
class Target:
    """A target to be tracked: its region in the reference frame and what it is called."""

    region: Region
    name: str = "1"


@dataclass(frozen=True, slots=True, eq=False)
class TargetState:
    """What a `TargetChain` remembers: its tracker's state, and all the rest as the core writes it."""

    tracker: Any
    core: NDArray[np.uint8]


class TargetChain:
    """Tracks one target; every frame's variances rest on the frames up to it.

    The core (`core/src/track/chain.rs`) looks at each frame and what a tracker found in it: frozen and dark frames,
    light, codec, blur and saturation, the row that the target lies in, the lens. Where the tracker is the core's too,
    one call takes a frame through both.
    """

    def __init__(self, reference: Frame, target: Target, opening: Opening) -> None:
        self.region, self.name = target.region, target.name
        self._opening, region = opening, target.region
        self.tracker = opening.opened(reference, region)
        pictured = not opening.radiometric(reference)
        self._core = _core.TargetChain(
            reference.pixels,
            (region.x, region.y, region.width, region.height),
            picture=pictured,
            light=pictured and opening.reference == "first",
            lossless=opening.lossless,
            readout_s=opening.readout_s,
            quarter_turns=opening.quarter_turns,
            lens=lens_of(opening.lens),
        )
        # How long after the reference frame's stamp the row of the target's middle was read out, ns.
        self.first_late_ns: int = self._core.first_late_ns

    @property
    def state(self) -> TargetState:
        """Everything that changes from frame to frame."""
        return TargetState(self.tracker.state, np.frombuffer(self._core.state(), dtype=np.uint8))

    def restore(self, state: TargetState) -> None:
        """Continue from a `state` taken earlier. Raises DataError for that of another version or of other settings."""
        try:
            self._core.restore(state.core.tobytes())
        except ValueError as error:
            raise DataError(f"A target's state must come from this version of midspan; received {error}.") from None
        self.tracker.restore(state.tracker)

    def restart(self, tracker: Any) -> None:
        """Take the frames so far once more, of which what is usual is kept; `tracker`: its state before them."""
        self.tracker.restore(tracker)
        self._core.keep_usual()

    @property
    def frozen_frames(self) -> int:
        """How many of the frames so far repeated the one before, or a part of it."""
        return self._core.frozen_frames

    @property
    def picture(self) -> PictureReport | None:
        """What the frames so far say of themselves; None of temperatures, which have no codec and no full scale."""
        return picture_report(self._core)

    @property
    def light(self) -> LightReport | None:
        """What light did to the frames so far; None of temperatures and of trackers whose reference changes."""
        return None if self._core.light is None else LightReport(*self._core.light)

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """The translation in `frame` in pixels of the ideal camera, dated by the row that the target lies in.

        prediction: the same, of this frame. The target is LOST in the dark and where the picture, or a part of it,
        is the one before once more.
        """
        core, tracker = self._core, self.tracker
        events: tuple[Event, ...] = ()
        try:
            if tracker.core is None:
                row = core.unseen(frame.pixels, frame.time_ns)
            else:
                row = core.track(tracker.core, frame.pixels, frame.time_ns, prediction)
                if tracker.core.learnable:
                    tracker.keep(frame)
        except ValueError:
            check_size(frame, tracker.reference)
            raise
        if row is None:
            found = tracker.search(frame, shown_prediction(prediction, self.region, self._opening.lens))
            row, events = core.push(frame.pixels, frame.time_ns, found), found.events
        return translation_of(row, events)

    def rows(self, frames: Sequence[Frame]) -> bytes:
        """The rows of frames as `=qdddddBdddB`, up to one that has to be pushed on its own, without predictions.

        While the tracker learns, and where it is none of the core's, that is the first.
        """
        if self.tracker.core is None or not self.tracker.settled:
            return b""
        try:
            return self._core.track_all(self.tracker.core, frames)
        except ValueError:
            for frame in frames:
                check_size(frame, self.tracker.reference)
            raise

    def blur_s(self, exposure_s: float | None) -> float:
        """The time a translation is averaged over: the exposure, and the read-out of the region's rows.

        Both are box averages; their widths add as squares.
        """
        rows, columns = self.tracker.reference.pixels.shape
        turned = self._opening.quarter_turns % 2
        share = self.region.width / max(columns, 1) if turned else self.region.height / max(rows, 1)
        return math.hypot(exposure_s or 0.0, self._opening.readout_s * share)


@dataclass(frozen=True, slots=True, eq=False)
class CameraState:
    """What a `CameraChain` remembers: its targets' states."""

    targets: tuple[TargetState, ...]


class CameraChain:
    """Tracks a camera's targets from the reference frame on; `targets` hold what is worth reporting of each.

    Before the first push, `learn` may be given the first `frames_to_learn` frames: the variances of the very first
    frames then know of the codec and of the noise, which no single frame shows. Everything after that is a function of
    the frames pushed.
    """

    def __init__(self, reference: Frame, targets: Sequence[Target], opening: Opening) -> None:
        """Raises UsageError for a target that cannot be tracked, or is out of the lens model's reach."""
        self.targets = tuple(TargetChain(reference, target, opening) for target in targets)

    @property
    def state(self) -> CameraState:
        """Everything that changes from frame to frame."""
        return CameraState(tuple(target.state for target in self.targets))

    def restore(self, state: CameraState) -> None:
        """Continue from a `state` taken earlier."""
        for target, own in zip(self.targets, state.targets, strict=True):
            target.restore(own)

    def push(
        self, frame: Frame, predictions: Sequence[Prediction | None] | None = None
    ) -> tuple[PixelTranslation, ...]:
        """The translation of each target in `frame`; predictions: of each target, in pixels of the ideal camera."""
        expected = predictions or (None,) * len(self.targets)
        return tuple(target.push(frame, one) for target, one in zip(self.targets, expected, strict=True))

    @property
    def frames_to_learn(self) -> int:
        """How many frames are worth learning from, the reference frame among them."""
        return max(WARM_UP_FRAMES, *(target.tracker.frames_to_learn for target in self.targets))

    def learn(self, frames: Sequence[Frame], felt: Expected | None = None) -> None:
        """Learn from the first frames, in the order of their times from the reference on; they are pushed afterwards.

        felt: the translation in them as the accelerometer shows it; without it trackers that need it are not taught,
        and with too little of it they raise DataError.
        The trackers are taught; then the frames are gone through once, and of that only the usual variances, the usual
        sharpness and what the codec does are kept.
        """
        for tracker in (target.tracker for target in self.targets if target.tracker.frames_to_learn):
            if not tracker.learns_by_acceleration:
                # Frames that do not show the target teach nothing; the tracker then stays with its reference.
                with suppress(DataError):
                    tracker.learn(frames)
            elif felt is not None:
                tracker.learn(frames, felt.translation_px, direction=felt.direction, band_hz=felt.band_hz)
        begun = [target.tracker.state for target in self.targets]
        for frame in frames[:WARM_UP_FRAMES]:
            self.push(frame)
        for target, tracker in zip(self.targets, begun, strict=True):
            target.restart(tracker)
