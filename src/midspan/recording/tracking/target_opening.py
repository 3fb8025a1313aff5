"""How a target's tracker is opened: its reference frames, temperatures made ready, the lens in front of all."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from midspan.checks import refuse
from midspan.engine.thermal_target import ThermalTarget, thermal_target
from midspan.records import Event, Frame, PixelTranslation, Region, Status
from midspan.thermal.limits import Limits
from midspan.vision.lens import Lens, bare, through
from midspan.vision.reference.strength import open_counting, strength
from midspan.vision.reference.tracker import KeyFrameSettings, KeyFrameTracker
from midspan.vision.reference.updating import UpdatingSettings, UpdatingTracker
from midspan.vision.tracker import Telling, Tracker, Wandering

# Temperatures throw no shadows: what no mix explains of them is no motion. Their places were seen to wander by 0.01 to
# 0.04 px. At dusk they change sooner than shading does: new key frames begin earlier.
HEAT: dict[str, Any] = {
    "heat": True,
    "unmixed_px": 0.5,
    "link_floor_px": 0.02,
    "renew_share": 0.95,
    "return_share": 0.97,
}
# Of a target's pixels; the others are shown as black or white.
LEAST_INSIDE = 0.05


@dataclass(frozen=True, slots=True)
class Opening:
    """What a target is tracked with.

    tracker, settings: its name and settings record (None: its defaults). reference: "first", "key-frames" or
    "updating". thermal: whether frames are temperatures; those of whole numbers are pictures all the same. levels: the
    range of temperatures shown in 256 grey levels, None: °C as they are. lens: None: none is corrected.
    """

    tracker: str
    settings: Any = None
    reference: str = "first"
    thermal: bool = False
    levels: Limits | None = None
    lens: Lens | None = None

    def opened(self, reference: Frame, region: Region) -> Tracker:
        """The tracker of the target in `region` (px) of the frame `reference`."""
        if self.thermal and reference.pixels.dtype.kind == "f":
            made = thermal_target(reference, region, lambda frame: self._followed(frame, region), self.levels)
            return through(made, self.lens)
        return through(self._followed(reference, region), self.lens)

    def _followed(self, frame: Frame, region: Region) -> Tracker:
        """The tracker with its rule for the reference frame, on a frame that has been made ready."""
        if self.reference == "key-frames":
            own: dict[str, Any] = {"tracker": self.tracker, "tracker_settings": self.settings}
            heat = frame.pixels.dtype.kind == "f"
            settings = KeyFrameSettings(**own, **HEAT) if heat else KeyFrameSettings(**own)
            return KeyFrameTracker(frame, region, settings)
        if self.reference == "updating":
            return UpdatingTracker(frame, region, UpdatingSettings(self.tracker, self.settings))
        return open_counting(self.tracker, frame, region, self.settings)


def refuse_empty_range(reference: Frame, region: Region, levels: Limits) -> None:
    """UsageError where hardly any of a target's temperatures in the reference frame are within the range shown."""
    if reference.pixels.dtype.kind != "f":
        return
    part = reference.pixels[region.y : region.y + region.height, region.x : region.x + region.width]
    celsius = np.asarray(part, dtype=np.float64)
    if np.mean((celsius > levels.low_c) & (celsius < levels.high_c)) >= LEAST_INSIDE:
        return
    low, high = np.percentile(celsius, (1.0, 99.0))
    raise refuse(
        "infrared.temperature_range_c",
        f"a range in °C with the target's temperatures in it; in the first frame used they are {low:.4g} to {high:.4g}",
        [levels.low_c, levels.high_c],
    )


def thermal_part(tracker: Tracker) -> ThermalTarget | None:
    """What makes temperatures ready for a tracker; None where it gets pictures."""
    own = bare(tracker)
    return own if isinstance(own, ThermalTarget) else None


def events_of(tracker: Tracker) -> list[Event]:
    """What happened to a tracker since this was last asked: shutters, reference frames."""
    own = bare(tracker)
    return own.take_events() if isinstance(own, Telling) else []


def wandering_px2(tracker: Tracker, found: PixelTranslation) -> tuple[float, float]:
    """The part of the variances (px²) of what was just `found` that the reference makes, for many frames alike."""
    own = bare(tracker)
    own = own.tracker if isinstance(own, ThermalTarget) else own
    if found.status is not Status.TRACKING or not isinstance(own, Wandering):
        return 0.0, 0.0
    x, y = own.own_variance_px2
    return max(found.variance_x_px2 - x, 0.0), max(found.variance_y_px2 - y, 0.0)


def strength_of(tracker: Tracker, found: PixelTranslation) -> float:
    """Good matches of what was just `found`, of trackers without matches the quality in percent; 0 where lost."""
    own = bare(tracker)
    value = strength(own.tracker if isinstance(own, ThermalTarget) else own, found)
    return value if np.isfinite(value) else 0.0
