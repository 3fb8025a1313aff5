"""Calibrations of live points: made in a process of their own, kept in the store, accepted, in force."""

import asyncio
import json
import os
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from midspan.engine.channels import CLOCK_WALK
from midspan.errors import DataError, UntrustedError
from midspan.radar.chirp import RadarInfo, profile_to_json
from midspan.service.point import LivePoint
from midspan.settings.kinds import AUXILIARY, KINDS
from midspan.settings.recording import RecordingSettings
from midspan.settings.stored.calibration import CALIBRATION_FILE, Calibration, calibration_from_dict, load_calibration
from midspan.store.store import Store

# Where the chirps stand among the settings.
CHIRPS = "chirps"


def number_in_force(live: LivePoint, store: Store, folder: Path) -> int:
    """The number of the calibration in force: the store's own, or that of the site's file where it was written later
    than the store's was made; 0 without one, or where it was made for other sensors.

    folder: of the site's file, which `calibration` is relative to.
    """
    in_force = store.calibration(live.name)
    if in_force is not None and not is_of(in_force.settings, live.settings):
        in_force = None
    if live.plan.settings.calibration is None:
        return in_force.number if in_force else 0
    file = folder / live.plan.settings.calibration
    body = json.dumps(load_calibration(file, axis=live.plan.axis).to_dict())
    if in_force is not None and (in_force.body == body or in_force.made_ns > file.stat().st_mtime_ns):
        return in_force.number
    return added(live, store, body, accept=True)


def is_of(kept: str, settings: RecordingSettings) -> bool:
    """Whether a calibration's settings as the store has them are of the same sensors, along the same axes."""
    now, then = settings.model_dump(mode="json", exclude_none=True), json.loads(kept)

    def named(tree: dict[str, Any]) -> list[tuple[str, Any, Any]]:
        # One of a kind is a section, several are a list.
        given = {kind: tree.get(kind, []) for kind in (*KINDS, *AUXILIARY)}
        sections = {kind: own if isinstance(own, list) else [own] for kind, own in given.items()}
        return [(kind, one.get("name"), one.get("direction")) for kind, own in sections.items() for one in own]

    # An earlier version may have kept none.
    return not then or named(then) == named(now)


def settings_json(settings: RecordingSettings, radars: Mapping[str, RadarInfo]) -> str:
    """A point's settings as the store keeps them with a calibration; with them the chirp of each radar, by its name."""
    chirps = {name: json.loads(profile_to_json(info.profile)) for name, info in radars.items() if info.profile}
    return json.dumps({**settings.model_dump(mode="json", exclude_none=True), CHIRPS: chirps})


def added(live: LivePoint, store: Store, body: str, *, accept: bool) -> int:
    """Keep a calibration of now, in force or offered; returns its number."""
    settings = settings_json(live.settings, live.radars)
    return store.add_calibration(live.name, time.time_ns(), body, settings, accept=accept)


def loaded(live: LivePoint, store: Store, number: int | None = None) -> Calibration:
    """A point's calibration of this number; left out: the one in force."""
    found = store.calibration(live.name, live.number if number is None else number)
    assert found is not None
    return calibration_from_dict(json.loads(found.body))


def accepted(live: LivePoint, store: Store, wanted: str) -> int | None:
    """Put an offered calibration in force: the one of a number, or the newest; None where there is no such one of the
    point's sensors.
    """
    kept = [one for one in store.calibrations(live.name) if is_of(one.settings, live.settings)]
    offered = [one for one in kept if one.state == "offered"]
    chosen = next((one for one in reversed(offered) if not wanted or str(one.number) == wanted), None)
    if chosen is None or not store.accept(live.name, chosen.number):
        return None
    return chosen.number


def refused(live: LivePoint, store: Store, number: int) -> bool:
    """Refuse an offered calibration; whether there was such a one."""
    return store.refuse(live.name, number)


# A calibration of an hour's recording takes minutes.
LONGEST_S = 1800.0
# Of the process, as of POSIX (0 usual, 19 least urgent): a tenth of the processor where the engine needs it all.
NICENESS = 10
COMMAND = "from midspan.cli.main import main; main()"


async def calibrated_folder(folder: Path) -> str:
    """Calibrate a captured recording; returns the calibration as JSON text.

    Raises UntrustedError where it is refused, DataError where it fails or lasts too long.
    """
    code, printed = await _ran(COMMAND, "calibrate", str(folder), "--json", "--quiet")
    if code == 0:
        body = (folder / CALIBRATION_FILE).read_text(encoding="utf-8")
        require_steady_clocks(calibration_from_dict(json.loads(body)))
        return body
    try:
        text = json.loads(printed)["error"]
    except (ValueError, KeyError, TypeError):
        text = f"The calibration's process ended with code {code}."
    raise UntrustedError(text) if code == UntrustedError.exit_code else DataError(text)


def require_steady_clocks(calibration: Calibration) -> None:
    """UntrustedError for a clock that gains faster than the engine follows: live nothing else takes its rate out."""
    for name, _, known in calibration.sensors:
        rate = getattr(known, "clock_rate", 0.0)
        if abs(rate) > CLOCK_WALK**0.5:
            raise UntrustedError(
                f"{name}: its clock gains {-1e6 * rate:+.0f} ppm on the accelerometer's, more than the "
                f"{1e6 * CLOCK_WALK**0.5:.0f} ppm that are followed. Set both clocks by NTP."
            )


async def _ran(program: str, *arguments: str) -> tuple[int | None, bytes]:
    """Run Python on a program at low urgency; returns its exit code and what it printed.

    Raises DataError where it lasted too long. Where it is cancelled its process ends too.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", program, *arguments,
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL,
    )  # fmt: skip
    with suppress(OSError):
        # The rows of all points go first.
        os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS)
    try:
        printed, _ = await asyncio.wait_for(process.communicate(), LONGEST_S)
    except (TimeoutError, asyncio.CancelledError) as ended:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        if isinstance(ended, asyncio.CancelledError):
            raise
        raise DataError(f"The calibration took longer than {LONGEST_S:g} s.") from None
    return process.returncode, printed
