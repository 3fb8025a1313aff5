"""What other settings do to a running site's points: what those have that end is kept, calibrations are looked at."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any

from midspan.errors import MidspanError
from midspan.service.calibrations import number_in_force
from midspan.service.running import Running


async def end_points(ending: Sequence[Running], keep: Callable[[Running], None]) -> None:
    """End points that get nothing more: as at the end of the service all that came is kept, and how each stands."""
    jobs = [one.work for one in ending if one.work is not None]
    for job in jobs:
        job.cancel()
    await asyncio.gather(*jobs, return_exceptions=True)
    for one in ending:
        keep(one)
        one.live.end()


async def look_at_calibration(
    one: Running, folder: Path, in_thread: Callable[..., Awaitable[Any]], tell: Callable[[Running, str, str], None]
) -> None:
    """The calibration's file of a point that goes on may be another one than it was, or damaged by now.

    folder: of the site's file; in_thread: runs a function with a store of its own; tell: takes an event.
    """
    live = one.live
    try:
        number = await in_thread(number_in_force, live, folder)
    except MidspanError as error:
        tell(one, "calibration_refused", f"{one.name}: {error} Calibration {live.number} stays in force.")
    else:
        if number != live.number:
            live.calibrated(number)
