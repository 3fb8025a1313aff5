"""A recording given by its path, and what its result states of the zero."""

import json

import numpy as np
import pytest

import midspan
from midspan.cli.main import run


def test_calibrate_and_estimate_take_a_path(gnss):
    opened = midspan.open_recording(gnss)
    assert midspan.calibrate(str(gnss)).noise_std_m_s2 == midspan.calibrate(opened).noise_std_m_s2
    by_path, by_recording = midspan.estimate(gnss), midspan.estimate(opened)
    assert np.array_equal(by_path.displacement_mm, by_recording.displacement_mm)


def test_the_zeros_part_of_the_band_is_stored_and_no_larger_than_any_rows(footbridge, tmp_path):
    result = midspan.estimate(footbridge)
    stored = json.loads(result.save(tmp_path / "r.csv").with_suffix(".json").read_text(encoding="utf-8"))["zero_std_mm"]
    assert stored == pytest.approx(1e3 * result.zero_std_m)
    assert 0.0 < stored <= result.displacement_std_mm.min()


@pytest.mark.usefixtures("undrawn")
def test_command_and_report_state_both_parts_of_the_deviation(footbridge_copy, tmp_path, capsys):
    page = tmp_path / "report.html"
    assert run(["estimate", str(footbridge_copy), "-o", str(tmp_path / "r.csv"), "--report", str(page), "-v"]) == 0
    said, text = capsys.readouterr(), page.read_text(encoding="utf-8")
    figures = midspan.estimate(footbridge_copy).figures()
    assert np.hypot(figures["zero_std_mm"], figures["median_own_std_mm"]) == pytest.approx(figures["median_std_mm"])
    assert f"{figures['zero_std_mm']:.3g} mm, common to all rows" in said.out
    assert f"{figures['median_own_std_mm']:.3g} mm" in said.out
    assert f"{figures['zero_std_mm']:.4g} mm" in text
    assert f"{figures['median_own_std_mm']:.4g} mm" in text


def test_a_displacement_sensor_has_its_own_zero(gnss):
    assert midspan.estimate(gnss).metadata()["zero_std_mm"] == 0.0
