"""Calibrations of live points in the store: the one in force, new ones, accepted ones."""

import json
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from midspan.radar.chirp import RadarInfo, profile_to_json
from midspan.service.point import LivePoint
from midspan.settings.recording import RecordingSettings
from midspan.settings.stored.calibration import Calibration
from midspan.settings.stored.calibration_file import calibration_from_dict, load_calibration
from midspan.store.store import Store, open_store

# Where the chirps stand among the settings.
CHIRPS = "chirps"


def number_in_force(live: LivePoint, store: Store, folder: Path) -> int:
    """The number of the calibration in force: that of the site's file, else the store's own; 0 without one.

    folder: of the site's file, which `calibration` is relative to.
    """
    given = live.plan.settings.calibration
    if given is None:
        in_force = store.calibration(live.name)
        return in_force.number if in_force else 0
    body = json.dumps(load_calibration(folder / given).to_dict())
    known = next((one for one in store.calibrations(live.name) if one.body == body), None)
    return known.number if known else added(live, store, body, accept=True)


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
    """Put an offered calibration in force: the one of a number, or the newest; None where there is no such one."""
    offered = [one for one in store.calibrations(live.name) if one.state == "offered"]
    chosen = next((one for one in reversed(offered) if not wanted or str(one.number) == wanted), None)
    if chosen is None:
        return None
    store.accept(live.name, chosen.number)
    return chosen.number


@contextmanager
def of_a_thread(where: str) -> Iterator[Store]:
    """The store, opened for one piece of work in a thread of its own."""
    store = open_store(where)
    try:
        yield store
    finally:
        store.close()
