"""Writes docs/reference-keys.md and docs/reference-commands.md from the settings' models and the command line.

`python tools/reference.py` writes both; a test compares them with what it would write.
"""

import inspect
from collections.abc import Sequence
from pathlib import Path

import click

from midspan.cli.console import commands
from midspan.cli.main import COMMANDS
from midspan.settings.keys import Key, KeySection, calibration_sections, recording_sections, site_sections

DOCS = Path(__file__).resolve().parents[1] / "docs"
# Naming keys that an earlier section has alike saves rows from this number on.
MIN_SHARED = 4
MADE = "<!-- Written by `python tools/reference.py` from the software: change the sentences there. -->"
KEYS = f"""# Keys of the settings' files

{MADE}

Keys not marked `required` may be omitted. A number outside its range is refused.
`midspan help SECTION` prints a section, `midspan check-config FILE` the values in force.
[Configuration](configuration.md) explains signs, clocks, and how sections work together.

| file | sections |
| --- | --- |"""
FILES = {
    "recording.toml": "Paths are relative to the file. [Several](configuration.md#several-sensors-of-a-kind) [camera], "
    "[infrared], [radar] and [displacement] are possible.",
    "SITE.toml": "Paths are relative to the file; `{NAME}` in a text is an environment variable. [Live](live.md) "
    "has an example.",
    "calibration.json": "`midspan calibrate` writes it. Valid for one set-up: same camera, lens, focus, distance, "
    "target and region; clock offsets are valid for one recording unless the clocks are locked. Unknown keys are "
    "ignored, invalid values refused. `midspan help camera.targets` and `midspan help radar.targets` list the keys of "
    "single targets.",
}
COMMAND = f"""# Commands

{MADE}

Every command has `-h, --help`, `-q, --quiet` (print errors only) and `--json` (one JSON document on standard
output). [Configuration](configuration.md#commands) has exit codes and shell completion."""


def keys_page() -> str:
    """All keys of the three files."""
    # Single targets of a calibration are left to `midspan help`.
    stored = [one for one in calibration_sections() if not one.name.endswith(".targets")]
    files = dict(zip(FILES, (recording_sections(), site_sections(), stored), strict=True))
    contents = [
        f"| {file} | {', '.join(f'[{one.name}](#{anchor(_heading(file, one))})' for one in _named(sections))} |"
        for file, sections in files.items()
    ]
    parts = ["\n".join([KEYS, *contents])]
    for file, sections in files.items():
        parts += [f"## {file}", FILES[file], *_tables(file, sections)]
    return "\n\n".join(parts) + "\n"


def _named(sections: Sequence[KeySection]) -> list[KeySection]:
    return [one for one in sections if one.name and one.keys]


def _heading(file: str, section: KeySection) -> str:
    """Headings of two files differ, and so do their anchors."""
    return f"[{section.name}]" if file != "calibration.json" else f"{section.name} of {file}"


def anchor(heading: str) -> str:
    """The anchor that Markdown makes of a heading."""
    plain = "".join(sign for sign in heading.lower() if sign.isalnum() or sign in " _-")
    return plain.strip().replace(" ", "-")


def _tables(file: str, sections: Sequence[KeySection]) -> list[str]:
    """Heading, sentence and list of each section; keys that an earlier section has alike are named alone."""
    parts: list[str] = []
    before: dict[Key, str] = {}
    for section in (one for one in sections if one.keys):
        parts += [f"### {_heading(file, section)}", section.text] if section.name else []
        alike: dict[str, list[Key]] = {}
        for key in section.keys:
            alike.setdefault(before.get(key, ""), []).append(key)
        shared = {place: keys for place, keys in alike.items() if place and len(keys) >= MIN_SHARED}
        parts += [_shared(keys, next(one for one in sections if one.name == place)) for place, keys in shared.items()]
        named = [key for keys in shared.values() for key in keys]
        rows = [_line(key, file) for key in section.keys if key not in named]
        parts += ["\n".join(rows)] if rows else []
        before = dict.fromkeys(section.keys, section.name) | before
    return parts


def _shared(keys: Sequence[Key], source: KeySection) -> str:
    """The keys that a section has from another one: those named, or all but the others, whichever is shorter."""
    others = [key for key in source.keys if key not in keys]
    which, listed = ("all but ", others) if others and len(others) < len(keys) else ("", keys)
    return f"As in [{source.name}]: {'all' if not others else which + ', '.join(f'`{key.name}`' for key in listed)}."


def _line(key: Key, file: str) -> str:
    """A key with its values and default; of calibration.json nobody chooses values, names have units."""
    if file == "calibration.json":
        return f"- `{key.name}`: {key.text}"
    default = f"default `{key.default}`" if key.default not in ("", "required") else key.default
    return f"- `{key.name}` ({', '.join(filter(None, (key.values, default)))}): {key.text}"


def commands_page() -> str:
    """All commands with their options."""
    parts = [COMMAND]
    for name in COMMANDS:
        found = commands.get_command(click.Context(commands), name)
        usage = [piece for piece in found.collect_usage_pieces(click.Context(found)) if piece != "[OPTIONS]"]
        text = [part.replace("\n", " ") for part in inspect.cleandoc(found.help or "").split("\n\n")]
        parts += [f"## {name}", f"`{' '.join(['midspan', name, *usage])}`: {text[0]}", *text[1:]]
        given = [one for one in found.params if isinstance(one, click.Option) and one.name not in ("quiet", "as_json")]
        parts += ["\n".join(_option(one) for one in given)] if given else []
    return "\n\n".join(parts) + "\n"


def _option(option: click.Option) -> str:
    """Names of an option with what follows it, and its help with the default."""
    names, kind = ", ".join((*option.opts, *option.secondary_opts)), option.type
    value = option.metavar or (
        "|".join(kind.choices) if isinstance(kind, click.Choice) else kind.name.split()[0].upper()
    )
    default = f" Default: {option.default}." if option.show_default else " Required." if option.required else ""
    return f"- `{names if option.is_flag else f'{names} {value}'}`: {option.help}{default}"


PAGES = {DOCS / "reference-keys.md": keys_page, DOCS / "reference-commands.md": commands_page}

if __name__ == "__main__":
    for path, text in PAGES.items():
        path.write_text(text(), encoding="utf-8")
