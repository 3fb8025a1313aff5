"""`midspan check-config FILE`."""

from typing import Any

import click

from midspan.cli.console import Console, common_options


@click.command("check-config")
@click.argument("file", type=click.Path())
@common_options
def command(file: str, quiet: bool, as_json: bool) -> None:
    """Validate a recording.toml (or the folder that holds it) without running it."""
    from midspan.settings.load import load_settings, settings_file

    console = Console(quiet, as_json)
    path, settings = settings_file(file), load_settings(file)
    missing = []
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
