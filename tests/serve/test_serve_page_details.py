"""Details of the page in a browser that somebody relies on who looks once a day, or at night."""

import re

import pytest
from page import SITE, traced

from midspan.serve.application import PAGE
from served import state, until

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
        card.get_by_role("link", name="A calibration waits").click()
        play.expect(card.page.get_by_role("button", name="Accept")).to_be_visible()
        card.page.goto(card.page.url.replace("calibration/p", "point/p"))
        play.expect(card.page.get_by_role("link", name="A calibration waits")).to_be_visible()
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
