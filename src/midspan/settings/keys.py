"""The keys of the settings' files as rows: name, default, values with their unit, and what each means.

All of it stands in the models' fields, once; the reference, `midspan help`, `init` and `check-config` show these rows.
"""

import re
import types
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from annotated_types import Ge, Gt, Le, Lt
from pydantic import AfterValidator, BaseModel
from pydantic.fields import FieldInfo

from midspan.settings.alarms import AlarmSettings
from midspan.settings.campaign import CampaignSettings
from midspan.settings.fields import Form, OneOf, Within
from midspan.settings.group import GroupSettings
from midspan.settings.kinds import ACCELEROMETER, LIVE
from midspan.settings.live_axes import SOURCES
from midspan.settings.recording import RecordingSettings
from midspan.settings.site import FILE_KEYS, PointSettings, SiteFile
from midspan.settings.stored.calibration import StoredCalibration
from midspan.trees import toml_value

# Ends of keys and the unit that they name, longer ends before those that they end with themselves.
UNITS = {
    "_mm_per_px": "mm/px", "_mm_per_rad": "mm/rad", "_m_s2": "m/s²", "_m_s3": "m/s³", "_rad_m": "rad/m",
    "_rad2": "rad²", "_rad": "rad", "_bins": "bins", "_bin": "bins", "_px": "px", "_mm": "mm", "_deg": "°",
    "_hz": "Hz", "_db": "dB", "_s": "s", "_m": "m", "_c": "°C",
}  # fmt: skip
REQUIRED, LEFT_OUT = "required", ""
PLAIN = {str: "text", int: "whole number", float: "number", bool: "true, false"}


@dataclass(frozen=True, slots=True)
class Key:
    """One key: its default as TOML writes it (empty: left out), its values with their unit, and what it means."""

    name: str
    default: str
    values: str
    text: str


@dataclass(frozen=True, slots=True)
class KeySection:
    """One section of a file, empty name for the top: what it is, and its keys; many: there may be several."""

    name: str
    text: str
    keys: tuple[Key, ...]
    many: bool = False


def recording_sections() -> list[KeySection]:
    """Those of recording.toml."""
    return list(_sections(RecordingSettings))


def site_sections() -> list[KeySection]:
    """Those of SITE.toml: the file, its points, their sensors and alarms, and its groups."""
    sensors = [
        Key(kind, REQUIRED if kind == ACCELEROMETER else LEFT_OUT, ", ".join(f"{one}…" for one in row.schemes), text)
        for kind, row in LIVE.items()
        for text in [f"source of [point.{kind}]"]
    ]
    text = (
        f"A point's sensors: `source`, and the keys of recording.toml's section but {', '.join(FILE_KEYS)}. "
        f'With direction = "xy" the accelerometer has {" and ".join(SOURCES.values())} instead; '
        "a rotation has source_x, source_y, source_z, about the camera's axes."
    )
    return [
        *_sections(SiteFile),
        KeySection("point", _summary(PointSettings), _keys(PointSettings), many=True),
        KeySection("point.SENSOR", text, tuple(sensors)),
        KeySection("point.alarm", _summary(AlarmSettings), _keys(AlarmSettings), many=True),
        KeySection("group", _summary(GroupSettings), _keys(GroupSettings), many=True),
    ]


def campaign_sections() -> list[KeySection]:
    """That of CAMPAIGN.toml."""
    return list(_sections(CampaignSettings))


def calibration_sections() -> list[KeySection]:
    """Those of calibration.json, of whose values the unit is given alone: nobody has to choose them."""
    return [
        replace(one, keys=tuple(replace(key, values=_unit(key.name)) for key in one.keys))
        for one in _sections(StoredCalibration)
    ]


def described(sections: Sequence[KeySection], place: str) -> str:
    """What the key at a place such as `camera[2].roi` means; empty where nothing is said of it."""
    section, _, name = re.sub(r"\[\d+\]", "", place).rpartition(".")
    return next((key.text for one in sections if one.name == section for key in one.keys if key.name == name), "")


def _sections(model: type[BaseModel], prefix: str = "", *, many: bool = False) -> Iterator[KeySection]:
    yield KeySection(prefix, _summary(model), _keys(model), many)
    for attribute, field in model.model_fields.items():
        inner = section_in(field.annotation)
        if inner is not None and not _forms(field):
            name = f"{prefix}.{field.alias or attribute}".lstrip(".")
            yield from _sections(inner, name, many=get_origin(_plain(field.annotation)) is tuple)


def _summary(model: type[BaseModel]) -> str:
    return (model.__doc__ or "").split("\n\n")[0].replace("\n", " ").strip()


def _keys(model: type[BaseModel]) -> tuple[Key, ...]:
    """The keys of a section that are described."""
    return tuple(
        Key(field.alias or name, _default(field), _values(name, field), field.description)
        for name, field in model.model_fields.items()
        if field.description
    )


def section_in(annotation: Any) -> type[BaseModel] | None:
    """The section that a key holds, one or several; None for a value."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for part in get_args(annotation) if (found := section_in(part)) is not None), None)


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return REQUIRED
    value = field.get_default(call_default_factory=True, validated_data={})
    return LEFT_OUT if value is None or value in ("", (), {}) else toml_value(value)


def _values(name: str, field: FieldInfo) -> str:
    """What a key may hold: its form, or names, or limits with their unit."""
    rules = [*field.metadata, *_rules(field.annotation)]
    checks = [rule.func for rule in rules if isinstance(rule, AfterValidator)]
    names = [", ".join(check.table) for check in checks if isinstance(check, OneOf)]
    limits = [_range(check.limits.low, check.limits.high, check.limits.unit or _unit(name))
              for check in checks if isinstance(check, Within)]  # fmt: skip
    kind = _plain(field.annotation)
    if get_origin(kind) is Literal:
        names.append(", ".join(str(one) for one in get_args(kind) if one))
    return (*_forms(field), *names, *limits, _bounds(name, rules) or PLAIN.get(kind, "section"))[0]


def _forms(field: FieldInfo) -> list[str]:
    """What is said of the values in words; a section of which that is said is described as a key is."""
    return [rule.text for rule in (*field.metadata, *_rules(field.annotation)) if isinstance(rule, Form)]


def _unit(name: str) -> str:
    return next((unit for end, unit in UNITS.items() if name.endswith(end)), "")


def _range(low: float, high: float, unit: str) -> str:
    return f"{_short(low)} … {_short(high)} {unit}".rstrip()


def _short(number: Any) -> str:
    return re.sub(r"e([+-])0*(\d)", lambda match: f"e{match[1].strip('+')}{match[2]}", f"{number:g}")


def _bounds(name: str, rules: Sequence[Any]) -> str:
    """The range of a number by its bounds, empty where it has not both."""
    low = next((_short(one.ge) for one in rules if isinstance(one, Ge)), "")
    low = next((f"above {_short(one.gt)}" for one in rules if isinstance(one, Gt)), low)
    high = next((_short(one.le) for one in rules if isinstance(one, Le)), "")
    high = next((f"below {_short(one.lt)}" for one in rules if isinstance(one, Lt)), high)
    return f"{low} … {high} {_unit(name)}".rstrip() if low and high else ""


def _rules(annotation: Any) -> Iterator[Any]:
    """What is annotated inside an annotation, from the outside in."""
    for rule in getattr(annotation, "__metadata__", ()):
        yield rule
        yield from rule.metadata if isinstance(rule, FieldInfo) else ()
    for part in (annotation.__origin__,) if get_origin(annotation) is Annotated else get_args(annotation):
        yield from _rules(part)


def _plain(annotation: Any) -> Any:
    """An annotation without None and without what is annotated."""
    if get_origin(annotation) is Annotated:
        return _plain(annotation.__origin__)
    if get_origin(annotation) in (Union, types.UnionType):
        return _plain(next(part for part in get_args(annotation) if part is not types.NoneType))
    return annotation
