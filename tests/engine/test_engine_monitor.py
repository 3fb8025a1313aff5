"""The loop of filter and tracker: predictions in pixels with the right sign and axis, measurements back in metres."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from midspan.engine.monitor import LEAST_STD_PX, CameraScale, Monitor
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


def run(scale, lost=(), rate_hz=10.0):
    """Push both streams in time order; returns tracker, frames' times on the accelerometer's clock, outputs, "
    "monitor."""
    tracker = KnowingTracker(scale, lost)
    monitor = Monitor(tracker, scale, KalmanFilter())
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
