"""One target of a thermal camera: temperatures are made ready before its tracker sees them.

Only here do thermal and vision meet. A frame in °C goes through the cleaner, the tracker gets what is left of it, and
the cleaner learns from what the tracker found. With a temperature range the tracker gets 256 grey levels instead.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from midspan.records import Event, Frame, PixelTranslation, Prediction, Region
from midspan.thermal.cleaning import Cleaned, CleaningState, ThermalCleaner
from midspan.thermal.limits import Limits
from midspan.thermal.temperature_range import grey
from midspan.vision.target import lost
from midspan.vision.tracker import Coverable, Learner, PhaseGain, Telling, Tracker

# Temperatures of another kind on more than this share of the target are a thing in front (one in a hundred pixels is
# its own tail); it pulls by its share of so many px: 0.17 to 0.3 px were seen with a tenth to a half covered.
USUAL_SHARE, COVERED_PX = 0.01, 1.5

Opener = Callable[[Frame], Tracker]
"""Opens a tracker on a reference frame that has been made ready."""


@dataclass(frozen=True, slots=True, eq=False)
class ThermalTargetState:
    """What is remembered: of the cleaner, and the tracker's own state."""

    cleaner: CleaningState
    tracker: Any


class ThermalTarget:
    """A tracker behind a cleaner of temperatures; its `reference` is the frame in °C as the camera gave it.

    Frames with the shutter closed are LOST. levels: the range shown in 256 grey levels; None: temperatures as they are.
    """

    def __init__(self, reference: Frame, region: Region, opener: Opener, levels: Limits | None = None) -> None:
        self._reference, self.levels = reference, levels
        # The reference is tracked once more as the first frame: a watch that had seen it would call it frozen.
        ready = self._ready(ThermalCleaner(reference, region), reference, region)
        self.tracker = opener(reference if ready is None else ready)
        self._cleaner = ThermalCleaner(reference, region)
        self._events: list[Event] = []

    @property
    def reference(self) -> Frame:
        """The frame that the translation counts from, in °C."""
        return self._reference

    @property
    def region(self) -> Region:
        """The target's region in the reference frame."""
        return self.tracker.region

    @property
    def region_now(self) -> Region:
        """Where the target was last seen."""
        return self.tracker.region_now

    @property
    def limits(self) -> Limits:
        """Temperatures that the tracker sees: the range, else those that count in full at the moment, °C."""
        if self.levels is not None:
            return self.levels
        own, margin = self._cleaner.limits, self._cleaner.settings.margin
        wider = 2.0 * margin * own.half_k
        return Limits(own.low_c - wider, own.high_c + wider)

    @property
    def state(self) -> ThermalTargetState:
        """Everything that changes from frame to frame."""
        return ThermalTargetState(self._cleaner.state, self.tracker.state)

    def restore(self, state: ThermalTargetState) -> None:
        """Continue from a `state` taken earlier."""
        self._cleaner.restore(state.cleaner)
        self.tracker.restore(state.tracker)

    def take_events(self) -> list[Event]:
        """What happened since this was last called: shutters, steps of the level, reference frames."""
        told, self._events = self._events, []
        if isinstance(self.tracker, Telling):
            told += self.tracker.take_events()
        return told

    def push(self, frame: Frame, prediction: Prediction | None = None) -> PixelTranslation:
        """Measure the translation (px) in `frame`, which is in °C; LOST while the shutter is closed."""
        cleaned = self._cleaner.push(frame, self.tracker.region_now)
        self._events += cleaned.events
        ready = self._shown(cleaned, frame)
        if ready is None:
            return lost(frame.time_ns)
        covered = max(cleaned.foreign - USUAL_SHARE, 0.0)
        if isinstance(self.tracker, Coverable):
            self.tracker.covered = covered
        found = self.tracker.push(ready, prediction)
        if covered == 0.0:
            self._cleaner.tracked(found)
            return found
        more = (COVERED_PX * covered) ** 2
        return replace(found, variance_x_px2=found.variance_x_px2 + more, variance_y_px2=found.variance_y_px2 + more)

    def _ready(self, cleaner: ThermalCleaner, frame: Frame, region: Region) -> Frame | None:
        """The frame as the tracker gets it, None with the shutter closed."""
        return self._shown(cleaner.push(frame, region), frame)

    def _shown(self, cleaned: Cleaned, frame: Frame) -> Frame | None:
        """A cleaned frame as the tracker gets it."""
        if cleaned.frame is None or self.levels is None:
            return cleaned.frame
        return Frame(frame.time_ns, grey(frame.pixels, self.levels), frame.index)


class ThermalLearner(ThermalTarget):
    """A tracker of temperatures that knows its target better from frames in which it moves."""

    tracker: Any

    @property
    def frames_to_learn(self) -> int:
        """How many frames are worth learning from."""
        return int(self.tracker.frames_to_learn)

    def learn(self, frames: Sequence[Frame]) -> Any:
        """Let the tracker learn from frames in °C, in the order of their times; closed ones are left out."""
        cleaner = ThermalCleaner(self._reference, self.region)
        ready = [self._ready(cleaner, frame, self.region) for frame in frames]
        return self.tracker.learn([frame for frame in ready if frame is not None])


class ThermalPhaseTarget(ThermalLearner):
    """A tracker of phase in temperatures."""

    @property
    def phase_gain_px_per_rad(self) -> tuple[float, float]:
        """Translation by mean phase along x and y, px/rad, signed."""
        x, y = self.tracker.phase_gain_px_per_rad
        return float(x), float(y)


def thermal_target(reference: Frame, region: Region, opener: Opener, levels: Limits | None = None) -> ThermalTarget:
    """The target of `region` (px) in the frame `reference` in °C, tracked by what `opener` opens on it.

    levels: see `ThermalTarget`. What is returned learns, or measures phase, where the tracker does.
    """
    made = ThermalTarget(reference, region, opener, levels)
    kind = ThermalTarget
    if isinstance(made.tracker, PhaseGain):
        kind = ThermalPhaseTarget
    elif isinstance(made.tracker, Learner):
        kind = ThermalLearner
    # The tracker may have cost seconds to open.
    inner = made.tracker
    return made if kind is ThermalTarget else kind(reference, region, lambda _: inner, levels)
