"""The report as a file: whole, self-contained, safe, complete, and small even for long records."""

import base64
import io
import json
import re
import time
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from scipy.ndimage import fourier_shift, gaussian_filter

from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.engine.sensor_series import SensorSeries
from midspan.errors import UsageError
from midspan.recording.estimate import estimate
from midspan.recording.result import Result
from midspan.recording.streams.recording import open_recording
from midspan.records import Estimate, Event, Innovation, Source, TimeOffset, TimeSeries
from midspan.report.report import report_html, write_report
from midspan.settings.load import validate
from midspan.settings.stored.calibration import Calibration
from midspan.settings.stored.calibration_file import load_calibration

NASTY = "bridge <script>alert(\"x\")</script> & 'co'"
FREQUENCIES, AMPLITUDES_M = (0.31, 1.37, 2.83), (2e-3, 1.5e-3, 0.6e-3)
SCALE_M_PER_PX = -1.5e-3


def displacement_m(t):
    # A smooth start: a kink would be an impulse of acceleration, which samples do not hold.
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.clip((t - 1.0) / 2.0, 0.0, 1.0))
    return ramp * sum(a * np.sin(2 * np.pi * f * t) for f, a in zip(FREQUENCIES, AMPLITUDES_M, strict=True))


def write_recording(folder, sections):
    """Accelerometer and truth of a known motion, and the settings' further sections."""
    fine = np.arange(0.0, 30.0, 1e-3)
    t = fine[::10]
    acceleration = np.gradient(np.gradient(displacement_m(fine), 1e-3), 1e-3)[::10]
    rng = np.random.default_rng(1)
    rows = np.column_stack((t, acceleration + 2e-3 * rng.standard_normal(len(t))))
    np.savetxt(folder / "accel.csv", rows, delimiter=",", header="time_s,accel", comments="")
    truth = np.column_stack((t, 1e3 * displacement_m(t)))
    np.savetxt(folder / "truth.csv", truth, delimiter=",", header="time_s,displacement_mm", comments="")
    text = (
        f"name = {json.dumps(NASTY)}\n"
        '[accelerometer]\nfile = "accel.csv"\ntime = "time_s"\nvalue = "accel"\nunit = "m/s^2"\n'
        '[reference]\nfile = "truth.csv"\ntime = "time_s"\nvalue = "displacement_mm"\nunit = "mm"\n'
    )
    (folder / "recording.toml").write_text(text + sections)
    return open_recording(folder)


@pytest.fixture(name="camera", scope="module")
def camera_recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("camera")
    rng = np.random.default_rng(2)
    scene = gaussian_filter(rng.standard_normal((128, 160)), 1.5, mode="wrap")
    spectrum = np.fft.fft2(120 + 45 * scene / scene.std())
    t = np.arange(0.0, 30.0, 0.1)
    shifts = displacement_m(t) / SCALE_M_PER_PX
    frames = np.stack([np.fft.ifft2(fourier_shift(spectrum, (s, 0.0))).real for s in shifts])
    np.save(folder / "camera.npy", np.clip(frames + rng.standard_normal(frames.shape), 0, 255).astype(np.uint8))
    return write_recording(folder, '[camera]\nfile = "camera.npy"\nrate_hz = 10.0\ndirection = "y"\n')


@pytest.fixture(name="camera_result", scope="module")
def result_of_camera(camera):
    return estimate(camera)


@pytest.fixture(name="camera_text", scope="module")
def page_of_camera(camera, camera_result):
    return report_html(camera_result, camera.reference)


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


def picture_bytes(source):
    head, data = source.split(",", 1)
    assert head in ("data:image/svg+xml;base64", "data:image/png;base64")
    return base64.b64decode(data)


def test_a_camera_recording_has_every_section_and_figure_in_their_order(camera_text):
    found = Page(camera_text)
    expected = ["warnings", "displacement", "spectra", "calibration", "innovations", "camera", "numbers"]
    assert found.sections == expected
    assert [title for title, _ in found.pictures] == [
        "Displacement",
        "Error against the reference",
        "The liveliest seconds",
        "Spectra",
        "Scale factor and clock offset",
        "Innovations",
        "Region of interest",
        "Choice of the region",
        "Tracking",
    ]


def test_a_displacement_recording_has_no_camera_parts(sensor_text):
    found = Page(sensor_text)
    assert found.sections == ["warnings", "displacement", "spectra", "calibration", "innovations", "numbers"]
    titles = [title for title, _ in found.pictures]
    assert titles == ["Displacement", "The liveliest seconds", "Spectra", "Innovations"]
    coded = r'<style>.*?</style>|<script>.*?</script>|base64,[^"]*|data-history="[^"]*"'
    assert "px" not in re.sub(coded, "", sensor_text, flags=re.DOTALL)


def test_the_file_needs_nothing_from_elsewhere(camera, camera_result, tmp_path):
    path = write_report(camera_result, tmp_path / "report.html", camera.reference)
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]
    text = path.read_text(encoding="utf-8")
    found = Page(text)
    assert found.sources
    assert all(source.startswith("data:") for source in found.sources)
    assert "link" not in found.tags
    assert "iframe" not in found.tags
    assert found.tags.count("script") == 1
    assert not re.search(r"https?://|@import|url\(|fetch\(|XMLHttpRequest|import\(", text)
    # Also inside the pictures nothing may be loaded: an SVG's references are fragments or data.
    for _, source in found.pictures:
        inner = picture_bytes(source)
        if inner.startswith(b"<?xml"):
            links = re.findall(rb'(?:xlink:href|href|src)="([^"]*)"', inner)
            assert all(link.startswith((b"#", b"data:")) for link in links)
            assert b"<script" not in inner


def test_a_malicious_name_stays_text(camera_text):
    assert "<script>alert" not in camera_text
    assert "bridge &lt;script&gt;alert(&quot;x&quot;)&lt;/script&gt; &amp; &#x27;co&#x27;" in camera_text


def test_the_cards_say_what_result_and_comparison_say(camera_text, camera_result):
    values = dict(re.findall(r"<div class=label>(.*?)</div><div class=value>(.*?)</div>", camera_text))
    figures = camera_result.figures()
    assert values["Largest displacement"] == f"{figures['largest_mm']:+.4g} mm"
    assert values["Smallest displacement"] == f"{figures['smallest_mm']:+.4g} mm"
    # The truth is known: the error that is printed is the distance to it, found here without the room's own metrics.
    error = camera_result.estimate.displacement_m - displacement_m(camera_result.time_s)
    printed = float(values["RMSE against reference"].removesuffix(" mm"))
    # Three digits are printed.
    assert printed == pytest.approx(1e3 * np.sqrt(np.mean(error**2)), rel=0.01)


def test_a_calibration_from_a_file_says_that_it_has_no_figures(camera, camera_result, tmp_path):
    camera_result.calibration.save(tmp_path / "calibration.json")
    result = estimate(camera, load_calibration(tmp_path / "calibration.json"))
    text = report_html(result)
    assert "came from a file" in text
    assert "Scale factor and clock offset" not in [title for title, _ in Page(text).pictures]
    assert "The region was given" in text


def test_a_reference_of_another_time_is_told_not_raised(camera_result):
    reference = TimeSeries(np.arange(10, dtype=np.int64) * 10**9 + 10**15, np.arange(10.0))
    text = report_html(camera_result, reference)
    assert "The reference could not be used. Result and reference have no instants in common" in text


def test_the_settings_tell_what_was_taken_for_those_that_were_left_out(camera_text, camera_result):
    settings = camera_text.split("<h3>Settings</h3>")[1]
    found = dict(re.findall(r"<tr><th>([\w.]*)</th><td>(.*?)</td></tr>", settings))
    region = camera_result.calibration.camera.region
    assert found["camera.reference"] == "first (default)"
    assert found["camera.roi"] == f"{region.x}, {region.y}, {region.width}, {region.height} (chosen)"


def test_the_embedded_history_is_the_result(camera_text, camera_result):
    data = re.search(r'data-history="([^"]*)"', camera_text).group(1)
    layout = json.loads(re.search(r'data-layout="([^"]*)"', camera_text).group(1).replace("&quot;", '"'))
    columns = np.frombuffer(base64.b64decode(data), dtype="<f4").reshape(len(layout["names"]), layout["rows"])
    low = columns[layout["names"].index("low")]
    # float32 keeps 24 bits: 6e-8 of some millimetres.
    np.testing.assert_allclose(low, camera_result.displacement_mm, atol=1e-6)


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
    told = tuple(Event(int(time_ns[i]), "gap", f"event number {i}.") for i in range(events))
    calibration = Calibration(1e-3, 0.0, displacement=DisplacementCalibration(1e-5, TimeOffset(0.0, np.inf)))
    return Result(block, calibration, settings, "smoother", innovation, told, (), measured=(sensor,), name="long")


def written_in_s(path, rows):
    """Processor time of a report of so many rows with a reference, s."""
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
    data = base64.b64decode(re.search(r'data-history="([^"]*)"', text).group(1))
    # The single high row is in the thinned columns.
    assert np.nanmax(np.frombuffer(data, dtype="<f4").reshape(-1, 10_000)[1:3]) == pytest.approx(7.5, rel=1e-6)
    assert "time after 2025-06-15 15:06:40 UTC (s)" in text


def shown_events(result):
    """Outside the JSON: summaries of what is folded, and how often each event stands in a table."""
    text = report_html(result).split("Settings, calibration and events as JSON")[0]
    rows = re.findall(r"<td>event number (\d+)\.</td>", text)
    return re.findall(r"<summary>(.*?)</summary>", text), Counter(int(number) for number in rows)


def test_many_events_are_all_there_folded_by_their_kinds_with_counts():
    result = long_result(3000, events=120)
    of_two_kinds = tuple(replace(e, kind="switch") if k % 3 == 0 else e for k, e in enumerate(result.events))
    folded, rows = shown_events(replace(result, events=of_two_kinds))
    assert [line.split(",")[0] for line in folded] == ["switch: 40", "gap: 80", "all 120 in the order of time"]
    # The clock of this record begins with its first row, 10 ms a row; the last switch is event 117.
    assert folded[0] == "switch: 40, from 0.000 to 1.170 s"
    assert rows == dict.fromkeys(range(120), 2)


def test_a_few_events_stand_open_in_one_table():
    folded, rows = shown_events(long_result(3000, events=12))
    assert not folded
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


def test_pictures_are_drawings_in_lines_or_readable_dots(sensor_text):
    from matplotlib.image import imread

    for _, source in Page(sensor_text).pictures:
        inner = picture_bytes(source)
        if inner.startswith(b"\x89PNG"):
            assert imread(io.BytesIO(inner)).shape[1] == 1440
        else:
            assert b"<svg" in inner[:500]


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
