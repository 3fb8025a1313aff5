"""How a point of a running site begins: from its checkpoint, else it is opened anew with its calibration, if any."""

import time
from collections.abc import Callable
from pathlib import Path

from midspan.errors import DataError, MidspanError
from midspan.service.calibrations import is_of, loaded, number_in_force
from midspan.service.journal import ROWS
from midspan.service.opening import head_of, opened, resumed
from midspan.service.running import Running
from midspan.settings.kinds import ACCELEROMETER, AUXILIARY
from midspan.store.store import Store


def begin(one: Running, store: Store, folder: Path, say: Callable[[str], None]) -> None:
    """Let a point go on from its checkpoint where that can be used. folder: of the site's file; say: takes one line for
    a person.
    """
    one.live.number = number_in_force(one.live, store, folder)
    one.live.follows = store.newest_ns(one.name, ROWS) is not None
    try:
        kept = store.checkpoint(one.name)
    except DataError as error:
        say(f"{one.name}: {error}")
        return
    if kept is None or not one.live.number:
        return
    try:
        if _resume(one, store, kept[1]):
            say(f"{one.name}: continues from its checkpoint.")
    except (MidspanError, ValueError, KeyError, OSError) as error:
        one.live.drop()
        say(f"{one.name}: the checkpoint cannot be used ({error}); the point reopens.")


def _resume(one: Running, store: Store, kept: bytes) -> bool:
    """Whether a point goes on from a checkpoint: one of the same sensors along the same axes, whose captured
    recording is there.
    """
    head = head_of(kept)
    folder = one.live.folder / Path(head["folder"]).name
    number = head["calibration"]
    made = store.calibration(one.name, number)
    if made is None or not is_of(made.settings, one.live.settings) or not (folder / "recording.toml").is_file():
        return False
    # Where another calibration or other settings came into force since, the rows go on until the point is opened with
    # them.
    found = opened(folder, one.name, loaded(one.live, store, number), number, push=False)
    if {ACCELEROMETER, *found.point.sensors} - set(AUXILIARY) != set(one.live.plan.sources) - set(AUXILIARY):
        return False
    resumed(found, kept, store)
    one.live.resumed(found, folder)
    one.published_ns = store.newest_ns(one.name, ROWS) or 0
    # That nobody listened meanwhile has to be known before the first record.
    one.live.tick(time.time_ns())
    return True
