"""The liveliest part of a record: found by its variance, not by its mean."""

import numpy as np

from midspan.recording.streams.window import liveliest
from midspan.records import NANOSECONDS

TIME_NS = np.round(np.arange(0.0, 300.0, 0.02) * NANOSECONDS).astype(np.int64)


def shaken(first_s):
    """Gravity and noise, and a minute of motion from an instant on."""
    time_s = TIME_NS / NANOSECONDS
    noise = 0.01 * np.random.default_rng(1).normal(size=len(time_s))
    moving = (time_s >= first_s) & (time_s < first_s + 60.0)
    # A slow drift of the bias by 1 m/s² is no motion of a minute.
    return 9.81 + time_s / 300.0 + noise + np.where(moving, np.sin(9.0 * time_s), 0.0)


def test_the_minute_of_motion_is_found():
    span_ns = int(TIME_NS[0]), int(TIME_NS[-1])
    assert liveliest(TIME_NS, shaken(140.0), span_ns, 60.0) == 140 * NANOSECONDS
    # Only what both streams hold counts.
    assert liveliest(TIME_NS, shaken(140.0), (0, 150 * NANOSECONDS), 60.0) == 90 * NANOSECONDS


def test_nothing_is_moved_where_the_first_minute_is_the_liveliest_or_the_only_one():
    assert liveliest(TIME_NS, shaken(0.0), (0, int(TIME_NS[-1])), 60.0) is None
    assert liveliest(TIME_NS, shaken(140.0), (0, 65 * NANOSECONDS), 60.0) is None
