"""Details of the page in a browser that somebody relies on who looks once a day, or at night."""

import re

import pytest
from page import traced

from midspan.serve.application import PAGE
from served import until

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
