"""Details of the page in a browser that somebody relies on who looks once a day, or at night."""

import re
import time

import pytest
from page import SITE, WIDE, traced

from midspan.records import NANOSECONDS
from midspan.serve.application import PAGE
from served import Served, logged_in, made_store, state, until

play = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytestmark = pytest.mark.skipif(not PAGE.is_dir(), reason="the page is not built: make page")


def test_the_trace_is_drawn_before_the_events_are_there(opened):
    page, held = opened(), []
    page.route(re.compile("/points/p/events"), lambda route: held.append(route))
    page.evaluate("location.hash = '#/point/p'")
    # The middle of the minute that is shown is of the store: no row of it came while the page was open.
    until(lambda: all(traced(page, (0.4, 0.6))), 5.0)
    page.wait_for_timeout(100)
    held[-1].fulfill(json=[{"time": "", "time_ns": 0, "kind": "gap", "text": "came later"}])
    play.expect(page.get_by_text("came later")).to_be_visible()


def test_an_offer_is_shown_though_a_stream_has_ended(opened, site):
    first, second = state()["points"]
    source = {**first["sources"][0], "reason": "ended", "text": "The stream ended."}
    point = {
        **first,
        "reason": "ended",
        "text": "The stream ended.",
        "notice": "calibration_offered",
        "sources": [source],
    }
    try:
        site.engine.state = state(ready=False, points=[point, second], sources=[source])
        card = opened().locator(".card").first
        play.expect(card.locator(".why")).to_have_text("camera: The stream ended.")
        card.get_by_role("link", name="A calibration awaits acceptance").click()
        play.expect(card.page.get_by_role("button", name="Accept")).to_be_visible()
        card.page.goto(card.page.url.replace("calibration/p", "point/p"))
        play.expect(card.page.get_by_role("link", name="A calibration awaits acceptance")).to_be_visible()
    finally:
        site.engine.state = state()


def test_settings_that_are_not_saved_outlast_their_view_and_are_asked_about(opened, site):
    site.file.write_text(SITE)
    page = opened("settings")
    area = page.get_by_label("SITE.toml")
    play.expect(area).to_have_value(SITE)
    play.expect(page.get_by_text("Not saved.")).to_have_count(0)
    area.click()
    page.keyboard.type("# soon")
    changed = area.input_value()
    page.get_by_role("link", name="Site").click()
    play.expect(page.get_by_role("heading", name="Site")).to_be_visible()
    page.get_by_role("link", name="Settings").click()
    play.expect(area).to_have_value(changed)
    play.expect(page.get_by_text("Not saved.")).to_be_visible()
    page.get_by_role("link", name="Site").click()
    with page.expect_event("dialog") as asked:
        page.close(run_before_unload=True)
    assert asked.value.type == "beforeunload"
    asked.value.accept()
    assert site.file.read_text() == SITE


def test_the_address_of_a_point_has_the_time_that_is_shown(opened):
    page = opened("point/p")
    shown = page.get_by_label("Shown")
    shown.select_option("600")
    play.expect(page).to_have_url(re.compile("#/point/p/600$"))
    box = page.locator(".u-over").bounding_box()
    page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 50)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 60, steps=4)
    page.mouse.up()
    play.expect(page).to_have_url(re.compile(r"#/point/p/\d{4}-.*Z/\d{4}-.*Z$"))
    # A fifth of ten minutes is no choice of the list.
    length = re.compile(r"^(2 min|1 min 59 s|2 min 1 s)$")
    play.expect(shown.locator("option:checked")).to_have_text(length)
    address, seen = page.url, page.locator("p.quiet", has_text="), ").inner_text()
    # The view's link comes back to it, and so does the address in another browser.
    page.get_by_role("link", name="Site").click()
    page.get_by_role("link", name="Point", exact=True).click()
    play.expect(page.locator("p.quiet", has_text="), ")).to_have_text(seen)
    other = opened(address.partition("#/")[2])
    play.expect(other.locator("p.quiet", has_text="), ")).to_have_text(seen)
    play.expect(other.get_by_label("Shown").locator("option:checked")).to_have_text(length)
    other.get_by_label("Point").select_option("q")
    play.expect(other.locator("p.quiet", has_text="), ")).to_have_text(seen)


def test_a_picture_shows_where_its_region_is_now(opened, site):
    target = {"name": "", "roi": [10, 20, 64, 48], "x_px": 4.25, "y_px": -2.0, "quality": 0.9, "matches": 37}
    before, site.engine.shown = site.engine.shown, {**site.engine.shown, "targets": [target]}
    try:
        page = opened("camera")
        text = "Target now, dashed: moved by 4.25 px to the right, −2.00 px down; 37 matches."
        play.expect(page.get_by_text(text)).to_be_visible()
        site.engine.shown = {**before, "targets": [{**target, "x_px": None, "y_px": None, "matches": None}]}
        # Of the picture that is shared.
        page.wait_for_timeout(600)
        page.get_by_role("button", name="New image").click()
        play.expect(page.get_by_text("Target: lost in the newest frame.")).to_be_visible()
        # A camera that ended is asked for no picture.
        asked = []
        page.on("request", lambda request: asked.append(request.url))
        first, second = state()["points"]
        source = {**first["sources"][0], "reason": "ended", "text": "The stream ended."}
        site.engine.state = state(ready=False, points=[{**first, "sources": [source]}, second], sources=[source])
        page.wait_for_timeout(500)
        page.get_by_role("button", name="New image").click()
        play.expect(page.get_by_text("The stream ended.")).to_be_visible()
        assert asked == []
    finally:
        site.engine.shown, site.engine.state = before, state()


VIEWS = ("site", "point/p", "alarms", "sources", "calibration/p", "camera", "compare", "settings")


def test_over_a_store_alone_nothing_is_offered_that_cannot_work(browser, tmp_path):
    made_store(tmp_path / "store", (time.time_ns() // NANOSECONDS - 600) * NANOSECONDS)
    password = logged_in(tmp_path / "store", "anna", "admin", kind="user")
    served, said = Served(tmp_path / "store"), []
    context = browser.new_context(viewport=WIDE)
    try:
        page = context.new_page()
        page.on("console", lambda one: said.append(one.text) if one.type in ("error", "warning") else None)
        page.goto(f"http://127.0.0.1:{served.port}/")
        page.get_by_label("User").fill("anna")
        page.get_by_label("Password").fill(password)
        page.keyboard.press("Enter")
        page.wait_for_selector(".card")
        for view in VIEWS:
            page.evaluate("view => location.hash = '#/' + view", view)
            page.wait_for_selector("main h1")
            page.wait_for_timeout(150)
            if view.startswith("calibration"):
                for name in ("Calibrate again", "Accept", "Refuse …"):
                    play.expect(page.get_by_role("button", name=name)).to_be_disabled()
            if view == "alarms":
                play.expect(page.get_by_role("button", name="Send a test message")).to_be_disabled()
                play.expect(page.get_by_text("Not known. No measuring process is running")).to_be_visible()
        play.expect(page.get_by_text("This store has no SITE.toml here")).to_be_visible()
        assert said == []
    finally:
        context.close()
        served.stop()
