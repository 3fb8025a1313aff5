"""What is wrong with a settings tree, in words: the key, the rule with its unit, the value received, the remedy."""

from typing import Any

from midspan.checks import nearest, shown
from midspan.settings.recording import RecordingSettings


def explain(item: Any) -> str:
    """One sentence for one of pydantic's errors."""
    place, kind, value = list(item["loc"]), item["type"], item["input"]
    if place and isinstance(place[-1], int) and kind in ("missing", "int_type", "float_type"):
        place = place[:-1]
    key = _key(place)
    if kind == "extra_forbidden":
        return _unknown(key, [str(part) for part in place if not isinstance(part, int)], value)
    if kind == "too_long" or (kind == "missing" and isinstance(item["loc"][-1], int)):
        return f"{key}: must have {4 if key.endswith('roi') else 2} numbers; received {shown(list(value))}."
    if kind == "missing":
        return f"{key}: is missing. Add it; `midspan check-config` shows what a file says."
    if kind == "tuple_type" and key in ("camera.target", "infrared.target"):
        return f"{key}: must be a list, one [[{key}]] for each target; received {shown(value)}."
    if kind.startswith(("model_type", "model_attributes", "dict_type")):
        return f"{key}: must be one section, [{key}]; received {shown(value)}."
    if kind == "string_too_short":
        return f"{key} = {shown(value)}: must not be empty; leave the key out instead."
    text = str(item["msg"]).removeprefix("Value error, ")
    text = text.replace("Input should", "must").replace("String should", "must")
    if place and place[0] == "infrared":
        text = text.replace("[[camera.", "[[infrared.")
    return (
        f"{key}: {text}."
        if key == "settings" or isinstance(value, dict)
        else f"{key} = {_plain(value)}: {text}.".replace("..", ".").replace("?.", "?")
    )


def _key(place: list[Any]) -> str:
    """A place of the tree as it is written; of a list the entry's number, counted from 1."""
    text = ".".join(f"[{part + 1}]" if isinstance(part, int) else str(part) for part in place)
    return text.replace(".[", "[") or "settings"


def _plain(value: Any) -> str:
    return shown(list(value)) if isinstance(value, tuple) else shown(value)


def _unknown(key: str, place: list[str], value: Any) -> str:
    known = _keys_at(place[:-1])
    if len(place) == 1:
        known = [name for name in known if name != "name"] if isinstance(value, dict) else ["name"]
    what = "section" if isinstance(value, dict) else "key"
    hint = nearest(place[-1], known)
    return f"{key}: is not a known {what}. {hint + ' ' if hint else ''}Known: {', '.join(known)}."


def _keys_at(place: list[str]) -> list[str]:
    """The keys that are known at a place of the tree."""
    model: Any = RecordingSettings
    for name in place:
        annotation = model.model_fields[name].annotation
        options = [annotation, *getattr(annotation, "__args__", ())]
        model = next(option for option in options if hasattr(option, "model_fields"))
    return list(model.model_fields)
