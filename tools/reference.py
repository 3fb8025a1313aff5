"""Writes docs/reference-keys.md and docs/reference-commands.md from the settings' models and the command line.

`python tools/reference.py` writes both; a test compares them with what it would write.
"""

import inspect
import re
from collections.abc import Sequence
from pathlib import Path

import click

from midspan.cli.console import commands
from midspan.cli.main import COMMANDS
from midspan.settings.keys import Key, KeySection, calibration_sections, recording_sections, site_sections

DOCS = Path(__file__).resolve().parents[1] / "docs"
# A range from which nobody chooses: its ratio, and its upper end.
WIDE = 1e6
# How the help of such an option begins.
TWO_FILES = "Two files:"
MADE = "<!-- Written by `python tools/reference.py` from the software: change the sentences there. -->"
KEYS = f"""# Keys of the settings' files

{MADE}

Keys not marked `required` may be omitted. A number outside its range is refused; `midspan help SECTION` also prints
ranges that only catch typing errors, `midspan check-config FILE` the values in force. σ is a standard deviation.
[Configuration](configuration.md) explains signs, clocks, and how sections work together."""
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
    parts = [KEYS]
    for file, sections in files.items():
        parts += [f"## {file}", FILES[file], *_tables(file, sections)]
    return "\n\n".join(parts) + "\n"


def _heading(file: str, section: KeySection) -> str:
    """Headings of two files differ, and so do their anchors."""
    return f"[{section.name}]" if file != "calibration.json" else f"{section.name} of {file}"


def _tables(file: str, sections: Sequence[KeySection]) -> list[str]:
    """Heading, sentence and list of each section; keys that earlier sections have alike are named alone."""
    parts: list[str] = []
    before: list[tuple[KeySection, list[str]]] = []
    for section in (one for one in sections if one.keys):
        lines = [_line(key, file) for key in section.keys]
        alike = next((one for one, theirs in before if theirs == lines), None)
        parts += [f"### {_heading(file, section)}"] if section.name else []
        if alike:
            text = "As" if alike.text == section.text else f"{section.text} Keys as in"
            parts += [f"{text} [{alike.name}]."]
            continue
        parts += [section.text] if section.name else []
        shared = _shared(lines, before)
        named = {line for _, taken in shared for line in taken}
        parts += [f"As in {'; '.join(_names(*one) for one in shared)}."] if shared else []
        rows = [line for line in lines if line not in named]
        parts += ["\n".join(rows)] if rows else []
        before.append((section, lines))
    return parts


def _shared(
    lines: Sequence[str], before: Sequence[tuple[KeySection, list[str]]]
) -> list[tuple[tuple[KeySection, list[str]], list[str]]]:
    """Earlier sections with the lines that a section has from them: the section that has most of them first."""
    left, found = list(lines), []
    while before:
        source = max(before, key=lambda one: sum(line in one[1] for line in left))
        taken = [line for line in left if line in source[1]]
        if not taken:
            break
        found.append((source, taken))
        left = [line for line in left if line not in taken]
    return found


def _names(source: tuple[KeySection, list[str]], taken: Sequence[str]) -> str:
    """The keys that a section has from another one: those named, or all but the others, whichever is shorter."""
    others = [line for line in source[1] if line not in taken]
    which, listed = ("all but ", others) if len(others) < len(taken) else ("", taken)
    names = ", ".join(f"`{line.split('`')[1]}`" for line in listed)
    return f"[{source[0].name}]: {'all' if not others else which + names}"


def _line(key: Key, file: str) -> str:
    """A key with its values and default; of calibration.json nobody chooses values, names have units."""
    if file == "calibration.json":
        return f"- `{key.name}`: {key.text}"
    default = f"default `{key.default}`" if key.default not in ("", "required") else key.default
    given = ", ".join(filter(None, (_shown(key.values), default)))
    return f"- `{key.name}`{f' ({given})' if given else ''}: {key.text}"


def _shown(values: str) -> str:
    """The values of a key; of a range that only catches typing errors, the unit alone."""
    found = re.fullmatch(r"(-?[\d.e-]+) … (\S+) ?(.*)", values)
    if not found or float(found[2]) < max(WIDE * float(found[1]), WIDE):
        return values
    return found[3]


def commands_page() -> str:
    """All commands with their options."""
    parts = [COMMAND]
    for name in COMMANDS:
        found = commands.get_command(click.Context(commands), name)
        usage = [piece for piece in found.collect_usage_pieces(click.Context(found)) if piece != "[OPTIONS]"]
        text = [part.replace("\n", " ") for part in inspect.cleandoc(found.help or "").split("\n\n")]
        parts += [f"## {name}", f"`{' '.join(['midspan', name, *usage])}`: {text[0]}", *text[1:]]
        given = [one for one in found.params if isinstance(one, click.Option) and one.name not in ("quiet", "as_json")]
        parts += ["\n".join(_options(given))] if given else []
    return "\n\n".join(parts) + "\n"


def _options(given: Sequence[click.Option]) -> list[str]:
    """A line for each option; those of two files, which `init` has too, share one."""
    both = [one for one in given if (one.help or "").startswith(TWO_FILES)]
    names = ", ".join(f"`{one.opts[0]}`" for one in both)
    shared = [f"- {names}: With two files, as in [init](#init)."] if both else []
    return [*shared, *(_option(one) for one in given if one not in both)]


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
