"""The kinds of sensors: the accelerometer, and those of which there may be several each, with their lists and names."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator

ACCELEROMETER = "accelerometer"
# In the order in which they count: the first one of a recording gives the zero.
KINDS = ("camera", "infrared", "radar", "displacement")
CAMERAS = ("camera", "infrared")
# Words of the files and of results that mean something else than one sensor.
TAKEN = (
    *KINDS,
    ACCELEROMETER,
    "accelerometer_x",
    "accelerometer_y",
    "calibration",
    "fusion",
    "reference",
    "site",
    "name",
    "overlap",
    "recording",
    "prediction",
)


def _is_a_word(value: str) -> str:
    """A text that can become part of a column's name."""
    if not (value.isascii() and value.replace("-", "_").replace("_", "a").isalnum()):
        raise ValueError("must be a word of letters, digits, _ or -, as it becomes part of columns' names")
    return value


def _listed(value: Any) -> Any:
    """One section, or several, as a list."""
    if value is None or isinstance(value, tuple) or (isinstance(value, list) and value):
        return value or ()
    if not isinstance(value, dict):
        raise ValueError("must be a section with keys, or a list of such sections with a name each")
    return [value]


Listed = BeforeValidator(_listed)
SensorName = Annotated[str, AfterValidator(_is_a_word)]


def sensor_names(listed: Mapping[str, Sequence[str | None]]) -> tuple[str, ...]:
    """The name of each sensor in the order of KINDS; listed: kind → names as given, None for one without.

    A single one without a name is called by its kind. Raises ValueError where they cannot be distinguished.
    """
    names = []
    for kind in KINDS:
        given = listed.get(kind, ())
        for count, name in enumerate(given, start=1):
            if not name and len(given) > 1:
                raise ValueError(f"must give each of several [[{kind}]] a name of its own; {kind}[{count}] has none")
            if name in TAKEN and name != kind:
                raise ValueError(f"must not give {kind}[{count}] the name {name!r}, which means something else")
            names.append(name or kind)
    name, count = Counter(names).most_common(1)[0] if names else ("", 0)
    if count > 1:
        raise ValueError(f"must give each sensor a name of its own; {count} have the name {name!r}")
    return tuple(names)
