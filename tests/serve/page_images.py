"""The pictures of the page in the documentation: `python tests/serve/page_images.py [FOLDER]` (docs/images).

A made-up bridge, the server's own process, and a browser; each view once. Needs playwright, Chromium and `make page`.
"""

import contextlib
import shutil
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "serve")]

import scene  # noqa: E402

from midspan.records import NANOSECONDS  # noqa: E402
from midspan.store.store import Batch, open_store  # noqa: E402
from served import Engine, Served, logged_in  # noqa: E402

STEP_S = 0.2
DESK, PHONE = {"width": 1180, "height": 820}, {"width": 390, "height": 780}
# Name of each picture and its view.
DESK_VIEWS = {
    "site": "site", "point": "point/quarter-span", "frequencies": "point/quarter-span", "alarms": "alarms",
    "sources": "sources", "calibration": "calibration/quarter-span", "infrared": "camera/midspan.infrared",
    "radar": "camera/pier-3.radar", "settings": "settings",
}  # fmt: skip
PHONE_VIEWS = {"point": "point/quarter-span"}
COLOURS = 64
# Of these whole views, of the others what a screen shows.
FULL = ("page",)


class Bridge:
    """The made-up bridge at real time, and its server."""

    def __init__(self, folder):
        self.store = folder / "store"
        self.begin_ns = time.time_ns() // NANOSECONDS * NANOSECONDS
        scene.fill(self.store, self.begin_ns)
        (folder / "SITE.toml").write_text(scene.SITE)
        self.password = logged_in(self.store, "anna", "admin", kind="user")
        self.engine = Engine(self.store)
        self.engine.site_file = str(folder / "SITE.toml")
        self.engine.state = scene.state()
        self.engine.picture = scene.picture(infrared=True), 960, 540
        self.engine.shown = {
            "low": 3.4,
            "high": 17.9,
            "unit": "degC",
            "time_ns": time.time_ns(),
            "targets": scene.TARGETS,
        }
        self.engine.answers |= {
            "profile": lambda _: scene.profile(),
            "alarms": lambda _: scene.alarms(time.time_ns()),
        }
        self.engine.start()
        self.served = Served(self.store)
        self._ending = threading.Event()
        self._feeding = threading.Thread(target=self._feed, daemon=True)
        self._feeding.start()

    def _feed(self):
        at_ns = self.begin_ns
        with contextlib.closing(open_store(self.store)) as store:
            while not self._ending.wait(0.02):
                if at_ns + STEP_S * NANOSECONDS > time.time_ns():
                    continue
                count = round(STEP_S * scene.LIVE_RATE_HZ)
                time_ns = at_ns + np.arange(count) * (NANOSECONDS // scene.LIVE_RATE_HZ)
                at_ns += round(STEP_S * NANOSECONDS)
                time_s = time_ns % (1000 * scene.DAY_S * NANOSECONDS) / NANOSECONDS
                chunks = [
                    scene.rows_of(point, time_ns, scene.displacement_mm(time_s, seed=seed))
                    for seed, point in enumerate(scene.POINTS)
                ]
                store.write(Batch(chunks=chunks))
                for chunk in chunks:
                    self.engine.give(chunk)

    def stop(self):
        """End it all."""
        self._ending.set()
        self._feeding.join(10.0)
        self.served.stop()
        self.engine.end()


def prepared(page, name):
    """Wait for what a view shows, and open what it shows on demand."""
    page.wait_for_selector("main h1")
    page.wait_for_timeout(2000)
    if name == "point":
        page.get_by_role("button", name="Freeze").click()
    elif name == "frequencies":
        page.locator("section select").select_option("28")
        page.get_by_role("button", name="Natural frequencies over time").click()
        page.get_by_text("Natural frequencies, one segment").wait_for(timeout=120_000)
    elif name == "settings":
        page.get_by_text("Add or remove points and sources").click()
    page.wait_for_timeout(500)


def taken(browser, bridge, folder, views, viewport, prefix, **options):
    """A picture of each view."""
    context = browser.new_context(viewport=viewport, **options)
    at = f"http://127.0.0.1:{bridge.served.port}"
    context.request.post(f"{at}/api/v1/login", data={"user": "anna", "password": bridge.password})
    for name, view in views.items():
        page = context.new_page()
        page.goto(f"{at}/#/{view}")
        prepared(page, name)
        file = folder / f"{prefix}-{name}.png"
        if name == "frequencies":
            page.locator("section", has=page.get_by_role("button", name="Course")).screenshot(path=file)
        else:
            page.screenshot(path=file, full_page=name != "settings" and prefix in FULL)
        page.close()
        smaller(file)
    context.close()


def smaller(file):
    """A picture in few colours: what a page has."""
    from PIL import Image

    with Image.open(file) as image:
        made = image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    made.save(file, optimize=True)
    print(f"{file.name}: {made.width} x {made.height}, {file.stat().st_size / 1000:.0f} kB")


def main(folder=ROOT / "docs" / "images"):
    """Take them all."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as name, sync_playwright() as play:
        bridge = Bridge(Path(name))
        program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
        browser = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        try:
            taken(browser, bridge, Path(folder), DESK_VIEWS, DESK, "page", color_scheme="light")
            taken(browser, bridge, Path(folder), PHONE_VIEWS, PHONE, "page-phone", color_scheme="dark", has_touch=True)
        finally:
            browser.close()
            bridge.stop()


if __name__ == "__main__":
    main(*sys.argv[1:])
