"""What people are shown of a source: temperatures of a picture, a radar's range profile."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from midspan.engine.camera import Target as Named
from midspan.engine.sensors import CameraSensor, Seen
from midspan.radar.target import Target
from midspan.records import Frame, PixelTranslation, RangeFrame, Region, Status
from midspan.service.camera_process import pictured
from midspan.service.commands import profile_of, shown_range, tracked
from midspan.service.journal import Journal


def test_a_picture_of_counts_says_its_temperatures_and_one_of_grey_levels_nothing():
    celsius = np.linspace(-5.0, 25.0, 100 * 80).reshape(80, 100)
    # 1 % of each end is left to specks: 0.3 K of 30.
    counts = pictured(Frame(1, np.round((celsius + 273.15) / 0.04).astype(np.uint16), 0))
    found = shown_range(counts, (0.04, 0.0))
    assert (found["low"], found["high"]) == pytest.approx((-4.7, 24.7), abs=0.05)
    assert found["unit"] == "degC"
    assert shown_range(counts, None)["unit"] == "counts"
    degrees = celsius.astype(np.float32)
    degrees[3, 4] = np.nan
    found = shown_range(pictured(Frame(1, degrees, 0)), None)
    assert (found["low"], found["high"], found["unit"]) == (
        pytest.approx(-4.7, abs=0.05),
        pytest.approx(24.7, abs=0.05),
        "degC",
    )
    grey = pictured(Frame(1, celsius.astype(np.uint8), 0))
    assert shown_range(grey, (0.04, 0.0)) == {"low": None, "high": None, "unit": ""}


@pytest.mark.parametrize(("tracker", "matches"), [("features", [41, 0]), ("registration", [None, None])])
def test_a_picture_says_where_its_targets_are_now(tracker, matches):
    targets = [Named(Region(10, 20, 64, 48), "near"), Named(Region(200, 90, 32, 32), "far")]
    sensor = CameraSensor("camera", SimpleNamespace(targets=targets), [[0], [1]], "y")
    found = (
        PixelTranslation(1, 0.5, -3.25, 1e-4, 1e-4, 0.97, Status.TRACKING, strength=41.0),
        PixelTranslation(1, math.nan, math.nan, math.inf, math.inf, 0.0, Status.LOST),
    )
    journal = Journal("p", {})
    opened = SimpleNamespace(journal=journal, point=SimpleNamespace(sensors={"camera": sensor}))
    streams = [("camera", "camera", SimpleNamespace(tracker=tracker))]
    live = SimpleNamespace(opened=opened, settings=SimpleNamespace(streams=streams))
    assert tracked(live, "camera") == []
    journal.given([Seen("camera", None, found)])
    near, far = tracked(live, "camera")
    assert (near["roi"], near["x_px"], near["y_px"], near["quality"]) == ([10, 20, 64, 48], 0.5, -3.25, 0.97)
    assert (far["name"], far["x_px"], far["y_px"]) == ("far", None, None)
    assert [near["matches"], far["matches"]] == matches
    assert tracked(SimpleNamespace(opened=None), "camera") == []


def test_a_range_profile_is_the_power_of_its_received_channels():
    phasors = np.full((2, 8), 1e-3, dtype=np.complex64)
    phasors[:, 5] = 10.0
    phasors[0, 2] = 1.0
    phasors[1] *= 7.0
    frame = RangeFrame(9, phasors, np.array([True, False]))
    found = profile_of(frame, 0.25 * np.arange(8), [Target(5.0, 1.25, 10.0, 30.0, np.ones(2, complex), 0.0)])
    assert np.argmax(found["magnitude_db"]) == 5
    assert found["magnitude_db"][2] == pytest.approx(-20.0)
    assert found["magnitude_db"][0] == pytest.approx(-80.0)
    assert found["targets"][0]["range_m"] == 1.25
    assert profile_of(frame, np.full(8, np.nan), [])["range_m"] is None
    nothing = RangeFrame(9, phasors, np.array([False, False]))
    assert profile_of(nothing, np.arange(8.0), [])["magnitude_db"] == []


def test_a_profile_without_power_is_far_below_any_that_has_some():
    for value, expected_db in ((0.0, -200.0), (1e-30, 0.0)):
        frame = RangeFrame(9, np.full((1, 8), value, dtype=np.complex64), np.array([True]))
        assert profile_of(frame, np.arange(8.0), [])["magnitude_db"] == [expected_db] * 8


def test_a_bin_without_a_number_leaves_the_others():
    phasors = np.full((1, 8), 10.0, dtype=np.complex64)
    phasors[0, 3] = np.nan
    found = profile_of(RangeFrame(9, phasors, np.array([True])), np.arange(8.0), [])
    assert found["magnitude_db"] == [0.0, 0.0, 0.0, -200.0, 0.0, 0.0, 0.0, 0.0]
