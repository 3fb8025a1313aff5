"""A sensor's clock that is set in mid-stream."""

import re

import numpy as np
import pytest
from estimator_cases import (
    BRIDGE,
    FINE_HZ,
    Found,
    estimated,
    measured_of,
    oscillating,
    samples_of,
    scores,
    sensor_of,
)

from midspan.fusion.estimator import Estimator, Lag
from midspan.fusion.model import EstimatorSettings, Parameter, ParameterKind
from midspan.records import Event, joined, part, seconds

LENGTH_S, SET_AT_S, SET_BY_S = 80.0, 20.0, 0.3
# Standard deviation (m) and middle angular frequency (1/s) of the motion without a passage.
MOTION = ((float(np.hypot(1e-3, 1.5e-3)), 15.0), (0.0, 0.0))
# How far (m) and for how long (s) a passage bends the structure.
BENT_M, PASSAGE_S = 15e-3, 1.6


def passages(rng):
    """The usual motion and, every eight seconds, a passage: a raised cosine, whose acceleration is exact."""
    truth = oscillating(rng, LENGTH_S, BRIDGE[1:])
    time = np.arange(len(truth.x)) / FINE_HZ
    rate = 2.0 * np.pi / PASSAGE_S
    for start_s in np.arange(6.0, LENGTH_S - 4.0, 8.0) + rng.uniform(0.0, 4.0):
        within = (time >= start_s) & (time < start_s + PASSAGE_S)
        phase, bent = rate * (time[within] - start_s), BENT_M * rng.uniform(0.7, 1.0)
        truth.x[within] += 0.5 * bent * (1.0 - np.cos(phase))
        truth.a[within] += 0.5 * bent * rate**2 * np.cos(phase)
    return truth


# A sensor's clock is estimated, and follows a drift of 60 ppm.
CLOCK = Parameter(ParameterKind.CLOCK_OFFSET, (0,), 0.0, 0, 3.6e-9)


def test_a_clock_that_is_set_is_found_under_passages():
    inside, worst = [], []
    for seed in range(1, 5):
        rng = np.random.default_rng(seed)
        truth = passages(rng)
        sensor = sensor_of(truth, rng, length_s=LENGTH_S)
        sensor.time[sensor.time >= SET_AT_S] += SET_BY_S
        samples = samples_of(truth, rng, length_s=LENGTH_S)
        found = estimated(samples, [sensor], motion=MOTION, parameters=(CLOCK,))
        assert [event.kind for event in found.events].count("clock") == 1
        _, error = found.error_of(truth)
        worst.append(np.abs(error).max())
        inside.append(np.mean(np.abs(error) < 1.96 * np.sqrt(found.rows.variance_m2)))
    # Until the step is found a row may be as wrong as a passage is high.
    assert max(worst) < BENT_M
    assert 0.93 < np.mean(inside) < 0.99


@pytest.mark.parametrize("set_by_s", [0.3, -0.06, 0.02])
def test_a_step_of_a_clock_is_found_and_corrected(set_by_s):
    """After it rows are as good as without it, but where the clock runs ahead so that measurements come late."""
    set_at_s, length_s = 30.0, 60.0
    rng = np.random.default_rng(5)
    truth = oscillating(rng, length_s, BRIDGE[1:])
    samples, sensor = samples_of(truth, rng, length_s=length_s), sensor_of(truth, rng, length_s=length_s)
    how = {"motion": MOTION, "parameters": (CLOCK,)}
    sound, late = estimated(samples, [sensor], **how), (set_at_s + 2.0, length_s - 1.0)
    assert "clock" not in {event.kind for event in sound.events}
    expected = scores(sound, truth, inner=late)[0]
    sensor.time[sensor.time >= set_at_s] += set_by_s
    found = estimated(samples, [sensor], **how)
    (event,) = [event for event in found.events if event.kind == "clock"]
    # What is added is the opposite of the step: to 5 ms, when it is found.
    added_ms = float(re.search(r"accelerometer's: ([-+]?[\d.]+)", event.text)[1])
    assert abs(added_ms + 1e3 * set_by_s) < 5.0
    rms, _, inside = scores(found, truth, inner=late)
    assert inside > 0.9
    assert rms < (2.0 if set_by_s > 0.1 else 1.2) * expected
    # The lag gives rows later, with what was decided anew.
    stream = Lag(EstimatorSettings((sensor.channel,), **how), 50)
    outputs = [*stream.push(measured_of([sensor])), *stream.push(samples), *stream.finish()]
    lagged = Found(joined([one.estimates[0] for one in outputs if one.estimates]), [], stream, outputs)
    assert scores(lagged, truth, inner=late)[0] < rms
    assert scores(lagged, truth, inner=late)[2] > 0.88


def test_any_cutting_and_a_restart_give_the_same_rows_while_a_step_is_looked_for():
    set_at_s, length_s = 10.0, 16.0
    rng = np.random.default_rng(6)
    truth = oscillating(rng, length_s, BRIDGE[1:])
    samples, sensor = samples_of(truth, rng, length_s=length_s), sensor_of(truth, rng, length_s=length_s)
    sensor.time[sensor.time >= set_at_s] += SET_BY_S
    settings = EstimatorSettings((sensor.channel,), motion=MOTION, parameters=(CLOCK,))
    measured = measured_of([sensor])
    for make in (Estimator, lambda known: Lag(known, 50)):
        rows, sought = [], False
        for step in (len(samples.time_ns), 7):
            stream, outputs, due = make(settings), [], 0
            for first in range(0, len(samples.time_ns), step):
                block = part(samples, slice(first, first + step))
                end = int(np.searchsorted(measured.time_ns, block.time_ns[-1], side="right"))
                outputs += stream.push(part(measured, slice(due, end)))
                outputs += stream.push(block)
                due = end
                sought |= stream.seeks_clock
                if step == 7:
                    again = make(settings)
                    again.restore(stream.state)
                    stream = again
            outputs += stream.finish()
            rows.append(joined([one.estimates[0] for one in outputs if one.estimates]))
        assert sought
        assert not stream.seeks_clock
        np.testing.assert_array_equal(rows[0].displacement_m, rows[1].displacement_m)
        np.testing.assert_array_equal(rows[0].variance_m2, rows[1].variance_m2)


def test_no_clock_step_is_claimed_where_the_prediction_tells_nothing():
    """Both were away and the stamps went back: predictions are off by decimetres, and sound measurements within that.

    As a clock that stepped the sensor bounds the slow motion alone, with a band sixty times too wide for good.
    """
    away_s, back_s, cut_ns = 20.0, 35.0, round(35.1e9)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        truth = oscillating(rng, 60.0, BRIDGE[1:])
        samples, sensor = samples_of(truth, rng, length_s=60.0), sensor_of(truth, rng, length_s=60.0)
        seen = (sensor.time < away_s) | (sensor.time > back_s)
        for name in ("time", "value", "variance", "reference"):
            setattr(sensor, name, getattr(sensor, name)[seen])
        time_s = seconds(samples.time_ns, 0)
        bridged = (time_s > away_s) & (time_s < back_s)
        samples.value_m_s2[bridged], samples.noise_density[bridged] = 5e-3, 1e-3
        settings = EstimatorSettings((sensor.channel,), motion=MOTION, parameters=(CLOCK,))
        estimator, outputs = Estimator(settings), []
        measured = measured_of([sensor])
        for half in (np.less, np.greater_equal):
            outputs += estimator.push(part(measured, half(measured.time_ns, cut_ns)))
            outputs += estimator.push(part(samples, half(samples.time_ns, cut_ns)))
            outputs += estimator.push(Event(cut_ns, "clock", ""))
        outputs += estimator.finish()
        events = {event.kind for one in outputs for event in one.events}
        assert "clock" not in events
        found = Found(joined([one.estimates[0] for one in outputs if one.estimates]), events, estimator, outputs)
        std = np.sqrt(found.rows.variance_m2)
        at_s = seconds(found.rows.time_ns, 0)
        before, after = (np.median(std[(at_s > a) & (at_s < b)]) for a, b in ((10.0, 20.0), (40.0, 58.0)))
        assert np.max(std[(at_s > 34.0) & (at_s < back_s)]) > 0.1
        # The noise's level is followed: its standard deviation scatters by 7 %.
        assert after < 1.3 * before
        assert scores(found, truth, inner=(38.0, 58.0))[0] < 0.1
