"""The loop of filter and tracker: predictions in pixels with the right sign and axis, measurements back in metres."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from midspan.engine.monitor import LEAST_STD_PX, AxisLoop, CameraScale, Monitor
from midspan.fusion.kalman import KalmanFilter
from midspan.records import (
    Acceleration,
    Estimate,
    Frame,
    Innovation,
    PixelTrack,
    PixelTranslation,
    Prediction,
    Source,
    Status,
    joined,
    part,
)

OMEGA = 2 * np.pi * 1.3
AMPLITUDE_M = 4e-3
DENSITY = 4e-8
OFFSET_NS = 37_000_000


def displacement(time_s):
    return AMPLITUDE_M * np.sin(OMEGA * time_s)


def acceleration():
    time_ns = np.arange(0, 3000, dtype=np.int64) * 10_000_000
    value = -(OMEGA**2) * displacement(time_ns / 1e9) + 0.02
    return Acceleration(time_ns, value, np.full(len(time_ns), DENSITY))


@dataclass
class KnowingTracker:
    """Gives the true translation of a frame (its index on the camera's clock) and keeps what was predicted."""

    scale: CameraScale
    lost: tuple[int, ...] = ()
    across: float = 3.25
    predictions: list[Prediction | None] = field(default_factory=list)

    def push(self, frame, prediction=None):
        self.predictions.append(prediction)
        along = displacement((frame.time_ns + OFFSET_NS) / 1e9) / self.scale.scale_m_per_px
        if frame.index in self.lost:
            nan = float("nan")
            return PixelTranslation(frame.time_ns, nan, nan, nan, nan, 0.0, Status.LOST)
        x, y = (along, self.across) if self.scale.direction == "x" else (self.across, along)
        return PixelTranslation(frame.time_ns, x, y, 1e-4, 1e-4, 1.0, Status.TRACKING)


def camera(*trackers):
    """What the monitor asks for the translations of all targets."""
    return lambda frame, expected: [one.push(frame, where) for one, where in zip(trackers, expected, strict=True)]


def run(scale, lost=(), rate_hz=10.0):
    """Push both streams in time order; returns tracker, frames' times on the accelerometer's clock, outputs, "
    "monitor."""
    tracker = KnowingTracker(scale, lost)
    monitor = Monitor(camera(tracker), [AxisLoop([scale], KalmanFilter())])
    samples, outputs, pushed = acceleration(), [], 0
    times = (np.arange(1, 280) / rate_hz * 1e9).astype(np.int64)
    for index, time_ns in enumerate(times):
        due = int(np.searchsorted(samples.time_ns, time_ns + OFFSET_NS, side="right"))
        outputs += monitor.push(part(samples, slice(pushed, due)))
        pushed = due
        (translation,) = monitor.push(Frame(int(time_ns), np.zeros((2, 2), np.uint8), index))
        assert isinstance(translation, PixelTranslation)
    outputs += monitor.push(part(samples, slice(pushed, None)))
    return tracker, (times + OFFSET_NS) / 1e9, outputs, monitor


SCALES = [
    CameraScale(scale_m_per_px=sign * 2.289e-3, direction=direction, time_offset_ns=OFFSET_NS)
    for sign in (-1.0, 1.0)
    for direction in ("x", "y")
]


@pytest.mark.parametrize("scale", SCALES, ids=lambda s: f"{s.scale_m_per_px:+g}-{s.direction}")
def test_the_target_is_where_it_was_predicted_on_the_measured_axis(scale):
    tracker, times, _, _ = run(scale)
    settled = slice(100, None)
    predicted = [p.x_px if scale.direction == "x" else p.y_px for p in tracker.predictions[settled]]
    truth = displacement(times[settled]) / scale.scale_m_per_px
    # The last acceleration is held for up to a sample: a · dt²/2 = 13 µm = 0.006 px at the most.
    np.testing.assert_allclose(predicted, truth, atol=0.02)
    # A wrong sign or a clock offset left out would be far beyond: 37 ms at 33 mm/s are 0.5 px.
    assert np.max(np.abs(truth)) > 1.5


@pytest.mark.parametrize("scale", SCALES, ids=lambda s: f"{s.scale_m_per_px:+g}-{s.direction}")
def test_across_the_measured_axis_the_last_translation_is_expected(scale):
    tracker, _, _, _ = run(scale)
    across = {p.y_px if scale.direction == "x" else p.x_px for p in tracker.predictions[10:]}
    assert across == {3.25}


def test_there_is_no_prediction_before_anything_was_measured_and_a_floor_afterwards():
    tracker, _, _, _ = run(SCALES[0])
    assert tracker.predictions[0] is None
    assert all(p is not None for p in tracker.predictions[30:])
    assert all(p.std_x_px >= LEAST_STD_PX for p in tracker.predictions[30:])


@pytest.mark.parametrize("scale", SCALES, ids=lambda s: f"{s.scale_m_per_px:+g}-{s.direction}")
def test_the_loop_gives_back_the_displacement(scale):
    _, _, outputs, _ = run(scale)
    estimates = [item for item in outputs if isinstance(item, Estimate)]
    time = np.concatenate([e.time_ns for e in estimates]) / 1e9
    value = np.concatenate([e.displacement_m for e in estimates])
    source = np.concatenate([e.source for e in estimates])
    np.testing.assert_array_equal(np.diff(time) > 0, True)
    assert len(time) == 3000
    # Exact measurements and acceleration: what is left is Numerov's 0.002 % and the bias being learnt.
    inner = (time > 15.0) & (time < 27.0)
    assert np.sqrt(np.mean((value - displacement(time))[inner] ** 2)) < 2e-5
    assert np.all(source[inner] == Source.CAMERA)
    assert any(isinstance(item, Innovation) for item in outputs)


def test_lost_frames_are_passed_over_and_their_prediction_goes_on():
    lost = tuple(range(150, 160))
    tracker, times, outputs, _ = run(SCALES[0], lost)
    truth = displacement(times) / SCALES[0].scale_m_per_px
    for index in lost:
        assert tracker.predictions[index].x_px == pytest.approx(truth[index], abs=0.15)
    # The band of the prediction grows while nothing is seen, above the floor or not at all.
    assert tracker.predictions[159].std_x_px >= tracker.predictions[150].std_x_px
    status = np.concatenate([e.status for e in outputs if isinstance(e, Estimate)])
    assert np.count_nonzero(status == Status.COASTING) > 30
    met = sum(len(item.time_ns) for item in outputs if isinstance(item, Innovation))
    assert met == 279 - len(lost)


def test_a_track_becomes_a_displacement_with_the_scales_sign_clock_and_variance():
    scale = CameraScale(-2e-3, "y", 5, variance_factor=3.0, source=Source.INFRARED)
    row = PixelTranslation(100, 9.0, -1.5, 0.5, 0.25, 1.0, Status.TRACKING)
    block = scale.displacement(PixelTrack.stack([row]))
    assert block.time_ns.tolist() == [105]
    assert block.value_m.tolist() == pytest.approx([3e-3])
    assert block.variance_m2.tolist() == pytest.approx([4e-6 * 3.0 * 0.25])
    assert block.source.tolist() == [Source.INFRARED]


@dataclass
class PlaneTracker:
    """Gives true translations along both axes; from `jump_at` on it is `jump_px` off along y."""

    scales: dict[str, CameraScale]
    zero_px: float = 0.0
    jump_at: int = 10**9
    jump_px: float = 0.0
    predictions: list[Prediction | None] = field(default_factory=list)

    def push(self, frame, prediction=None):
        self.predictions.append(prediction)
        time_s = (frame.time_ns + OFFSET_NS) / 1e9
        x = sideways(time_s) / self.scales["x"].scale_m_per_px
        y = displacement(time_s) / self.scales["y"].scale_m_per_px + self.zero_px
        y += self.jump_px * (frame.index >= self.jump_at)
        return PixelTranslation(frame.time_ns, x, y, 1e-4, 1e-4, 1.0, Status.TRACKING)


def sideways(time_s):
    return 3e-3 * np.sin(2 * np.pi * 0.7 * time_s + 1.0)


def scales_of(per_px):
    return {axis: CameraScale(per_px, axis, OFFSET_NS) for axis in "xy"}


def run_plane(trackers, axes):
    """Push frames at 10 Hz and each axis's acceleration; returns the estimate along y."""
    loops = [AxisLoop([tracker.scales[axis] for tracker in trackers], KalmanFilter()) for axis in axes]
    monitor = Monitor(camera(*trackers), loops)
    down = acceleration()
    across = replace(down, value_m_s2=-((2 * np.pi * 0.7) ** 2) * sideways(down.time_ns / 1e9) + 0.02)
    samples = {"y": down, "x": across}
    found, pushed = [], 0
    for index in range(1, 280):
        time_ns = index * 100_000_000
        due = int(np.searchsorted(down.time_ns, time_ns + OFFSET_NS, side="right"))
        for number, axis in enumerate(axes):
            out = monitor.push(part(samples[axis], slice(pushed, due)), number)
            found += [item for item in out if isinstance(item, Estimate)] if axis == "y" else []
        pushed = due
        assert len(monitor.push(Frame(time_ns, np.zeros((2, 2), np.uint8), index))) == len(trackers)
    return monitor, joined(found)


def test_with_two_axes_the_target_is_where_it_was_predicted_on_both():
    tracker = PlaneTracker(scales_of(-2e-3))
    run_plane([tracker], "yx")
    times = (np.arange(101, 280) * 1e8 + OFFSET_NS) / 1e9
    settled = tracker.predictions[100:]
    np.testing.assert_allclose([p.y_px for p in settled], displacement(times) / -2e-3, atol=0.02)
    np.testing.assert_allclose([p.x_px for p in settled], sideways(times) / -2e-3, atol=0.02)
    assert all(p.std_x_px == LEAST_STD_PX for p in settled)


def test_targets_at_other_distances_are_predicted_by_their_own_scale_and_zero():
    trackers = [PlaneTracker(scales_of(-2e-3)), PlaneTracker(scales_of(-1e-3), zero_px=0.8)]
    monitor, _ = run_plane(trackers, "y")
    times = (np.arange(201, 280) * 1e8 + OFFSET_NS) / 1e9
    predicted = np.array([p.y_px for p in trackers[1].predictions[200:]])
    np.testing.assert_allclose(predicted, displacement(times) / -1e-3 + 0.8, atol=0.08)
    # Both zeros together are moved by what lies between: 0.8 px of 1 mm each.
    assert monitor.axes[0].zeros_m[1] - monitor.axes[0].zeros_m[0] == pytest.approx(-0.8e-3, abs=0.02e-3)


def test_a_target_that_jumps_away_makes_no_step_and_its_prediction_stays():
    trackers = [PlaneTracker(scales_of(-2e-3), jump_at=150, jump_px=3.0), PlaneTracker(scales_of(-2e-3))]
    _, found = run_plane(trackers, "y")
    time = found.time_ns / 1e9
    after = (time > 15.5) & (time < 27.5)
    # 3 px are 6 mm; the mean of both would be off by 3 mm. What is left is the held acceleration between frames.
    assert np.max(np.abs(found.displacement_m - displacement(time))[after]) < 0.1e-3
    assert trackers[0].predictions[-1].y_px == pytest.approx(trackers[1].predictions[-1].y_px, abs=0.1)
