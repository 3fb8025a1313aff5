"""Outliers among the first measurements of a record, where nothing is known that they could contradict."""

import numpy as np
import pytest
from estimator_cases import estimated, oscillating, samples_of, sensor_of

from midspan.fusion.blocks import REJECTED

SEEDS = range(1000, 1040)
LENGTH_S, FIRST_S = 10.0, 0.504


@pytest.mark.parametrize(
    ("which", "zero_ns"), [([0], None), ([1], round(FIRST_S * 1e9)), ([0, 1], round(FIRST_S * 1e9)), ([1, 2], None)]
)
def test_outliers_among_the_first_are_reported_and_the_band_holds(which, zero_ns):
    inside = []
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        truth = oscillating(rng, LENGTH_S)
        samples = samples_of(truth, rng, length_s=LENGTH_S)
        sensor = sensor_of(truth, rng, length_s=LENGTH_S)
        sensor.value[which] += rng.choice([-1.0, 1.0], len(which)) * rng.uniform(0.05, 1.0, len(which))
        found = estimated(samples, [sensor], zero_ns=zero_ns)
        verdict = np.concatenate([one.innovations[0].verdict for one in found.outputs if one.innovations])
        assert list(np.flatnonzero(verdict[:20] == REJECTED)) == which
        time_s, error = found.error_of(truth, None if zero_ns is None else FIRST_S)
        late = time_s > FIRST_S + 2.0
        inside.append(np.mean(np.abs(error[late]) < 1.96 * np.sqrt(found.rows.variance_m2[late])))
    # Rows of one record hang together over a second, those that count from the first instant by its error too: 40
    # records are 40 to 300 independent ones, of which 95 ± 1.5 % lie inside.
    assert np.mean(inside) >= 0.93
