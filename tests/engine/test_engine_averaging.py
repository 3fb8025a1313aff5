"""Measurements that are means over an exposure: completed by the acceleration, and no camera waits for it."""

import numpy as np
import pytest

from midspan.engine.averaging import Averaging, in_displacement_alone
from midspan.engine.sensors import Seen
from midspan.records import Channel, Measured, SampleKind, Samples, Source, joined, nanoseconds

HERTZ, EXPOSURE_S, BIAS = 2.0, 0.2, 0.3
OMEGA = 2.0 * np.pi * HERTZ
CHANNEL = Channel("level", Source.DISPLACEMENT, 1.0, exposure_s=EXPOSURE_S)


def samples(time_s):
    acceleration = BIAS - OMEGA**2 * np.sin(OMEGA * time_s)
    kinds = np.full(len(time_s), SampleKind.MEASURED, dtype=np.uint8)
    return Samples(nanoseconds(time_s), acceleration[:, None], np.ones((len(time_s), 1)), kinds)


def measured(at_s):
    mean = np.sinc(HERTZ * EXPOSURE_S) * np.sin(OMEGA * at_s)
    zeros = np.zeros(len(at_s))
    return Measured(nanoseconds(at_s), zeros.astype(np.int64), mean, zeros, zeros)


@pytest.mark.parametrize("length", [7, 400])
def test_a_mean_becomes_what_its_first_term_says(length):
    held = Averaging([CHANNEL])
    assert held.seen(Seen("level", measured(np.arange(0.57, 3.4, 0.23)))).measured is None
    time_s = np.arange(0.0, 4.0, 0.005)
    complete, given = [], []
    for first in range(0, len(time_s), length):
        found, due = held.sampled(samples(time_s[first : first + length]))
        complete += [one.measured for one in found]
        given.append(due)
        # A sample goes on once half an exposure has come after it.
        if len(due.time_ns):
            assert due.time_ns[-1] <= nanoseconds(time_s[: first + length])[-1] - 100_000_000
    _, rest = held.finish()
    np.testing.assert_array_equal(joined([*given, rest]).time_ns, nanoseconds(time_s))
    found = joined(complete)
    at_s = found.time_ns * 1e-9
    # The estimator's own equation: displacement and T²/24 of the acceleration with its bias.
    expected = np.sin(OMEGA * at_s) - EXPOSURE_S**2 / 24.0 * OMEGA**2 * np.sin(OMEGA * at_s)
    # Straight lines between samples leave (omega dt)²/12 of 0.24.
    np.testing.assert_allclose(found.value, expected, atol=2e-4)


def test_no_samples_wait_where_a_camera_is_predicted():
    assert in_displacement_alone([CHANNEL])
    assert not in_displacement_alone([CHANNEL, Channel("camera", Source.CAMERA, 1.0)])
