"""`kalman` and `lag` follow the displacement's noise: what they learn from, and what they must not learn from."""

import numpy as np
import pytest
from fusion_oracles import acceleration_block, displacement_block

from midspan.fusion.causal import filter_record
from midspan.fusion.gate import REJECTED, GateSettings
from midspan.fusion.kalman import KalmanFilter, KalmanSettings
from midspan.fusion.lag import LagSettings, LagSmoother, smooth_with_lag
from midspan.fusion.noise_online import LEAST, MOST
from midspan.fusion.response import linear
from midspan.records import Displacement, Source, joined, part

NOISE_A, NOISE_D = 2e-3, 1e-4
LENGTH = 8000
TIME, MET = np.arange(LENGTH) / 100.0, np.arange(LENGTH // 10 - 1) / 10.0 + 0.004
MIDDLE, LATER = 40.0, (TIME > 43.0) & (TIME < 78.0)
FIXED = KalmanSettings(learn_noise=False)
RUNS = {
    "kalman": filter_record,
    "lag": lambda a, d, settings=None: smooth_with_lag(a, d, LagSettings(0.5, settings or KalmanSettings())),
}
BOTH = pytest.mark.parametrize("method", RUNS)


def moving(time, order=0):
    parts = ((8e-3, 0.1), (3e-3, 3.3))
    return sum((-1 if order else 1) * a * (2 * np.pi * f) ** order * np.sin(2 * np.pi * f * time) for a, f in parts)


def record(seed, scale=1.0, *, told=1.0, density=1.0, bias=5e-3, unlike=0.0):
    """Acceleration and displacement with the noise times `scale` (m,); variances told wrong by these factors."""
    rng = np.random.default_rng(seed)
    acceleration = moving(TIME, 2) + bias + rng.normal(0, NOISE_A, LENGTH) + unlike
    value = moving(MET) + scale * rng.normal(0, NOISE_D, len(MET))
    return (
        acceleration_block(TIME, acceleration, density * NOISE_A**2 / 100.0),
        displacement_block(MET, value, np.broadcast_to(told * NOISE_D**2, len(MET))),
    )


def step(factor):
    return np.where(MET > MIDDLE, factor, 1.0)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def error(found, where=LATER):
    return (found.estimate.displacement_m - moving(TIME))[where]


def learnt(found, after_s=10.0):
    """Median factor on the noise's deviation from `after_s` on."""
    return float(np.median(np.sqrt(found.variance_m2[after_s < MET]) / NOISE_D))


@BOTH
def test_noise_five_times_as_large_is_followed_and_the_band_stays_honest(method):
    got, known, inside = [], [], []
    for seed in range(6):
        found = RUNS[method](*record(seed, step(5.0)))
        got.append(error(found))
        known.append(error(RUNS[method](*record(seed, step(5.0), told=step(5.0) ** 2), FIXED)))
        inside.append(np.mean(np.abs(got[-1]) <= 1.96 * np.sqrt(found.estimate.variance_m2[LATER])))
        # The last forty measurements tell a deviation to a fifth.
        assert np.sqrt(found.variance_m2[-1]) == pytest.approx(5.0 * NOISE_D, rel=0.5)
    # Three seconds after the change it costs what not knowing the noise exactly costs.
    assert rms(got) <= 1.10 * rms(known)
    # Six runs of 35 s hold some 250 independent errors: 95 ± 1.4 %, and learnt noise of a fifth's scatter.
    assert 0.90 <= np.mean(inside) <= 0.98


@BOTH
def test_noise_as_told_costs_below_one_per_cent(method):
    inner = (TIME > 5.0) & (TIME < 78.0)
    pairs = [record(seed) for seed in range(20, 28)]
    got, fixed = ([error(RUNS[method](*pair, kalman), inner) for pair in pairs] for kalman in (KalmanSettings(), FIXED))
    assert rms(got) <= 1.01 * rms(fixed)


@BOTH
@pytest.mark.parametrize("told", [0.1, 10.0])
def test_a_variance_told_ten_times_wrong_is_mended(method, told):
    inner = (TIME > 5.0) & (TIME < 78.0)
    wrong = [RUNS[method](*record(seed, told=told)) for seed in range(30, 34)]
    right = [RUNS[method](*record(seed), FIXED) for seed in range(30, 34)]
    assert rms([error(f, inner) for f in wrong]) <= 1.06 * rms([error(f, inner) for f in right])
    # The learnt deviation scatters by an eighth; four runs halve that.
    assert np.mean([learnt(f, 20.0) for f in wrong]) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("fault", ["bias", "drift", "acceleration noise", "outliers"])
def test_what_is_not_the_displacements_noise_is_not_learnt_as_such(fault):
    found = []
    for seed in range(40, 44):
        rng = np.random.default_rng(seed)
        if fault == "bias":
            pair = record(seed, bias=50e-3)
        elif fault == "drift":
            # Three times what the bias's walk expects.
            pair = record(seed, unlike=2.5e-3 / 60.0 * TIME)
        elif fault == "acceleration noise":
            # Told a hundredth of what it is: innovations are large, and alike in neighbours.
            pair = record(seed, density=0.01)
        else:
            size = rng.choice([-1.0, 1.0], len(MET)) * rng.uniform(10, 60, len(MET)) * NOISE_D
            acceleration, plain = record(seed)
            bad = np.where(rng.random(len(MET)) < 0.1, size, 0.0)
            pair = acceleration, displacement_block(MET, plain.value_m + bad, NOISE_D**2)
        found.append(learnt(filter_record(*pair)))
    # A tenth of twenty-fold outliers would make the deviation six times as large, the missing process noise its own.
    assert 0.8 < np.mean(found) < 1.5


def test_a_rejected_measurement_teaches_nothing():
    acceleration, plain = record(50)
    far = plain.value_m.copy()
    far[400:430] += 20e-3
    found = filter_record(acceleration, displacement_block(MET, far, NOISE_D**2))
    assert np.all(found.innovation.verdict[400:430] == REJECTED)
    np.testing.assert_array_equal(found.variance_m2[400:431], found.variance_m2[400])


def test_the_learnt_noise_stays_between_floor_and_ceiling():
    deviation = np.sqrt(filter_record(*record(51, 1e-4)).variance_m2) / NOISE_D
    assert deviation.min() >= LEAST * (1 - 1e-12)
    assert np.median(deviation[-100:]) < 0.3
    # A sensor gone mad: the ceiling holds, and the filter goes on with finite numbers.
    mad = filter_record(*record(52, step(3000.0)))
    assert np.sqrt(mad.variance_m2.max()) <= MOST * NOISE_D * (1 + 1e-12)
    assert np.all(np.isfinite(mad.estimate.displacement_m))


def test_each_source_has_its_own_noise():
    acceleration, first = record(53)
    rng = np.random.default_rng(54)
    stamps = MET + 0.05
    source = Source.CAMERA
    second = displacement_block(stamps, moving(stamps) + 5 * rng.normal(0, NOISE_D, len(MET)), NOISE_D**2, int(source))
    both = joined([first, second])
    order = np.argsort(both.time_ns)
    merged = part(both, order)
    taken = np.sqrt(filter_record(acceleration, merged).variance_m2) / NOISE_D
    met = merged.source[: len(taken)]
    late = np.arange(len(taken)) > 400
    assert np.median(taken[late & (met == Source.DISPLACEMENT)]) == pytest.approx(1.0, rel=0.3)
    assert np.median(taken[late & (met == source)]) == pytest.approx(5.0, rel=0.3)


@pytest.mark.parametrize("stream", [KalmanFilter, lambda: LagSmoother(LagSettings(0.5))], ids=["kalman", "lag"])
@pytest.mark.parametrize("size", [1, 7, 997])
def test_the_learnt_noise_does_not_depend_on_the_cutting(stream, size):
    acceleration, displacement = record(55, step(5.0))
    acceleration = part(acceleration, slice(3500, 4500))

    def run(block):
        filter_ = stream()
        filter_.push(displacement)
        parts = [part(acceleration, slice(start, start + block)) for start in range(0, 1000, block)]
        return np.concatenate([filter_.run(samples)[2] for samples in parts])

    whole = run(1000)
    assert whole.max() > 4.0 * whole[0]
    np.testing.assert_array_equal(run(size), whole)


def test_without_a_gate_or_a_value_nothing_is_learnt():
    acceleration, displacement = record(56, 5.0)
    for settings in (FIXED, linear(KalmanSettings()), KalmanSettings(gate=GateSettings(limit=1e9))):
        np.testing.assert_array_equal(filter_record(acceleration, displacement, settings).variance_m2, NOISE_D**2)
    # The bound is a run over zeros, which know no noise: it must not be taken for none.
    zeros = displacement_block(MET, np.zeros(len(MET)), NOISE_D**2)
    still = acceleration_block(TIME, np.zeros(LENGTH), NOISE_A**2 / 100.0)
    np.testing.assert_array_equal(filter_record(still, zeros).variance_m2, NOISE_D**2)


def test_the_band_of_an_innovation_holds_the_variance_that_was_used():
    found = filter_record(*record(57, step(5.0)))
    assert isinstance(found.variance_m2, np.ndarray)
    assert len(found.variance_m2) == len(found.innovation.value_m)
    assert np.all(found.innovation.variance_m2 > found.variance_m2)
    normal = (found.innovation.value_m / np.sqrt(found.innovation.variance_m2))[MET > 43.0]
    # Some 370 innovations: their variance is 1 ± 0.07, and the noise is known to a tenth.
    assert np.mean(normal**2) == pytest.approx(1.0, abs=0.35)


def test_a_measurement_without_a_number_teaches_nothing():
    acceleration, displacement = record(58, 5.0)
    value = displacement.value_m.copy()
    value[::3] = np.nan
    kept = part(displacement, np.isfinite(value))
    poisoned = Displacement(displacement.time_ns, value, displacement.variance_m2, displacement.source)
    np.testing.assert_array_equal(
        filter_record(acceleration, poisoned).variance_m2, filter_record(acceleration, kept).variance_m2
    )
