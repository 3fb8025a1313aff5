"""The camera's stage: a frame and what is expected of it in, a translation of each target with final variances out."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from midspan.engine.camera_target import ChainSettings, Target, TargetChain, TargetState
from midspan.errors import DataError
from midspan.records import Frame, PixelTranslation, Prediction
from midspan.thermal.temperature_range import Expected

# What is usual is estimated up to the frame that completes the third check of the codec, see core/src/track/codec.rs.
WARM_UP_FRAMES = 28


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

    def __init__(self, reference: Frame, targets: Sequence[Target], settings: ChainSettings) -> None:
        """Raises UsageError for a target that cannot be tracked, or is out of the lens model's reach."""
        self.targets = tuple(TargetChain(reference, target, settings) for target in targets)

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
        return tuple(map(TargetChain.push, self.targets, (frame,) * len(self.targets), expected))

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

    def leave_out(self, places: Sequence[int]) -> None:
        """Track the targets of these numbers (from 0) no further."""
        self.targets = tuple(target for k, target in enumerate(self.targets) if k not in places)
