"""Messages about a sensor's keys, as they read for the section or the name of the sensor."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

from midspan.errors import MidspanError
from midspan.notices import Notice
from midspan.settings.camera import InfraredSettings
from midspan.settings.kinds import KINDS
from midspan.settings.sensors import DisplacementSettings, RadarSettings

_FIELDS = {key for one in (InfraredSettings, RadarSettings, DisplacementSettings) for key in one.model_fields}
_KEYS = "|".join(sorted(_FIELDS, key=len, reverse=True))
_PLACE = rf"(?=(\.({_KEYS})\b|:|\]| \([^()]*\):|'s clock\b))"
_BEFORE = r"(?<![\w/\\.'\"])"
_CAMERA, _ANY = (re.compile(f"{_BEFORE}({words}){_PLACE}") for words in ("camera", "|".join(KINDS)))


def worded(text: str, sensor: str) -> str:
    """A message about a sensor of a kind, as it reads for the one called `sensor`; in those of a thermal camera too."""
    if sensor in KINDS and sensor != "infrared":
        return text
    return (_CAMERA if sensor == "infrared" else _ANY).sub(sensor, text)


def renamed(notice: Notice, sensor: str) -> Notice:
    """A notice as it reads for the sensor of this name."""
    return notice.worded(worded(notice, sensor))


@contextmanager
def in_words_of(sensor: str) -> Iterator[None]:
    """Let the messages of errors raised inside name the sensor by its name."""
    try:
        yield
    except MidspanError as error:
        error.args = (worded(str(error), sensor),)
        raise
