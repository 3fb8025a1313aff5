"""The rows of a target: as they were found, built once, and small for records of a day."""

import tracemalloc

import numpy as np
import pytest

from midspan.recording.tracking.tracking import TargetTracking, TrackingSettings
from midspan.records import Frame, PixelTrack, PixelTranslation, Region, Status

REGION = Region(8, 8, 24, 24)
SETTINGS = TrackingSettings("template")


class Following:
    """A tracker that finds what it is told to."""

    def __init__(self, reference):
        self.reference, self.region, self.region_now = reference, REGION, REGION

    def push(self, frame, prediction=None):
        k = frame.index
        status = Status.LOST if k % 50 == 49 else Status.TRACKING
        strength = 0.0 if status is Status.LOST else 90.0
        x, y = (np.nan, np.nan) if status is Status.LOST else (0.1 * np.sin(k), 0.3 * np.cos(k))
        return PixelTranslation(frame.time_ns, x, y, 1e-4 + 1e-6 * (k % 7), 1e-4, 0.9, status, strength)


@pytest.fixture(scope="module")
def pictures():
    rng = np.random.default_rng(0)
    return [rng.integers(20, 220, (40, 40), dtype=np.uint8) for _ in range(7)]


def frame(pictures, k):
    return Frame(1_700_000_000_000_000_000 + 33_333_333 * k, pictures[k % 7], k)


def followed(target, pictures, numbers):
    rows = []
    for k in numbers:
        one = frame(pictures, k)
        rows.append(target.push(one))
        target.add(one, rows[-1])
    return rows


def test_the_rows_are_what_was_found_to_the_last_bit(pictures):
    target = TargetTracking(Following(frame(pictures, 0)), "1", SETTINGS)
    rows = PixelTrack.stack(followed(target, pictures, range(120)))
    for name in ("time_ns", "x_px", "y_px", "quality", "status"):
        found = getattr(target.track, name)
        assert found.dtype == getattr(rows, name).dtype
        np.testing.assert_array_equal(found, getattr(rows, name))
    np.testing.assert_array_equal(target.strengths, np.where(rows.status == Status.LOST, 0.0, 90.0))


def test_the_track_is_built_once_for_as_many_frames_as_there_are(pictures):
    target = TargetTracking(Following(frame(pictures, 0)), "1", SETTINGS)
    followed(target, pictures, range(20))
    assert target.track is target.track
    assert target.quick is target.quick
    before = target.track
    followed(target, pictures, range(20, 30))
    assert len(target.track.time_ns) == len(target.quick.time_ns) == 30
    np.testing.assert_array_equal(target.track.x_px[:20], before.x_px)


def test_a_frame_takes_a_fraction_of_what_objects_would(pictures):
    tracemalloc.start()
    try:
        target, used = TargetTracking(Following(frame(pictures, 0)), "1", SETTINGS), []
        for k in range(4001):
            followed(target, pictures, [k])
            if k in (1000, 4000):
                used.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    # Thirteen numbers of 8 bytes and two of one, an eighth more for growing, and a look at noise every 96 frames;
    # as objects they took 450 bytes.
    assert (used[1] - used[0]) / 3000 < 180.0
