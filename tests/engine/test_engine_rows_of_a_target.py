"""The rows of a target: as they were found, built once, and small for records of a day."""

import tracemalloc
from dataclasses import fields, replace

import numpy as np
import pytest

from midspan.engine.camera import Target, TargetChain
from midspan.engine.target_opening import Opening
from midspan.engine.tracking import TargetTracking, light_warnings
from midspan.records import Frame, PixelTrack, PixelTranslation, Region, Status
from midspan.vision.picture_report import LightReport
from midspan.vision.target import lost


def found(k):
    """What is found in frame k."""
    time_ns = 1_700_000_000_000_000_000 + 33_333_333 * k
    if k % 50 == 49:
        return lost(time_ns)
    x, y = 0.1 * np.sin(k), 0.3 * np.cos(k)
    return PixelTranslation(time_ns, x, y, 1e-4 + 1e-6 * (k % 7), 1e-4, 0.9, Status.TRACKING, 90.0, 1e-5, 2e-5)


@pytest.fixture
def target():
    picture = np.random.default_rng(0).integers(20, 220, (40, 40), dtype=np.uint8)
    return TargetTracking(TargetChain(Frame(0, picture), Target(Region(8, 8, 24, 24), "deck"), Opening("template")))


def test_the_rows_are_what_was_found_to_the_last_bit(target):
    for k in range(120):
        target.add(replace(found(k), unseen="dark" if k == 49 else ""))
    rows = PixelTrack.stack([found(k) for k in range(120)])
    for field in fields(PixelTrack):
        one = getattr(target.rows, field.name)
        assert one.dtype == getattr(rows, field.name).dtype
        np.testing.assert_array_equal(one, getattr(rows, field.name))
    seen = rows.status == Status.TRACKING
    np.testing.assert_array_equal(target.strengths, np.where(seen, 90.0, 0.0))
    np.testing.assert_array_equal(target.reference_px2, np.where(seen[:, None], [1e-5, 2e-5], 0.0))
    np.testing.assert_array_equal(target.track.variance_y_px2, rows.variance_y_px2 + np.where(seen, 2e-5, 0.0))
    assert [k for k in range(120) if target.translation(k).unseen == "dark"] == [49]


def test_the_track_is_built_once_for_as_many_frames_as_there_are(target):
    for k in range(20):
        target.add(found(k))
    before = target.track
    assert target.track is before
    for k in range(20, 30):
        target.add(found(k))
    assert len(target.track.time_ns) == 30
    np.testing.assert_array_equal(target.track.x_px[:20], before.x_px)


def test_a_frame_takes_a_fraction_of_what_objects_would(target):
    tracemalloc.start()
    try:
        used = []
        for k in range(4001):
            target.add(found(k))
            if k in (1000, 4000):
                used.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    # Ten numbers of 8 bytes and two of one, an eighth more for growing; as objects they took 450 bytes.
    assert (used[1] - used[0]) / 3000 < 100.0


def test_changed_light_is_reported_with_when_it_began():
    (line,) = light_warnings(LightReport(largest_px2=0.09**2, notable_ns=2 * 10**9))
    assert "from 2.000 s on" in line
    assert "0.09 px" in line
    assert "key-frames" in line
    assert light_warnings(LightReport(largest_px2=0.01**2)) == []
