"""A camera that is dark when a recording begins, or inside the window: what is used of it, and from where on."""

from types import SimpleNamespace

import numpy as np
import pytest

from midspan.engine.row_messages import unmeasured_ends
from midspan.recording.point import zero_instant
from midspan.recording.tracked import TrackedCamera
from midspan.recording.tracking.opening import where_it_sees
from midspan.records import NANOSECONDS, Measured, nanoseconds


class Frames:
    """Frames at 4 Hz for 60 s, lit in the segments given."""

    tracks = ()

    def __init__(self, lit):
        self.time_s, self.lit = np.arange(0.0, 60.0, 0.25), lit

    def times_ns(self):
        return np.rint(1e9 * self.time_s).astype(np.int64)

    def frames(self, first, last):
        for index in range(first, last):
            bright = any(begin <= self.time_s[index] < end for begin, end in self.lit)
            yield SimpleNamespace(pixels=np.full((8, 8), 120 if bright else 1, np.uint8))


@pytest.mark.parametrize(
    ("lit", "used_from_s"),
    [
        ([(0.0, 20.0), (36.0, 60.0)], 0.0),
        ([(0.0, 0.5), (36.0, 60.0)], 36.0),  # a headlight is no day
        ([(36.0, 60.0)], 36.0),
    ],
)
def test_frames_before_a_night_in_the_window_are_used(lit, used_from_s, monkeypatch):
    recording = SimpleNamespace(
        kind="camera", companions=(SimpleNamespace(kind="infrared"),), frames=Frames(lit), late_ns=0
    )
    recording.seeing = lambda *stamps: stamps
    monkeypatch.setattr("midspan.recording.tracking.opening.window_ends", lambda _: (0, 60 * NANOSECONDS))
    (begun, ended, used_from), (text,) = where_it_sees(recording)
    assert (begun / NANOSECONDS, ended / NANOSECONDS) == (36.0, 59.75)
    assert used_from / NANOSECONDS == used_from_s
    assert "from 36.000 s to 59.750 s" in text


def tracked_camera(sensor, first_s, sees_from_s=None):
    """A camera whose first frame used is at `first_s`, out of frames from 0 s on; its clock is 1 s behind."""
    stamps = Frames([]).times_ns()
    view = SimpleNamespace(sensor=sensor, frames=Frames([]))
    view.sees_from_ns = None if sees_from_s is None else sees_from_s * NANOSECONDS
    target = SimpleNamespace(chain=SimpleNamespace(first_late_ns=0))
    tracking = SimpleNamespace(skipped=0, time_ns=stamps[stamps >= first_s * NANOSECONDS], targets=(target,))
    return TrackedCamera(view, tracking, (SimpleNamespace(offset=SimpleNamespace(value_s=1.0), best_used=0),))


def test_the_zero_of_a_camera_that_begins_dark_is_the_first_frame_that_either_sees():
    main = SimpleNamespace(recording=SimpleNamespace(views=()), calibration=SimpleNamespace(auxiliary=()))
    infrared = tracked_camera("infrared", 2)
    assert zero_instant(main, (tracked_camera("camera", 34, sees_from_s=34), infrared), {}) == 3 * NANOSECONDS
    assert zero_instant(main, (tracked_camera("camera", 5), infrared), {}) == 6 * NANOSECONDS
    assert zero_instant(main, (tracked_camera("camera", 0, sees_from_s=0), infrared), {}) == NANOSECONDS


def test_a_result_that_begins_late_is_reported():
    stamps = nanoseconds(np.arange(0.0, 60.0, 0.25))
    zeros = np.zeros(len(stamps))
    measured = Measured(stamps, zeros.astype(np.int64), np.where(stamps < 42 * NANOSECONDS, np.nan, 0.0), zeros, zeros)
    sampled = np.array([0, NANOSECONDS])
    rows = SimpleNamespace(time_ns=np.array([42 * NANOSECONDS]))
    (line,) = unmeasured_ends(sampled, {"camera": [measured]}, rows)
    assert "from 0.000 s to 42.000 s" in line
    assert "42.0 s late" in line
    assert not unmeasured_ends(sampled, {"camera": [measured]}, SimpleNamespace(time_ns=np.array([NANOSECONDS // 2])))
