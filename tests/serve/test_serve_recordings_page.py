"""The page over recordings in a browser, against `midspan open` itself: link, region, estimate, traces, files."""

import re
import shutil

import pytest
from page import AXE, PHONE, WIDE, violations

from midspan.serve.application import PAGE
from served import opened_recordings

play = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytestmark = pytest.mark.skipif(not PAGE.is_dir(), reason="the page is not built: make page")
VIEWS = ("recordings", "contents/0", "region/0", "settings/0", "result/0")


@pytest.fixture(scope="module")
def folder(footbridge, tmp_path_factory):
    """Two recordings, the second of which has wrong settings."""
    folder = tmp_path_factory.mktemp("recordings")
    shutil.copytree(footbridge, folder / "a bridge")
    shutil.copytree(footbridge, folder / "b")
    wrong = folder / "b" / "recording.toml"
    wrong.write_text(wrong.read_text().replace("direction", '"<img src=x onerror=alert(1)>"'))
    return folder


@pytest.fixture(scope="module")
def page(browser, folder):
    """The page, once its link was followed; what goes wrong on it, or leaves the host, is seen at the end."""
    process, document = opened_recordings(folder)
    wrong, asked = [], []
    context = browser.new_context(viewport=WIDE, accept_downloads=True)
    page = context.new_page()
    page.set_default_timeout(30_000)
    # A command that is asked something takes seconds to begin, on a machine that does other things as well.
    play.expect.set_options(timeout=30_000)
    page.on("console", lambda said: wrong.append(said.text) if said.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(document["address"])
    page.link = document["address"]
    yield page
    play.expect.set_options(timeout=5_000)
    context.close()
    process.terminate()
    _, errors = process.communicate(timeout=60)
    assert (process.returncode, errors) == (0, "")
    # Before there is a calibration, and where a link is used again, that is an answer.
    assert [text for text in wrong if not re.search(r"Failed to load resource|willReadFrequently", text)] == []
    assert [url for url in asked if not re.match(r"(blob:)?http://127\.0\.0\.1:", url)] == []
    # The link's secret is in no request.
    assert [url for url in asked if "link/" in url] == []


def go(page, view):
    page.evaluate("view => location.hash = '#/' + view", view)


def test_a_link_opens_the_list_and_works_no_second_time(page, browser):
    play.expect(page.get_by_role("heading", name="Recordings")).to_be_visible()
    assert "link" not in page.url
    rows = page.locator("tbody tr")
    play.expect(rows).to_have_count(2)
    play.expect(rows.nth(1)).to_contain_text("<img src=x onerror=alert(1)>")
    page.reload()
    play.expect(rows).to_have_count(2)
    # Another browser, which has no token: as of another user.
    other = browser.new_context()
    stranger = other.new_page()
    stranger.goto(page.link)
    play.expect(stranger.get_by_role("status").last).to_contain_text("has been used")
    other.close()


def test_what_is_in_it_is_said(page):
    page.get_by_role("link", name="Contents").click()
    play.expect(page.get_by_text(re.compile("accelerometer and camera overlap"))).to_be_visible()
    play.expect(page.locator("section", has_text="camera.mkv")).to_contain_text("96 × 96 px")


def test_the_region_is_drawn_on_the_first_frame_and_written(page, folder):
    go(page, "region/0")
    canvas = page.locator(".picture canvas")
    play.expect(canvas).to_have_attribute("width", "96")
    play.expect(page.get_by_text("Region: not selected yet.")).to_be_visible()
    canvas.focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Alt+ArrowDown")
    page.keyboard.press("Shift+ArrowUp")
    play.expect(page.get_by_text("Region: 64 × 72 px at 24, 15 (not applied yet)")).to_be_visible()
    page.get_by_role("button", name="Save the region").click()
    play.expect(page.get_by_text("recording.toml is written.")).to_be_visible()
    assert "[camera]\nroi = [24, 15, 64, 72]\n" in (folder / "a bridge" / "recording.toml").read_text()


def test_wrong_settings_are_not_written(page, folder):
    go(page, "settings/1")
    area = page.get_by_label("recording.toml")
    play.expect(area).to_have_value(re.compile("accelerometer"))
    before = (folder / "b" / "recording.toml").read_text()
    page.get_by_role("button", name="Check and save").click()
    play.expect(page.get_by_role("alert")).to_contain_text("img src")
    assert (folder / "b" / "recording.toml").read_text() == before
    assert page.locator("img").count() == 0


def test_it_is_estimated_and_the_result_shown_compared_and_saved(page, folder, tmp_path):
    go(page, "result/0")
    page.get_by_role("button", name="Estimate").click()
    play.expect(page.get_by_role("progressbar")).to_be_visible()
    page.get_by_role("button", name="Cancel").click()
    play.expect(page.get_by_text("Cancelled; nothing was written.")).to_be_visible()
    assert not (folder / "a bridge" / "result.csv").exists()
    page.get_by_role("button", name="Estimate").click()
    play.expect(page.get_by_text(re.compile(r"^Done in \d+ s\. midspan estimate"))).to_be_visible(timeout=120_000)
    assert (folder / "a bridge" / "result.csv").exists()
    play.expect(page.locator("tr", has_text="RMSE").first).to_contain_text("inside ±1.96 σ")
    play.expect(page.get_by_text("accelerometer sensitivity: an error of 1 %")).to_be_visible()
    frame = page.locator(".chart")
    largest = page.locator("dl.figures div", has_text="maximum").locator("dd")
    whole = largest.inner_text()
    assert re.fullmatch(r"−?\d+\.\d{3} mm", whole)
    frame.focus()
    for _ in range(3):
        page.keyboard.press("+")
    play.expect(page.locator("dl.figures")).to_contain_text("rms about the mean")
    page.keyboard.press("a")
    play.expect(largest).to_have_text(whole)
    page.get_by_label("Trace").select_option("error")
    # The footbridge is estimated to hundredths of a millimetre, and moves by millimetres.
    play.expect(largest).to_have_text(re.compile(r"^−?0\.0\d\d mm$"))
    page.get_by_label("as csv").select_option("mat")
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save all rows").click()
    assert saved.value.suggested_filename == "a bridge.mat"
    assert saved.value.path().stat().st_size > 10_000
    page.get_by_role("button", name="Calibrate").click()
    play.expect(page.get_by_role("heading", name=re.compile("^calibration.json of"))).to_be_visible()
    # What was calibrated is what it is estimated with next.
    assert page.get_by_label("Calibration").input_value() == "kept"
    with page.context.expect_page() as report:
        page.get_by_role("button", name="Open the report").click()
    play.expect(report.value.get_by_role("heading", name="Displacement", exact=True)).to_be_visible()
    report.value.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_view_fits_a_phone_and_is_accessible(page, scheme):
    page.set_viewport_size(PHONE)
    page.emulate_media(color_scheme=scheme)
    for view in VIEWS:
        go(page, view)
        page.wait_for_selector("main h1")
        page.wait_for_timeout(1000)
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"], view
        if AXE.is_file():
            assert violations(page) == [], view
    page.set_viewport_size(WIDE)
