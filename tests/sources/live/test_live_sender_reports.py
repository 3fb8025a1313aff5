"""The clock of a network camera by its sender reports: one alone is not used, whatever it says."""

import numpy as np
import pytest

from midspan.records import NANOSECONDS
from midspan.sources.live.instants import SenderReports

BEGIN_NS = 1_790_000_000 * NANOSECONDS
RATE_HZ = 20


def packets(offsets_ms, per_report=100, seed=0):
    """Stream times and the sender's instants, whole microseconds, of packets under reports with these offsets."""
    rng = np.random.default_rng(seed)
    for number, offset_ms in enumerate(offsets_ms):
        for k in range(per_report):
            stream_s = (number * per_report + k) / RATE_HZ
            exact_us = BEGIN_NS / 1e3 + 1e6 * stream_s + 1e3 * offset_ms
            yield stream_s, 1000 * round(exact_us + rng.uniform(-0.5, 0.5))


def test_a_single_report_is_not_used():
    reports = SenderReports()
    for stream_s, sent_ns in packets([-62.7], 1000):
        reports.take(stream_s, sent_ns)
        assert reports.instant_ns(stream_s) is None


@pytest.mark.parametrize(
    ("offsets_ms", "used_from"), [([0.3, 0.31], 1), ([-41.0, 0.3, 0.31], 2), ([-41, 9, 0, 0.5], 3)]
)
def test_stamps_are_the_senders_once_two_reports_agree(offsets_ms, used_from):
    reports = SenderReports()
    for k, (stream_s, sent_ns) in enumerate(packets(offsets_ms)):
        reports.take(stream_s, sent_ns)
        found = reports.instant_ns(stream_s)
        # A report is known by its second packet.
        if k <= 100 * used_from:
            assert found is None
        else:
            # The rounding of two clocks to microseconds.
            error_ns = found - BEGIN_NS - round(NANOSECONDS * stream_s) - round(1e6 * offsets_ms[k // 100])
            assert abs(error_ns) < (2_000 if k % 100 else 1e6)


def test_the_first_packet_may_carry_another_frames_instant():
    reports = SenderReports()
    for k, (stream_s, sent_ns) in enumerate(packets([0.0, 0.0071])):
        reports.take(stream_s, sent_ns + (48_677_778 if k == 0 else 0))
    assert abs(reports.instant_ns(0.0) - BEGIN_NS) < 10_000


def test_a_clock_that_is_set_while_it_runs_is_followed():
    reports = SenderReports()
    for stream_s, sent_ns in packets([0.0, 0.0071, 300.0]):
        reports.take(stream_s, sent_ns)
    # One report may be wrong.
    assert abs(reports.instant_ns(0.0) - BEGIN_NS) < 10_000
    for stream_s, sent_ns in packets([300.0071]):
        reports.take(stream_s, sent_ns)
    assert abs(reports.instant_ns(0.0) - BEGIN_NS - 300_007_100) < 2_000
