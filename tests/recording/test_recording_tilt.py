"""A camera's own tilt: in the band by its standard deviation and the distance, or said to be left out."""

import json
from dataclasses import dataclass

import numpy as np
import pytest

import midspan
from lively_recordings import SCALE_MM_PER_PX, Lively, write
from midspan.cli.main import run
from midspan.recording.not_in_band import DELAY, SENSITIVITY, TILT
from recording_edits import append, set_keys
from repeats import slow

STD_MDEG, DISTANCE_M = 0.5, 12.0
STD_MM = 1e3 * np.radians(1e-3 * STD_MDEG) * DISTANCE_M
CASE = Lively(duration_s=20.0, rms_m=2e-3)
METHODS = ("smoother", "kalman", "lag", "fir")
LENS = "[camera.lens]\nmatrix = [{fx}, {fy}, 41.5, 41.5]\ndistortion = [0.0, 0.0, 0.0, 0.0]\nsize = [84, 84]\n"


@dataclass(frozen=True)
class Tilting(Lively):
    """A camera that turns slowly and at random, with a standard deviation of STD_MDEG."""

    @property
    def met_m(self):
        rng = np.random.default_rng(77 + self.seed)
        hertz, phase = rng.uniform(0.02, 0.08, 12), rng.uniform(0.0, 2.0 * np.pi, 12)
        size = rng.normal(0.0, 1.0, 12) / np.sqrt(6.0)
        turned = np.sin(2.0 * np.pi * np.multiply.outer(self.met_s, hertz) + phase) @ size
        return self.motion(self.met_s) + 1e-3 * STD_MM * turned


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write(tmp_path_factory.mktemp("tilt") / "camera", CASE, "camera")


@pytest.fixture(scope="module")
def known(folder):
    return midspan.calibrate(folder)


@pytest.mark.parametrize("method", METHODS)
def test_rows_and_zero_each_have_the_tilts_variance(folder, known, method):
    before = midspan.estimate(folder, known, method=method)
    set_keys(folder, "camera", tilt_std_mdeg=STD_MDEG, distance_m=DISTANCE_M)
    after = midspan.estimate(folder, known, method=method)
    set_keys(folder, "camera", tilt_std_mdeg=None, distance_m=None)
    # fir looks for outliers together with the rows' band: to 0.1 µm.
    np.testing.assert_allclose(after.displacement_mm, before.displacement_mm, atol=1e-4)
    # The tilt of the row's instant and that of the zero's; fir's rows without a whole window count it once more.
    more_mm2 = after.displacement_std_mm**2 - before.displacement_std_mm**2
    own = (after.time_s > after.time_s[0] + 4.0) & (after.time_s < after.time_s[-1] - 4.0)
    np.testing.assert_allclose(more_mm2[own], 2.0 * STD_MM**2, rtol=1e-3)
    assert np.all(more_mm2 > 1.999 * STD_MM**2)
    assert 1e6 * (after.zero_std_m**2 - before.zero_std_m**2) == pytest.approx(STD_MM**2)


def test_a_focal_length_and_the_scale_factor_stand_for_the_distance(folder, tmp_path):
    other = write(tmp_path / "lens", CASE, "camera", LENS.format(fx=1000.0, fy=8000.0))
    set_keys(other, "camera", tilt_std_mdeg=STD_MDEG)
    grown_m2 = midspan.estimate(other).zero_std_m ** 2 - midspan.estimate(folder).zero_std_m ** 2
    # 8000 px of 1.5 mm are 12 m: the focal length of the measured axis, y. The scale is found to a thousandth.
    assert 8000.0 * abs(SCALE_MM_PER_PX) == pytest.approx(1e3 * DISTANCE_M)
    assert 1e6 * grown_m2 == pytest.approx(STD_MM**2, rel=0.01)


@pytest.mark.parametrize("seeds", [2, *slow(4)])
def test_slow_tilt_of_that_size_is_held(seeds, tmp_path):
    inside = {0.0: [], STD_MDEG: []}
    for seed in range(seeds):
        case = Tilting(seed=seed, duration_s=25.0, rms_m=2e-3)
        other = write(tmp_path / str(seed), case, "camera", "")
        set_keys(other, "camera", distance_m=DISTANCE_M)
        for std, found in inside.items():
            set_keys(other, "camera", tilt_std_mdeg=std)
            result = midspan.estimate(other)
            error = result.displacement_mm - case.from_zero_mm(result.time_s)
            found.append(np.mean(np.abs(error) < 1.96 * result.displacement_std_mm))
    # A tilt is slow: four records are a few dozen independent errors, two a dozen and more.
    assert np.mean(inside[STD_MDEG]) > 0.9
    assert np.mean(inside[0.0]) < 0.4


def test_without_a_distance_one_message_tells_what_is_needed(tmp_path, capsys):
    other = write(tmp_path / "none", CASE, "camera", "")
    set_keys(other, "camera", tilt_std_mdeg=2.0)
    assert run(["estimate", str(other)]) == 2
    said = capsys.readouterr().err
    assert "camera: must have distance_m (m from camera to target) or a section lens" in said
    assert said.count("\n") <= 2
    append(other, LENS.format(fx=1000.0, fy=1000.0))
    assert run(["check-config", str(other / "recording.toml")]) == 0


def test_left_out_the_result_says_that_tilt_is_not_observed(folder, tmp_path, capsys):
    assert run(["estimate", str(folder), "-o", str(tmp_path / "r.csv"), "-v"]) == 0
    printed = capsys.readouterr()
    assert f"camera: {TILT}" in printed.out
    assert TILT not in printed.err
    said = json.loads((tmp_path / "r.json").read_text())["not_in_band"]
    assert [begins in line for begins, line in zip((SENSITIVITY, DELAY, TILT), said, strict=True)] == [True] * 3
    assert "0.017 mm per metre of distance" in said[2]
    set_keys(folder, "camera", tilt_std_mdeg=STD_MDEG, distance_m=DISTANCE_M)
    assert not any(TILT in line for line in midspan.estimate(folder).not_in_band)
    set_keys(folder, "camera", tilt_std_mdeg=None, distance_m=None)
