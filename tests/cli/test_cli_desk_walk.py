"""The walk of someone with a workbook of acceleration, a video, and Excel or MATLAB for the rest: commands only."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.io import loadmat

from midspan.cli.main import run

# Of the simulated footbridge: the band of its upper mode, far from the steps of the walkers.
MODE_HZ = (4.45, 4.75)


@pytest.fixture(scope="module")
def walked(footbridge, tmp_path_factory):
    """The desk after the commands: result as workbook and for MATLAB."""
    desk = tmp_path_factory.mktemp("desk")
    rows = pd.read_csv(footbridge / "accel.csv")
    rows.columns = ["Time (s)", "Acceleration (m/s²)"]
    rows.to_excel(desk / "logger.xlsx", index=False)
    files = str(desk / "logger.xlsx"), str(footbridge / "camera.mkv")
    assert run(["estimate", *files, "-o", str(desk / "result.xlsx"), "--quiet"]) == 0
    assert run(["export", str(desk / "result.xlsx"), "-o", str(desk / "result.mat"), "--quiet"]) == 0
    return desk


def answer(capsys, *arguments):
    capsys.readouterr()
    assert run([*map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def columns(path):
    if path.suffix == ".mat":
        return {name: values[:, 0] for name, values in loadmat(path).items() if name.endswith(("_mm", "_s"))}
    frame = pd.read_excel(path, sheet_name="result")
    return {name: frame[name].to_numpy() for name in frame}


@pytest.mark.parametrize("name", ["result.xlsx", "result.mat"])
def test_what_excel_and_matlab_open_is_the_motion(walked, footbridge, name):
    found, truth = columns(walked / name), pd.read_csv(footbridge / "truth.csv")
    expected = np.interp(found["time_s"], truth["time_s"], truth["displacement_mm"])
    error = found["displacement_mm"] - expected
    # The zero is common to all rows: its own standard deviation at most four times, the rest within each row's band.
    assert abs(error.mean()) < 4 * np.median(found["displacement_std_mm"])
    assert np.mean(np.abs(error - error.mean()) < 1.96 * found["displacement_std_mm"]) > 0.9
    assert error.std() < 2e-3 * np.ptp(expected)  # a wrong scale or sign would be percents of the motion


@pytest.mark.parametrize("name", ["result.xlsx", "result.mat"])
def test_compare_says_the_same_as_the_columns(walked, footbridge, name, capsys):
    found, truth = columns(walked / name), pd.read_csv(footbridge / "truth.csv")
    error = found["displacement_mm"] - np.interp(found["time_s"], truth["time_s"], truth["displacement_mm"])
    reported = answer(capsys, "compare", walked / name, footbridge / "truth.csv")
    assert reported["count"] == error.size
    # A workbook has the times to the microsecond at least: 1e-6 s at 60 mm/s.
    assert reported["rmse_mm"] == pytest.approx(np.sqrt(np.mean(error**2)), abs=1e-4)
    assert reported["bias_mm"] == pytest.approx(error.mean(), abs=1e-4)
    assert reported["without_zero"]["coverage_95"] > 0.9


def test_spectrum_finds_the_mode_in_both_and_the_same(walked, footbridge, capsys):
    book, matlab = (answer(capsys, "spectrum", walked / f"result{suffix}")["modes"] for suffix in (".xlsx", ".mat"))
    truth = answer(capsys, "spectrum", footbridge / "truth.csv")["modes"]
    for modes in (book, matlab):
        assert [m["frequency_hz"] for m in modes] == pytest.approx([m["frequency_hz"] for m in book], rel=1e-6)
        (upper,) = (m for m in modes if MODE_HZ[0] < m["frequency_hz"] < MODE_HZ[1])
        (same,) = (m for m in truth if MODE_HZ[0] < m["frequency_hz"] < MODE_HZ[1])
        # Both have one realisation of the force, over spans that differ by the clock offset and the last frame.
        assert abs(upper["frequency_hz"] - same["frequency_hz"]) < 2 * same["frequency_std_hz"]
        assert upper["rms_mm"] == pytest.approx(same["rms_mm"], rel=0.05)


def test_a_wrong_unit_of_the_reference_is_named(walked, footbridge, capsys):
    reported = answer(capsys, "compare", walked / "result.mat", footbridge / "truth.csv", "--unit", "m")
    assert "the displacement is 0.001 times the reference. Check the units" in reported["notes"][0]


def test_the_video_first_is_said(walked, footbridge, capsys):
    assert run(["estimate", str(footbridge / "camera.mkv"), str(walked / "logger.xlsx"), "--unit", "g"]) == 2
    assert "Name the accelerometer's file first, then the video." in capsys.readouterr().err


@pytest.mark.parametrize("name", ["accel.csv", ""])
def test_spectrum_takes_displacement_only(footbridge, name, capsys):
    assert run(["spectrum", str(footbridge / name)]) == 2
    text = capsys.readouterr().err
    assert ("'accel' is acceleration by its name" if name else "is a folder; a result's file is needed") in text


def test_a_spectrum_is_a_csv_and_takes_no_other_files_place(walked, footbridge_copy, capsys):
    accel = footbridge_copy / "accel.csv"
    before = accel.read_bytes()
    for target, said in ((walked / "s.xlsx", "the suffix must be .csv"), (accel, "is not a spectrum")):
        assert run(["spectrum", str(walked / "result.mat"), "-o", str(target)]) == 2
        assert said in capsys.readouterr().err
    assert accel.read_bytes() == before
    for _ in range(2):
        assert run(["spectrum", str(walked / "result.mat"), "-o", str(walked / "s.csv"), "--quiet"]) == 0


def test_a_result_that_is_not_there_is_no_store(walked, capsys):
    assert run(["export", str(walked / "reslut.xlsx"), "-o", str(walked / "x.mat")]) == 3
    assert "does not exist" in capsys.readouterr().err


def test_miniseed_is_known_as_midspans_own(walked):
    for _ in range(2):
        assert run(["export", str(walked / "result.mat"), "-o", str(walked / "again.mseed"), "--quiet"]) == 0


def test_the_two_files_are_one_result(walked, capsys):
    reported = answer(capsys, "compare", walked / "result.mat", walked / "result.xlsx")
    assert reported["largest_error_mm"] < 1e-9
    assert reported["notes"] == []
