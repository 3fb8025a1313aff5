"""A sensor's clock that is set in mid-stream, where heavy passages are many times larger than the motion usually is."""

import numpy as np
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

from midspan.fusion.estimator import Estimator
from midspan.fusion.model import EstimatorSettings
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


def test_a_clock_that_is_set_costs_less_than_a_passage():
    inside = []
    for seed in range(1, 7):
        rng = np.random.default_rng(seed)
        truth = passages(rng)
        sensor = sensor_of(truth, rng, length_s=LENGTH_S)
        sensor.time[sensor.time >= SET_AT_S] += SET_BY_S
        found = estimated(samples_of(truth, rng, length_s=LENGTH_S), [sensor], motion=MOTION)
        assert "clock" in {event.kind for event in found.events}
        _, error = found.error_of(truth)
        # Two instants of the motion are no farther apart than a passage is high: as wrong as that a row may be.
        assert np.abs(error).max() < BENT_M
        inside.append(np.mean(np.abs(error) < 1.96 * np.sqrt(found.rows.variance_m2)))
    # The two instants differ for as long as a passage lasts, longer than the usual motion says: of each passage's rows
    # some are outside, 1 to 3 % of all rows.
    assert np.mean(inside) > 0.91


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
        estimator, outputs = Estimator(EstimatorSettings((sensor.channel,), motion=MOTION)), []
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
