"""What the geometry of a camera's targets can tell of its tilt, in sentences, from the settings alone.

A tilt moves all targets by as many pixels, a displacement the nearer ones by more (`calibration.camera.tilt`): targets
at two distances show it. A roll moves what lies apart across the measured axis by different amounts.
"""

import math
from collections.abc import Sequence

from midspan.calibration.camera.tilt import differ
from midspan.settings.camera import CameraSettings, TargetSettings
from midspan.settings.recording import RecordingSettings

ADD = "add a target at least three times as far away or as near, stacked along {axis}"


def observed(settings: RecordingSettings) -> dict[str, str]:
    """A sentence or two on each camera, by its name; none where a sensor measures its tilt."""
    if any(kind != "velocity" for kind in settings.auxiliary):
        return {}
    cameras = [(one.name, one.settings) for one in settings.sensors if isinstance(one.settings, CameraSettings)]
    return {name: _camera(own) for name, own in cameras}


def _camera(camera: CameraSettings) -> str:
    axis = "the measured axis" if camera.direction == "xy" else camera.direction
    add, targets = ADD.format(axis=axis), camera.target
    if max(len(targets), camera.automatic_targets) == 1:
        held = "" if camera.tilt_std_mdeg == 0.0 else f" beyond the {camera.tilt_std_mdeg:g} mdeg of tilt_std_mdeg"
        return f"with one target slow tilt is not observed{held}: {add}."
    third = "" if max(len(targets), camera.automatic_targets) > 2 else " A third distinguishes it from a moving target."
    distances = [target.inverse_distance for target in targets]
    known = [one for one in distances if one is not None]
    if not known or len(known) < len(distances):
        text = f"targets at different distances show tilt along {axis}, which is then removed; at one distance they do "
        return f"{text}not (distance_m declares it).{third}{_across(camera)}"
    if not any(differ(one, other) for one in known for other in known):
        return f"all targets are at one distance, slow tilt is not observed: {add}."
    return f"its targets are at different distances, tilt along {axis} is removed.{third}{_across(camera)}"


def _across(camera: CameraSettings) -> str:
    """A sentence where targets lie farther apart across the measured axis than along it."""
    if camera.direction == "xy" or len(camera.target) < 2:
        return ""
    x_px, y_px = (_extent(camera.target, place) for place in (0, 1))
    across, along = (x_px, y_px) if camera.direction == "y" else (y_px, x_px)
    if across <= along:
        return ""
    roll_px = math.radians(1e-3) * across
    return (
        f" They lie {across:g} px apart across {camera.direction}: 1 mdeg of roll moves them apart by {roll_px:.2g} "
        f"px, which is not observed. Stack them along {camera.direction}."
    )


def _extent(targets: Sequence[TargetSettings], place: int) -> float:
    """How far the regions' centres reach along x (0) or y (1), px."""
    centres = [target.roi[place] + 0.5 * target.roi[2 + place] for target in targets]
    return max(centres) - min(centres)
