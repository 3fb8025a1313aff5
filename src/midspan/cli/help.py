"""`midspan help [TOPIC]`: a command, a section of the settings' files, or one key."""

from typing import TYPE_CHECKING

import click

from midspan.cli.console import Console, commands, common_options
from midspan.cli.main import COMMANDS

if TYPE_CHECKING:
    from midspan.settings.keys import Key, KeySection

# A file without sections, as a topic.
CAMPAIGN = "campaign"


@click.command("help")
@click.argument("topic", required=False)
@common_options
def command(topic: str | None, quiet: bool, as_json: bool) -> None:
    """Explain a command, a section of the settings' files or a key: `estimate`, `camera.lens`, `fusion.lag_s`.

    Without TOPIC it lists commands and sections.
    """
    from midspan.checks import option
    from midspan.settings.keys import calibration_sections, campaign_sections, recording_sections, site_sections

    console = Console(quiet, as_json)
    context = click.get_current_context()
    if topic in COMMANDS:
        found = commands.get_command(context, topic)
        assert found is not None
        text = found.get_help(click.Context(found, info_name=f"midspan {topic}"))
        console.say(text)
        console.document({"topic": topic, "text": text})
        return
    files = {
        "recording.toml": recording_sections(),
        "SITE.toml": site_sections(),
        "CAMPAIGN.toml": campaign_sections(),
        "calibration.json": calibration_sections(),
    }
    if topic is None:
        console.say(commands.get_help(click.Context(commands, info_name="midspan")))
        for file, sections in files.items():
            names = ", ".join(one.name for one in sections if one.name and one.keys) or f"none; see help {CAMPAIGN}"
            console.say(f"\nSections of {file}:\n  {names}")
        console.document({"commands": list(COMMANDS), **{file: [one.name for one in files[file]] for file in files}})
        return
    rows = _rows(files, topic.strip("[]"))
    if not rows:
        topics = [
            *COMMANDS,
            CAMPAIGN,
            *dict.fromkeys(one.name for sections in files.values() for one in sections if one.name and one.keys),
        ]
        option("TOPIC", topic, topics)
    for file, section, keys in rows:
        console.say(f"[{section.name}] of {file}: {section.text}" if section.name else f"{file}: {section.text}")
        for key in keys:
            given = ", ".join(filter(None, (key.values, key.default and f"default {key.default}")))
            console.say(f"  {key.name} ({given})\n      {key.text}")
    shown = [{"file": file, "section": one.name, "keys": [_tree(key) for key in keys]} for file, one, keys in rows]
    console.document({"topic": topic, "found": shown})


def _rows(files: dict[str, "list[KeySection]"], topic: str) -> "list[tuple[str, KeySection, tuple[Key, ...]]]":
    """The sections of a name, or those with a key of it, named with its section or without; with the keys meant."""
    every = [(file, section) for file, sections in files.items() for section in sections]
    named = (file for file in files if topic == CAMPAIGN and file.startswith("CAMPAIGN"))
    whole = [(file, section, section.keys) for file in named for section in files[file]]
    whole += [(file, section, section.keys) for file, section in every if section.name == topic and section.keys]
    if whole:
        return whole
    keys = [
        (file, section, tuple(key for key in section.keys if topic in (key.name, f"{section.name}.{key.name}")))
        for file, section in every
    ]
    return [row for row in keys if row[2]]


def _tree(key: "Key") -> dict[str, str]:
    return {"key": key.name, "default": key.default, "values": key.values, "text": key.text}
