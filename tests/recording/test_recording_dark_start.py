"""A camera that is dark when a recording begins, or inside the window: what is used of it, and from where on."""

from types import SimpleNamespace

import numpy as np
import pytest

from midspan.recording.cameras.tracked import zero_of
from midspan.recording.estimate import _late_start
from midspan.recording.tracking.daylight import where_it_sees
from midspan.records import NANOSECONDS, Displacement, Source


def blind_until(time_s):
    """Displacement of zeros at 4 Hz for 60 s that is not seen before."""
    stamps = np.arange(0.0, 60.0, 0.25)
    source = np.full(len(stamps), Source.CAMERA, np.uint8)
    value = np.where(stamps < time_s, np.nan, 0.0)
    return Displacement(np.rint(1e9 * stamps).astype(np.int64), value, np.full(len(stamps), 1e-10), source)


class Frames:
    """Frames at 4 Hz for 60 s, lit in the stretches given."""

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
    recording = SimpleNamespace(sensor="camera", infrared=object(), frames=Frames(lit))
    recording.seeing = lambda *stamps: stamps
    monkeypatch.setattr("midspan.recording.tracking.daylight.window_ends", lambda _: (0, 60 * NANOSECONDS))
    (begun, ended, used_from), (text,) = where_it_sees(recording)
    assert (begun / NANOSECONDS, ended / NANOSECONDS) == (36.0, 59.75)
    assert used_from / NANOSECONDS == used_from_s
    assert "from 36.000 s to 59.750 s" in text


def test_the_zero_of_a_camera_that_begins_dark_is_a_frame_that_saw_something():
    both = blind_until(34.0)
    view = SimpleNamespace(frames=Frames([]), sees_from_ns=34 * NANOSECONDS)
    camera = SimpleNamespace(eye=SimpleNamespace(tracking=SimpleNamespace(skipped=0), view=view), measured=both)
    assert zero_of((camera,), both) == 34 * NANOSECONDS
    camera.eye.view.sees_from_ns = 0
    assert zero_of((camera,), both) == 0


def test_a_result_that_begins_late_is_told():
    inputs = SimpleNamespace(
        displacement=blind_until(42.0),
        acceleration=SimpleNamespace(time_ns=np.array([0, NANOSECONDS])),
        kalman=SimpleNamespace(coasting_s=1.0),
    )
    rows = SimpleNamespace(time_ns=np.array([42 * NANOSECONDS]))
    (line,) = _late_start(inputs, rows)
    assert "from 0.000 s to 42.000 s" in line
    assert "42.0 s late" in line
    assert not _late_start(inputs, SimpleNamespace(time_ns=np.array([NANOSECONDS // 2])))
