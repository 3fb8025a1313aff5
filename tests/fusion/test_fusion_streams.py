"""The estimator on plain arrays: rows, predictions, what is unusable, and every method of the table."""

import numpy as np
import pytest
from fusion_oracles import acceleration_block, displacement_block, filtered

from midspan.errors import UsageError
from midspan.fusion.blocks import REJECTED
from midspan.fusion.methods import DEFAULT_METHOD, METHODS, no_literal_form
from midspan.fusion.runners import run_method
from midspan.fusion.streams import NO_ERRORS, KalmanFilter, KalmanSettings, MethodSettings, smooth
from midspan.records import Estimate, Innovation, Source, Status, joined, part

TIME, MET = np.arange(4000) / 100.0, np.arange(400) / 10.0 + 0.003
OMEGA = 2 * np.pi * 0.8
NOISE_A, NOISE_D = 2e-3, 1e-4


def truth(time):
    return 2e-3 * np.sin(OMEGA * time)


def record(seed=1):
    """2 mm at 0.8 Hz, the accelerometer with a bias."""
    rng = np.random.default_rng(seed)
    value = -(OMEGA**2) * truth(TIME) + 5e-3 + rng.normal(0, NOISE_A, TIME.size)
    return (
        acceleration_block(TIME, value, NOISE_A**2 / 100.0),
        displacement_block(MET, truth(MET) + rng.normal(0, NOISE_D, MET.size), NOISE_D**2),
    )


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_default_is_a_method_and_not_printed_in_a_paper():
    assert DEFAULT_METHOD in METHODS
    assert "adaptive-kalman" in no_literal_form("smoother")


@pytest.mark.parametrize("literal", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_every_method_gives_a_row_a_sample_and_follows_a_sine(method, literal):
    acceleration, displacement = record()
    # The printed adaptive filter knows no bias but the expected one.
    settings = MethodSettings(kalman=KalmanSettings(bias=5e-3), literal=literal and METHODS[method].literal)
    found = run_method(method, acceleration, displacement, settings).estimate
    np.testing.assert_array_equal(found.time_ns, acceleration.time_ns)
    error = (found.displacement_m - truth(TIME))[1000:-500]
    # Every method must be better than the displacement itself, which is off by 0.1 mm at its own instants.
    assert rms(error) < NOISE_D


def test_an_unknown_method_is_refused_with_the_nearest_name():
    with pytest.raises(UsageError, match="kalman"):
        run_method("kalmann", *record())


def test_the_lag_lies_between_filter_and_smoother():
    acceleration, displacement = record()
    errors = [
        rms((run_method(name, acceleration, displacement).estimate.displacement_m - truth(TIME))[500:-500])
        for name in ("kalman", "lag", "smoother")
    ]
    assert errors[2] <= errors[1] <= errors[0]


def test_before_the_first_measurement_rows_are_lost_and_as_uncertain_as_the_settings_say():
    acceleration, displacement = record()
    late = part(displacement, displacement.time_ns > 10e9)
    known = KalmanSettings(displacement_std=0.5, velocity_std=0.1, bias_std=1e-3)
    causal = filtered(acceleration, late, known)[0]
    before = TIME < 10.0
    assert np.all(causal.status[before] == Status.LOST)
    # Displacement and velocity alone: 0.5² + (0.1 t)², the bias of 1e-3 m/s² adds 0.05 m after 10 s.
    expected = 0.5**2 + (0.1 * TIME[before]) ** 2 + (0.5e-3 * TIME[before] ** 2) ** 2
    np.testing.assert_allclose(causal.variance_m2[before], expected, rtol=0.01)
    # What comes later tells the smoother.
    both = smooth(acceleration, late, known).estimate
    assert np.all(both.variance_m2[before] < 0.1 * causal.variance_m2[before])
    assert np.all(np.abs(both.displacement_m - truth(TIME))[before] < 5.0 * np.sqrt(both.variance_m2[before]))


def test_without_a_measurement_every_row_is_lost():
    acceleration, displacement = record()
    for poison in (part(displacement, slice(0)), displacement_block(MET, np.full(MET.size, np.nan), 1e-8)):
        found = smooth(acceleration, poison)
        assert len(found.estimate.time_ns) == TIME.size
        assert np.all(found.estimate.status == Status.LOST)
        assert len(found.innovation.time_ns) == 0


@pytest.mark.parametrize("poison", ["nan value", "inf value", "nan variance", "inf variance"])
def test_measurements_without_a_number_change_nothing(poison):
    acceleration, displacement = record()
    without = np.ones(MET.size, dtype=bool)
    without[[0, 7, 8, 9, 200, 399]] = False
    value, variance = displacement.value_m.copy(), displacement.variance_m2.copy()
    kind, which = poison.split()
    (value if which == "value" else variance)[~without] = float(kind)
    expected = smooth(acceleration, part(displacement, without))
    got = smooth(acceleration, displacement_block(MET, value, variance))
    for name in Estimate.__slots__:
        np.testing.assert_array_equal(getattr(got.estimate, name), getattr(expected.estimate, name), err_msg=name)
    assert len(got.innovation.value_m) == np.count_nonzero(without)


def test_outliers_are_rejected_unless_no_errors_are_expected():
    acceleration, displacement = record()
    wrong = np.arange(30, 390, 9)
    displacement.value_m[wrong] += 5e-3
    found = smooth(acceleration, displacement)
    np.testing.assert_array_equal(np.flatnonzero(found.innovation.verdict == REJECTED), wrong)
    reported = smooth(acceleration, displacement, KalmanSettings(rates=NO_ERRORS))
    assert not np.any(reported.innovation.verdict)
    assert rms(found.estimate.displacement_m - truth(TIME)) < 0.3 * rms(reported.estimate.displacement_m - truth(TIME))


@pytest.mark.parametrize("place", [3, 200, 396])
def test_without_errors_every_row_is_linear_in_the_measurements(place):
    acceleration, displacement = record()
    known = KalmanSettings(rates=NO_ERRORS, noise_memory=np.inf)
    moved = displacement_block(MET, displacement.value_m + 10.0 * (np.arange(MET.size) == place), NOISE_D**2)
    twice = displacement_block(MET, displacement.value_m + 20.0 * (np.arange(MET.size) == place), NOISE_D**2)
    plain, once, more = (
        smooth(acceleration, one, known).estimate.displacement_m for one in (displacement, moved, twice)
    )
    # Ten metres to fifteen digits.
    np.testing.assert_allclose(more - plain, 2.0 * (once - plain), atol=1e-12)


def test_each_source_has_its_own_noise_and_marks_its_rows():
    acceleration, displacement = record()
    rng = np.random.default_rng(3)
    value = truth(MET + 0.05) + rng.normal(0, 10 * NOISE_D, MET.size)
    second = displacement_block(MET + 0.05, value, NOISE_D**2, source=Source.RADAR)
    both = joined([displacement, second])
    both = part(both, np.argsort(both.time_ns))
    alone, found = smooth(acceleration, displacement).estimate, smooth(acceleration, both).estimate
    assert set(found.source[500:-500].tolist()) == {Source.DISPLACEMENT}
    # The second one's noise is ten times the declared one; followed, it does no harm.
    assert rms((found.displacement_m - truth(TIME))[500:]) < 1.1 * rms((alone.displacement_m - truth(TIME))[500:])


def test_a_prediction_is_the_row_that_comes_next_but_for_the_motion_of_one_step():
    acceleration, displacement = record()
    stream = KalmanFilter()
    assert np.isinf(stream.predict(0)[1])
    stream.push(displacement)
    outputs = stream.push(part(acceleration, slice(3000)))
    value, variance = stream.predict(int(acceleration.time_ns[3000]))
    (row,) = [item for item in stream.push(part(acceleration, slice(3000, 3001))) if isinstance(item, Estimate)]
    # The acceleration that was held changes by 2.5 mm/s² in a step of 10 ms, and by its noise of 2.8 mm/s²: a sixth and
    # a third of both times 1e-4 s² are 0.1 µm.
    assert value == pytest.approx(row.displacement_m[0], abs=5e-7)
    assert variance == pytest.approx(row.variance_m2[0], rel=1e-3)
    assert any(isinstance(item, Innovation) for item in outputs)


def test_a_stream_gives_the_rows_of_the_whole_record_from_the_first_measurement_on():
    acceleration, displacement = record()
    stream = KalmanFilter()
    stream.push(displacement)
    outputs = [*stream.push(acceleration), *stream.finish()]
    rows = joined([item for item in outputs if isinstance(item, Estimate)])
    expected = filtered(acceleration, displacement)[0]
    np.testing.assert_array_equal(rows.time_ns, expected.time_ns[1:])
    # The start is 7 ms later: what it knows is forgotten after the first seconds.
    np.testing.assert_allclose(rows.displacement_m[500:], expected.displacement_m[501:], atol=1e-9)


def test_what_is_held_does_not_grow():
    stream, sizes = KalmanFilter(lag_samples=50), []
    for block in range(30):
        rng = np.random.default_rng(block)
        time, met = 20.0 * block + np.arange(2000) / 100.0, 20.0 * block + np.arange(200) / 10.0 + 0.003
        stream.push(displacement_block(met, rng.normal(0, 1e-4, 200) + 5e-3 * (rng.random(200) < 0.1), 1e-8))
        stream.push(acceleration_block(time, rng.normal(0, 2e-3, 2000), 4e-8))
        sizes.append(sum(stream._estimator.core.held()))
    # The lag and a quarter of it, and what is not decided yet.
    assert max(sizes[3:]) < 1000


@pytest.mark.parametrize("seed", [3, 7, 36, 45])
def test_no_start_leaves_all_that_is_measured_later_rejected(seed):
    # Four of the first eight values are 10 to 60 deviations off: no hypothesis may be right, and one must find back.
    rng = np.random.default_rng(seed)
    time, met, parts = np.arange(1000) / 100.0, np.arange(100) / 10.0 + 0.004, ((8e-3, 0.1), (3e-3, 3.3))

    def moved(at):
        return sum(size * np.sin(2 * np.pi * hz * at) for size, hz in parts)

    value, wrong = moved(met) + rng.normal(0, NOISE_D, met.size), rng.choice(8, 4, replace=False)
    value[wrong] += rng.choice([-1.0, 1.0], 4) * rng.uniform(1e-3, 6e-3, 4)
    pushed = -sum(size * (2 * np.pi * hz) ** 2 * np.sin(2 * np.pi * hz * time) for size, hz in parts) + 5e-3
    acceleration = acceleration_block(time, pushed + rng.normal(0, NOISE_A, time.size), NOISE_A**2 / 100.0)
    found = filtered(acceleration, displacement_block(met, value, NOISE_D**2))[0]
    settled = found.time_ns > 7e9
    # Six deviations of the causal band (0.06 mm).
    assert np.abs(found.displacement_m - moved(found.time_ns / 1e9))[settled].max() < 4e-4
