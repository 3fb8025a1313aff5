"""The report's section on cameras by day and by night, and the temperature range."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import midspan
from midspan.records import Event, Source
from midspan.report import infrared_figures, tables
from midspan.report.figures import innovations_of
from midspan.report.material import gather
from midspan.report.report import report_html
from midspan.report.sections import cameras
from midspan.simulate.day.infrared import DayCourse
from midspan.simulate.scenarios.table import SCENARIOS
from midspan.simulate.scenarios.write import write
from midspan.thermal.limits import Limits
from midspan.thermal.temperature_range import RangeSurface

# Of a day of 400 s the first 20 s are filmed: light and temperatures hardly change, both cameras see all the time.
DAY_S, FILMED_S = 400.0, 20.0


@pytest.fixture(name="result", scope="module")
def result_of_a_short_noon(tmp_path_factory):
    """Twenty seconds from noon on with two small cameras."""
    with pytest.MonkeyPatch.context() as patch:
        base = SCENARIOS["day-and-night"]
        day = replace(
            base.day,
            sky=replace(base.day.sky, length_s=DAY_S, fog=(), rain=()),
            camera=replace(base.day.camera, size_px=(96, 112)),
            infrared=replace(base.day.infrared, size_px=(96, 112)),
            course=DayCourse(14.0, 6.0, DAY_S),
            thermal=replace(base.day.thermal, shutters_s=(9.0,)),
            bodies=(),
            cars=replace(base.day.cars, starts_s=()),
            camera_roi=(24, 20, 60, 56),
            infrared_roi=(24, 20, 60, 56),
        )
        short = replace(base, duration_s=FILMED_S, day=day, window_s=(0.0, 18.0))
        patch.setitem(SCENARIOS, "day-and-night", short)
        folder = write("day-and-night", tmp_path_factory.mktemp("day") / "site", seed=3)
    return midspan.estimate(midspan.open_recording(folder))


def section(text, name="cameras"):
    return re.search(rf'<section id="{name}">.*?</section>', text, re.DOTALL)[0]


def test_the_section_shows_both_cameras(result):
    text = section(report_html(result, result.recording.reference))
    assert re.findall(r'<img alt="([^"]*)"', text) == ["Cameras over the record"]


@pytest.mark.usefixtures("undrawn")
def test_each_camera_has_its_own_frame_tracking_and_calibration(result):
    text = report_html(result)
    for name in ("camera", "infrared"):
        assert re.findall(r'<img alt="([^"]*)"', section(text, name)) == ["Region of interest", "Tracking"]
    of_both = ["Scale factor and clock offset", "Scale factor and clock offset of the infrared"]
    assert re.findall(r'<img alt="([^"]*)"', section(text, "calibration")) == of_both
    for camera in (result.calibration.camera, result.calibration.infrared):
        # The slope that is drawn is the inverse of the scale factor, to the few digits that both are shown with.
        slope = camera.diagnostics.search.fit.ratio
        assert slope * camera.scale.value_m_per_px == pytest.approx(1.0, rel=0.01)


def test_each_cameras_innovations_are_drawn_with_what_is_expected_of_it(result):
    found = dict(innovations_of(gather(result, None)))
    assert list(found) == ["camera", "infrared"]
    for measured in result.measured:
        assert set(found[measured.sensor].time_ns) <= set(measured.time_ns)
    rows = result.estimate.time_ns
    shown = (result.innovation.time_ns >= rows[0]) & (result.innovation.time_ns <= rows[-1])
    assert sum(len(one.time_ns) for one in found.values()) == np.count_nonzero(shown)


def test_the_settings_name_the_reference_rule_of_both_cameras(result):
    found = dict(tables.settings(gather(result, None)))
    assert found["camera.reference"] == "first (default)"
    assert found["infrared.reference"] == "key-frames (default)"


def test_the_calibration_tells_the_scale_factor_and_clock_of_both_cameras(result):
    found = dict(tables.calibrated(result.calibration))
    for sensor, camera in (("camera", result.calibration.camera), ("infrared", result.calibration.infrared)):
        assert float(found[f"{sensor}: scale factor"].split()[0]) == pytest.approx(
            1e3 * camera.scale.value_m_per_px, 1e-5
        )
        assert f"{sensor}: clock offset" in found


def test_both_cameras_measurements_are_drawn_on_the_results_zero(result):
    measured = gather(result, None).measured
    assert [one.name for one in measured] == ["camera", "infrared"]
    for one in measured:
        fused = np.interp(one.time_ns / 1e9, result.time_s, result.displacement_mm)
        # Moved by the median of the difference, so that half of it lies on either side.
        assert np.nanmedian(one.value_mm - fused) == pytest.approx(0.0, abs=1e-9)
    # Frames at 4 Hz from 0.137 s on and from -0.023 s on, inside the accelerometer's 20 s.
    assert [len(one.time_ns) for one in measured] == pytest.approx([79, 80], abs=1)


def test_the_strip_tells_the_share_of_each_source(result):
    rows = result.estimate.source
    with_text = infrared_figures.shares(rows)
    assert sum(share for _, share in with_text) == pytest.approx(1.0)
    assert dict(with_text)[Source.CAMERA] == pytest.approx(float(np.mean(rows == Source.CAMERA)))
    assert Source.RADAR not in dict(with_text)


def test_events_are_placed_on_the_accelerometers_clock(result):
    material = gather(result, None)
    infrared = next(camera for camera in result.cameras if camera.source is Source.INFRARED)
    shutters = [event for event in infrared.events if event.kind == "shutter"]
    assert len(shutters) == 1
    # The shutter closes at 9.0 s of true time; the first frame that shows it comes within a quarter of a second.
    place = infrared_figures.places(material, shutters)[0]
    assert 9.0 <= place <= 9.25


def test_what_stood_in_front_is_shaded_from_hidden_to_seen_and_to_the_end_where_it_stays(result):
    material = gather(result, None)
    reported = ((4.0, "hidden"), (5.0, "reference"), (6.5, "seen"), (15.0, "hidden"))
    events = [Event(round(1e9 * at), kind, "") for at, kind in reported]
    found = infrared_figures.hidden_spans(material, SimpleNamespace(events=events))
    last = float(result.time_s[-1])
    assert np.allclose(found, [(4.0, 2.5), (15.0, last - 15.0)], atol=1e-6)


def test_the_segments_of_the_sources_cover_the_record_once(result):
    source = np.where((result.time_s >= 6.0) & (result.time_s < 9.0), Source.INFRARED, Source.CAMERA).astype(np.uint8)
    material = gather(replace(result, estimate=replace(result.estimate, source=source)), None)
    found = infrared_figures.source_spans(material)
    step = float(np.median(np.diff(result.time_s)))
    # A segment reaches from its first row to the row after it: one step of either end is open.
    assert np.allclose(found[Source.INFRARED], [(6.0, 3.0)], atol=1.5 * step)
    assert len(found[Source.CAMERA]) == 2
    covered = sum(length for segments in found.values() for _, length in segments)
    assert covered == pytest.approx(float(result.time_s[-1] - result.time_s[0]), abs=2.0 * step)


@pytest.mark.parametrize(
    ("values", "texts"),
    [
        ([15.0, 20.0], ["15.00", "20.00"]),
        ([14.98, 15.01], ["14.98", "15.01"]),
        ([25.2121, 25.2174], ["25.21", "25.22"]),
        ([25.2121, 25.2134], ["25.212", "25.213"]),
        ([25.0, 25.0], ["25.00", "25.00"]),
    ],
)
def test_limits_of_temperature_have_digits_that_tell_them_apart(values, texts):
    assert infrared_figures.reported_apart(np.array(values)) == texts


def surface(best):
    """Four ranges, the lower limit falling and the upper one rising, one of them lost."""
    low, high = np.array([23.0, 16.0]), np.array([28.0, 33.0])
    error = np.array([[0.05, 0.06], [0.04, np.nan]])
    return RangeSurface(low, high, error, np.isnan(error).astype(float), best)


@pytest.mark.parametrize(
    ("limits", "place"),
    [((16.0, 28.0), (0, 0)), ((23.0, 28.0), (1, 0)), ((23.0, 33.0), (1, 1)), ((16.0, 33.0), (0, 1))],
)
def test_the_range_chosen_is_marked_where_its_limits_are(limits, place):
    assert infrared_figures.chosen_place(surface(Limits(*limits))) == place


def test_an_optimised_range_is_shown_with_its_limits(result):
    camera, infrared = result.cameras
    searched = replace(infrared, range_surface=surface(Limits(16.0, 28.0)))
    text = cameras(gather(replace(result, cameras=(camera, searched)), None))
    assert "Temperature range" in text
    assert "16.00 to 28.00 °C" in text


@pytest.mark.usefixtures("undrawn")
def test_one_camera_of_light_with_its_first_frame_has_no_such_section(result):
    alone = replace(result, cameras=result.cameras[:1], events=())
    assert cameras(gather(alone, None)) == ""
    # A reference frame that changed is worth showing.
    events = tuple(replace(event, kind="reference") for event in result.events[:1])
    assert events
    assert "Cameras over the record" in cameras(gather(replace(alone, events=events), None))
