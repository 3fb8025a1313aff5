"""How a target's tracker is opened: its rule for the reference frame, and temperatures made ready before it sees them.

Only here do thermal and vision meet. A frame in °C goes through the cleaner, the tracker gets what is left of it, and
the cleaner learns from what the tracker found. With a temperature range the tracker gets 256 grey levels instead.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any, get_type_hints

import numpy as np

from midspan.checks import refuse
from midspan.errors import MidspanError
from midspan.records import NANOSECONDS, Floats, Frame, PixelTranslation, Prediction, Region, Status
from midspan.thermal.cleaning import PATTERN_FRAMES, Cleaned, CleaningState, ThermalCleaner
from midspan.thermal.limits import MARGIN, Limits
from midspan.thermal.pattern import FixedPattern, shifted_scene
from midspan.thermal.temperature_range import grey
from midspan.vision.lens import Lens, check_lens
from midspan.vision.reference.policy import KeyFrameSettings
from midspan.vision.reference.tracker import KeyFrameTracker
from midspan.vision.target import lost
from midspan.vision.tracker import TRACKERS, UPDATING, AxisMotion, Tracker, open_tracker, tracker_class

# Temperatures of another kind on more than this share of the target are a thing in front (one in a hundred pixels is
# its own tail); it pulls by its share of this many px: 0.17 to 0.3 px were seen with a tenth to a half covered.
USUAL_SHARE, COVERED_PX = 0.01, 1.5

# The pattern's pull on a tracker is tried on this many drawn patterns and frames, whose scene moves by this much or
# more (standard deviation): below it the pull does not depend on the motion.
PULL_DRAWS, PULL_FRAMES, PULL_PX = 4, 8, 0.1

Opener = Callable[[Frame], Tracker]
"""Opens a tracker on a reference frame that has been made ready."""
# Temperatures throw no shadows: what no mix explains of them is no motion. Their places were seen to drift by 0.01 to
# 0.04 px, all of them together (benchmark day_and_night). At dusk they change sooner than shading does: new key frames
# begin earlier.
HEAT: dict[str, Any] = {
    "heat": True,
    "unmixed_px": 0.5,
    "link_floor_px": 0.04,
    "renew_share": 0.95,
    "return_share": 0.97,
}
# Of a target's pixels; the others are shown as black or white.
MIN_INSIDE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class ThermalTargetState:
    """What is remembered: of the cleaner, the pattern that was taken out of the reference, the tracker's own state."""

    cleaner: CleaningState
    pattern: FixedPattern | None
    tracker: Any


class ThermalTarget(Tracker):
    """A tracker behind a cleaner of temperatures; its `reference` is the frame in °C as the camera gave it.

    Frames with the shutter closed are LOST. levels: the range shown in 256 grey levels; None: temperatures as they are.
    """

    def __init__(self, reference: Frame, region: Region, opener: Opener, levels: Limits | None = None) -> None:
        super().__init__(reference, region)
        self.levels = levels
        # The reference is tracked once more as the first frame: a watch that had seen it would call it frozen.
        self._opener = opener
        self._pattern: FixedPattern | None = None
        self.tracker = self._opened()
        self._cleaner = ThermalCleaner(reference, region)
        self._pull: tuple[FixedPattern, float] | None = None

    @property
    def region_now(self) -> Region:
        """Where the target was last seen."""
        return self.tracker.region_now

    @property
    def limits(self) -> Limits:
        """Temperatures that the tracker sees: the range, else those that count in full at the moment, °C."""
        if self.levels is not None:
            return self.levels
        own = self._cleaner.limits
        wider = 2.0 * MARGIN * own.half_k
        return Limits(own.low_c - wider, own.high_c + wider)

    @property
    def state(self) -> ThermalTargetState:
        """Everything that changes from frame to frame."""
        return ThermalTargetState(self._cleaner.state, self._pattern, self.tracker.state)

    def restore(self, state: ThermalTargetState) -> None:
        """Continue from a `state` taken earlier."""
        self._cleaner.restore(state.cleaner)
        self._pattern = state.pattern
        self.tracker = self._opened()
        self.tracker.restore(state.tracker)

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) in `frame`, which is in °C; LOST while the shutter is closed.

        Its events tell of shutters and steps of the level besides the tracker's own. What a thing in front pulls the
        result by stays the same for many frames: it is part of the reference's variance.
        """
        cleaned = self._cleaner.push(frame, self.tracker.region_now)
        ready = self._shown(cleaned, frame)
        if ready is None:
            return lost(frame.time_ns, tuple(cleaned.events))
        covered = max(cleaned.foreign - USUAL_SHARE, 0.0)
        found = self.tracker.push(replace(ready, covered=covered), prediction)
        if covered == 0.0 and self._cleaner.tracked(found) and self.levels is None:
            # The pattern in the reference would meet what is left of it in the frames, and draw them to zero.
            self._pattern = self._cleaner.pattern
            self.tracker = self._opened()
        more = (COVERED_PX * covered) ** 2 if found.status is Status.TRACKING else 0.0
        return replace(
            found,
            reference_variance_x_px2=found.reference_variance_x_px2 + more,
            reference_variance_y_px2=found.reference_variance_y_px2 + more,
            events=(*cleaned.events, *found.events),
        )

    @property
    def frames_to_learn(self) -> int:
        """How many frames the tracker and the pattern can be learned from."""
        return max(PATTERN_FRAMES, self.tracker.frames_to_learn)

    @property
    def learns_by_acceleration(self) -> bool:
        """Whether the tracker does."""
        return self.tracker.learns_by_acceleration

    def _learn(self, frames: Sequence[Frame], motion: AxisMotion | None) -> Any:
        """Learn the pattern, where it shows, and let the tracker learn, from frames in °C in the order of their times.

        What moved before the pattern is known would be drawn to zero. Closed frames are left out.
        """
        begun = self.state
        for frame in frames:
            self.push(frame)
        pattern = self._pattern
        self.restore(begun)
        cleaner = ThermalCleaner(self.reference, self.region)
        if pattern is not None:
            self._pattern = pattern
            self.tracker = self._opened()
            self._cleaner.use(pattern)
            cleaner.use(pattern)
        if not self.tracker.frames_to_learn:
            return None
        ready = [self._shown(cleaner.push(frame, self.region), frame) for frame in frames]
        kept = [k for k, frame in enumerate(ready) if frame is not None]
        shown = [frame for frame in ready if frame is not None]
        return self.tracker._learn(shown, None if motion is None else motion.part(kept))

    @property
    def scale_share_std(self) -> float:
        """The share by which translations may be too small because of what is left of the fixed pattern."""
        found = self._cleaner.last_pattern
        if found is None:
            return 0.0
        if self._pattern is not None:
            return found.share_std
        if self._pull is None or self._pull[0] is not found:
            self._pull = (found, self._pulled_share(found))
        return self._pull[1]

    def _pulled_share(self, found: FixedPattern) -> float:
        """The share (root mean square) by which the tracker's translations are too small on the scene with patterns of
        the strength found; the one of least squares where the tracker does not see it.
        """
        moved = _tried_motion(found.pictured.moved_px)
        scenes = shifted_scene(found.pictured.scene, moved)
        rng = np.random.default_rng(1)
        shares = []
        for _ in range(PULL_DRAWS):
            pattern = found.pictured.spread_k * rng.normal(size=scenes[0].shape)
            try:
                tracks = self._tried([scene + pattern for scene in scenes])
            except MidspanError:
                return found.kept_share_std
            seen = np.isfinite(tracks[:, 0])
            if 2 * np.count_nonzero(seen) < len(seen):
                return found.kept_share_std
            true, own = (part[seen] - np.mean(part[seen], axis=0) for part in (moved, tracks))
            shares.append(float(np.sum(true * (true - own)) / np.sum(true**2)))
        share = math.sqrt(float(np.mean(np.square(shares))))
        # A scene from which the pattern could not be taken holds it once itself: a / (1 - a) of it is a of the scene.
        return share if found.known else share / max(1.0 - share, 0.5)

    def _tried(self, scenes: Sequence[Floats]) -> Floats:
        """Translations (n, 2), px, that a new tracker finds of a scene's pictures laid where the target is."""
        level = float(np.median(np.asarray(self.reference.pixels, dtype=np.float64)))
        shown = []
        for k, scene in enumerate(scenes):
            celsius = (level + _laid_out(scene, self.reference.pixels.shape, self.region)).astype(np.float32)
            pixels = celsius if self.levels is None else grey(celsius, self.levels)
            shown.append(Frame(self.reference.time_ns + k * NANOSECONDS, pixels, k))
        tracker = self._opener(shown[0])
        found = [tracker.push(frame) for frame in shown]
        return np.array([(one.x_px, one.y_px) for one in found])

    @property
    def phase_gain_px_per_rad(self) -> tuple[float, float] | None:
        """The tracker's translation by mean phase along x and y, px/rad."""
        return self.tracker.phase_gain_px_per_rad

    def _opened(self) -> Tracker:
        """A tracker on the reference frame without the pattern, where that is known."""
        frame = self.reference
        if self._pattern is not None:
            frame = replace(frame, pixels=self._pattern.removed(frame.pixels))
        ready = self._shown(ThermalCleaner(frame, self.region).push(frame, self.region), frame)
        return self._opener(self.reference if ready is None else ready)

    def _shown(self, cleaned: Cleaned, frame: Frame) -> Frame | None:
        """A cleaned frame as the tracker gets it, None with the shutter closed."""
        if cleaned.frame is None or self.levels is None:
            return cleaned.frame
        return Frame(frame.time_ns, grey(frame.pixels, self.levels), frame.index)


def _tried_motion(moved_px: Floats) -> Floats:
    """PULL_FRAMES translations (n, 2), px, of those seen, from the first one on; enlarged where they are tiny."""
    moved = moved_px[np.linspace(0, len(moved_px) - 1, PULL_FRAMES).round().astype(np.int64)]
    moved = moved - moved[0]
    size = float(np.sqrt(np.sum(np.var(moved, axis=0))))
    if size == 0.0:
        return PULL_PX * np.linspace(0.0, 2.0, PULL_FRAMES)[:, None] * np.ones(2)
    return np.asarray(moved * max(PULL_PX / size, 1.0))


def _laid_out(scene: Floats, shape: tuple[int, ...], region: Region) -> Floats:
    """A picture of `shape` that holds the scene about the middle of the region, and 0 elsewhere."""
    out = np.zeros(shape)
    top = region.y + (region.height - scene.shape[0]) // 2
    left = region.x + (region.width - scene.shape[1]) // 2
    part = scene[max(-top, 0) : shape[0] - top, max(-left, 0) : shape[1] - left]
    out[max(top, 0) : max(top, 0) + part.shape[0], max(left, 0) : max(left, 0) + part.shape[1]] = part
    return out


@dataclass(frozen=True, slots=True)
class Opening:
    """What a target is tracked with, and how its frames are made.

    tracker, tracker_settings: its name and settings record (None: its defaults). reference: "first", "key-frames" or
    "updating"; reference_settings: of the last one, by name. thermal: whether frames are temperatures; those of whole
    numbers are pictures all the same. levels: the range of temperatures shown in 256 grey levels, None: °C as they are.
    lens: None: none is corrected. readout_s: rolling shutter, s from the first row (which the stamps belong to) to the
    last: translations are dated by the row of the target's middle. lossless: whether the frames come from a file which
    leaves nothing out. quarter_turns: by which the sensor's rows were turned with the picture.
    """

    tracker: str
    tracker_settings: Any = None
    reference: str = "first"
    reference_settings: Mapping[str, Any] = field(default_factory=dict)
    thermal: bool = False
    levels: Limits | None = None
    lens: Lens | None = None
    readout_s: float = 0.0
    lossless: bool = False
    quarter_turns: int = 0

    def radiometric(self, frame: Frame) -> bool:
        """Whether a frame holds temperatures."""
        return self.thermal and frame.pixels.dtype.kind == "f"

    def opened(self, reference: Frame, region: Region) -> Tracker:
        """The tracker of the target in `region` (px) of the frame `reference`; it sees the frames as they are.

        Raises UsageError where the lens is for frames of another size, or does not reach the region.
        """
        if self.lens is not None:
            rows, columns = reference.pixels.shape
            check_lens(self.lens, region, columns, rows)
        if self.radiometric(reference):
            return ThermalTarget(reference, region, lambda frame: self._followed(frame, region), self.levels)
        return self._followed(reference, region)

    def _followed(self, frame: Frame, region: Region) -> Tracker:
        """The tracker with its rule for the reference frame, on a frame that has been made ready."""
        own = self.tracker_settings
        if self.reference == "key-frames":
            heat = HEAT if frame.pixels.dtype.kind == "f" else {}
            return KeyFrameTracker(frame, region, KeyFrameSettings(tracker=self.tracker, tracker_settings=own, **heat))
        if self.reference == "updating":
            updating = import_module(UPDATING)
            rule = updating.updating_settings(self.tracker, own, self.reference_settings)
            tracker: Tracker = updating.UpdatingTracker(frame, region, rule)
            return tracker
        return open_tracker(self.tracker, frame, region, own)


def tracker_states() -> list[Any]:
    """The record that each tracker, alone or behind a rule for its frames, keeps its state in: that of `_state`."""
    kinds = [KeyFrameTracker, import_module(UPDATING).UpdatingTracker, *(tracker_class(name) for name in TRACKERS)]
    return [ThermalTargetState, *(get_type_hints(kind)["_state"] for kind in kinds)]


def refuse_empty_range(reference: Frame, region: Region, levels: Limits) -> None:
    """UsageError where hardly any of a target's temperatures in the reference frame are within the range shown."""
    if reference.pixels.dtype.kind != "f":
        return
    celsius = np.asarray(reference.pixels[region.slices], dtype=np.float64)
    if np.mean((celsius > levels.low_c) & (celsius < levels.high_c)) >= MIN_INSIDE:
        return
    low, high = np.percentile(celsius, (1.0, 99.0))
    raise refuse(
        "infrared.temperature_range_c",
        f"a range in °C that contains the target's temperatures, {low:.4g} to {high:.4g} in the first frame used",
        [levels.low_c, levels.high_c],
    )
