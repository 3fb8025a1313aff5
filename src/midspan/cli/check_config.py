"""`midspan check-config FILE`."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from midspan.cli.console import Console, common_options
from midspan.trees import flattened, toml_value

if TYPE_CHECKING:
    from collections.abc import Sequence

    from midspan.settings.keys import KeySection
    from midspan.settings.recording import RecordingSettings
    from midspan.settings.site import PointPlan

# Width of a column of values, characters: that of most file names.
MAX_COLUMN = 24


@click.command("check-config")
@click.argument("file", type=click.Path())
@common_options
def command(file: str, quiet: bool, as_json: bool) -> None:
    """Validate a recording.toml, a SITE.toml or a CAMPAIGN.toml (or its folder) without running it."""
    from midspan.settings.campaign import is_campaign
    from midspan.settings.keys import recording_sections
    from midspan.settings.load import load_settings, settings_file
    from midspan.settings.site import is_site

    console = Console(quiet, as_json)
    if is_site(file):
        _site(file, console)
        return
    if is_campaign(file):
        _campaign(file, console)
        return
    path, settings = settings_file(file), load_settings(file)
    missing = []
    for name, quantity, section in [*_channels(settings), ("reference", "displacement", settings.reference)]:
        if section is not None and section.unit is not None:
            _check_unit(section, quantity, f"{path}: {name}")
    for name, _, part in [*settings.streams, ("reference", "", settings.reference)]:
        for key in ("file", "config"):
            file_name = getattr(part, key, None)
            if file_name is None or any(sign in file_name for sign in "*?["):
                continue
            if not (path.parent / file_name).exists():
                missing.append(f"{path}: {name}.{key} = {file_name!r}: no such file yet.")
    _check_regions(path, settings)
    console.table(_rows(settings.model_dump(exclude_none=True), recording_sections()))
    console.warn(missing)
    console.say(_verdict(str(path), missing))
    console.document(
        {"file": str(path), "valid": True, "warnings": missing, "settings": settings.model_dump(mode="json")}
    )


def _rows(tree: dict[str, Any], sections: "Sequence[KeySection]") -> list[tuple[str, str]]:
    """The settings as a file of TOML writes them, one a row, each with its meaning; without those that are empty."""
    from midspan.settings.keys import described

    given = [(key, toml_value(value)) for key, value in flattened(tree) if value not in ("", (), [], {})]
    # Long values do not move the meanings of all others.
    width = min(max((len(value) for _, value in given), default=0), MAX_COLUMN)
    return [
        (key, f"{value:<{width}}  # {text}" if (text := described(sections, key)) else value) for key, value in given
    ]


def _verdict(file: str, missing: list[str]) -> str:
    """The last line: whether the settings are valid, and whether what they name is there."""
    if not missing:
        return f"{file}: valid."
    are = "file is" if len(missing) == 1 else "files are"
    return f"{file}: valid, but {len(missing)} {are} missing."


def _check_unit(section: Any, quantity: str, where: str) -> None:
    """UsageError for a unit that does not measure what its section is for."""
    from midspan.errors import UsageError
    from midspan.sources.accelerometer.units import si_factor

    try:
        si_factor(section.unit, quantity, getattr(section, "sensitivity", 0.0) or None)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from None


def _check_regions(path: Path, settings: "RecordingSettings") -> None:
    """UsageError for a region beyond the picture of a camera whose file can be read."""
    from midspan.errors import MidspanError
    from midspan.recording.streams.recording import Recording
    from midspan.recording.tracking.opening import given_targets, require_inside
    from midspan.settings.camera import CameraSettings
    from midspan.vision.frame_source import StoredTrack

    for view in Recording(path, settings).cameras:
        camera = view.own.settings
        if not isinstance(camera, CameraSettings) or not given_targets(camera):
            continue
        try:
            frames = view.frames
            info = frames.info
        except MidspanError:
            # What is wrong with the file is for inspect to say.
            continue
        # A stored track has no picture.
        if not isinstance(frames, StoredTrack):
            require_inside(camera, (info.width, info.height), f"{path}: {view.sensor}")


def _channels(settings: "RecordingSettings") -> list[tuple[str, str, Any]]:
    """Name, quantity and section of the accelerometer and each sensor that brings readings."""
    from midspan.settings.kinds import LIVE

    return [(name, LIVE[kind].quantity, section) for name, kind, section in settings.streams if LIVE[kind].quantity]


def _site(file: str, console: Console) -> None:
    """A site's settings, without its secrets."""
    from midspan.settings.keys import recording_sections, site_sections
    from midspan.settings.live_sources import without_secrets
    from midspan.settings.site import load_site, require_folders

    site = load_site(file)
    file = str(site.file)
    require_folders(site)
    settings = site.settings.model_dump(mode="json", exclude_none=True)
    points = [
        {
            **plan.settings.model_dump(mode="json", exclude_none=True),
            "sources": {name: without_secrets(address) for name, address in plan.sources.items()},
            "sensors": _sensors(plan),
            "alarm": [one.model_dump(mode="json", exclude_none=True) for one in plan.alarms],
        }
        for plan in site.points
    ]
    warnings, missing = list[str](), list[str]()
    for plan in site.points:
        where = f"{file}: point {plan.name!r}"
        absent = [f"{where}: {line}" for line in _missing(plan, site.file.parent, where)]
        warnings += [*absent, *(f"{where}: {line}" for line in [*_units(plan, where), *_short(plan, site.file.parent)])]
        missing += absent
    sections = [replace(one, name=f"point.sensors.{one.name}") for one in recording_sections()]
    groups = [plan.settings.model_dump(mode="json") for plan in site.groups]
    settings |= {"point": points, "group": groups}
    console.table(_rows(settings, [*site_sections(), *sections]))
    console.warn(warnings)
    console.say(_verdict(file, missing))
    console.document({"file": file, "valid": True, "warnings": warnings, "settings": settings})


def _campaign(file: str, console: Console) -> None:
    """A campaign's settings, and what of its recordings is not there."""
    from midspan.scale.jobs import jobs_of
    from midspan.settings.campaign import load_campaign
    from midspan.settings.keys import campaign_sections

    found, path = load_campaign(file)
    jobs, warnings = jobs_of(found, path.parent)
    settings = found.model_dump(mode="json", exclude_none=True)
    console.table(_rows(settings, campaign_sections()))
    console.warn(warnings)
    console.say(f"{path}: valid, {len(jobs)} recordings.")
    console.document({"file": str(path), "valid": True, "warnings": warnings, "settings": settings})


def _sensors(plan: "PointPlan") -> dict[str, Any]:
    """The keys that are given of a point's sensors besides their sources."""
    from midspan.settings.site import FILE_KEYS

    return {
        name: section.model_dump(mode="json", exclude_none=True, exclude_unset=True, exclude={"name", *FILE_KEYS})
        for name, _, section in plan.recording.streams
    }


def _short(plan: "PointPlan", folder: Path) -> list[str]:
    """A line on recordings that are replayed and end before the point gives rows."""
    from midspan.errors import MidspanError
    from midspan.recording.streams.recording import open_recording
    from midspan.records import NANOSECONDS
    from midspan.service.point import OPENING_S

    if not all(address.startswith("replay:") for address in plan.sources.values()):
        return []
    lengths = []
    for place in set(plan.sources.values()):
        try:
            time_ns = open_recording(folder / place.removeprefix("replay:")).acceleration.time_ns
        except MidspanError:
            return []
        lengths.append(float(time_ns[-1] - time_ns[0]) / NANOSECONDS)
    calibrates_s = plan.settings.calibration_s if plan.settings.calibration is None else 0.0
    if min(lengths) >= calibrates_s + OPENING_S:
        return []
    needs = f"calibration_s = {calibrates_s:g}, the calibration itself and " if calibrates_s else ""
    remedy = "lower calibration_s, or give a calibration" if calibrates_s else "use a longer recording"
    return [f"replays {min(lengths):.4g} s; {needs}{OPENING_S:g} s to open come before rows: {remedy}."]


def _missing(plan: "PointPlan", folder: Path, where: str) -> list[str]:
    """What a point names that is not there yet: its calibration, the recordings that it replays, radars' settings.

    DataError for a calibration that is there and is none.
    """
    from midspan.errors import DataError
    from midspan.settings.load import settings_file
    from midspan.settings.stored.calibration import load_calibration

    named = {} if plan.settings.calibration is None else {"calibration": plan.settings.calibration}
    named |= {f"{name}.config": config for name, config in plan.configs.items()}
    lines = [f"{key} = {name!r}: no such file yet." for key, name in named.items() if not (folder / name).is_file()]
    if plan.settings.calibration is not None and (folder / plan.settings.calibration).is_file():
        try:
            load_calibration(folder / plan.settings.calibration, axis=plan.axis)
        except DataError as error:
            raise DataError(f"{where}: calibration: {error}") from None
    for name, address in plan.sources.items():
        if address.startswith("replay:"):
            try:
                settings_file(folder / address.removeprefix("replay:"))
            except DataError:
                lines.append(f"{name}.source = {address!r}: no such recording yet.")
    return lines


def _units(plan: "PointPlan", where: str) -> list[str]:
    """Which unit is taken where a source of blocks is given none; UsageError for a unit of something else."""
    from midspan.sources.accelerometer.units import SI_UNITS

    lines = []
    for name, quantity, section in _channels(plan.recording):
        if not plan.sources[name].startswith("replay:"):
            if section.unit is None:
                lines.append(f"{name}.unit: is missing; {SI_UNITS[quantity]} is assumed.")
            else:
                _check_unit(section, quantity, f"{where}: {name}")
    return lines
