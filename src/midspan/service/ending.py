"""When a run ends: at `stop`, after its time, or with the failure of what it cannot go on without."""

import asyncio
import math
import time
from collections.abc import Sequence
from typing import Any


async def until_stopped(
    stop: asyncio.Event, tasks: Sequence[asyncio.Future[Any]], for_s: float | None
) -> BaseException | None:
    """Wait until `stop`, the end of the time, or a task's failure, which is returned: without it nothing would be kept
    any more, and a service manager starts the whole again.
    """
    stopping = asyncio.create_task(stop.wait())
    waiting: set[asyncio.Future[Any]] = {stopping, *tasks}
    end_s = math.inf if for_s is None else time.monotonic() + for_s
    while not stop.is_set() and (left_s := end_s - time.monotonic()) > 0.0:
        timeout = None if left_s == math.inf else left_s
        done, waiting = await asyncio.wait(waiting, timeout=timeout, return_when=asyncio.FIRST_COMPLETED)
        failed = next((task.exception() for task in done if task.exception() is not None), None)
        if failed is not None:
            stopping.cancel()
            return failed
    stopping.cancel()
    return None
