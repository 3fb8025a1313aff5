"""Every method and tracker as printed runs live: the rows of a point that is fed in any way are those of `estimate`."""

from functools import cache

import numpy as np
import pytest
from test_live_equals_file import CASES, Site, assert_same, assert_same_events, interleaved, live, records

import midspan
from recording_edits import set_keys
from repeats import slow

PRINTED = ("adaptive-kalman", "fir", "two-stage-fir")
TRACKERS = ("template", "features", "phase", "hybrid")


def assert_live_is_file(site, method):
    result = midspan.estimate(site.recording(method), site.calibration, method=method)
    assert len(result.estimate.time_ns) > 1000
    outcome = live(site, method, 1)
    assert_same(outcome.estimate(0), result.estimate)
    assert_same_events(outcome, result)
    if result.across is not None:
        assert_same(outcome.estimate(1), result.across.estimate)
    return result


SITES = ("lossless", "displacement", "two axes", "radar")
# Each method with two sites, each site with a method.
PAIRS = [
    ("lossless", "fir"), ("lossless", "adaptive-kalman"), ("displacement", "two-stage-fir"),
    ("two axes", "two-stage-fir"), ("radar", "adaptive-kalman"), ("radar", "fir"),
]  # fmt: skip
REST = [(site, method) for site in SITES for method in PRINTED if (site, method) not in PAIRS]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The site of a case, made once."""
    return cache(lambda case: Site(CASES[case](tmp_path_factory.mktemp("live") / "site"), literal=True))


@pytest.mark.parametrize(("case", "method"), [*PAIRS, *slow(*REST)])
def test_rows_of_the_file_are_rows_of_the_point(case, method, made):
    assert_live_is_file(made(case), method)


@pytest.mark.parametrize("tracker", TRACKERS)
def test_with_each_tracker_as_printed_and_the_predictions_of_the_printed_filter(tracker, tmp_path):
    folder = CASES["lossless"](tmp_path / "site")
    set_keys(folder, "camera", tracker=tracker)
    assert_live_is_file(Site(folder, literal=True), "adaptive-kalman")


@pytest.mark.parametrize("method", PRINTED)
def test_a_row_comes_after_the_stated_delay_and_at_most_a_quarter_more(method, made):
    site = made("lossless")
    result = midspan.estimate(site.recording(method), site.calibration, method=method)
    point, sides, tracked_cameras = site.opened(method)
    late_s, push = [], point.estimator.push

    def pushed(record):
        out = push(record)
        newest = [rows.estimates[0].time_ns[-1] for rows in out if rows.estimates and len(rows.estimates[0].time_ns)]
        late_s.extend((int(record.time_ns[-1]) - int(one)) / 1e9 for one in newest)
        return out

    point.estimator.push = pushed
    for arrival in interleaved(records(point, sides, tracked_cameras, rng := np.random.default_rng(1)), rng):
        point.push(arrival)
    step_s = 0.01
    assert result.delay_s == pytest.approx(point.estimator.lag_samples * step_s)
    # Blocks of samples that are pushed hold up to a second.
    assert min(late_s) >= result.delay_s - 1e-9
    assert np.median(late_s) <= 1.25 * result.delay_s + step_s


def test_a_filter_that_is_longer_than_the_record_says_that_the_rows_are_the_estimators(tmp_path):
    folder = CASES["lossless"](tmp_path / "site")
    set_keys(folder, "fusion", method="fir", literal=True, half_window=100_000)
    result = midspan.estimate(folder)
    assert sum("gives no row here" in str(one) for one in result.warnings) == 1
