"""`midspan check-config FILE`."""

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
    for section in ("accelerometer", "camera", "infrared", "radar", "displacement", "reference"):
        part = getattr(settings, section)
        if part is not None and not any(sign in part.file for sign in "*?[") and not (path.parent / part.file).exists():
            missing.append(f"{path}: {section}.file = {part.file!r}: no such file yet.")
    radar = settings.radar
    if radar is not None and radar.config is not None and not (path.parent / radar.config).exists():
        missing.append(f"{path}: radar.config = {radar.config!r}: no such file yet.")
    console.say(f"{path}: valid.")
    console.table((key, str(value)) for key, value in _flat(settings.model_dump(exclude_none=True)))
    console.warn(missing)
    console.document(
        {"file": str(path), "valid": True, "warnings": missing, "settings": settings.model_dump(mode="json")}
    )


def _flat(tree: dict[str, object], prefix: str = "") -> list[tuple[str, object]]:
    rows: list[tuple[str, object]] = []
    for key, value in tree.items():
        rows += _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else [(prefix + key, value)]
    return rows
