"""The page open for eight hours on a point's trace: its heap does not grow.

`python -m benchmarks.live.open_page [HOURS]`: four points of 100 Hz. The page's clock (timers, frames) is advanced by
hand, as fast as the browser does what they ask for, and rows come by the websocket with stamps that advance as much: as
many draws, questions and rows as in that time. The heap is read after a collection of garbage.
"""

import contextlib
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.live.feed import Feed, ServedStore, browser, chromium, logged_in, rows
from benchmarks.table import goal
from midspan.records import NANOSECONDS
from midspan.store.store import Batch, open_store

HOURS, POINTS = 8.0, ("a", "b", "c", "d")
# The page's clock advances by this much between two blocks of rows, s; the heap is read so often in all.
STEP_S, READINGS = 5.0, 32
# Rows that are kept in the store, s: what the page asks for of the time before it was opened.
KEPT_S = 600.0
# Rows that the page keeps of a point, s, and a little more.
PAGE_KEEPS_S = 140.0
SETTLED_MS = 500
GOAL_MB = 2.0


def heap_mb(session: Any) -> float:
    """The page's JavaScript heap after a collection, MB."""
    for _ in range(2):
        session.send("HeapProfiler.collectGarbage")
    return float(session.send("Runtime.getHeapUsage")["usedSize"]) / 1e6


def quarters_mb(found: list[float]) -> tuple[float, float]:
    """Median of the second and of the last quarter of readings: one now and then has an answer in it."""
    quarter = len(found) // 4
    return float(np.median(found[quarter : 2 * quarter])), float(np.median(found[-quarter:]))


def readings_mb(started: Any, folder: Path, hours: float, readings: int = READINGS) -> list[float]:
    """The heap of a page over hours of its clock, MB."""
    store = open_store(folder)
    begin_ns = (time.time_ns() // NANOSECONDS - round(KEPT_S)) * NANOSECONDS
    store.write(Batch([rows(point, begin_ns, KEPT_S) for point in POINTS]))
    store.close()
    at_ns = begin_ns + round(KEPT_S * NANOSECONDS)
    feed, served = Feed(folder, list(POINTS)), ServedStore(folder)
    try:
        context = logged_in(started, served, served.access("viewer", "user"))
        page = context.new_page()
        page.clock.install()
        page.goto(f"{served.address}/#/point/a")
        page.locator("dl.figures").filter(has_text="mm").wait_for()
        session, found = context.new_cdp_session(page), []
        # What the page keeps of each point's rows is full from the beginning.
        for point in POINTS:
            feed.give(rows(point, at_ns, PAGE_KEEPS_S))
        at_ns += round(PAGE_KEEPS_S * NANOSECONDS)
        page.wait_for_timeout(4 * SETTLED_MS)
        page.clock.run_for(round(1e3 * STEP_S))
        steps = round(hours * 3600.0 / STEP_S)
        for step in range(steps):
            for point in POINTS:
                feed.give(rows(point, at_ns, STEP_S))
            if step % 60 == 0:
                feed.event("a", at_ns)
            at_ns += round(STEP_S * NANOSECONDS)
            page.clock.run_for(round(1e3 * STEP_S))
            if step % max(steps // readings, 1) == 0:
                # What is on its way, and was asked for, comes in its own time.
                page.wait_for_timeout(SETTLED_MS)
                page.clock.run_for(SETTLED_MS)
                found.append(heap_mb(session))
        context.close()
    finally:
        served.stop()
        feed.stop()
    return found


def main(hours: float = HOURS) -> int:
    """Leave the page open, and print what its heap does."""
    if chromium() is None:
        print("Needs chromium: sh tools/servers.sh installs it.", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="midspan-page-") as name, contextlib.ExitStack() as stack:
        begun_s = time.monotonic()
        found = readings_mb(stack.enter_context(browser()), Path(name) / "store", hours)
        second, last = quarters_mb(found)
        print(
            f"        {hours:g} h in {time.monotonic() - begun_s:.0f} s: heap {second:.2f} MB, at the end {last:.2f} MB"
        )
        goal("growth of the heap, second to last quarter", last - second, GOAL_MB, unit="MB")
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(float, sys.argv[1:])))
