"""Trees of plain values from TOML and JSON files, which people edit: encoding, depth and numbers are checked here."""

import json
import re
import stat
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

# Far deeper than any settings go, far below the depth at which Python gives up.
MAX_LEVELS = 64
# Settings and calibrations are below 1 MB; anything much larger is another file.
MAX_BYTES = 64 << 20
# Whole numbers of 64 bits, as TOML has them.
MAX_WHOLE = 2**63
# A number with a decimal comma behind a key.
_DECIMAL_COMMA = re.compile(r"=\s*([+-]?\d+),(\d+)\s*(?:#|$)")
_BARE_LIST = re.compile(r"=\s*[+-]?[\d.]+\s*,\s*[+-]?[\d.]+\s*,")
_WIDE = {
    b"\xff\xfe\x00\x00": "UTF-32",
    b"\x00\x00\xfe\xff": "UTF-32",
    b"\xff\xfe": "UTF-16",
    b"\xfe\xff": "UTF-16",
}


class TreeError(ValueError):
    """What is wrong with a file and what to do, without the file's name."""


def read_text(path: Path, *, strict: bool = True) -> str:
    """The text of a file in UTF-8, with or without byte-order mark; not strict: bytes of other codes are replaced.

    Raises TreeError for another encoding and for what is no text, OSError where the file cannot be read.
    """
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise TreeError("must be a regular file, which a folder, a pipe or a device is not")
    if found.st_size > MAX_BYTES:
        raise TreeError(f"must have at most {MAX_BYTES >> 20} MiB; it has {found.st_size >> 20} MiB. Give another file")
    raw = path.read_bytes()
    wide = next((name for mark, name in _WIDE.items() if raw.startswith(mark)), "UTF-16" if b"\0" in raw else "")
    if wide:
        raise TreeError(f"must be text in UTF-8; this is {wide}, or no text. Save it again with the encoding UTF-8")
    try:
        return raw.decode("utf-8-sig", "strict" if strict else "replace")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        what = f"byte 0x{raw[error.start]:02x} in line {line}"
        raise TreeError(f"must be text in UTF-8; received {what}. Save it again with the encoding UTF-8") from None


def read_toml(path: Path) -> dict[str, Any]:
    """The tree of a TOML file. Raises TreeError, and OSError where the file cannot be read."""
    text = read_text(path)
    try:
        tree = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place, remedy = re.search(r"at line (\d+)", str(error)), "Text values need quotes"
        line = text.splitlines()[int(place[1]) - 1] if place else ""
        if number := _DECIMAL_COMMA.search(line):
            remedy = f"The decimal sign is a point: {number[1]}.{number[2]}"
        elif _BARE_LIST.search(line):
            remedy = "A list needs brackets: [820, 340, 128, 128]"
        elif "\\" in line:
            remedy = "Between double quotes a backslash begins a code: write / in Windows paths, or put them in single "
            remedy += "quotes"
        raise TreeError(f"is not valid TOML: {error}. {remedy}") from None
    except RecursionError:
        raise _too_deep() from None
    except ValueError:
        raise TreeError("holds a number of thousands of digits. Correct it") from None
    _check(tree)
    return tree


def read_json(path: Path) -> Any:
    """The tree of a JSON file. Raises TreeError, and OSError where the file cannot be read."""
    return json_tree(read_text(path))


def json_tree(text: str | bytes) -> Any:
    """The tree of a JSON text. Raises TreeError; a key that stands twice is an error too."""
    try:
        tree = json.loads(text, object_pairs_hook=_unique)
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise TreeError(f"is not JSON: {error}") from None
    except RecursionError:
        raise _too_deep() from None
    except TreeError:
        raise
    except ValueError:
        raise TreeError("holds a number of thousands of digits. Correct it") from None
    _check(tree)
    return tree


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    tree = dict(pairs)
    if len(tree) < len(pairs):
        seen: set[str] = set()
        for name, _ in pairs:
            if name in seen:
                raise TreeError(f"must have each key once; {name[:80]!r} is there twice. Remove one")
            seen.add(name)
    return tree


def _check(tree: Any) -> None:
    """TreeError for a tree that is too deep or holds whole numbers of more than 64 bits."""
    level = [tree]
    for _ in range(MAX_LEVELS):
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                inner += value.values()
            elif isinstance(value, list):
                inner += value
            elif isinstance(value, int) and not -MAX_WHOLE <= value < MAX_WHOLE:
                bits = value.bit_length()
                raise TreeError(f"must have whole numbers of at most 64 bits; received one of {bits}. Correct it")
        if not inner:
            return
        level = inner
    raise _too_deep()


def _too_deep() -> TreeError:
    return TreeError(f"must have at most {MAX_LEVELS} levels of brackets; it has more. Check that it is the right file")


def toml_value(value: Any) -> str:
    """A value as TOML writes it, in one line."""
    import tomli_w

    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    return tomli_w.dumps({"key": value}).partition("= ")[2].rstrip("\n")


def flattened(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The values of a tree with their places, such as `camera.roi` or `point[2].name`."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from flattened(value, f"{prefix}{key}.")
        elif isinstance(value, list | tuple) and any(isinstance(one, dict) for one in value):
            yield from flattened({f"{key}[{count}]": one for count, one in enumerate(value, start=1)}, prefix)
        else:
            yield prefix + key, value
