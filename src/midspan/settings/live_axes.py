"""A live point along both image axes: two points of one axis each, which share their camera and accelerometer.

docs/decisions/0020-live-axes.md says why.
"""

from pathlib import Path
from typing import Any

from midspan.errors import DataError, UsageError
from midspan.settings.camera import CameraSettings
from midspan.settings.kinds import ACCELEROMETER, CAMERAS, LIVE
from midspan.settings.load import load_settings
from midspan.settings.sensors import ALONG, turning_axis

# The point keeps its name along the first one, as the main columns of a recording are those of y.
AXES = ("y", "x")
# Characters of a point's name.
MAX_NAME = 64
SOURCES = {axis: f"source_{axis}" for axis in AXES}


def by_axis(point: dict[str, Any], where: str, folder: Path) -> list[dict[str, Any]]:
    """The tree of a point, or with direction = "xy" those along y and x, called NAME and NAME-x.

    where: names the point in UsageError; folder: that its recordings are relative to.
    """
    sections = [(kind, one) for kind, row in LIVE.items() if not row.axes for one in _listed(point.get(kind))]
    both = [kind for kind, one in sections if kind in CAMERAS and one.get("direction") == "xy"]
    accelerometer = (*_listed(point.get(ACCELEROMETER)), {})[0]
    if "source_z" in accelerometer:
        raise UsageError(
            f"{where}: accelerometer.source_z: is for recordings only, where gravity along the view bounds the slow "
            "tilt. Remove it, and add [point.inclinometer] for the slow tilt."
        )
    if not both:
        if named := sorted(set(SOURCES.values()) & set(accelerometer)):
            raise UsageError(
                f'{where}: accelerometer.{named[0]}: must have camera.direction = "xy" with it; for one axis give '
                "accelerometer.source."
            )
        return [point]
    (kind, camera), *others = sections
    if others:
        raise UsageError(
            f'{where}: {both[0]}.direction = "xy": must be the only sensor besides the accelerometer. Put the others '
            "into another point; points may share sources."
        )
    _require_short(point.get("name"), where)
    if "scale_mm_per_px" in camera:
        raise UsageError(
            f'{where}: {kind}.scale_mm_per_px: must have direction = "x" or "y", because the sign may differ by '
            "axis. Write two points; points may share sources."
        )
    sources = _sources(accelerometer, f"{where}: accelerometer", folder)
    channel = {key: value for key, value in accelerometer.items() if key not in ("source", *SOURCES.values())}
    return [
        {
            **point,
            "name": point.get("name") if axis == AXES[0] else f"{point.get('name')}-{axis}",
            ACCELEROMETER: {"source": sources[axis], **channel},
            kind: {**camera, "direction": axis},
        }
        for axis in AXES
    ]


def _require_short(name: Any, where: str) -> None:
    """UsageError for a name that has no place for that of the second axis; what is no name is refused later."""
    longest = MAX_NAME - len(f"-{AXES[1]}")
    if isinstance(name, str) and longest < len(name) <= MAX_NAME:
        raise UsageError(
            f'{where}: name: must have at most {longest} characters with direction = "xy", as its x axis is called '
            f"NAME-{AXES[1]}; received {len(name)}. Write a shorter one."
        )


def _listed(section: Any) -> list[dict[str, Any]]:
    """One section or several of a kind; what is no section is refused where a point is read."""
    return [one for one in (section if isinstance(section, list) else [section]) if isinstance(one, dict)]


def _sources(accelerometer: dict[str, Any], where: str, folder: Path) -> dict[str, Any]:
    """The source of each axis; `where` names the section."""
    given = {axis: accelerometer[key] for axis, key in SOURCES.items() if key in accelerometer}
    source = accelerometer.get("source")
    if len(given) == len(AXES) and source is None:
        return given
    if given or not str(source).startswith("replay:"):
        raise UsageError(
            f'{where}: must have source_x and source_y, one for each image axis, with direction = "xy"; source alone '
            "is for a recording that has both, replay:RECORDING."
        )
    try:
        own = load_settings(folder / str(source).removeprefix("replay:")).accelerometer
    except (UsageError, DataError):
        # What is missing or wrong with it is said where it is read.
        return dict.fromkeys(AXES, source)
    if own is None or not (own.value_x and own.value_y):
        raise UsageError(
            f"{where}.source = {source!r}: must be a recording with accelerometer.value_x and value_y, with "
            'direction = "xy". Name both there, or write source_x and source_y.'
        )
    return dict.fromkeys(AXES, source)


def axis_of(point: dict[str, Any]) -> str:
    """The image axis that a point measures along, by its first camera; empty without one."""
    cameras = [one for kind in CAMERAS for one in _listed(point.get(kind))]
    default = CameraSettings.model_fields["direction"].default
    return str(cameras[0].get("direction", default)) if cameras else ""


def of_rotation(section: dict[str, Any], axis: str, where: str) -> dict[str, Any]:
    """The section of a rotation with the source of that which moves the image along `axis` as its `source`.

    Of the other axes nothing is read, as in a recording. `where` names the section in UsageError.
    """
    named = {f"source_{one}": section.get(f"source_{one}") for one in ALONG}
    rest = {key: value for key, value in section.items() if key not in ("source", *named)}
    if str(section.get("source")).startswith("replay:") and len(rest) + 1 == len(section):
        return section
    about = turning_axis(axis)
    source = named[f"source_{about}"]
    if "source" in section or source is None:
        raise UsageError(
            f"{where}.source_{about}: is missing: a rotation about the image's {about} axis moves it along "
            f"{axis or 'y'}. Give source_x, source_y, source_z, as many as there are; source alone is "
            "replay:RECORDING."
        )
    return {"source": source, **rest}
