"""A tracker behind the cleaner of temperatures: what it sees, what it passes on, and how it goes on from a state."""

import numpy as np
import pytest

from midspan.engine.thermal_target import ThermalTarget, thermal_target
from midspan.records import Frame, Region, Status
from midspan.simulate.scene.texture import textured_scene
from midspan.simulate.scene.thermal import ThermalCamera, ThermalView
from midspan.thermal.limits import Limits
from midspan.vision.tracker import Learner, PhaseGain, Telling, open_tracker

REGION = Region(14, 12, 56, 52)


@pytest.fixture(scope="module")
def film():
    """Fifty frames at 10 Hz of a wall that moves by 3 px, with a shutter that closes at 2 s for half a second."""
    scene = textured_scene("natural", (76, 84), rng=np.random.default_rng(2), reach_px=8.0, lens_px=1.0)
    stamps = np.arange(50) / 10.0
    moved = 3.0 * np.sin(2 * np.pi * 0.5 * stamps)
    view = ThermalView((scene,), camera=ThermalCamera(shutters_s=(2.0,), closed_s=0.5))
    pictures = view.film(np.column_stack((0.0 * moved, moved)), stamps, rng=np.random.default_rng(1))
    return [Frame(round(1e9 * t), p, k) for k, (t, p) in enumerate(zip(stamps, pictures, strict=True))], moved


def opened(film, name="template", levels=None):
    return thermal_target(film[0][0], REGION, lambda frame: open_tracker(name, frame, REGION), levels)


def test_the_first_frame_is_the_zero_and_the_shutter_is_lost_and_told(film):
    frames, moved = film
    target = opened(film)
    rows = [target.push(frame) for frame in frames]
    assert rows[0].status is Status.TRACKING
    assert rows[0].y_px == pytest.approx(0.0, abs=1e-3)
    closed = [k for k, row in enumerate(rows) if row.status is Status.LOST]
    assert closed == [20, 21, 22, 23, 24]
    assert isinstance(target, Telling)
    assert [event.kind for event in target.take_events()] == ["shutter"]
    assert target.take_events() == []
    error = np.array([row.y_px - y for k, (row, y) in enumerate(zip(rows, moved, strict=True)) if k not in closed])
    # 0.05 K on 1 K of contrast: the pieces reach 0.004 px on a larger region.
    assert np.sqrt(np.mean(error**2)) < 0.02


@pytest.mark.parametrize("cut", [7, 22, 40])
def test_a_target_opened_anew_goes_on_from_a_state_as_the_old_one_would(film, cut):
    frames, _ = film
    old, new = opened(film), opened(film)
    for frame in frames[:cut]:
        old.push(frame)
    new.restore(old.state)
    for frame in frames[cut:]:
        one, other = old.push(frame), new.push(frame)
        assert one.status is other.status
        np.testing.assert_array_equal([one.x_px, one.y_px], [other.x_px, other.y_px])


def test_with_a_range_the_tracker_sees_256_grey_levels_of_it(film):
    frames, moved = film
    seen = []

    class Watching:
        """A tracker that keeps what it is shown."""

        def __init__(self, frame):
            self.tracker = open_tracker("template", frame, REGION)
            self.region, self.region_now = REGION, REGION
            seen.append(frame.pixels)

        def push(self, frame, prediction=None):
            seen.append(frame.pixels)
            return self.tracker.push(frame, prediction)

    target = ThermalTarget(frames[0], REGION, Watching, Limits(16.0, 24.0))
    rows = [target.push(frame) for frame in frames[:20]]
    assert {picture.dtype for picture in seen} == {np.dtype(np.uint8)}
    expected = np.clip(np.rint((frames[5].pixels - 16.0) * 255.0 / 8.0), 0, 255)
    np.testing.assert_allclose(seen[6], expected, atol=1)
    assert target.limits == Limits(16.0, 24.0)
    assert np.abs([row.y_px - y for row, y in zip(rows, moved, strict=False)]).max() < 0.05


@pytest.mark.parametrize(("name", "learns"), [("template", False), ("hybrid", True), ("registration", False)])
def test_it_learns_and_measures_phase_where_its_tracker_does(film, name, learns):
    target = opened(film, name)
    assert isinstance(target, Learner) is learns
    assert isinstance(target, PhaseGain) is learns
    if learns:
        frames, moved = film
        target.learn(frames[:20])
        rows = [target.push(frame) for frame in frames[:20]]
        assert np.abs([row.y_px - y for row, y in zip(rows, moved, strict=False)]).max() < 0.06
