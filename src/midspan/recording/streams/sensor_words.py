"""Messages about a camera's keys, as they read for the section that the camera stands in."""

import re

from midspan.settings.camera import InfraredSettings

_KEYS = "|".join(sorted(InfraredSettings.model_fields, key=len, reverse=True))
_CAMERA = re.compile(rf"(?<![\w/\\.'\"])camera(?=(\.({_KEYS})\b|:|\]))")


def worded(text: str, sensor: str) -> str:
    """A message about a camera's keys, as it reads for the section `sensor`."""
    return _CAMERA.sub(sensor, text) if sensor != "camera" else text
