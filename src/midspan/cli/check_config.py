"""`midspan check-config FILE`."""

from typing import TYPE_CHECKING, Any

import click

from midspan.cli.console import Console, common_options

if TYPE_CHECKING:
    from midspan.settings.recording import RecordingSettings


@click.command("check-config")
@click.argument("file", type=click.Path())
@common_options
def command(file: str, quiet: bool, as_json: bool) -> None:
    """Validate a recording.toml (or the folder that holds it) or a SITE.toml without running it."""
    from midspan.settings.load import load_settings, settings_file
    from midspan.settings.site import is_site

    console = Console(quiet, as_json)
    if is_site(file):
        _site(file, console)
        return
    path, settings = settings_file(file), load_settings(file)
    missing = []
    _require_units(str(path), settings)
    sections = (
        ("accelerometer", settings.accelerometer),
        *((sensor.name, sensor.settings) for sensor in settings.sensors),
        ("reference", settings.reference),
    )
    for name, part in sections:
        for key in ("file", "config"):
            file_name = getattr(part, key, None)
            if file_name is None or any(sign in file_name for sign in "*?["):
                continue
            if not (path.parent / file_name).exists():
                missing.append(f"{path}: {name}.{key} = {file_name!r}: no such file yet.")
    console.say(f"{path}: valid.")
    console.table((key, str(value)) for key, value in _flat(settings.model_dump(exclude_none=True)))
    console.warn(missing)
    console.document(
        {"file": str(path), "valid": True, "warnings": missing, "settings": settings.model_dump(mode="json")}
    )


def _require_units(path: str, settings: "RecordingSettings") -> None:
    """UsageError for a unit that does not measure what its section is for."""
    from midspan.errors import UsageError
    from midspan.sources.accelerometer.units import si_factor

    channels: list[tuple[str, str, Any]] = [
        ("accelerometer", "acceleration", settings.accelerometer),
        ("reference", "displacement", settings.reference),
    ]
    channels += [(one.name, "displacement", one.settings) for one in settings.sensors if one.kind == "displacement"]
    for name, quantity, section in channels:
        if section is not None and section.unit is not None:
            try:
                si_factor(section.unit, quantity, getattr(section, "sensitivity", 0.0) or None)
            except UsageError as error:
                raise UsageError(f"{path}: {name}: {error}") from None


def _site(file: str, console: Console) -> None:
    """A site's settings, without its secrets."""
    from midspan.settings.site import load_site, without_secrets

    site = load_site(file)
    settings = site.settings.model_dump(mode="json", exclude_none=True)
    points = [
        {
            **plan.settings.model_dump(mode="json", exclude_none=True),
            "sources": {name: without_secrets(address) for name, address in plan.sources.items()},
        }
        for plan in site.points
    ]
    console.say(f"{file}: valid.")
    console.table((key, str(value)) for key, value in _flat({**settings, "point": points}))
    console.document({"file": file, "valid": True, "warnings": [], "settings": {**settings, "point": points}})


def _flat(tree: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for key, value in tree.items():
        if isinstance(value, dict):
            rows += _flat(value, f"{prefix}{key}.")
        elif isinstance(value, list | tuple) and any(isinstance(one, dict) for one in value):
            rows += _flat({f"{key}[{count}]": one for count, one in enumerate(value, start=1)}, prefix)
        else:
            rows.append((prefix + key, value))
    return rows
