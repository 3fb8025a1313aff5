"""What is wrong with a tree of settings, in words: the key, the rule with its unit, the value received, the remedy."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from pydantic import BaseModel

from midspan.checks import nearest, shown
from midspan.errors import MidspanError
from midspan.notices import Notice
from midspan.settings.kinds import CAMERAS, KINDS

# The validation library's words, and what stands for them.
PLAIN = {
    "Input should": "must",
    "String should": "must",
    "a valid boolean": "true or false",
    "a valid number": "a number",
    "a valid integer": "a whole number",
}
DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+\s*")


def explain(item: Any, tree: dict[str, Any], model: type[BaseModel]) -> str:
    """One sentence for one of pydantic's errors about `tree`, which `model` validated."""
    place, kind, value = list(item["loc"]), item["type"], item["input"]
    if len(place) > 1 and isinstance(place[1], int) and isinstance(tree.get(place[0]), dict):
        # A section that is not written as a list has no number.
        del place[1]
    last = place[-1] if place else None
    if isinstance(last, int) and kind in ("missing", "int_type", "float_type"):
        place = place[:-1]
    # Of a list the entry's number, counted from 1.
    key = ".".join(f"[{part + 1}]" if isinstance(part, int) else str(part) for part in place).replace(".[", "[")
    key = key or "settings"
    if kind == "extra_forbidden":
        known = _keys_at([str(part) for part in place[:-1] if not isinstance(part, int)], model)
        if len(place) == 1:
            # Keys of a whole file are not what a section may be named, and the other way round.
            of_its_kind = [name for name in known if _has_sections(_field(model, name)) == _is_section(value)]
            known = of_its_kind or known
        return unknown(key, value, known)
    if kind == "too_long" or (kind == "missing" and isinstance(last, int)):
        return f"{key}: must have {4 if key.endswith('roi') else 2} numbers; received {shown(list(value))}."
    if kind == "missing":
        return f"{key}: is missing. Add it."
    if kind == "tuple_type" and key.endswith(".target"):
        return f"{key}: must be a list, one [[{place[0]}.target]] for each target; received {shown(value)}."
    if kind == "tuple_type":
        return f"{key}: must be a list; received {shown(value)}."
    if kind.startswith(("model_type", "model_attributes", "dict_type")):
        return f"{key}: must be one section with keys, [{key}]; received {shown(value)}."
    if kind == "string_too_short":
        return f"{key} = {shown(value)}: must not be empty; leave the key out instead."
    text = str(item["msg"]).removeprefix("Value error, ")
    for words, plain in PLAIN.items():
        text = text.replace(words, plain)
    if not place:
        return f"{text}."
    if place[0] in CAMERAS:
        text = text.replace("[[camera.", f"[[{place[0]}.")
    if isinstance(value, dict):
        return f"{key}: {text}."
    if text == "must be a number" and isinstance(value, str) and DECIMAL_COMMA.fullmatch(value):
        text += f", without quotes and with a decimal point: {value.replace(',', '.')}"
    received = shown(list(value) if isinstance(value, tuple) else value)
    return f"{key} = {received}: {text}.".replace("..", ".").replace("?.", "?")


def unknown(key: str, value: Any, known: Sequence[str]) -> str:
    """One sentence for a key, or a section, that is none of the known ones."""
    hint, what = nearest(key.rpartition(".")[2], known), "section" if _is_section(value) else "key"
    return f"{key}: is not a known {what}. {hint + ' ' if hint else ''}Known: {', '.join(known)}."


def _is_section(value: Any) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and any(isinstance(one, dict) for one in value))


def _field(model: Any, name: str) -> Any:
    """What a key of a model holds."""
    return next(field.annotation for key, field in model.model_fields.items() if name == (field.alias or key))


def _has_sections(annotation: Any) -> bool:
    """Whether a key holds a section, or a list of them."""
    return hasattr(annotation, "model_fields") or any(map(_has_sections, getattr(annotation, "__args__", ())))


def _keys_at(place: list[str], model: Any) -> list[str]:
    """The keys that are known at a place of the tree."""
    for name in place:
        fields = {field.alias or key: field for key, field in model.model_fields.items()}
        annotation = fields[name].annotation
        options = [annotation, *getattr(annotation, "__args__", ())]
        model = next(option for option in options if hasattr(option, "model_fields"))
    return [field.alias or key for key, field in model.model_fields.items()]


_FIELDS = {key for row in KINDS.values() for key in row.section.model_fields}
_KEYS = "|".join(sorted(_FIELDS, key=len, reverse=True))
_PLACE = rf"(?=(\.({_KEYS})\b|:|\]| \([^()]*\):|'s clock\b))"
_BEFORE = r"(?<![\w/\\.'\"])"
_CAMERA, _ANY = (re.compile(f"{_BEFORE}({words}){_PLACE}") for words in ("camera", "|".join(KINDS)))


def worded(text: str, sensor: str) -> str:
    """A message about a sensor of a kind, as it reads for the one called `sensor`; in those of a thermal camera too."""
    if sensor in CAMERAS:
        return _CAMERA.sub(sensor, text)
    return text if sensor in KINDS else _ANY.sub(sensor, text)


def renamed(notice: Notice, sensor: str) -> Notice:
    """A notice as it reads for the sensor of this name."""
    return notice.worded(worded(notice, sensor))


@contextmanager
def in_words_of(sensor: str) -> Iterator[None]:
    """Let the messages of errors raised inside name the sensor by its name."""
    try:
        yield
    except MidspanError as error:
        error.args, error.more = (worded(str(error), sensor),), worded(error.more, sensor)
        raise
