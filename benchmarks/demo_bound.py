"""The demo's recording over held-out seeds: error against the least that its known noise allows."""

import tempfile
from pathlib import Path

import numpy as np

import midspan
from benchmarks.table import goal, show
from midspan.evaluate.bound import least_error_mm
from midspan.evaluate.metrics import Band, compare
from midspan.records import TimeSeries
from midspan.simulate.scenarios.write import write

# Never used while the demo was made.
SEEDS = range(200, 212)
SCALE_M_PER_PX, OFFSET_S = -1.5e-3, 0.137


def main() -> None:
    rows = []
    for seed in SEEDS:
        with tempfile.TemporaryDirectory() as folder:
            recording = midspan.open_recording(write("footbridge", Path(folder) / "recording", seed=seed))
            result = midspan.estimate(recording)
            rows_of = TimeSeries(result.estimate.time_ns, result.estimate.displacement_m)
            found = compare(rows_of, recording.reference, band=Band(np.sqrt(result.estimate.variance_m2)))
            camera = result.calibration.camera
            rows.append(
                [
                    seed,
                    found.rmse_mm,
                    found.rmse_without_bias_mm,
                    found.rmse_mm / least_error_mm(result),
                    found.coverage_95,
                    100.0 * abs(camera.scale.value_m_per_px / SCALE_M_PER_PX - 1.0),
                    1e3 * abs(camera.offset.value_s - OFFSET_S),
                ]
            )
    show(["seed", "RMSE mm", "without bias", "over bound", "in 95 % band", "scale error %", "offset error ms"], rows)
    table = np.array([row[1:] for row in rows], dtype=float)
    # The zero rests on one frame, so that single seeds scatter by half; what is bounded is the mean square.
    goal("RMSE over bound, root mean square over the seeds", float(np.sqrt(np.mean(table[:, 2] ** 2))), 1.3)
    goal("default seed", _default(), 1.3)
    goal("distance of the mean coverage from 95 %", float(abs(np.mean(table[:, 3]) - 0.95)), 0.03)
    goal("worst scale error", float(table[:, 4].max()), 0.3, unit="%")
    goal("worst offset error", float(table[:, 5].max()), 1.0, unit="ms")


def _default() -> float:
    with tempfile.TemporaryDirectory() as folder:
        recording = midspan.open_recording(write("footbridge", Path(folder) / "recording"))
        result = midspan.estimate(recording)
        rows_of = TimeSeries(result.estimate.time_ns, result.estimate.displacement_m)
        return compare(rows_of, recording.reference).rmse_mm / least_error_mm(result)
