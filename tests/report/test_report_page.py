"""The report as a file: whole, self-contained, safe, complete, and small even for long records."""

import base64
import hashlib
import re
import time
from collections import Counter
from dataclasses import replace
from html import escape
from html.parser import HTMLParser

import numpy as np
import pytest
from embedded import chart, picture_bytes, without_pictures
from known_motion import SCALE_M_PER_PX, displacement_m, write_recording
from scipy.signal import lfilter

from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.engine.sensor_series import SensorSeries
from midspan.errors import UsageError
from midspan.notices import Notice
from midspan.recording.estimate import estimate
from midspan.recording.result import Result
from midspan.records import Estimate, Event, Innovation, Region, Source, TimeOffset, TimeSeries
from midspan.report.drawing import style
from midspan.report.figures import innovations, natural_frequencies
from midspan.report.material import gather
from midspan.report.report import report_html, write_report
from midspan.report.tables import candidates, with_std
from midspan.settings.load import validate
from midspan.settings.stored.calibration import Calibration, load_calibration


@pytest.fixture(name="camera_text", scope="module")
def page_of_camera(camera_report):
    return camera_report.read_text(encoding="utf-8")


@pytest.fixture(name="sensor_result", scope="module")
def result_of_displacement_sensor(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sensor")
    t = np.arange(0.0, 30.0, 0.2)
    noise = np.random.default_rng(3).standard_normal(len(t))
    rows = np.column_stack((t, 1e3 * displacement_m(t) + 0.2 * noise))
    np.savetxt(folder / "level.csv", rows, delimiter=",", header="time_s,level", comments="")
    return estimate(write_recording(folder, '[displacement]\nfile = "level.csv"\nvalue = "level"\nunit = "mm"\n'))


@pytest.fixture(name="sensor_text", scope="module")
def page_of_displacement_sensor(sensor_result):
    return report_html(sensor_result)


class Page(HTMLParser):
    """Elements, links and headings of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.sources, self.sections, self.pictures = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.tags.append(tag)
        self.sources += [attributes[key] for key in ("src", "href", "data", "action", "poster") if key in attributes]
        if tag == "section":
            self.sections.append(attributes["id"])
        if tag == "img":
            self.pictures.append((attributes["alt"], attributes["src"]))
            assert attributes["alt"]


def test_a_camera_recording_has_every_section_and_figure_in_their_order(camera_text):
    found = Page(camera_text)
    # No warnings and no events: no sections of them.
    expected = ["displacement", "band", "closer", "spectra", "calibration", "innovations", "camera", "numbers"]
    assert found.sections == expected
    assert [title for title, _ in found.pictures] == [
        "Displacement",
        "Error against the reference",
        "Fastest motion",
        "Spectra",
        "Scale factor and clock offset",
        "Innovations",
        "Region of interest",
        "Choice of the region",
        "Tracking",
    ]


def test_a_displacement_recording_has_no_camera_parts(sensor_text):
    found = Page(sensor_text)
    assert found.sections == ["displacement", "band", "closer", "spectra", "calibration", "innovations", "numbers"]
    titles = [title for title, _ in found.pictures]
    assert titles == ["Displacement", "Fastest motion", "Spectra", "Innovations"]
    coded = r"<style>.*?</style>|<script>.*?</script>"
    assert "px" not in re.sub(coded, "", without_pictures(sensor_text), flags=re.DOTALL)


def test_the_file_needs_nothing_from_elsewhere(camera_report, camera_text):
    assert [file.name for file in camera_report.parent.iterdir()] == ["report.html"]
    text = camera_text
    found = Page(text)
    assert found.sources
    assert all(source.startswith(("data:", "#")) for source in found.sources)
    assert "link" not in found.tags
    assert "iframe" not in found.tags
    assert found.tags.count("script") == 1
    assert not re.search(r"https?://|@import|url\(|fetch\(|XMLHttpRequest|import\(", without_pictures(text))
    # Also inside the pictures nothing may be loaded: an SVG's references are fragments or data.
    for _, source in found.pictures:
        inner = picture_bytes(source)
        links = re.findall(rb'(?:xlink:href|href|src)="([^"]*)"', inner) + re.findall(rb"url\(([^)]*)\)", inner)
        assert all(link.startswith((b"#", b"data:")) for link in links)
        assert b"<script" not in inner


def test_a_malicious_name_stays_text(camera_text):
    assert "<script>alert" not in camera_text
    assert "bridge &lt;script&gt;alert(&quot;x&quot;)&lt;/script&gt; &amp; &#x27;co&#x27;" in camera_text


def test_cards_and_tables_say_what_result_and_comparison_say(camera_text, camera_result):
    values = dict(re.findall(r"<div class=label>(.*?)</div><div class=value>(.*?)</div>", camera_text))
    rows = dict(re.findall(r"<tr><th>([^<]*)</th><td>(.*?)</td></tr>", camera_text))
    figures = camera_result.figures()
    assert len(values) == 6
    assert values["Maximum"] == f"{figures['largest_mm']:+.4g} mm"
    assert values["Minimum"] == f"{figures['smallest_mm']:+.4g} mm"
    # The scale is negative: what is positive is up in the image, whose rows count downwards.
    assert rows["direction"].startswith("accel: ")
    assert "the target then moves up in the image" in rows["direction"]
    scale, std = values["Scale of the camera"].removesuffix(" mm/px").split(" ± ")
    assert abs(float(scale) - 1e3 * SCALE_M_PER_PX) < 4.0 * float(std)
    # The true motion's peak, and four times the noise of a sample on top of it.
    fine = displacement_m(np.arange(0.0, 30.0, 1e-3))
    peak_g = np.max(np.abs(np.gradient(np.gradient(fine, 1e-3), 1e-3))) / 9.80665
    printed_g = float(rows["peak acceleration without bias"].removesuffix(" g"))
    assert printed_g == pytest.approx(peak_g, abs=4 * 2e-3 / 9.8 + 0.005 * peak_g)
    # The truth is known: the error that is printed is the distance to it, found here without the room's own metrics.
    error = camera_result.estimate.displacement_m - displacement_m(camera_result.time_s)
    printed = float(rows["RMSE as recorded"].split(" mm")[0])
    # Three digits are printed.
    assert printed == pytest.approx(1e3 * np.sqrt(np.mean(error**2)), rel=0.01)
    assert float(rows["RMSE zero removed"].split(" mm")[0]) == pytest.approx(1e3 * np.std(error), rel=0.01)


@pytest.mark.usefixtures("undrawn")
def test_the_verdict_stands_first_and_no_path_anywhere(camera_text, camera_result):
    head = camera_text.split("<section")[0]
    assert escape(camera_result.verdict) in head
    # The result is right: its error without the zero is its own part of the band, ± a third.
    differs = re.search(r"Error against the reference without its zero: (\S+) mm rms, ([\d.]+).% inside", head)
    assert float(differs[1]) == pytest.approx(camera_result.figures()["median_own_std_mm"], rel=0.34)
    assert float(differs[2]) > 85.0
    folder = camera_result.file.resolve().parent
    assert str(folder) not in camera_text
    # As two files on the command line may be given.
    sensor = camera_result.settings.accelerometer.model_copy(update={"file": str(folder / "accel.csv")})
    settings = camera_result.settings.model_copy(update={"accelerometer": sensor})
    text = report_html(replace(camera_result, settings=settings))
    assert "<tr><th>accelerometer.file</th><td>accel.csv</td></tr>" in text
    assert str(folder) not in text


@pytest.mark.usefixtures("undrawn")
def test_three_warnings_stand_open_the_worst_first_and_the_rest_on_a_click(camera_result):
    codes = ("tilt", "outliers", "lens", "frozen", "unit-doubtful")
    warned = replace(camera_result, warnings=tuple(Notice(code, f"camera: {code}.") for code in codes))
    text = report_html(warned)
    found = text.split('<section id="warnings">')[1].split("</section>")[0]
    opened, closed = found.split("<details>")
    assert re.findall(r"<code>(.*?)</code>", opened) == ["unit-doubtful", "outliers", "lens"]
    assert re.findall(r"<code>(.*?)</code>", closed) == ["frozen", "tilt"]
    assert "<summary>2 more</summary>" in closed
    assert '<p class="verdict serious">Do not use this displacement' in text


@pytest.mark.usefixtures("undrawn")
def test_a_calibration_from_a_file_is_shown_with_what_the_recording_itself_says(camera, camera_result, tmp_path):
    camera_result.calibration.save(tmp_path / "calibration.json")
    result = estimate(camera, load_calibration(tmp_path / "calibration.json"))
    text = report_html(result)
    assert "Scale factor in the calibration file" in text
    assert "Scale factor and clock offset" in [title for title, _ in Page(text).pictures]
    here, std = re.search(r"from this recording: (\S+) ± (\S+) mm/px", text).groups()
    # Of the same frames, tracked once more with the filter's prediction.
    assert abs(float(here) - 1e3 * SCALE_M_PER_PX) < 4.0 * float(std)
    # Without the recording's files nothing can be drawn.
    alone = report_html(replace(result, file=None))
    assert "contains values, not the measurements" in alone
    assert "The region was given by the calibration file" in text


@pytest.mark.usefixtures("undrawn")
def test_a_reference_of_another_time_is_reported_not_raised(camera_result):
    reference = TimeSeries(np.arange(10, dtype=np.int64) * 10**9 + 10**15, np.arange(10.0))
    text = report_html(camera_result, reference)
    assert "The reference could not be used. Result and reference have no instants in common" in text


def test_the_settings_tell_what_was_taken_for_those_that_were_left_out(camera_text, camera_result):
    settings = camera_text.split("<h3>Settings</h3>")[1]
    found = dict(re.findall(r"<tr><th>([\w.]*)</th><td>(.*?)</td></tr>", settings))
    region = camera_result.calibration.camera.region
    assert found["camera.reference"] == "first (default)"
    assert found["camera.roi"] == f"{region.x}, {region.y}, {region.width}, {region.height} (chosen)"


def test_the_embedded_rows_are_the_result(camera_text, camera_result):
    layout, columns = chart(camera_text)
    lines = {line["name"]: line for line in layout["lines"]}
    assert list(lines) == ["displacement", "reference", "camera", "velocity", "acceleration"]
    main = lines["displacement"]
    quantum, own_std_mm = layout["columns"][main["value"]]["quantum"], camera_result.figures()["median_own_std_mm"]
    # Rounding to a sixteenth of a row's own standard deviation widens it by (1/16)²/24 = 0.02 %.
    assert quantum <= own_std_mm / 16
    np.testing.assert_allclose(columns[main["value"]], camera_result.displacement_mm, atol=0.51 * quantum)
    np.testing.assert_allclose(columns[main["std"]], camera_result.displacement_std_mm, rtol=2e-3)
    np.testing.assert_allclose(columns[main["time"]], camera_result.time_s - camera_result.time_s[0], atol=1e-6)
    np.testing.assert_array_equal(columns[layout["status"]], camera_result.estimate.status)
    felt = camera_result.recording.acceleration
    shown = np.interp(
        felt.time_ns / 1e9, layout["first"] + columns[main["time"]], columns[lines["acceleration"]["value"]]
    )
    inside = (felt.time_ns >= camera_result.estimate.time_ns[0]) & (felt.time_ns <= camera_result.estimate.time_ns[-1])
    # A quarter of the noise of a sample is the finest that is kept.
    noise = camera_result.calibration.noise_std_m_s2
    np.testing.assert_allclose(shown[inside], felt.value[inside], atol=0.13 * noise)


def long_result(count, events=0):
    """A made-up result of a displacement sensor with `count` rows at 100 Hz, a peak in one single row."""
    time_ns = np.arange(count, dtype=np.int64) * 10_000_000 + 1_750_000_000 * 10**9
    t = np.arange(count) / 100.0
    value = 1e-3 * np.sin(2 * np.pi * 1.1 * t) * np.sin(2 * np.pi * t / 977.0)
    value[count // 3] = 7.5e-3
    status = np.zeros(count, dtype=np.uint8)
    status[count // 2 : count // 2 + 500] = 1
    block = Estimate(
        time_ns, value, np.full(count, 1e-10), np.gradient(value, 0.01), np.full(count, 4, np.uint8), status
    )
    met = slice(0, count, 10)
    noise = 1e-5 * np.random.default_rng(4).standard_normal(len(time_ns[met]))
    innovation = Innovation(time_ns[met], noise, np.full(len(noise), 1e-10), np.zeros(len(noise), dtype=np.int8))
    settings = validate({"accelerometer": {"file": "a.csv"}, "displacement": {"file": "d.csv"}}, "test")
    sensor = SensorSeries(
        "displacement", Source.DISPLACEMENT, time_ns[met], value[met] + noise, np.full(len(noise), 1e-5)
    )
    reported = tuple(Event(int(time_ns[i]), "gap", f"event number {i}.") for i in range(events))
    calibration = Calibration(1e-3, 0.0, displacement=DisplacementCalibration(1e-5, TimeOffset(0.0, np.inf)))
    return Result(block, calibration, settings, "smoother", innovation, reported, (), measured=(sensor,), name="long")


def written_in_s(path, rows):
    """Processor time of a report of this many rows with a reference, s."""
    result = long_result(rows, events=120)
    reference = TimeSeries(result.estimate.time_ns, result.estimate.displacement_m + 1e-6)
    start = time.process_time()
    write_report(result, path, reference)
    return time.process_time() - start


def test_a_long_record_stays_small_quick_and_keeps_its_peak(tmp_path):
    path = tmp_path / "long.html"
    short_s = written_in_s(tmp_path / "short.html", 50_000)
    # Twenty times the rows take twenty times the processor time at most, however slow the machine: about three times,
    # as the figures are drawn of thinned rows; what grows with the square would take 400 times.
    assert written_in_s(path, 1_000_000) < 20.0 * short_s
    assert path.stat().st_size < 6e6
    text = path.read_text(encoding="utf-8")
    layout, columns = chart(text)
    assert columns[layout["lines"][0]["value"]].max() == pytest.approx(7.5, abs=layout["columns"][2]["quantum"])
    assert "time after 2025-06-15 15:06:40 UTC (s)" in text


def shown_events(result):
    """Outside the JSON: summaries of what is aliased, and how often each event stands in a table."""
    text = report_html(result).split("Settings, calibration and events as JSON")[0]
    rows = re.findall(r"<td>event number (\d+)\.</td>", text)
    return re.findall(r"<summary>([^<]*)</summary>", text), Counter(int(number) for number in rows)


@pytest.mark.usefixtures("undrawn")
def test_many_events_are_all_there_folded_by_their_kinds_with_counts():
    result = long_result(3000, events=120)
    of_two_kinds = tuple(replace(e, kind="switch") if k % 3 == 0 else e for k, e in enumerate(result.events))
    collapsible, rows = shown_events(replace(result, events=of_two_kinds))
    assert [line.split(",")[0] for line in collapsible] == ["switch: 40", "gap: 80", "all 120 in order of time"]
    # The clock of this record begins with its first row, 10 ms a row; the last switch is event 117.
    assert collapsible[0] == "switch: 40, from 0.000 to 1.170 s"
    assert rows == dict.fromkeys(range(120), 2)


@pytest.mark.usefixtures("undrawn")
def test_a_few_events_stand_in_one_table():
    collapsible, rows = shown_events(long_result(3000, events=12))
    assert not collapsible
    assert rows == dict.fromkeys(range(12), 1)


def test_a_structure_at_rest_and_a_filter_that_rejected_all_still_have_a_report():
    result = long_result(3000)
    rest = replace(result.estimate, displacement_m=np.zeros(3000), velocity_m_s=np.zeros(3000))
    rejected = replace(result.innovation, verdict=np.ones(300, dtype=np.int8))
    found = Page(
        report_html(replace(result, estimate=rest, innovation=rejected), TimeSeries(rest.time_ns, np.zeros(3000)))
    )
    assert "innovations" in found.sections
    assert "Spectra" in [title for title, _ in found.pictures]


def test_pictures_are_drawings_that_follow_the_colour_scheme(camera_text):
    for _, source in Page(camera_text).pictures:
        inner = picture_bytes(source).decode()
        assert inner.startswith("<svg")
        assert "prefers-color-scheme:dark" in inner
        # No sheet lies under the drawing.
        assert "fill: #ffffff" not in inner.split('id="axes_1"')[0]


@pytest.mark.usefixtures("undrawn")
def test_a_report_that_cannot_be_written_leaves_nothing(sensor_result, tmp_path):
    with pytest.raises(UsageError, match="does not exist"):
        write_report(sensor_result, tmp_path / "missing" / "report.html")
    (tmp_path / "folder.html").mkdir()
    with pytest.raises(UsageError, match="cannot be written"):
        write_report(sensor_result, tmp_path / "folder.html")
    assert [file.name for file in tmp_path.iterdir()] == ["folder.html"]


def test_the_users_plot_settings_stay_as_they_were(sensor_result, tmp_path):
    import matplotlib

    before = dict(matplotlib.rcParams)
    write_report(sensor_result, tmp_path / "report.html")
    assert dict(matplotlib.rcParams) == before


def test_the_policy_lets_nothing_in_but_the_page_s_own_script_and_style(camera_text):
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', camera_text).group(1)
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    assert rules["default-src"] == "'none'"
    for kind, tag in (("style-src", "style"), ("script-src", "script")):
        inner = re.search(f"<{tag}>(.*?)</{tag}>", camera_text, re.DOTALL).group(1)
        own = base64.b64encode(hashlib.sha256(inner.encode()).digest()).decode()
        assert rules[kind] == f"'sha256-{own}'"
    assert not re.search(r"<[^>]*\s(style|on\w+)=", without_pictures(camera_text))


@pytest.mark.usefixtures("undrawn")
def test_what_is_warned_of_stands_once(camera_result):
    line = "The scale factor is uncertain for a made-up reason."
    calibration = replace(camera_result.calibration, warnings=(line,))
    text = report_html(replace(camera_result, calibration=calibration, warnings=(line,)))
    assert text.split("Settings, calibration and events as JSON")[0].count(line) == 1


def test_innovations_beyond_the_axis_are_counted():
    result = long_result(3000)
    value = result.innovation.value_m.copy()
    value[[7, 70, 140]] = 5e-4  # 50 standard deviations
    with style():
        figure = drawn_innovations(replace(result, innovation=replace(result.innovation, value_m=value)))
    assert "3 beyond ±6 median σ, drawn at the border" in figure


def drawn_innovations(result):
    """The labels of the figure, as texts."""
    import matplotlib

    with matplotlib.rc_context({"svg.fonttype": "none"}):
        return innovations(gather(result, None)).data.decode()


# Frequency in Hz, damping ratio, rms in mm.
MODES = ((1.9, 0.012, 1.0), (5.2, 0.007, 0.2))


@pytest.mark.usefixtures("undrawn")
def test_natural_frequencies_are_those_of_two_oscillators():
    """Two modes of known frequency and damping under white force lie within four of the σ given."""
    rate, count = 100.0, 60_000
    rng, value = np.random.default_rng(8), np.zeros(60_000)
    for frequency, damping, size in MODES:
        pole = np.exp(2 * np.pi * frequency / rate * (-damping + 1j * np.sqrt(1 - damping**2)))
        one = lfilter([1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], rng.standard_normal(count))
        value += size * 1e-3 * one / one.std()
    result = long_result(count)
    result = replace(result, estimate=replace(result.estimate, displacement_m=value))
    found = natural_frequencies(gather(result, None))
    assert len(found) == 2
    for mode, (frequency, damping, _) in zip(found, MODES, strict=True):
        assert abs(mode.frequency_hz - frequency) < 4.0 * mode.frequency_std_hz
        assert abs(mode.damping - damping) < 4.0 * mode.damping_std
    text = report_html(result)
    for mode in found:
        assert f"<th>{with_std(mode.frequency_hz, mode.frequency_std_hz, 'Hz')}</th>" in text


def test_a_place_that_hardly_moves_is_said_to_be_partly_static(camera_result):
    choice = camera_result.cameras[0].choice
    own = replace(choice.candidates[0], region=choice.region, scale_m_per_px=SCALE_M_PER_PX)
    others = [replace(own, region=Region(k, 0, 24, 24), scale_m_per_px=k * SCALE_M_PER_PX) for k in (1, 5)]
    rows = candidates(replace(choice, candidates=(own, *others)))
    assert ["partly static" in row[-1] for row in rows] == [False, False, True]
