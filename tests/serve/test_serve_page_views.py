"""Each view of the page in a browser: what it says of a site in which everything has a figure."""

import re

import pytest
from page import AXE, PHONE, violations

from midspan.serve.application import PAGE
from served import state

play = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytestmark = pytest.mark.skipif(not PAGE.is_dir(), reason="the page is not built: make page")


@pytest.fixture
def stated(site):
    """A function that changes how the site stands: fields of its point p, of that one's camera, and of the rest."""

    def change(point=None, camera=None, **rest):
        first, second = state()["points"]
        source = {**first["sources"][0], **(camera or {})}
        site.engine.state = state(
            points=[{**first, "sources": [source], **(point or {})}, second], sources=[source], **rest
        )

    yield change
    site.engine.state = state()


def test_a_source_shows_rates_counts_and_its_clock_and_nothing_where_a_figure_is_not_known(opened, stated):
    stated(camera={
        "nominal_rate_hz": 30.0, "delay_s": 0.137, "late": 3, "restarts": 2, "clock_offset_s": -0.01234,
        "clock_offset_std_s": 0.0021, "clock_drift_ppm": 1.26,
    })  # fmt: skip
    page = opened("sources", viewport=PHONE)
    row = page.locator("tbody tr")
    for name, text in (
        ("Rate", "20.0 of 30.0 /s"), ("Delay", "137 ms"), ("Left out", "3 late, 1 faulty, opened again 2 times"),
        ("Clock ± σ", "−12.3 ± 2.1 ms, 1.3 ppm"), ("Time stamps", "the camera's clock"),
    ):  # fmt: skip
        play.expect(row.locator(f"[data-name='{name}']")).to_have_text(text)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    if AXE.is_file():
        assert violations(page) == []
    stated(camera={"faults": 0})
    play.expect(row.locator("[data-name='Left out']")).to_have_text("none")
    for name in ("Delay", "Clock ± σ"):
        play.expect(row.locator(f"[data-name='{name}']")).to_be_empty()
    play.expect(row.locator("[data-name=Rate]")).to_have_text(re.compile(r"^20\.0 /s$"))
