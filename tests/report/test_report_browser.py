"""The report in a browser: values, keyboard, wheel, touch, colours, sizes, and that it asks for nothing."""

import io
import re

import numpy as np
import pandas as pd
import pytest
from hour import MODE_HZ, hour_result

from midspan.report.report import write_report

pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

WIDE, PHONE = {"width": 1400, "height": 1000}, {"width": 390, "height": 800}


@pytest.fixture
def report(camera_report):
    return camera_report


@pytest.fixture(scope="module")
def hour(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hour")
    return write_report(hour_result(folder), folder / "report.html")


@pytest.fixture
def opened(browser):
    """A function that opens a page in a window of this size; what went wrong on it is checked at the end."""
    contexts, wrong, asked = [], [], []

    def open_page(path, viewport=WIDE, **options):
        context = browser.new_context(viewport=viewport, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: wrong.append(message.text) if message.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_selector(".live canvas[aria-label]")
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert wrong == []
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []


def test_the_shown_range_is_a_csv_file(opened, report, camera_result):
    page = opened(report)
    page.click("text=10 s")
    first, last = view(page)
    with page.expect_download() as waiting:
        page.click("button.save")
    assert waiting.value.suggested_filename.startswith("displacement_")
    found = pd.read_csv(waiting.value.path())
    rows = camera_result.to_pandas()
    rows = rows[(rows.index >= first - 1e-3) & (rows.index <= last + 1e-3)]
    assert len(found) == pytest.approx(len(rows), abs=2)
    near = camera_result.to_pandas().index.get_indexer(found.time_s, method="nearest")
    whole = camera_result.to_pandas().iloc[near]
    # The page holds values to a sixteenth of a standard deviation.
    half = whole.displacement_std_mm.median() / 16
    assert np.max(np.abs(found.displacement_mm.to_numpy() - whole.displacement_mm.to_numpy())) < half
    np.testing.assert_allclose(found.displacement_std_mm, whole.displacement_std_mm, rtol=5e-3)
    assert list(found.columns[:3]) == ["time_s", "displacement_mm", "displacement_std_mm"]
    assert {"velocity_mm_s", "status"} <= set(found.columns)


def view(page):
    """First and last time shown, s, as the chart's label says."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    found = re.search(r"from ([-\d.]+) to ([-\d.]+) s", page.get_attribute("canvas", "aria-label"))
    return float(found[1]), float(found[2])


def values(page):
    """What the read-out says: its time, s, and value and band by the names of the lines."""
    text = page.inner_text("output").replace("−", "-")
    lines = re.findall(r"(\w+) ([-+][\d.]+)(?: ± ([\d.e+-]+))? (?:mm|mm/s|m/s²)(?: ·|$)", text)
    found = {name: (float(value), float(band or "nan")) for name, value, band in lines}
    return float(re.search(r"t = ([-\d.]+) s", text)[1]), found, text.split(" · ")[-1]


def middle(page):
    """The canvas's middle on the screen."""
    page.locator("canvas").first.scroll_into_view_if_needed()
    box = page.locator("canvas").first.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + 120


def pixels(page, selector="canvas"):
    """An element as it is seen: (rows, columns, 3) from 0 to 1."""
    from matplotlib.image import imread

    return imread(io.BytesIO(page.locator(selector).first.screenshot()))[:, :, :3]


@pytest.mark.parametrize("viewport", [WIDE, PHONE], ids=["wide", "phone"])
def test_no_page_is_wider_than_its_window(opened, report, viewport):
    page = opened(report, viewport)
    assert page.evaluate("document.documentElement.scrollWidth") == viewport["width"]


def test_the_read_out_says_what_the_result_file_says(opened, report, camera_result, tmp_path):
    table = pd.read_csv(camera_result.save(tmp_path / "result.csv"))
    page = opened(report)
    for button in ("velocity", "camera"):
        page.get_by_role("button", name=button).click()
    x, y = middle(page)
    for move in (-310, -120, 5, 200, 333):
        page.mouse.move(x + move, y)
        view(page)
        time_s, found, status = values(page)
        row = int(np.argmin(np.abs(table["time_s"] - time_s)))
        # Times are shown to a tenth of a row; displacements to a quantum below a sixteenth of the row's own σ.
        assert abs(table["time_s"][row] - time_s) < 1e-3
        value, band = found["displacement"]
        own_mm = camera_result.figures()["median_own_std_mm"]
        assert abs(value - table["displacement_mm"][row]) < own_mm / 16
        assert band == pytest.approx(1.96 * table["displacement_std_mm"][row], rel=0.01)
        assert found["velocity"][0] == pytest.approx(table["velocity_mm_s"][row], abs=0.05)
        assert "reference" in found
        # The camera has frames ten times more rarely, with times of their own.
        measured = re.search(
            r"camera ([-+][\d.]+) ± [\d.]+ mm(?: at ([\d.]+) s)?", page.inner_text("output").replace("−", "-")
        )
        at_s = float(measured[2] or time_s)
        series = camera_result.measured[0]
        k = int(np.argmin(np.abs(series.time_ns / 1e9 - at_s)))
        assert abs(series.time_ns[k] / 1e9 - at_s) < 1e-3
        assert abs(at_s - time_s) <= 0.051
        assert status == table["status"][row]


def test_keys_move_the_cursor_row_by_row_zoom_and_go_back(opened, report, camera_result):
    page = opened(report)
    whole = view(page)
    page.locator("canvas").focus()
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    for _ in range(7):
        page.keyboard.press("+")
    near = view(page)
    assert near[1] - near[0] == pytest.approx((whole[1] - whole[0]) / 2**7, rel=0.05)
    page.keyboard.press("ArrowRight")
    view(page)
    before = values(page)[0]
    page.keyboard.press("ArrowRight")
    view(page)
    # The rows are 10 ms apart.
    assert values(page)[0] - before == pytest.approx(0.01, abs=1e-6)
    page.keyboard.press("-")
    far = view(page)
    assert far[1] - far[0] == pytest.approx(2.0 * (near[1] - near[0]), rel=0.05)
    page.keyboard.press("Home")
    assert view(page) == whole


def test_a_range_button_shows_as_many_seconds_as_it_says(opened, report):
    page = opened(report)
    for text, length_s in (("10 s", 10.0), ("1 s", 1.0)):
        page.get_by_role("button", name=text, exact=True).click()
        found = view(page)
        assert found[1] - found[0] == pytest.approx(length_s, abs=2e-3)
        assert page.get_by_role("button", name=text, exact=True).get_attribute("aria-pressed") == "true"
    # The record is shorter than a minute.
    assert not page.get_by_role("button", name="60 s").is_visible()


def test_the_wheel_scrolls_the_page_until_it_is_meant_for_the_chart(opened, report):
    page = opened(report)
    whole = view(page)
    x, y = middle(page)
    page.mouse.move(x, y)
    before = page.evaluate("scrollY")
    page.mouse.wheel(0, 150)
    page.wait_for_function("(before) => scrollY > before", arg=before)
    assert view(page) == whole
    page.keyboard.down("Control")
    page.mouse.wheel(0, -400)
    page.keyboard.up("Control")
    zoomed = view(page)
    assert zoomed[1] - zoomed[0] < 0.7 * (whole[1] - whole[0])
    page.mouse.click(x, y)
    page.mouse.wheel(0, -400)
    assert view(page)[1] - view(page)[0] < 0.7 * (zoomed[1] - zoomed[0])


def test_one_finger_scrolls_the_page_and_two_zoom(opened, report):
    page = opened(report, PHONE, has_touch=True, is_mobile=True)
    whole = view(page)
    x, y = middle(page)
    session = page.context.new_cdp_session(page)

    def touch(kind, *places):
        points = [{"x": across, "y": down, "id": number} for number, (across, down) in enumerate(places)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        view(page)

    before = page.evaluate("scrollY")
    touch("touchStart", (x, y))
    for moved in range(20, 201, 20):
        touch("touchMove", (x, y - moved))
    touch("touchEnd")
    page.wait_for_function("(before) => scrollY > before + 100", arg=before)
    assert view(page) == whole
    x, y = middle(page)
    touch("touchStart", (x - 20, y), (x + 20, y))
    for apart in (30, 40, 60, 80):
        touch("touchMove", (x - apart, y), (x + apart, y))
    touch("touchEnd")
    pinched = view(page)
    # Four times as far apart: a quarter of the time.
    assert pinched[1] - pinched[0] == pytest.approx(0.25 * (whole[1] - whole[0]), rel=0.02)
    assert page.evaluate("visualViewport.scale") == 1.0


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_chart_and_figures_follow_the_colour_scheme(opened, report, scheme):
    page = opened(report, color_scheme=scheme)
    page.locator("summary", has_text="Innovations").click()
    for selector in ("canvas", "#innovations figure img"):
        typical = float(np.median(pixels(page, selector)))
        assert typical > 0.95 if scheme == "light" else typical < 0.2


def test_a_dark_page_is_printed_light_with_the_drawn_figure(opened, report):
    page = opened(report, color_scheme="dark")
    page.emulate_media(media="print", color_scheme="dark")
    assert not page.locator("canvas").is_visible()
    assert float(np.median(pixels(page, "figure.live img"))) > 0.95
    # Its letters are dark, too.
    assert float(np.min(pixels(page, "figure.live img"))) < 0.3


def test_the_first_window_has_verdict_and_history_and_all_else_opens_on_a_click(opened, report):
    page = opened(report)
    chart = page.locator("canvas").bounding_box()
    assert page.locator(".verdict").bounding_box()["y"] < chart["y"]
    assert chart["y"] + chart["height"] < WIDE["height"]
    figures = page.locator("#innovations figure")
    assert not figures.is_visible()
    page.locator("summary", has_text="Innovations").click()
    assert figures.is_visible()
    # Paper has no clicks.
    page.emulate_media(media="print")
    assert page.locator("#camera figure").first.bounding_box()["height"] > 100


def test_the_reference_shows_where_it_equals_the_result(opened, report):
    seen = pixels(opened(report))
    orange = (seen[:, :, 0] > 0.7) & (seen[:, :, 0] - seen[:, :, 2] > 0.3)
    # A line of one pixel across 1000 is 1000; below the result's line of 1.4 it has at least as much on either side.
    assert np.count_nonzero(orange) > 1000


def test_the_page_may_not_ask_for_anything(browser, report):
    with browser.new_page() as page:
        page.goto(report.as_uri())
        assert page.evaluate("fetch('data:,a').then(() => 'answered', () => 'refused')") == "refused"
        page.evaluate("document.body.append(Object.assign(document.createElement('script'), {text: 'window.ran = 1'}))")
        assert page.evaluate("window.ran") is None


def test_an_hour_at_200_hz_is_small_shows_at_once_and_has_its_cycles(opened, hour):
    assert hour.stat().st_size <= 5e6
    painted = []
    for _ in range(3):
        page = opened(hour)
        painted.append(page.evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime"))
    assert min(painted) <= 1000.0
    page.get_by_role("button", name="10 s", exact=True).click()
    first, last = view(page)
    assert last - first == pytest.approx(10.0, abs=0.02)
    assert crossings(page) == pytest.approx(2.0 * MODE_HZ * (last - first), abs=2)


def crossings(page):
    """How often the blue line crosses the middle of its range, from the canvas's pixels."""
    seen = pixels(page)[:250]
    blue = (seen[:, :, 2] > seen[:, :, 0] + 0.4) & (seen[:, :, 0] < 0.25)
    columns = np.flatnonzero(blue.any(axis=0))
    height = np.array([np.flatnonzero(blue[:, column]).mean() for column in columns])
    above = height > np.median(height)
    return int(np.count_nonzero(np.diff(above.astype(int))))
