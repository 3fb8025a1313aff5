"""The kinds of sensors, one row each: the accelerometer, and those of which there may be several each, with names."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from midspan.records import Frame, RangeFrame, Readings
from midspan.settings.camera import CameraSettings, InfraredSettings
from midspan.settings.fields import Section
from midspan.settings.sensors import (
    ALONG,
    AccelerometerSettings,
    DisplacementSettings,
    GyroscopeSettings,
    InclinometerSettings,
    RadarSettings,
    RotationSettings,
    VelocitySettings,
)
from midspan.settings.stored.auxiliary import StoredAuxiliary
from midspan.settings.stored.cameras import StoredCamera
from midspan.settings.stored.radar import StoredRadar
from midspan.settings.stored.sections import StoredAccelerometer, StoredDisplacement
from midspan.sources.live.blocks import ACCELERATION, ANGLE, DISPLACEMENT, ROTATION_RATE, VELOCITY

ACCELEROMETER = "accelerometer"
# Keys of a section that say where the file of a recording is, and of cameras what only frames need: the regions stand
# in the calibration, a track has them no more.
_FILE = ("file", "times", "rate_hz", "start_s", "every")
_FRAMES = (*_FILE, "roi", "target", "automatic_targets", "temperature_range_c")
_RADAR = ("file", "config", "rate_hz", "start_s", "iq_order", "carrier_hz")


@dataclass(frozen=True, slots=True)
class SensorKind:
    """What differs between the kinds of sensors in settings, files and sources.

    section: of recording.toml; stored: of calibration.json; brings: the records of its stream; schemes: what the
    addresses of its live sources begin with; captured: the file of a captured recording; of_files: keys of the section
    that only a file has; to_check: what may be wrong where it contradicts the acceleration, {} for its name; quantity:
    of a channel's readings, with the kind of their blocks. axes: along or about which each may have a live source.
    """

    section: type[Section]
    stored: Any
    brings: type[Frame | RangeFrame | Readings]
    schemes: tuple[str, ...]
    captured: str
    of_files: tuple[str, ...] = _FILE
    to_check: str = ""
    quantity: str = ""
    block: int = 0
    axes: tuple[str, ...] = ()

    @property
    def turns(self) -> bool:
        """Whether it measures a rotation: one of its axes moves the image along the measured one."""
        return issubclass(self.section, RotationSettings)


_CAMERA = partial(
    SensorKind, brings=Frame, schemes=("rtsp://", "usb:", "replay:"), of_files=_FRAMES, to_check="its {}.roi"
)
_CHANNEL = partial(SensorKind, brings=Readings, schemes=("mqtt:", "serial:", "replay:"))
_SEEN = "what the radar sees (`midspan inspect` lists it)"
# In the order in which they count: the first one of a recording gives the zero.
KINDS = {
    "camera": _CAMERA(CameraSettings, StoredCamera, captured="camera"),
    "infrared": _CAMERA(InfraredSettings, StoredCamera, captured="infrared"),
    "radar": SensorKind(RadarSettings, StoredRadar, RangeFrame, ("udp:", "replay:"), "radar", _RADAR, _SEEN),
    "displacement": _CHANNEL(
        DisplacementSettings,
        StoredDisplacement,
        captured="displacement.npz",
        to_check="the unit and sign of its displacement file",
        quantity="displacement",
        block=DISPLACEMENT,
    ),
}
CAMERAS = tuple(kind for kind, row in KINDS.items() if row.brings is Frame)
_ACCELERATION = _CHANNEL(
    AccelerometerSettings,
    StoredAccelerometer,
    captured="acceleration.npz",
    quantity="acceleration",
    block=ACCELERATION,
    axes=("x", "y"),
)
_HELPING = partial(_CHANNEL, stored=StoredAuxiliary)
# What helps the sensors above, one of a kind: none tells where the structure is.
AUXILIARY: dict[str, SensorKind] = {
    "velocity": _HELPING(VelocitySettings, captured="velocity.npz", quantity="velocity", block=VELOCITY),
    "gyroscope": _HELPING(
        GyroscopeSettings, captured="gyroscope.npz", quantity="rotation rate", block=ROTATION_RATE, axes=ALONG
    ),
    "inclinometer": _HELPING(
        InclinometerSettings, captured="inclinometer.npz", quantity="angle", block=ANGLE, axes=ALONG
    ),
}
LIVE = {ACCELEROMETER: _ACCELERATION, **KINDS, **AUXILIARY}
# Words of the files and of results that mean something else than one sensor.
_OF_FILES = ("name", "calibration", "fusion", "reference", "site")
_OF_RESULTS = ("accelerometer_x", "accelerometer_y", "overlap", "recording", "prediction")
TAKEN = (*LIVE, *_OF_FILES, *_OF_RESULTS)


def sensors_of(of_kind: Callable[[str], Sequence[Any]]) -> tuple[tuple[str, str, Any], ...]:
    """Name, kind and section of each sensor in the order of KINDS; of_kind: the sections of a kind, each with its name.

    A single one without a name is called by its kind. Raises ValueError where they cannot be distinguished.
    """
    found = []
    for kind in KINDS:
        listed = of_kind(kind)
        for count, section in enumerate(listed, start=1):
            name = section.name
            if not name and len(listed) > 1:
                raise ValueError(f"must give each of several [[{kind}]] a unique name; {kind}[{count}] has none")
            if name in TAKEN and name != kind:
                raise ValueError(f"must not give {kind}[{count}] the name {name!r}, which is reserved")
            found.append((name or kind, kind, section))
    name, count = Counter(name for name, _, _ in found).most_common(1)[0] if found else ("", 0)
    if count > 1:
        raise ValueError(f"must give each sensor a unique name; {count} have the name {name!r}")
    return tuple(found)
