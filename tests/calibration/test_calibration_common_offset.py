"""One clock offset out of several targets' own."""

from dataclasses import replace

import numpy as np
import pytest

from midspan.calibration.camera.calibrate import relative_scale_std
from midspan.calibration.common_offset import Fitted, one_offset, pooled_variance
from midspan.calibration.fit import Pair
from midspan.calibration.scale import calibrate_scale
from midspan.calibration.sensors.camera import TargetCalibration
from midspan.records import Region
from midspan.simulate.motion.motion import random_motion
from midspan.simulate.motion.sensors import AccelerometerModel, DisplacementSensorModel, simulate_pair

SCALES, NOISE_PX, OFFSET_S = (1.5e-3, 0.75e-3), (0.02, 0.05), 0.06


def targets(seed, offsets_s=(OFFSET_S, OFFSET_S)):
    """Two targets at two distances together with one accelerometer, 40 s at 10 Hz."""
    motion = random_motion((0.5, 4.0), 1.5e-3, rng=np.random.default_rng(seed))
    model = AccelerometerModel(100.0, 3e-3, 0.02)
    found = []
    for k, (scale, noise, offset) in enumerate(zip(SCALES, NOISE_PX, offsets_s, strict=True)):
        sensor = DisplacementSensorModel(10.0, 0.0, offset)
        pair = simulate_pair(motion, 40.0, accelerometer=model, displacement=sensor, seed=seed)
        time, met = pair.acceleration.time_ns / 1e9, pair.displacement.time_ns / 1e9
        noisy = pair.displacement.value / -scale + noise * np.random.default_rng([seed, k]).standard_normal(len(met))
        rows = np.column_stack((met, noisy - noisy[0], np.full(len(met), noise**2)))[8:-8]
        value = pair.acceleration.value
        samples = np.column_stack((time, value - value.mean(), np.ones(len(time))))
        found.append(calibrate_scale(Pair(samples, rows), 0.3))
    return Fitted(tuple(found), ("", ""))


def test_the_common_offset_lies_between_is_more_certain_and_its_band_holds():
    ratios = []
    for seed in range(8):
        fit = targets(seed)
        own = [found.search.offset for found in fit.found]
        (joint,) = one_offset([fit])
        offset = joint.used[0].search.offset
        assert min(o.value_s for o in own) <= offset.value_s <= max(o.value_s for o in own)
        assert offset.variance < min(o.variance for o in own)
        assert all(found.search.fit.offset_s == offset.value_s for found in joint.used)
        ratios.append((offset.value_s - OFFSET_S) / np.sqrt(offset.variance))
    # The root mean square of eight standard normal values lies within 0.35 … 1.75 in 99.8 % of all cases.
    assert 0.35 < np.sqrt(np.mean(np.square(ratios))) < 1.75


def test_scale_factors_at_the_common_offset_stay_right():
    (joint,) = one_offset([targets(3)])
    for found, scale in zip(joint.used, SCALES, strict=True):
        ratio = (found.scale.value_m_per_px + scale) / np.sqrt(found.scale.variance)
        assert abs(ratio) < 4.0


def test_a_target_on_another_clock_is_left_out_with_a_reason():
    (joint,) = one_offset([targets(4, (OFFSET_S, OFFSET_S + 0.02))])
    assert len(joint.used) == 1
    assert "clock offset" in "".join(joint.reasons)


def test_one_target_alone_stays_as_it_is():
    fit = targets(5)
    alone = replace(fit, reasons=("", "refused"))
    assert one_offset([alone])[0].used == [fit.found[0]]


def test_errors_in_common_do_not_average_out():
    weight, variance = np.array([0.5, 0.5]), np.array([4.0, 4.0])
    assert pooled_variance(weight, variance, 0.0) == pytest.approx(2.0)
    assert pooled_variance(weight, variance, 1.0) == pytest.approx(4.0)


def test_what_compression_does_to_the_scale_factors_is_one_error_of_all_targets():
    (joint,) = one_offset([targets(6)])

    def with_codec(relative):
        scales = [found.scale for found in joint.used]
        widened = [replace(s, variance=s.variance + (relative * s.value_m_per_px) ** 2) for s in scales]
        return [TargetCalibration(Region(0, 0, 8, 8), "", scale) for scale in widened]

    bare = relative_scale_std(joint.used, with_codec(0.0))
    own = [np.sqrt(found.scale.variance) / abs(found.scale.value_m_per_px) for found in joint.used]
    assert bare <= max(own)
    # One per cent of each target's is one per cent of their mean's.
    assert relative_scale_std(joint.used, with_codec(0.01)) == pytest.approx(np.hypot(bare, 0.01), rel=1e-9)
