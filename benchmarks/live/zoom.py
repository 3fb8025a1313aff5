"""From a zoom to its picture, and from an address to the first trace.

`python -m benchmarks.live.zoom [STORE]`: a day of 100 Hz and a year (a row each 160 s: years are drawn of least and
largest values of blocks) in a SQLite store, made where there is none, behind `midspan serve`. Through the interface:
2000 buckets that end at other instants each time. In the browser, where there is one: from the choice of a time until
the frame with its trace is painted, and from an address to the first trace, with empty caches.
"""

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.live.feed import ServedStore, browser, chromium, logged_in
from benchmarks.live.history import BUCKETS, DAYS, FIRST_NS, fill
from benchmarks.table import goal
from midspan.records import NANOSECONDS
from midspan.store.days import DAY_NS
from midspan.store.store import is_store, open_store

ROUNDS = 7
HOUR_NS = 3600 * NANOSECONDS
# What is shown: the point, its length (ns), and the goal, ms.
ZOOMS = {
    "1 h": ("day", HOUR_NS, 100.0), "3 h": ("day", 3 * HOUR_NS, 100.0), "a day": ("day", DAY_NS, 150.0),
    "a year": ("year", DAYS * DAY_NS, 400.0),
}  # fmt: skip
# The page's own choices of these lengths.
CHOICES = {"1 h": "3600", "3 h": "10800", "a day": "86400", "a year": "31622400"}
GOAL_FIRST_S = 2.0
# Chooses a time, and returns how long it took until the frame with its answer was painted, ms. Once the answer is
# read, the next time that the canvas is cleared its trace is drawn; the frame that this is in ends with the
# message.
CHOSEN = """
async value => {
    const select = [...document.querySelectorAll("select")].find(one => [...one.options].some(o => o.value === value));
    const [json, clear] = [Response.prototype.json, CanvasRenderingContext2D.prototype.clearRect];
    let isRead = false;
    const drawn = new Promise(done => {
        Response.prototype.json = async function () {
            const found = await json.call(this);
            isRead ||= this.url.includes("/series?");
            return found;
        };
        CanvasRenderingContext2D.prototype.clearRect = function (...where) {
            clear.apply(this, where);
            if (isRead) done();
        };
    });
    const begun = performance.now();
    select.value = value;
    select.dispatchEvent(new Event("change", { bubbles: true }));
    await drawn;
    [Response.prototype.json, CanvasRenderingContext2D.prototype.clearRect] = [json, clear];
    await new Promise(requestAnimationFrame);
    await new Promise(done => {
        const painted = new MessageChannel();
        painted.port1.onmessage = done;
        painted.port2.postMessage(0);
    });
    const took = performance.now() - begun;
    // What comes after the trace, as the events, is not of the next choice.
    await new Promise(done => setTimeout(done, 300));
    return took;
}
"""


def asked_ms(served: ServedStore, token: str) -> None:
    """Print how long buckets take through the interface."""
    import httpx

    with httpx.Client(base_url=served.address, headers={"Authorization": f"Bearer {token}"}, timeout=60.0) as client:
        for name, (point, length_ns, limit_ms) in ZOOMS.items():
            end_ns = FIRST_NS + (DAY_NS if point == "day" else DAYS * DAY_NS)
            took_ms = []
            for number in range(ROUNDS):
                to_ns = end_ns - number * (length_ns // 1000)
                path = f"/api/v1/points/{point}/series?buckets={BUCKETS}&from={to_ns - length_ns}&to={to_ns}"
                begun_s = time.perf_counter()
                answer = client.get(path).raise_for_status()
                took_ms.append(1e3 * (time.perf_counter() - begun_s))
                assert sum(one is not None for one in answer.json()["displacement_mm_max"]) > 0.9 * BUCKETS
            goal(f"{name}: through the interface, median", float(np.median(took_ms)), limit_ms, unit="ms")
            print(f"        first {took_ms[0]:.0f} ms, longest {max(took_ms):.0f} ms")


def drawn_ms(context: Any, served: ServedStore) -> None:
    """Print how long it takes in a browser until a time that was chosen is drawn."""
    page = context.new_page()
    for point in ("day", "year"):
        page.goto(f"{served.address}/#/point/{point}")
        page.get_by_label("Shown").wait_for()
        for name, (own, _, limit_ms) in ZOOMS.items():
            if own == point:
                took_ms = []
                for _ in range(ROUNDS):
                    page.evaluate(CHOSEN, "10")
                    took_ms.append(page.evaluate(CHOSEN, CHOICES[name]))
                goal(f"{name}: drawn in the browser, median", float(np.median(took_ms)), limit_ms, unit="ms")
    page.close()


def first_trace_s(started: Any, served: ServedStore, password: str, user: str) -> float:
    """From an address to the trace, in a browser that knows nothing of the page, s."""
    context = logged_in(started, served, password, user)
    page = context.new_page()
    begun_s = time.monotonic()
    page.goto(f"{served.address}/#/point/day")
    page.locator("dl.figures").filter(has_text="mm").wait_for()
    took_s = time.monotonic() - begun_s
    context.close()
    return took_s


def main(where: str | None = None) -> int:
    """Fill a store, look at it, and print how long that took."""
    with tempfile.TemporaryDirectory(prefix="midspan-zoom-") as name:
        folder = Path(where or name) / "store"
        if not is_store(folder):
            store = open_store(folder)
            fill(store)
            store.close()
        served = ServedStore(folder)
        try:
            asked_ms(served, served.access(f"script-{time.time_ns()}", "token"))
            if chromium() is None:
                print("Needs chromium for the rest: sh tools/servers.sh installs it.", file=sys.stderr)
                return 2
            user = f"viewer-{time.time_ns()}"
            password = served.access(user, "user")
            with browser() as started:
                goal("first trace", first_trace_s(started, served, password, user), GOAL_FIRST_S, unit="s")
                drawn_ms(logged_in(started, served, password, user), served)
        finally:
            served.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
