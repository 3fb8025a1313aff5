"""A sensor's clock that is set in mid-stream, where heavy passages are many times larger than the motion usually is."""

import numpy as np
from estimator_cases import BRIDGE, FINE_HZ, estimated, oscillating, samples_of, sensor_of

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
