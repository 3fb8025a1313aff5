"""With `--literal` the adaptive filter as printed predicts for its tracker: AMKF paper, equations 27 to 29."""

import numpy as np
import pytest

import midspan
from lively_recordings import Lively, write
from midspan.engine.camera import CameraChain
from midspan.fusion.blocks import VELOCITY_WITHIN
from midspan.papers.printed.adaptive import AdaptiveRows, PrintedFilter
from midspan.records import Acceleration, Displacement, Source

CASE = Lively(seed=4, first_s=1.0037, rate_hz=9.99, duration_s=30.0, tones=((6e-3, 0.7), (2e-3, 2.2)), mm_per_px=-1.6)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write(tmp_path_factory.mktemp("predicted"), CASE, "camera")


def predicted(folder, monkeypatch, **fusion):
    """The result, the stamps (ns) of the frames that were tracked with a prediction, what was predicted along y with
    its deviation, and what was found, px, with its variance.
    """
    view = midspan.open_recording(folder, calibration={"window_s": [0.0, 15.0]}, camera={"tracker": "template"})
    calibration = midspan.calibrate(view)
    rows, push = [], CameraChain.push

    def noted(chain, frame, predictions=None):
        found = push(chain, frame, predictions)
        if predictions is not None and predictions[0] is not None:
            one = predictions[0]
            rows.append((frame.time_ns, one.y_px, one.std_y_px, found[0].y_px, found[0].variance_y_px2))
        return found

    monkeypatch.setattr(CameraChain, "push", noted)
    asked = midspan.open_recording(folder, camera={"tracker": "template"}, fusion=fusion)
    result = midspan.estimate(asked, calibration=calibration)
    return result, calibration, np.array(rows)


def test_the_tracker_gets_the_printed_filters_own_prediction_and_deviation(folder, monkeypatch):
    kept = []
    begun = AdaptiveRows._begun
    monkeypatch.setattr(AdaptiveRows, "_begun", lambda own, ns: kept.append(begun(own, ns)) or kept[-1])
    fusion = {"method": "adaptive-kalman", "literal": True, "input_noise_m_s2": 0.01, "start_velocity_mm_s": 50.0}
    _, calibration, rows = predicted(folder, monkeypatch, **fusion)
    scale, offset_s = calibration.camera.scale.value_m_per_px, calibration.camera.offset.value_s
    time_s, value = np.loadtxt(folder / "accel.csv", delimiter=",", skiprows=1).T
    # The same filter by hand over the frames and the samples before each.
    settings = kept[0].settings
    assert (settings.input_noise_m_s2, settings.kalman.bias) == (0.01, calibration.bias_m_s2)
    own = PrintedFilter(settings, 0, step_s=0.01, speed_m_s=settings.kalman.velocity_std / VELOCITY_WITHIN)
    stamps, pushed = rows[:, 0] + np.rint(1e9 * offset_s), 0
    samples = Acceleration(np.rint(1e9 * time_s).astype(np.int64), value, np.ones(len(value)))
    expected = []
    for (_, _, _, y_px, variance), stamp in zip(rows, stamps, strict=True):
        due = int(np.searchsorted(samples.time_ns, stamp, side="right"))
        own.push(Acceleration(samples.time_ns[pushed:due], value[pushed:due], samples.noise_density[pushed:due]))
        pushed = due
        y_m, g_m2 = own.predict(int(stamp))
        expected.append((y_m / scale, np.sqrt(g_m2) / abs(scale)))
        source = np.array([Source.CAMERA], dtype=np.uint8)
        seen = np.array([y_px * scale]), np.array([variance * scale**2])
        own.wait(Displacement(np.array([int(stamp)]), *seen, source))
    assert len(rows) > 200
    # From the first frame with a prediction on the two filters differ by what the frame before it did: forgotten.
    np.testing.assert_allclose(rows[100:, 1:3], np.array(expected)[100:], rtol=1e-3, atol=2e-3)


def test_the_guarded_method_keeps_the_estimators_prediction(folder, monkeypatch):
    result, _, rows = predicted(folder, monkeypatch, method="adaptive-kalman")
    literal = predicted(folder, monkeypatch, method="adaptive-kalman", literal=True)
    # The printed filter is late by half a sample and its deviation has no least: both differ.
    assert np.all(rows[:, 2] >= 0.5)
    assert np.median(literal[2][50:, 2]) < 0.5
    # The first rows of a causal filter do not know the velocity yet; the literal form lags by half a sample: 0.15 mm.
    error_mm = (result.displacement_mm - CASE.from_zero_mm(result.time_s))[200:]
    assert np.std(error_mm) < 0.01
