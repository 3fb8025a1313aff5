"""`midspan export` of a file: the same table in another format."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.io import loadmat

from midspan.cli.main import run
from midspan.sinks.metadata import read_metadata
from midspan.sinks.table import ResultTable
from midspan.sinks.write import write_result

TIME_NS = 1_714_564_800_123_456_789 + np.rint(np.arange(300) * 1e9 / 128).astype(np.int64)
MM = np.random.default_rng(3).normal(size=300).round(9)


@pytest.fixture
def result(tmp_path: Path) -> Path:
    columns = {
        "time_s": TIME_NS / 1e9,
        "displacement_mm": MM,
        "displacement_std_mm": np.full(300, 0.125),
        "velocity_mm_s": -MM,
        "source": ["camera"] * 300,
        "status": ["tracking"] * 299 + ["coasting"],
    }
    path = tmp_path / "result.csv"
    write_result(path, ResultTable(columns, TIME_NS, {"midspan": "0.1.0", "zero_std_mm": 0.05}))  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize("suffix", [".parquet", ".h5", ".mat", ".xlsx", ".tdms"])
def test_a_result_goes_through_every_format_and_back_without_loss(
    result: Path, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    other, back = result.with_name(f"other{suffix}"), result.with_name("back.csv")
    assert run(["export", str(result), "-o", str(other), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"file": str(result), "rows": 300, "written": str(other)}
    assert run(["export", str(other), "-o", str(back), "--quiet"]) == 0
    one, two = pd.read_csv(result), pd.read_csv(back)
    # The other formats keep a float of seconds, a workbook six decimals; the rest is the same to the digit.
    np.testing.assert_allclose(two["time_s"], one["time_s"], rtol=0, atol=1e-6)
    pd.testing.assert_frame_equal(two.drop(columns="time_s"), one.drop(columns="time_s"))
    assert {key: value for key, value in read_metadata(back).items() if key != "csv"} == {
        "midspan": "0.1.0",
        "zero_std_mm": 0.05,
    }


def test_every_digit_of_a_csvs_times_is_kept(result: Path) -> None:
    copy = result.with_name("copy.csv")
    assert run(["export", str(result), "-o", str(copy), "--quiet"]) == 0
    assert copy.read_bytes() == result.read_bytes()


def test_a_csv_of_another_program_has_more_digits_than_nanoseconds(tmp_path: Path) -> None:
    time_s = np.arange(300) / 3 + 0.1
    pd.DataFrame({"time_s": time_s, "displacement_mm": MM}).to_csv(tmp_path / "plain.csv", index=False)
    assert run(["export", str(tmp_path / "plain.csv"), "-o", str(tmp_path / "plain.mat"), "--quiet"]) == 0
    found = loadmat(tmp_path / "plain.mat")
    np.testing.assert_allclose(found["time_s"][:, 0], time_s, rtol=0, atol=0.5e-9)  # the nearest nanosecond
    np.testing.assert_array_equal(found["displacement_mm"][:, 0], MM)


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("time_s", "", "time_s must be a number of seconds in every row"),
        ("time_s", "abc", "time_s must be a number of seconds in every row"),
        ("time_s", "inf", "time_s must be a number of seconds in every row"),
        ("time_s", "0.1", "time_s must grow from row to row; the row at 0.1 s follows that at"),
        ("displacement_mm", "abc", "the column displacement_mm holds text"),
    ],
)
@pytest.mark.parametrize("suffix", [".csv", ".xlsx"])
def test_a_mutilated_table_is_refused(
    tmp_path: Path, column: str, value: str, said: str, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    frame = pd.DataFrame({"time_s": np.arange(300) / 3 + 0.1, "displacement_mm": MM}).astype(object)
    frame.loc[7, column] = float(value) if suffix == ".xlsx" and value == "0.1" else value
    path = tmp_path / f"table{suffix}"
    if suffix == ".csv":
        frame.to_csv(path, index=False)
    else:
        frame.to_excel(path, index=False, sheet_name="result")
    assert run(["export", str(path), "-o", str(tmp_path / "x.mat"), "--quiet"]) == 3
    assert said in capsys.readouterr().err
    assert not (tmp_path / "x.mat").exists()


def test_matlab_gets_named_column_vectors(result: Path) -> None:
    target = result.with_name("result.mat")
    assert run(["export", str(result), "-o", str(target), "--quiet"]) == 0
    found = loadmat(target)
    for name in ("time_s", "displacement_mm", "displacement_std_mm", "velocity_mm_s"):
        assert found[name].shape == (300, 1)
    np.testing.assert_array_equal(found["displacement_mm"][:, 0], MM)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["-o", "x.doc"], "the suffix must be one of"),
        ([], "-o: is missing"),
        (["-o", "x.csv", "--point", "north"], "--point: needs a store"),
    ],
)
def test_wrong_use_is_refused_with_its_remedy(
    result: Path, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["export", str(result), *arguments]) == 2
    assert said in capsys.readouterr().err


def test_a_file_that_is_no_result_is_refused_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.csv").write_text("x,y\n1,2\n")
    assert run(["export", str(tmp_path / "a.csv"), "-o", str(tmp_path / "b.mat")]) == 3
    assert "holds no rows with a column time_s" in capsys.readouterr().err
    (tmp_path / "a.uff").write_text("-1")
    assert run(["export", str(tmp_path / "a.uff"), "-o", str(tmp_path / "b.mat")]) == 2
    assert not (tmp_path / "b.mat").exists()
