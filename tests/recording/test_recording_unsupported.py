"""Long segments without a displacement: their rows are lost, reported once, and inside a band that says so."""

import numpy as np
import pytest

import midspan
from midspan.records import Status
from midspan.simulate.scenarios.write import write
from recording_edits import read_columns
from repeats import slow

GAP = (95.0, 110.0)


@pytest.fixture(scope="module")
def damaged(tmp_path_factory):
    """GNSS heights at 1 Hz, 15 s of them without a value."""
    folder = tmp_path_factory.mktemp("unsupported") / "gnss"
    write("gnss", folder, seed=3)
    lines = (folder / "gnss.csv").read_text(encoding="utf-8").splitlines()
    kept = [
        line.split(",")[0] + "," if k and GAP[0] <= float(line.split(",")[0]) < GAP[1] else line
        for k, line in enumerate(lines)
    ]
    (folder / "gnss.csv").write_text("\n".join(kept) + "\n", encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def calibration(damaged):
    return midspan.calibrate(midspan.open_recording(damaged))


@pytest.mark.parametrize("method", ["lag", "smoother", "fir", *slow("kalman", "adaptive-kalman", "two-stage-fir")])
def test_fifteen_seconds_without_a_value_are_lost_reported_and_inside_the_band(damaged, calibration, method):
    found = midspan.estimate(midspan.open_recording(damaged), calibration, method=method)
    gap = (found.time_s > GAP[0] - 1.0) & (found.time_s < GAP[1] - 0.6)
    status = found.estimate.status[gap]
    # The last value is of 94 s: 2.5 s of age make a row coasting, ten make it lost.
    assert np.mean(status == Status.LOST) > 0.25
    assert np.all(status[found.time_s[gap] > 97.0] != Status.TRACKING)
    # Whatever the method, the user reads it once: the rows of each method have the same ages.
    (reported,) = [event for event in found.events if event.kind == "lost" and 93.9 < event.time_ns / 1e9 < 97.0]
    assert reported.text in found.warnings
    truth = read_columns(damaged / "truth.csv")
    error = found.displacement_mm - np.interp(found.time_s, truth[:, 0], truth[:, 1])
    # One curve of an error that is alike all through the gap: a single draw, and a band that grows with it.
    assert np.max(np.abs(error / found.displacement_std_mm)[gap]) < 3.5
    assert np.max(found.displacement_std_mm[gap]) > 2.0 * np.min(found.displacement_std_mm[gap])


def test_a_gap_that_is_only_coasted_through_is_not_reported_as_lost(damaged, calibration):
    found = midspan.estimate(midspan.open_recording(damaged), calibration, method="kalman")
    # The scenario's own gap of four seconds, from 120 s on.
    rows = (found.time_s > 122.6) & (found.time_s < 123.9)
    assert np.all(found.estimate.status[rows] == Status.COASTING)
    assert not any(event.kind == "lost" and event.time_ns / 1e9 > 118.0 for event in found.events)
