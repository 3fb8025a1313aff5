"""What each hypothesis is worth before the measurement speaks: a probability."""

import numpy as np
import pytest
from estimator_cases import camera

from midspan.fusion.forward import MEASUREMENT_COLUMNS
from midspan.fusion.hypothesis import (
    ACCEPTED_AT,
    CLOCK,
    KINDS,
    LOST,
    MET_AT,
    NOISE,
    RETURN,
    SHIFT,
    SHIFTED,
    WRONG,
    one_of,
)
from midspan.fusion.innovation import look
from midspan.fusion.model import Beginning, EstimatorSettings, hypotheses_at, options_of, tables_of
from midspan.fusion.weighing import log_any_size, log_normal, weigh

# From a frame to a month.
LAPSES_S = (0.04, 10.0, 3600.0, 86400.0, 2.6e6)


@pytest.mark.parametrize("shifted", [False, True])
@pytest.mark.parametrize("lapse_s", LAPSES_S)
def test_no_prior_is_more_than_certain(lapse_s, shifted):
    settings = EstimatorSettings((camera(),), motion=((2e-3, 10.0), (0.0, 0.0)), displacement_std_m=1e-4)
    tables, options = tables_of(settings), options_of(settings)
    begin = Beginning(0.0, np.zeros(1), np.zeros(1), np.array([1e-4]), np.array([1e-3]), 0)
    hyps, motion, _ = hypotheses_at(begin, settings)
    hyp, scene, scratch = one_of(hyps, 0), (motion, 0.0, 0.0), (np.zeros(settings.size), np.zeros(1))
    mark = hyp[2][0]
    mark[[ACCEPTED_AT, MET_AT, SHIFTED]] = 0.0, 0.0, float(shifted)
    row = np.zeros(MEASUREMENT_COLUMNS)
    # 10 mm off, of a prediction that is good to 0.1 mm.
    row[[0, 2, 3]] = lapse_s, 1e-2, 1e-8
    chances = np.empty(KINDS)
    weigh(hyp, row, scene, tables, options, scratch, (False, 2e-8), chances)
    error, _, wider, own = look(hyp, row, scene, tables, scratch)
    any_size = log_any_size(error, wider + own)
    for kind in (SHIFT, WRONG, NOISE, LOST):
        prior = np.exp(chances[kind] - any_size)
        # Once an hour, as a Poisson process.
        assert prior == pytest.approx(1.0 - np.exp(-lapse_s / 3600.0), rel=1e-9)
    if shifted:
        # Nothing is known of a shift's size here: without it the innovation is the same.
        assert np.exp(chances[RETURN] - log_normal(error, wider + own)) <= 1.0 + 1e-12
    else:
        apart = tables[1][0, 9]
        assert np.exp(chances[CLOCK] - log_normal(error, wider + own + apart)) <= 1.0 + 1e-12
