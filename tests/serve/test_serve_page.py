"""The page in a browser, against the server's own process: login, values, every zoom, a cut, region, settings."""

import contextlib
import gzip
import json
import re
import time

import pytest
from page import AXE, HEIGHT, HOSTILE, PHONE, SITE, WIDTH, Wire, address, picture, traced, violations

from midspan.records import NANOSECONDS, Event
from midspan.serve.application import PAGE
from midspan.store.store import Batch, open_store
from served import PEAK_MM, PEAK_S, logged_in, state, until

play = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytestmark = pytest.mark.skipif(not PAGE.is_dir(), reason="the page is not built: make page")

# What is lower than a finger needs (44 px), or cut at the side.
SMALL = """() => [...document.querySelectorAll("button, select, input, summary, nav a, .card h2 a, .alarms a")]
    .filter(one => one.offsetParent && one.type !== "checkbox")
    .filter(one => { const box = one.getBoundingClientRect(); return box.height < 44 || box.right > innerWidth; })
    .map(one => one.outerHTML)"""
VIEWS = ("site", "point/p", "alarms", "sources", "calibration/p", "camera", "compare", "settings")


def test_a_login_shows_every_point_with_its_newest_value(opened, site):
    page = opened(logged_in=False)
    page.get_by_label("User").fill("anna")
    page.get_by_label("Password").fill("wrong")
    page.keyboard.press("Enter")
    play.expect(page.get_by_role("alert")).to_have_text("User or password is wrong.")
    # Another address takes nothing away that was typed.
    page.evaluate("location.hash = '#/site'; location.hash = '#/point/p'; location.hash = '#/site'")
    page.wait_for_timeout(200)
    play.expect(page.get_by_label("User")).to_have_value("anna")
    page.get_by_label("Password").fill(site.password)
    page.keyboard.press("Enter")
    card = page.locator(".card", has_text="p")
    play.expect(card.first).to_have_attribute("data-state", "good")
    play.expect(page.locator(".summary")).to_have_attribute("data-state", "good")
    play.expect(card.first.locator(".value")).to_have_text(re.compile(r"^−?\d\.\d{3} ± 0\.020 mm$"))
    before = card.first.locator(".value").inner_text()
    play.expect(card.first.locator(".value")).not_to_have_text(before)


def test_a_source_that_is_wrong_is_said_in_a_sentence_as_text(opened, site):
    source = {**state()["sources"][0], "reason": "silent", "text": f"Nothing has come: {HOSTILE}."}
    point = {**state()["points"][0], "sources": [source]}
    try:
        site.engine.state = state(ready=False, points=[point, state()["points"][1]], sources=[source])
        page = opened()
        card = page.locator(".card").first
        play.expect(card).to_have_attribute("data-state", "notice")
        play.expect(card.locator(".why")).to_have_text(f"camera: Nothing has come: {HOSTILE}.")
        play.expect(page.locator(".summary")).to_have_attribute("data-state", "notice")
        assert page.locator("img").count() == 0
        # What begins is no fault, and not good either.
        begins = {**point, "reason": "opening", "text": "The point is opening.", "sources": []}
        site.engine.state = state(ready=False, points=[begins, state()["points"][1]])
        play.expect(card.locator(".words")).to_have_text("is opening")
        play.expect(card).to_have_attribute("data-state", "notice")
    finally:
        site.engine.state = state()


def test_what_others_wrote_is_text_in_every_view(opened, site):
    """Names, reasons, addresses, events and calibrations come from sensors, files and people; none of it is markup."""
    source = {**state()["sources"][0], "reason": "payload", "stamps": HOSTILE, "text": HOSTILE,
              "address": f"mqtt:{HOSTILE}"}  # fmt: skip
    point = {**state()["points"][0], "reason": "lost", "text": HOSTILE, "notice": HOSTILE, "notice_text": HOSTILE,
             "sources": [source]}  # fmt: skip
    site.file.write_text(SITE.replace('"site"', f"'{HOSTILE}'"))
    wrong = {"text": HOSTILE, "file": HOSTILE, "key": HOSTILE}
    with contextlib.closing(open_store(site.store)) as store:
        store.write(Batch(events=[("p", Event(time.time_ns(), HOSTILE, HOSTILE))]))
        body = json.dumps({"version": 1, "warnings": [HOSTILE], "created": HOSTILE, HOSTILE: HOSTILE})
        number = store.add_calibration("p", time.time_ns(), body, "{}", accept=False)
    try:
        other = {**state()["points"][1], "point": "q"}
        site.engine.state = state(ready=False, points=[point, other], sources=[source], settings=wrong)
        site.engine.say({"kind": "hello", "site": HOSTILE, "site_file": str(site.file)})
        site.engine.picture = picture(), WIDTH, HEIGHT
        page, shown = opened(), 0
        page.on("dialog", lambda dialog: pytest.fail(dialog.message))
        for view in VIEWS:
            page.evaluate("view => { location.hash = `#/${view}`; }", view)
            site.engine.say({"kind": "event", "point": "p", "time_ns": time.time_ns(), "text": HOSTILE})
            play.expect(page.locator("main")).not_to_be_empty()
            # Answers, and what came by the socket.
            page.wait_for_timeout(400)
            assert page.locator("img, script:not([src]), [onerror]").count() == 0, view
            shown += HOSTILE in page.locator("body").inner_text()
        # As text it is there: where reasons, events and addresses are shown.
        assert shown >= 3
    finally:
        with contextlib.closing(open_store(site.store)) as store:
            store.refuse("p", number)
        site.engine.state = state()
        site.engine.say({"kind": "hello", "site": "site", "site_file": str(site.file)})
        site.file.write_text(SITE)


def test_a_peak_keeps_its_height_at_every_zoom_and_a_gap_is_open(opened, site):
    page = opened("point/p")
    largest = page.locator("dl.figures div", has_text="maximum").locator("dd")
    for span in ("3600", "10800", "86400", "31622400"):
        page.get_by_label("Shown").select_option(span)
        play.expect(largest).to_have_text(f"{PEAK_MM:.3f} mm")
    # A minute of gap is 20 px of an hour, and more of less.
    page.get_by_label("Shown").select_option("3600")
    for act in ("", "Zoom in", "Zoom in", "Freeze"):
        if act:
            page.get_by_role("button", name=act, exact=True).click()
        play.expect(largest).to_have_text(f"{PEAK_MM:.3f} mm")
        until(lambda: gap_px(page) >= 15, 5.0)
    # The mouse draws a time around the peak; what is below 30 s long is made of rows.
    hours, minutes, seconds = map(int, re.search(r"to (\d+):(\d+):(\d+)", shown(page).inner_text()).groups())
    since_s = (3600 * hours + 60 * minutes + seconds - site.begin_ns // NANOSECONDS - PEAK_S) % 86_400
    box = page.locator(".u-over").bounding_box()
    at = box["x"] + box["width"] * (1 - since_s / 900)
    page.mouse.move(at - 12, box["y"] + 50)
    page.mouse.down()
    page.mouse.move(at + 12, box["y"] + 60, steps=4)
    page.mouse.up()
    play.expect(shown(page)).to_have_text(re.compile(r"\((1|2)\d s\)"))
    play.expect(page.locator("dl.figures")).to_contain_text("rms")
    play.expect(largest).to_have_text(f"{PEAK_MM:.3f} mm")


def shown(page):
    """Which time is shown, in words."""
    return page.locator("p.quiet", has_text="), ")


def gap_px(page):
    """How wide the widest gap within the trace is."""
    drawn = "".join("x" if hit else " " for hit in traced(page)).strip()
    return max(map(len, drawn.split("x")))


def test_a_cut_is_said_and_leaves_no_hole(opened, site):
    wire = Wire(site.served.port)
    try:
        page = opened("point/p", port=wire.port)
        page.get_by_label("Shown").select_option("10")
        until(lambda: all(traced(page, (0.05, 0.95))), 5.0)
        page.wait_for_timeout(2500)
        wire.cut()
        cut_at = page.evaluate("new Date().toLocaleTimeString([], { hour12: false })").split(":")
        play.expect(page.locator("#connection")).to_have_text(re.compile(r"No connection .* old"))
        # That is when it was lost, not since when the point was measured before.
        play.expect(page.locator(".words").first).to_have_text(re.compile("no connection since"))
        since = re.search(r"(\d+):(\d+):(\d+)", page.locator(".words").first.inner_text()).groups()
        lost = [3600 * int(hours) + 60 * int(minutes) + int(seconds) for hours, minutes, seconds in (since, cut_at)]
        assert abs(lost[0] - lost[1]) <= 2
        page.wait_for_timeout(1500)
        wire.mend()
        play.expect(page.locator("#connection")).to_have_text("")
        # The cut is still within the ten seconds that are shown.
        until(lambda: all(traced(page, (0.05, 0.95))), 2.0)
    finally:
        wire.close()


def test_the_region_is_drawn_by_mouse_moved_by_keys_and_written_for_its_point(opened, site):
    site.file.write_text(SITE)
    page = opened("camera")
    canvas = page.locator(".picture canvas")
    play.expect(page.get_by_text("Region: 64 × 48 px at 10, 20")).to_be_visible()
    assert (canvas.get_attribute("width"), canvas.get_attribute("height")) == (str(WIDTH), str(HEIGHT))
    box = canvas.bounding_box()
    scale = box["width"] / WIDTH
    page.mouse.move(box["x"] + 100 * scale, box["y"] + 100 * scale)
    page.mouse.down()
    page.mouse.move(box["x"] + 180 * scale, box["y"] + 150 * scale, steps=4)
    page.mouse.up()
    play.expect(page.get_by_text("Region: 80 × 50 px at 100, 100 (not applied yet)")).to_be_visible()
    canvas.focus()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Shift+ArrowDown")
    for _ in range(30):
        page.keyboard.press("ArrowRight")
    play.expect(page.get_by_text("Region: 80 × 50 px at 240, 101")).to_be_visible()
    page.get_by_role("button", name="Apply the region").click()
    play.expect(page.get_by_text("reload done")).to_be_visible()
    assert site.file.read_text() == SITE.replace("[10, 20, 64, 48]", "[240, 101, 80, 50]")


def test_wrong_settings_are_said_with_their_key_and_change_nothing(opened, site):
    site.file.write_text(SITE)
    page = opened("settings")
    area = page.get_by_label("SITE.toml")
    play.expect(area).to_have_value(SITE)
    area.fill(SITE.replace("unit =", "unt ="))
    page.get_by_role("button", name="Save and apply").click()
    play.expect(page.get_by_role("alert")).to_contain_text("unt")
    assert site.file.read_text() == SITE
    area.fill(SITE.replace('"site"', '"bridge"'))
    page.get_by_role("button", name="Save and apply").click()
    play.expect(page.locator(".done")).to_have_text("reload done")
    assert 'name = "bridge"' in site.file.read_text()


def test_an_alarm_goes_through_all_its_states(opened, site):
    page = opened("alarms")
    badge = page.locator("#head .badge")
    play.expect(page.locator(".summary")).to_have_text("No alarm is open.")
    play.expect(badge).to_have_count(0)
    # The band of 0.02 mm alone touches the limit of 4 mm.
    site.amplitude_mm = 4.01
    row = page.locator("main section", has=page.get_by_role("heading", name="Open", exact=True)).locator("tbody tr")
    play.expect(row).to_contain_text("critical, pending: only the band exceeds the limit")
    play.expect(badge).to_have_text("1 open")
    site.amplitude_mm = 6.0
    play.expect(row.locator(".words")).to_have_text("critical, firing")
    play.expect(badge).to_have_attribute("data-state", "wrong")
    assert page.locator("img").count() == 0
    page.get_by_role("button", name=re.compile("^Acknowledge")).press("Enter")
    play.expect(row.locator(".words")).to_have_text("critical, acknowledged by anna")
    play.expect(page.get_by_text("is acknowledged.")).to_be_visible()
    # The focus goes on to what can be done next, and with a row where that goes.
    silence = page.get_by_role("button", name=re.compile("^Silence p"))
    play.expect(silence).to_be_focused()
    page.keyboard.press("Enter")
    dialog = page.get_by_role("dialog")
    if AXE.is_file():
        assert violations(page) == []
    dialog.get_by_role("combobox").select_option("8")
    dialog.get_by_label("Reason").fill("gauge is loose")
    page.keyboard.press("Enter")
    play.expect(dialog).to_have_count(0)
    silenced = page.locator("main section", has=page.get_by_role("heading", name="Silenced")).locator("tbody tr")
    play.expect(silenced).to_contain_text("(anna): gauge is loose")
    play.expect(row).to_have_count(0)
    play.expect(silence).to_be_focused()
    silence.click()
    play.expect(row).to_have_count(1)
    site.amplitude_mm = 1.0
    play.expect(row).to_have_count(0)
    play.expect(page.locator(".summary")).to_be_focused()
    play.expect(page.locator(".summary")).to_have_text("No alarm is open.")
    past = page.locator("main section", has=page.get_by_role("heading", name="Past")).locator("tbody tr")
    play.expect(past.first).to_contain_text(re.compile(r"(6\.000|5\.9\d\d) mm"))
    audit = page.locator("main section", has=page.get_by_role("heading", name="History")).locator("tbody tr")
    play.expect(audit.first).to_contain_text("ended")
    for what in ("pending", "firing", "acknowledged", "silenced", "silence ended"):
        play.expect(audit.filter(has=page.get_by_role("cell", name=what, exact=True))).not_to_have_count(0)
    page.get_by_role("button", name="Send a test message").click()
    play.expect(page.get_by_text("Test message sent to")).to_be_visible()
    play.expect(page.get_by_text(f"not delivered: {HOSTILE}")).to_be_visible()


def test_an_alarm_shows_on_site_and_point_with_its_limit(opened, site):
    site.amplitude_mm = 6.0
    try:
        page = opened()
        card = page.locator(".card").first
        play.expect(card.locator(".alarms")).to_contain_text(f"critical, firing: {HOSTILE}")
        # A critical one is red, though everything is measured.
        play.expect(card).to_have_attribute("data-state", "wrong")
        play.expect(page.locator(".summary")).to_have_attribute("data-state", "wrong")
        play.expect(card.locator(".words").first).to_have_attribute("data-state", "notice")
        page.goto(page.url.replace("site", "point/p"))
        play.expect(page.locator(".alarms")).to_contain_text("critical, firing")
        play.expect(page.locator("dl.figures")).to_contain_text("±4 mm")
        page.get_by_role("link", name=re.compile("critical")).click()
        play.expect(page.get_by_role("heading", name="Alarms", exact=True)).to_be_visible()
    finally:
        site.amplitude_mm = 1.0
    play.expect(page.locator(".summary")).to_have_text("No alarm is open.")


def test_who_may_only_read_can_change_no_alarm(opened, site, browser):
    site.amplitude_mm = 6.0
    password = logged_in(site.store, "rita", "read", kind="user")
    try:
        page = opened(logged_in=False)
        page.context.request.post(address(site), data={"user": "rita", "password": password})
        page.goto(page.url.replace("site", "alarms"))
        page.reload()
        play.expect(page.locator(".summary")).to_contain_text("1 fires")
        assert page.locator("main button").count() == 0
    finally:
        site.amplitude_mm = 1.0
    play.expect(page.locator(".summary")).to_have_text("No alarm is open.")


def test_a_source_is_paused_with_a_reason_and_a_calibration_accepted(opened, site):
    page = opened("sources")
    page.once("dialog", lambda dialog: dialog.accept("camera taken down"))
    page.get_by_role("button", name="Pause or resume p.camera").click()
    play.expect(page.get_by_text("pause done")).to_be_visible()
    assert site.engine.commands[-1] == {"command": "pause", "source": "p.camera", "reason": "camera taken down"}
    page.goto(page.url.replace("sources", "calibration/p"))
    page.get_by_role("button", name="Accept").click()
    play.expect(page.get_by_text("accept done")).to_be_visible()
    assert site.engine.commands[-1]["number"] == 2
    page.once("dialog", lambda dialog: dialog.accept(" taken at night "))
    page.get_by_role("button", name="Refuse").click()
    play.expect(page.get_by_text("refuse done")).to_be_visible()
    wanted = {"command": "refuse", "point": "p", "number": 2, "who": "anna", "reason": "taken at night"}
    assert site.engine.commands[-1] == wanted


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_view_fits_a_phone_and_is_accessible(opened, scheme):
    page = opened(viewport=PHONE, color_scheme=scheme, has_touch=True, is_mobile=True)
    for view in VIEWS:
        page.evaluate("view => location.hash = '#/' + view", view)
        page.wait_for_selector("main h1")
        page.wait_for_load_state("networkidle") if view == "settings" else page.wait_for_timeout(300)
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"], view
        assert page.evaluate(SMALL) == [], view
        if AXE.is_file():
            assert violations(page) == [], view


def test_keys_alone_lead_from_the_login_to_a_frozen_trace(opened, site):
    page = opened(logged_in=False)
    page.wait_for_selector("form.login")
    page.keyboard.type("anna")
    page.keyboard.press("Tab")
    page.keyboard.type(site.password)
    page.keyboard.press("Enter")
    page.wait_for_selector(".card")
    for _ in range(30):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.textContent") == "p":
            break
    page.keyboard.press("Enter")
    page.wait_for_selector(".chart canvas")
    for _ in range(40):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.classList.contains('chart')"):
            break
    page.keyboard.press("f")
    play.expect(page.get_by_role("button", name="Follow")).to_be_visible()
    before = shown(page).inner_text()
    page.keyboard.press("ArrowLeft")
    play.expect(shown(page)).not_to_have_text(before)


def test_what_is_shipped_is_small_and_asks_for_nothing_inline():
    scripts = list((PAGE / "assets").glob("*.js"))
    assert sum(len(gzip.compress(one.read_bytes())) for one in scripts) <= 150_000
    text = (PAGE / "index.html").read_text()
    assert not re.search(r"<script>|<style|style=|https?://", text)
