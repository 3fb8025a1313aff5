"""The second look: the estimator run again over what its first pass logged."""

import numpy as np
import pytest

from midspan.engine.channels import CLOCK_WALK
from midspan.engine.second_look import once_more
from midspan.fusion.estimator import Estimator
from midspan.fusion.model import EstimatorSettings, Parameter, ParameterKind
from midspan.records import Channel, Event, Measured, Samples, Source, part, seconds
from midspan.simulate.motion.motion import random_motion

RATE_HZ, LEVEL_HZ, LENGTH_S, BACK_S = 100.0, 20.0, 40.0, 20.0
NOISE_A, NOISE_M = 2e-3, 1e-4


def recorded(step_s):
    """Samples, and a sensor whose clock steps by `step_s` at `BACK_S`: its stamps are later than they should be."""
    rng = np.random.default_rng(3)
    motion = random_motion((0.5, 4.0), 2e-3, rng=rng, flat="velocity")
    times = [np.arange(0.0, LENGTH_S, 1.0 / rate) for rate in (RATE_HZ, LEVEL_HZ)]
    acceleration = motion.acceleration(times[0]) + rng.normal(0, NOISE_A, len(times[0]))
    late = np.where(times[1] > BACK_S, step_s, 0.0)
    value = motion.displacement(times[1] - late) + rng.normal(0, NOISE_M, len(times[1]))
    stamps = [np.rint(1e9 * own).astype(np.int64) for own in times]
    density = np.full((len(times[0]), 1), NOISE_A**2 / RATE_HZ)
    samples = Samples(stamps[0], acceleration[:, None], density, np.zeros(len(times[0]), dtype=np.uint8))
    nothing = np.zeros(len(value))
    return samples, Measured(stamps[1], nothing.astype(np.int64), value, nothing + NOISE_M**2, nothing)


@pytest.mark.parametrize("step_s", [0.0, 0.1])
def test_what_the_first_pass_doubted_is_doubted_again(step_s):
    samples, measured = recorded(step_s)
    clock = Parameter(ParameterKind.CLOCK_OFFSET, (0,), 0.0, 0, CLOCK_WALK)
    level, motion = Channel("level", Source.DISPLACEMENT, 1.0), ((2e-3, 10.0), (0.0, 0.0))
    settings = EstimatorSettings((level,), parameters=(clock,), motion=motion)
    first, rows = Estimator(settings, log=True), []
    first.push(measured)
    rows += first.push(part(samples, samples.time_ns <= BACK_S * 1e9))
    first.push(Event(round(BACK_S * 1e9) + 1, "backwards", "Stamps went back."))
    rows += first.push(part(samples, samples.time_ns > BACK_S * 1e9))
    rows += first.finish()
    log, again = once_more(settings, first, [measured])
    assert len(log.went_back_ns) == 1
    assert [e.text for one in again for e in one.events] == [e.text for one in rows for e in one.events]
    # The same records in other blocks: the same bits, of the smoothed rows too.
    found, expected = log.smoothed(settings)[0], first.smoothed(settings)[0]
    for name in ("time_ns", "displacement_m", "variance_m2", "source", "status"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    if step_s:
        # A step of a clock, which the motion shows within two seconds, is found where stamps went back.
        reported = [event for one in again for event in one.events if event.kind == "clock"]
        assert len(reported) == 1
        assert BACK_S <= seconds(np.array([reported[0].time_ns]), 0)[0] < BACK_S + 2.0
