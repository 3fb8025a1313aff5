"""The settings of a recording of a phone's own log and a film: which of the phone's axes is the measured one."""

import re
from pathlib import Path
from typing import TYPE_CHECKING

from midspan.errors import UsageError
from midspan.settings.two_files import DIRECTION
from midspan.sources.accelerometer.phone import MAX_SLANT_DEG

if TYPE_CHECKING:
    from midspan.settings.two_files import Choices, Draft
    from midspan.sources.accelerometer.phone import PhoneLog, Vertical

AXES = ("x", "y", "z")
# An angle to the vertical from here on is said.
SAID_TILT_DEG = 10.0
# Milliseconds since 1970, as Sensor Logger names its films.
NAMED_MS = re.compile(r"1\d{12}")


def film_of(log: "PhoneLog", given: Path | None) -> Path:
    """The film that goes with a log: the given one, or the only one in it."""
    from midspan.sources.accelerometer.phone import is_phone_log

    if given is not None:
        if is_phone_log(given):
            raise UsageError(f"{log.path} and {given} are two archives of a phone. Give one, and the film after it.")
        return given
    if len(log.films) == 1:
        return log.films[0]
    held = f"{len(log.films)} films: {', '.join(one.name for one in log.films[:6])}" if log.films else "no film"
    raise UsageError(f"{log.path} holds {held}. Give the film after the archive: `midspan estimate {log.path} VIDEO`.")


def put_acceleration(found: "Draft", log: "PhoneLog", film: Path, given: "Choices", choose: bool) -> str:
    """Put the keys of the accelerometer, and a line on the axis that was chosen; returns its column.

    choose: take the axis that is most likely where gravity does not tell it, for a person to look at.
    """
    table = log.acceleration
    column, why = _chosen(log, film, given, choose)
    remark = f"or {', '.join(repr(one) for one in table.columns if one != column)}: {why}"
    found.put(
        "accelerometer",
        "file",
        str(table.path.absolute()),
        f"{log.app}; the phone's axes: x right, y up, z out of the screen",
    )
    found.put("accelerometer", "time", table.time)
    axes = _seen(log, film, column, given)
    if axes is not None and log.with_gravity and (given.direction or DIRECTION) == "y":
        # Along the view where that column points down, and against it where it points up.
        found.put("accelerometer", "value_y", column, remark)
        found.put("accelerometer", "value_z", table.along(axes[2] if axes[1] > 0 else -axes[2]), "shows the pitch")
    else:
        found.put("accelerometer", "value", column, remark)
    found.put("accelerometer", "unit", given.unit or table.unit, "" if given.unit else f"of {log.app}")
    count = f"{log.pauses} pause{'s' if log.pauses > 1 else ''}"
    paused = f" Its clock leaves out {count}, which a film's does not." if log.pauses else ""
    turned = "" if axes is None or log.gyroscope is None else f" {log.gyroscope.path.name}: the phone's own tilt."
    found.said.append(f"{log.path.name} ({log.app}): {table.path.name}, axis {column!r}: {why}.{paused}{turned}")
    return column


def put_gyroscope(found: "Draft", log: "PhoneLog", film: Path, given: "Choices") -> None:
    """Put the keys of the phone's gyroscope where the acceleration's axis is one of its own film's."""
    own = found.sections["accelerometer"]
    table, axes = log.gyroscope, _seen(log, film, own.get("value_y") or own["value"], given)
    if table is None or axes is None:
        return
    found.put("gyroscope", "file", str(table.path.absolute()), "the phone's own tilt, in the image's axes")
    found.put("gyroscope", "time", table.time)
    for name, axis in zip(AXES, axes, strict=True):
        found.put("gyroscope", f"value_{name}", table.along(axis))
    found.put("gyroscope", "unit", table.unit, f"of {log.app}")


def _seen(log: "PhoneLog", film: Path, column: str, given: "Choices") -> tuple[int, int, int] | None:
    """The phone's axes along those of a film of its own camera, whose axis of the motion the column is; else None."""
    axes = log.camera_axes if film in log.films and log.gyroscope is not None else None
    if axes is None or log.acceleration.along(abs(axes["xy".index(given.direction or DIRECTION)])) != column:
        return None
    return axes


def _chosen(log: "PhoneLog", film: Path, given: "Choices", choose: bool) -> tuple[str, str]:
    """The column along the motion, and why."""
    columns, vertical = log.acceleration.columns, log.vertical
    if given.value is not None:
        named = [columns[k] for k in range(3) if given.value.lower() in (AXES[k], columns[k].lower())]
        if not named:
            raise UsageError(
                f"{log.path}: --value {given.value!r} is no axis of {log.acceleration.path.name}. Select one of "
                f"{', '.join(map(repr, columns))}."
            )
        return named[0], "as given by --value" + _sense(vertical, columns.index(named[0]))
    own, ask = (
        film in log.films,
        f"Select the axis along the measured motion with --value: {', '.join(map(repr, columns))}.",
    )
    if vertical is None or vertical.angle_deg > MAX_SLANT_DEG:
        if choose:
            return columns[1], "gravity shows no vertical axis"
        why = "the log has no gravity" if vertical is None else "no axis is within 45 degrees of gravity"
        raise UsageError(f"{log.path}: {why}, which shows the vertical axis. {ask}")
    if own and AXES[vertical.axis] == "z":
        # Its picture shows horizontal motion alone.
        if choose:
            return columns[1], "the phone's camera looks up or down"
        raise UsageError(f"{log.path}: the phone lay flat, so that its camera looked up or down. {ask}")
    if given.direction != "x":
        tilt = f", {vertical.angle_deg:.0f} degrees from it" if vertical.angle_deg > SAID_TILT_DEG else ""
        sense = _sense(vertical, vertical.axis)
        return columns[vertical.axis], f"the vertical one by gravity ({vertical.gravity_m_s2:+.2f} m/s²){tilt}{sense}"
    if not own:
        if choose:
            return columns[0], "the horizontal axis of the image is not known"
        raise UsageError(f"{log.path}: gravity does not show which axis is horizontal in the image. {ask}")
    # The picture of the phone's own camera lies in the plane of its screen.
    return columns[1 - vertical.axis], "the horizontal one of the phone's picture, by gravity"


def _sense(vertical: "Vertical | None", axis: int) -> str:
    """Where a positive displacement goes along the vertical axis: against the sense in which gravity is read."""
    if vertical is None or vertical.axis != axis:
        return ""
    return f"; positive is {'up' if vertical.gravity_m_s2 > 0.0 else 'down'}"


def named_s(film: Path) -> float | None:
    """When a film was begun by its name, s since 1970; None where the name does not say."""
    return 1e-3 * int(film.stem) if NAMED_MS.fullmatch(film.stem) else None
