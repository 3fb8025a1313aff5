"""How a target's tracker is opened: its rule for the reference frame, and temperatures made ready."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_type_hints

import numpy as np

from midspan.checks import refuse
from midspan.engine.thermal_target import ThermalTarget, ThermalTargetState
from midspan.records import Frame, Region
from midspan.thermal.limits import Limits
from midspan.vision.lens import Lens, check_lens
from midspan.vision.reference.policy import KeyFrameSettings
from midspan.vision.reference.tracker import KeyFrameTracker
from midspan.vision.reference.updating import UpdatingTracker, updating_settings
from midspan.vision.tracker import TRACKERS, Tracker, open_tracker, tracker_class

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


@dataclass(frozen=True, slots=True)
class Opening:
    """What a target is tracked with.

    tracker, tracker_settings: its name and settings record (None: its defaults). reference: "first", "key-frames" or
    "updating"; reference_settings: of the last one, by name. thermal: whether frames are temperatures; those of whole
    numbers are pictures all the same. levels: the range of temperatures shown in 256 grey levels, None: °C as they are.
    lens: None: none is corrected.
    """

    tracker: str
    tracker_settings: Any = None
    reference: str = "first"
    reference_settings: Mapping[str, Any] = field(default_factory=dict)
    thermal: bool = False
    levels: Limits | None = None
    lens: Lens | None = None

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
            return UpdatingTracker(frame, region, updating_settings(self.tracker, own, self.reference_settings))
        return open_tracker(self.tracker, frame, region, own)


def tracker_states() -> list[Any]:
    """The record that each tracker, alone or behind a rule for its frames, keeps its state in: that of `_state`."""
    kinds = [KeyFrameTracker, UpdatingTracker, *(tracker_class(name) for name in TRACKERS)]
    return [ThermalTargetState, *(get_type_hints(kind)["_state"] for kind in kinds)]


def refuse_empty_range(reference: Frame, region: Region, levels: Limits) -> None:
    """UsageError where hardly any of a target's temperatures in the reference frame are within the range shown."""
    if reference.pixels.dtype.kind != "f":
        return
    part = reference.pixels[region.y : region.y + region.height, region.x : region.x + region.width]
    celsius = np.asarray(part, dtype=np.float64)
    if np.mean((celsius > levels.low_c) & (celsius < levels.high_c)) >= MIN_INSIDE:
        return
    low, high = np.percentile(celsius, (1.0, 99.0))
    raise refuse(
        "infrared.temperature_range_c",
        f"a range in °C with the target's temperatures in it; in the first frame used they are {low:.4g} to {high:.4g}",
        [levels.low_c, levels.high_c],
    )
