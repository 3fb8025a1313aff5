"""Each view of the page in a browser: what it says of a site in which everything has a figure."""

import json
import re
import time
import tomllib

import pytest
from page import AXE, PHONE, SITE, traced, violations

from midspan.records import NANOSECONDS
from midspan.serve.application import PAGE
from served import state, until

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
        ("Rate", "20 of 30 /s"), ("Delay", "137 ms"), ("Rejected", "3 late, 1 faulty, reconnected 2 times"),
        ("Clock ± σ", "−12.3 ± 2.1 ms, 1.3 ppm"), ("Time stamps", "the camera's clock"),
    ):  # fmt: skip
        play.expect(row.locator(f"[data-name='{name}']")).to_have_text(text)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    if AXE.is_file():
        assert violations(page) == []
    unknown = dict.fromkeys(("nominal_rate_hz", "delay_s", "clock_offset_s", "clock_offset_std_s", "clock_drift_ppm"))
    stated(camera={"faults": 0, "late": 0, "restarts": 0, **unknown})
    play.expect(row.locator("[data-name='Rejected']")).to_have_text("none")
    for name in ("Delay", "Clock ± σ"):
        play.expect(row.locator(f"[data-name='{name}']")).to_be_empty()
    play.expect(row.locator("[data-name=Rate]")).to_have_text(re.compile(r"^20 /s$"))


def answered(page, path, body):
    """Answer a question of the page, as a server would that has more to say than the one of these tests."""
    page.route(re.compile(re.escape(path)), lambda route: route.fulfill(json=body))


def kept(number, scale, state="retired", **changes):
    """A calibration whose scale has a deviation of 0.002 mm/px."""
    camera = {"scale_mm_per_px": scale, "scale_std_mm_per_px": 0.002, "time_offset_s": 0.01, "time_offset_std_s": 1e-3}
    time = f"2026-0{number}-01T00:00:00Z"
    body = {"camera": camera, "warnings": []}
    return {"id": number, "time": time, "state": state, "calibration": body, "rows": [], **changes}


def test_calibrations_show_what_an_offer_changes_how_they_drifted_and_which_rows_they_made(opened, stated):
    stated(point={"stage": "capturing", "stage_left_s": 41.0})
    spans = [{"from": f"2026-05-0{day}T10:00:00Z", "to": f"2026-05-0{day}T11:00:00Z"} for day in range(1, 6)]
    page = opened("")
    # Ten deviations of their difference, five of the line through all.
    answered(page, "/points/p/calibrations", [
        kept(1, 1.0), kept(2, 1.0), kept(3, 1.0), kept(4, 9.0, "refused"), kept(5, 1.0, "in force", rows=spans),
        kept(6, 1.0283, "offered"),
    ])  # fmt: skip
    page.evaluate("location.hash = '#/calibration/p'")
    scale = page.locator("tr", has=page.get_by_role("rowheader", name="camera: scale"))
    play.expect(scale.locator("td")).to_have_text(
        ["1.0000 ± 0.0020 mm/px", "1.0283 ± 0.0020 mm/px", "+2.83 % (10.0 σ)"]
    )
    play.expect(scale.locator(".words")).to_have_attribute("data-state", "notice")
    course = page.locator("section", has=page.get_by_role("heading", name="camera: scale", exact=True))
    play.expect(course.locator(".words")).to_have_text(re.compile(r"^Has drifted: .* σ\) since Jan 1, 2026$"))
    play.expect(course.locator("canvas")).to_have_count(1)
    offset = page.locator("section", has=page.get_by_role("heading", name="camera: clock offset", exact=True))
    play.expect(offset.locator(".words")).to_have_text("Has not drifted: 0.00 ms (0.0 σ) since Jan 1, 2026")
    play.expect(page.locator("tbody tr", has_text="in force").last).to_contain_text("2 earlier spans")
    play.expect(page.get_by_text(re.compile(r"^Records are captured: about (3\d|40|41) s left\.$"))).to_be_visible()
    play.expect(page.get_by_role("progressbar")).to_be_visible()
    if AXE.is_file():
        assert violations(page) == []
    stated()
    play.expect(page.get_by_role("progressbar")).to_be_hidden()
    # Of a single one there is no course, and no rows yet is no word.
    answered(page, "/points/p/calibrations", [kept(1, 1.0, "in force", rows=[])])
    play.expect(page.get_by_role("heading", name="Over time")).to_be_hidden()
    play.expect(page.locator("tbody tr", has_text="in force").last.locator("td").last).to_be_empty()


def test_what_a_calibration_warns_of_is_on_its_card_and_in_its_view(opened, stated):
    remedy = {"code": "clock-differs", "severity": "warning", "text": "displacement: set estimate_offset = true."}
    doubt = {"code": "scale-implausible", "severity": "serious", "text": "camera: the scale is 40 % off."}
    stated(point={"warnings": [remedy]})
    page = opened("")
    card = page.locator(".card").first
    play.expect(card).to_have_attribute("data-state", "good")
    play.expect(card.get_by_role("link", name="Its calibration has a warning.")).to_be_visible()
    stated(point={"warnings": [doubt, remedy]})
    play.expect(card.locator(".words").first).to_have_text("measured; its calibration is doubtful")
    play.expect(card).to_have_attribute("data-state", "notice")
    play.expect(card.locator(".quiet")).to_contain_text(re.compile("newest row (now|.* ago), in this state since"))
    page.evaluate("location.hash = '#/point/p'")
    play.expect(page.locator(".legend")).to_contain_text("95 %")
    answered(page, "/points/p/calibrations", [
        kept(1, 1.0, "in force", calibration={**kept(1, 1.0)["calibration"], "notices": [doubt, remedy]}),
        kept(2, 1.0, "offered", calibration={**kept(1, 1.0)["calibration"], "warnings": ["of before"]}),
    ])  # fmt: skip
    page.get_by_role("link", name="Its calibration has 2 warnings.").click()
    said = page.locator("p.words[data-state]", has_text=re.compile("^Calibration [12]:"))
    play.expect(said).to_have_text([
        f"Calibration 1: {doubt['text']}", f"Calibration 1: {remedy['text']}", "Calibration 2: of before",
    ])  # fmt: skip
    play.expect(said.first).to_have_attribute("data-state", "wrong")
    if AXE.is_file():
        assert violations(page) == []


def test_a_link_that_is_followed_while_the_address_is_written_is_followed(opened):
    page = opened("point/p")
    play.expect(page.locator(".legend")).to_contain_text("95 %")
    # The link is followed a moment before the address is due: the browser says that it changed only after both.
    page.evaluate("""() => {
      setTimeout(() => { location.hash = '#/alarms'; }, 300);
      document.querySelector('.chart').dispatchEvent(new KeyboardEvent('keydown', {key: '+'}));
      const end = performance.now() + 400;
      while (performance.now() < end);
    }""")
    play.expect(page.get_by_role("heading", level=1)).to_have_text("Alarms")
    assert page.evaluate("location.hash") == "#/alarms"


def test_rows_that_grow_take_the_focus_from_nothing(opened):
    page = opened("")
    # The view is shown anew once the page has its first answer.
    play.expect(page.get_by_role("link", name="p", exact=True)).to_be_visible()
    span = [{"from": "2026-05-01T10:00:00Z", "to": "2026-05-01T11:00:00Z"}]
    answered(page, "/points/p/calibrations", [kept(1, 1.0, "in force", rows=span), kept(2, 1.01, "offered")])
    page.evaluate("location.hash = '#/calibration/p'")
    page.get_by_role("button", name="Accept").focus()
    grown = [{**span[0], "to": "2026-05-02T12:34:00Z"}]
    answered(page, "/points/p/calibrations", [kept(1, 1.0, "in force", rows=grown), kept(2, 1.01, "offered")])
    play.expect(page.locator("tbody tr", has_text="in force").last).to_contain_text(re.compile(r"34"))
    play.expect(page.get_by_role("button", name="Accept")).to_be_focused()


def test_a_check_says_what_would_change_and_only_saving_writes(opened, site):
    site.file.write_text(SITE)
    page, tried = opened("settings"), []

    def answer(route):
        tried.append(route.request.post_data)
        route.fulfill(json={"text": "Not written.", "restart": ["store"], "added": ["pier"], "removed": ["p"]})

    page.route(re.compile("dry_run=true"), answer)
    area = page.get_by_label("SITE.toml")
    play.expect(area).to_have_value(SITE)
    page.get_by_text("Add or remove points and sources").click()
    form = page.locator("details form")
    form.get_by_label("Name").fill("pier")
    form.get_by_label("Source").fill("serial:/dev/c")
    form.get_by_role("button", name="Insert").click()
    form.get_by_label("Sensor").select_option("camera")
    form.get_by_label("Source").fill("rtsp://10.0.0.9/x")
    form.get_by_label("Source").press("Enter")
    play.expect(page.get_by_text("camera of pier is in the text below.")).to_be_visible()
    page.locator("details .bar").last.get_by_role("combobox").select_option("p")
    page.get_by_role("button", name="Remove from the text").click()
    made = area.input_value()
    assert tomllib.loads(made)["point"] == [{
        "name": "pier", "accelerometer": {"source": "serial:/dev/c", "unit": "m/s^2"},
        "camera": {"source": "rtsp://10.0.0.9/x", "direction": "y"},
    }]  # fmt: skip
    if AXE.is_file():
        assert violations(page) == []
    page.get_by_role("button", name="Check", exact=True).click()
    play.expect(page.locator(".changes li")).to_have_text(
        ["Start: pier.", "Stop: p.", "Take effect after a restart of midspan run: store."]
    )
    assert (tried, site.file.read_text()) == ([made], SITE)
    page.get_by_role("button", name="Save").click()
    play.expect(page.locator(".done")).to_have_text("reload done")
    assert site.file.read_text() == made
    site.file.write_text(SITE)


def test_a_fault_of_settings_stands_with_its_line(opened, site):
    site.file.write_text(SITE)
    page = opened("settings")
    area = page.get_by_label("SITE.toml")
    play.expect(area).to_have_value(SITE)
    area.fill(SITE + '[[point]]\nname = "q"\n[point.accelerometer]\nsource = "serial:/dev/b"\nunt = "m/s^2"\n')
    page.get_by_role("button", name="Save").click()
    play.expect(page.get_by_role("alert")).to_have_text(re.compile(r"^Line 16: .*unt: is not a known key"))
    chosen = "area => area.value.slice(area.selectionStart, area.selectionEnd)"
    assert area.evaluate(chosen) == 'unt = "m/s^2"'


def test_rows_that_are_predicted_or_not_final_are_drawn_as_such(opened, site):
    page = opened("")
    head = []

    def forward(socket):
        def message(text):
            socket.send(text)
            came = json.loads(text)
            if came.get("point") == "p" and "time" in came:
                head.append(came["time"][-1])
                later = [came["time"][-1] + k * 10_000_000 for k in range(1, 60)]
                values = {"displacement_mm": [0.2] * 59, "displacement_std_mm": [0.1] * 59}
                socket.send(json.dumps({"type": "head", "point": "p", "time": later, **values}))

        socket.connect_to_server().on_message(message)

    page.route_web_socket(re.compile("/live"), forward)
    page.reload()
    page.evaluate("location.hash = '#/point/p'")
    key = page.locator(".legend .key")
    play.expect(key.nth(0)).to_be_visible()
    play.expect(key.nth(2)).to_be_visible()
    play.expect(key.nth(1)).to_be_hidden()
    # The newest of them is the end of what is shown, and its words are those of its layer.
    until(lambda: head)
    box = page.locator(".u-over").bounding_box()
    page.mouse.move(box["x"] + box["width"] - 1, box["y"] + 50)
    play.expect(page.get_by_text(re.compile("0.200 mm, with the band 0.004 to 0.396, preliminary"))).to_be_visible()


def test_the_course_of_frequencies_is_asked_for_until_it_is_whole(opened, site):
    page, asked = opened("point/p"), []

    def answer(route):
        asked.append(route.request.url)
        count = 2 * len(asked)
        course = {"frequency_hz": [2.0 + 0.01 * k for k in range(count)], "frequency_std_hz": [0.002] * count,
                  "rms_mm": [1.0] * count}  # fmt: skip
        now_ns = time.time_ns()
        times = [now_ns - k * 10_800 * NANOSECONDS for k in range(count, 0, -1)]
        route.fulfill(json={"step_s": 10_800, "segment_s": 1200, "time": times, "modes": [course], "reason": "",
                            "complete": len(asked) == 2})  # fmt: skip

    page.route(re.compile("/frequencies"), answer)
    page.get_by_role("button", name="Natural frequencies over time").click()
    play.expect(page.get_by_text("2.0150 ± 0.0020 Hz, from 2.000 to 2.030, in 4 segments")).to_be_visible()
    play.expect(page.get_by_text("one segment of 20 minutes in each 3 h")).to_be_visible()
    assert len(asked) == 2
    if AXE.is_file():
        assert violations(page) == []


def test_an_infrared_picture_has_a_scale_of_temperatures(opened, site, stated):
    site.engine.shown = {"low": -3.25, "high": 18.5, "unit": "degC"}
    stated(camera={"source": "infrared"})
    try:
        page = opened("camera")
        play.expect(page.locator(".scale")).to_have_text("−3.3 °C  18.5 °C")
        play.expect(page.locator(".shades")).to_be_visible()
        if AXE.is_file():
            assert violations(page) == []
    finally:
        site.engine.shown = {"low": None, "high": None, "unit": ""}
    page.wait_for_timeout(600)
    page.get_by_role("button", name="New image").click()
    play.expect(page.locator(".scale")).to_be_hidden()


def test_a_radar_shows_its_range_profile_with_its_targets(opened, stated):
    stated(camera={"source": "radar"})
    page = opened("camera", viewport=PHONE)
    play.expect(page.get_by_role("heading", name="Radar")).to_be_visible()
    play.expect(page.locator(".chart canvas")).to_have_count(1)
    play.expect(page.locator("tbody tr td")).to_have_text(["1", "3.05 m", "31 dB"])
    until(lambda: any(traced(page)))
    if AXE.is_file():
        assert violations(page) == []


def test_a_change_is_shown_at_once_and_nothing_is_asked_for_meanwhile(opened, site, stated):
    page, asked = opened(), []
    card = page.locator(".card").first
    play.expect(card).to_have_attribute("data-state", "good")
    # What a view begins with.
    page.wait_for_load_state("networkidle")
    page.on("request", lambda request: asked.append(request.url))
    page.wait_for_timeout(3500)
    stated(point={"status": "coasting"})
    play.expect(card.locator(".words")).to_have_text(re.compile("^predicted"), timeout=1500)
    source = {"reason": "silent", "text": "Nothing comes."}
    stated(camera=source, ready=False)
    play.expect(card.locator(".why")).to_have_text("camera: Nothing comes.", timeout=1500)
    stated()
    play.expect(card).to_have_attribute("data-state", "good", timeout=1500)
    assert asked == []


def test_a_silence_without_an_open_alarm_is_listed_and_ended(opened, site):
    page, kept, ended = opened(""), [], []
    kept += [{"id": f"s{k}", "point": "p", "name": f"rule {k}", "no_data": False, "until": "2030-01-01T00:00:00Z",
              "owner": "anna", "reason": "gauge is loose"} for k in (1, 2)]  # fmt: skip

    def answer(route):
        if route.request.method == "DELETE":
            ended.append(route.request.url.rpartition("/")[2])
            kept.pop(0)
            return route.fulfill(json={"text": "The silence is ended."})
        return route.fulfill(json=kept)

    page.route(re.compile("/alarms/silences"), answer)
    page.evaluate("location.hash = '#/alarms'")
    part = page.locator("main section", has=page.get_by_role("heading", name="Silences without"))
    play.expect(part.locator("tbody tr")).to_have_count(2)
    play.expect(part).to_contain_text("gauge is loose")
    if AXE.is_file():
        assert violations(page) == []
    part.get_by_role("button", name="End the silence of p: rule 1").click()
    play.expect(page.get_by_text("The silence is ended.")).to_be_visible()
    play.expect(part.locator("tbody tr")).to_have_count(1)
    assert ended == ["s1"]
    part.get_by_role("button").click()
    play.expect(part).to_be_hidden()
