"""Written tables: read by an independent library and by our own readers they must be what was handed over."""

import hashlib
import json
import os
import stat
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pymseed
import pytest
import pyuff
from nptdms import TdmsFile
from openpyxl import load_workbook
from scipy.io import loadmat

from midspan.errors import UsageError
from midspan.records import Source, Status
from midspan.sinks import parquet
from midspan.sinks.metadata import read_metadata
from midspan.sinks.table import ResultTable
from midspan.sinks.write import FORMATS, check_target, write_result
from midspan.sources.accelerometer.select import SeriesRequest, read_series

COUNT = 900
RNG = np.random.default_rng(11)
MM = RNG.normal(size=COUNT)
SOURCE = RNG.integers(0, 5, COUNT).astype(np.uint8)
STATUS = RNG.integers(0, 3, COUNT).astype(np.uint8)
METADATA = {"version": "0.1.0", "settings": {"lag_s": np.float64(0.5)}, "path": Path("a/b"), "roi": np.array([1, 2])}
READABLE = {"version": "0.1.0", "settings": {"lag_s": 0.5}, "path": "a/b", "roi": [1, 2]}
SUFFIXES = [".csv", ".parquet", ".h5", ".mat", ".xlsx", ".tdms", ".mseed", ".uff"]
# 300 Hz: an interval that is no whole number of nanoseconds; near 1970 and today, with a fraction of a microsecond.
STARTS = {"from zero": 0, "negative": -1_500_000_001, "epoch": 1_714_564_800_123_456_789}


def times(start_ns: int) -> np.ndarray:
    return start_ns + np.rint(np.arange(COUNT) * 1e9 / 300).astype(np.int64)


def table(start_ns: int = 0, **changed: object) -> ResultTable:
    time_ns = times(start_ns)
    columns = {
        "time_s": time_ns / 1e9,
        "displacement_mm": MM,
        "displacement_std_mm": np.abs(MM) + 0.1,
        "velocity_mm_s": 10 * MM,
        "source": SOURCE,
        "status": [Status(code).word for code in STATUS],
        **changed,
    }
    return ResultTable(columns, time_ns, METADATA)  # type: ignore[arg-type]


def words(values: object) -> list[str]:
    return [v.decode() if isinstance(v, bytes) else str(v).strip() for v in values]  # type: ignore[attr-defined]


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_result_reads_back_as_time_and_displacement(tmp_path: Path, suffix: str, start: str) -> None:
    path = tmp_path / f"result{suffix}"
    write_result(path, table(STARTS[start]))
    series = read_series(path, SeriesRequest("displacement", "time_s", "displacement_mm", "mm"))
    # Text has every nanosecond, miniSEED a start in whole microseconds and a rate; the others a float of seconds, for
    # times of today rounded twice: from whole nanoseconds (128 ns) and to seconds (2^-23 s, 119 ns). A workbook has
    # sixteen digits, the sixth decimal of such times: half of it more.
    tolerance = {".csv": 0, ".mseed": 502}.get(suffix, 250 if start == "epoch" else 1)
    tolerance += 500 if suffix == ".xlsx" and start == "epoch" else 0
    np.testing.assert_allclose(series.time_ns, times(STARTS[start]), rtol=0, atol=tolerance)
    # Text has nine decimals of a millimetre.
    np.testing.assert_allclose(series.value * 1e3, MM, rtol=1e-15, atol=5.1e-10 if suffix == ".csv" else 0)
    guessed = read_series(path, SeriesRequest("displacement"))
    np.testing.assert_array_equal(guessed.value, series.value)


def test_csv_has_the_columns_in_order_and_its_metadata_beside_it(tmp_path: Path) -> None:
    write_result(tmp_path / "r.csv", table())
    frame = pd.read_csv(tmp_path / "r.csv")
    assert ",".join(frame.columns) == "time_s,displacement_mm,displacement_std_mm,velocity_mm_s,source,status"
    assert (tmp_path / "r.csv").read_text().splitlines()[2].startswith("0.003333333,")
    assert frame["source"].tolist() == [Source(code).word for code in SOURCE]
    assert frame["status"].tolist() == [Status(code).word for code in STATUS]
    companions = json.loads((tmp_path / "r.json").read_text())
    digest = hashlib.sha256((tmp_path / "r.csv").read_bytes()).hexdigest()
    assert companions == READABLE | {"csv": {"rows": COUNT, "sha256": digest}}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["r.csv", "r.json"]


def test_parquet_keeps_units_words_and_metadata(tmp_path: Path) -> None:
    write_result(tmp_path / "r.parquet", table())
    found = pq.read_table(tmp_path / "r.parquet")
    np.testing.assert_array_equal(found["velocity_mm_s"].to_numpy(), 10 * MM)
    assert found["source"].to_pylist() == [Source(code).word for code in SOURCE]
    assert found.schema.field("velocity_mm_s").metadata[b"unit"] == b"mm/s"
    assert json.loads(found.schema.metadata[b"midspan"]) == READABLE


@pytest.mark.parametrize("rows", [7, COUNT - 1, COUNT, COUNT + 1])
def test_parquet_in_several_row_groups_is_the_same_table(tmp_path: Path, monkeypatch, rows: int) -> None:
    write_result(tmp_path / "whole.parquet", table())
    monkeypatch.setattr(parquet, "GROUP", rows)
    write_result(tmp_path / "groups.parquet", table())
    found = pq.ParquetFile(tmp_path / "groups.parquet")
    assert found.num_row_groups == -(-COUNT // rows)
    assert found.read().equals(pq.read_table(tmp_path / "whole.parquet"), check_metadata=True)


def test_hdf5_has_one_dataset_a_column_with_its_unit(tmp_path: Path) -> None:
    write_result(tmp_path / "r.h5", table())
    with h5py.File(tmp_path / "r.h5") as file:
        assert set(file) == set(table().columns)
        np.testing.assert_array_equal(file["displacement_mm"][:], MM)
        assert file["displacement_mm"].attrs["unit"] == "mm"
        assert words(file["status"][:]) == [Status(code).word for code in STATUS]
        assert json.loads(file.attrs["midspan"]) == READABLE


def test_matlab_variables_are_columns_and_character_matrices(tmp_path: Path) -> None:
    write_result(tmp_path / "r.mat", table())
    found = loadmat(tmp_path / "r.mat")
    assert found["displacement_mm"].shape == (COUNT, 1)
    np.testing.assert_array_equal(found["displacement_mm"][:, 0], MM)
    assert words(found["source"]) == [Source(code).word for code in SOURCE]
    assert json.loads(str(found["midspan"][0])) == READABLE


def test_a_workbook_has_the_rows_in_its_first_sheet_and_the_metadata_in_its_second(tmp_path: Path) -> None:
    long = ResultTable(table().columns, table().time_ns, METADATA | {"text": 40_000 * "ä"})
    write_result(tmp_path / "r.xlsx", long)
    book = load_workbook(tmp_path / "r.xlsx")
    assert book.sheetnames == ["result", "midspan"]
    frame = pd.read_excel(tmp_path / "r.xlsx")
    assert list(frame.columns) == list(table().columns)
    # Sixteen digits are written.
    np.testing.assert_allclose(frame["displacement_mm"], MM, rtol=1e-15)
    assert frame["source"].tolist() == [Source(code).word for code in SOURCE]
    # A cell holds 32 767 characters: the text goes over two rows.
    assert read_metadata(tmp_path / "r.xlsx") == READABLE | {"text": 40_000 * "ä"}


def test_more_rows_than_a_sheet_holds_are_refused(tmp_path: Path) -> None:
    count = 1_048_576
    long = ResultTable({"time_s": np.zeros(count)}, np.zeros(count, np.int64))
    with pytest.raises(UsageError, match=r"holds 1048575 rows; received 1048576\. Choose \.csv or \.parquet"):
        write_result(tmp_path / "r.xlsx", long)


def test_tdms_has_a_channel_for_each_column_with_its_unit(tmp_path: Path) -> None:
    write_result(tmp_path / "r.tdms", table())
    group = TdmsFile.read(tmp_path / "r.tdms")["midspan"]
    assert [channel.name for channel in group.channels()] == list(table().columns)
    np.testing.assert_array_equal(group["velocity_mm_s"][:], 10 * MM)
    assert group["velocity_mm_s"].properties["unit_string"] == "mm/s"
    assert list(group["source"][:]) == [Source(code).word for code in SOURCE]
    assert read_metadata(tmp_path / "r.tdms") == READABLE


def test_miniseed_starts_a_new_segment_after_a_gap(tmp_path: Path) -> None:
    time_ns = times(STARTS["epoch"])
    time_ns[400:] += 1_000_000_000
    whole = table()
    write_result(tmp_path / "r.mseed", ResultTable(whole.columns, time_ns, METADATA))
    found = pymseed.MS3TraceList.from_file(str(tmp_path / "r.mseed"), unpack_data=True)
    assert sorted(found.sourceids()) == [f"FDSN:XX_MIDSP__{a}_{b}_{c}" for a, b, c in ("DSP", "STD", "VEL")]
    segments = list(found[0])
    assert [s.numsamples for s in segments] == [400, 500]
    # Version 2 has whole microseconds.
    np.testing.assert_allclose([s.starttime for s in segments], time_ns[[0, 400]], rtol=0, atol=500)
    np.testing.assert_array_equal(np.concatenate([s.np_datasamples for s in segments]), MM)
    # The rate comes from intervals rounded to whole nanoseconds, a third of a nanosecond in 3.3 ms.
    assert abs(segments[0].samprate - 300) < 300 * 1e-6


def test_miniseed_is_read_by_obspy(tmp_path: Path) -> None:
    obspy = pytest.importorskip("obspy")
    write_result(tmp_path / "r.mseed", table(STARTS["epoch"]))
    stream = obspy.read(tmp_path / "r.mseed")
    assert sorted(trace.id for trace in stream) == ["XX.MIDSP..DSP", "XX.MIDSP..STD", "XX.MIDSP..VEL"]
    (trace,) = stream.select(channel="DSP")
    np.testing.assert_array_equal(trace.data, MM)
    assert abs(trace.stats.starttime.ns - STARTS["epoch"]) <= 500  # whole microseconds
    # A third of a nanosecond in 3.3 ms by the whole nanoseconds of the stamps.
    assert trace.stats.sampling_rate == pytest.approx(300, rel=1e-7)


def test_miniseed_stamps_do_not_drift_in_a_day_of_jittered_samples(tmp_path: Path) -> None:
    count = 100_000
    time_ns = np.rint((np.arange(count) + RNG.uniform(-0.1, 0.1, count)) * 1e9 / 300).astype(np.int64)
    write_result(tmp_path / "r.mseed", ResultTable({"displacement_mm": np.zeros(count)}, time_ns))
    series = read_series(tmp_path / "r.mseed", SeriesRequest("displacement"))
    # Within half an interval of the truth by construction; here the jitter of a tenth at both ends, twice.
    assert np.abs(series.time_ns - time_ns).max() < 0.5e9 / 300


@pytest.mark.filterwarnings("ignore:Exception ignored:pytest.PytestUnraisableExceptionWarning")  # left open by pyuff
def test_uff_functions_are_named_and_labelled_in_millimetres(tmp_path: Path) -> None:
    write_result(tmp_path / "r.uff", table(STARTS["negative"]))
    found = {entry["id1"]: entry for entry in pyuff.UFF(str(tmp_path / "r.uff")).read_sets()}
    assert set(found) == set(table().columns)
    np.testing.assert_array_equal(found["displacement_mm"]["data"], MM)
    np.testing.assert_array_equal(found["source"]["data"], SOURCE)
    assert found["displacement_mm"]["ordinate_axis_units_lab"] == "mm"
    # The abscissa of the format has six digits.
    np.testing.assert_allclose(found["displacement_mm"]["x"], times(STARTS["negative"]) * 1e-9, atol=3e-5)


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".h5", ".mat", ".xlsx", ".tdms"])
def test_a_camera_track_is_a_table_too(tmp_path: Path, suffix: str) -> None:
    time_ns = times(0)
    x = MM.copy()
    x[3] = np.nan
    names = ("time_s", "x_px", "y_px", "std_x_px", "std_y_px")
    columns = dict(zip(names, (time_ns * 1e-9, x, -x, np.abs(x), np.abs(x)), strict=True))
    path = tmp_path / f"track{suffix}"
    write_result(path, ResultTable({**columns, "status": STATUS}, time_ns))
    if suffix == ".csv":
        found = pd.read_csv(path)["x_px"].to_numpy()
    elif suffix == ".parquet":
        found = pd.read_parquet(path)["x_px"].to_numpy()
    elif suffix == ".xlsx":
        found = pd.read_excel(path, sheet_name="result")["x_px"].to_numpy()
    elif suffix == ".tdms":
        found = TdmsFile.read(path)["midspan"]["x_px"][:]
    elif suffix == ".h5":
        with h5py.File(path) as file:
            found = file["x_px"][:]
    else:
        found = loadmat(path)["x_px"][:, 0]
    np.testing.assert_allclose(found, x, atol=5.1e-10)


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".h5", ".mat", ".xlsx", ".tdms"])
def test_a_table_without_rows_is_written(tmp_path: Path, suffix: str) -> None:
    empty = ResultTable({"time_s": np.zeros(0), "x_px": np.zeros(0), "status": []}, np.zeros(0, np.int64))
    write_result(tmp_path / f"r{suffix}", empty)
    assert (tmp_path / f"r{suffix}").stat().st_size > 0


def test_an_existing_file_is_replaced_and_the_users_mask_kept(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_text("old")
    write_result(path, table())
    assert path.read_text().startswith("time_s,")
    (tmp_path / "plain").write_text("")
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"r{suffix}"
    path.write_text("old")
    with pytest.raises(UsageError):
        write_result(path, table(source=np.full(COUNT, 9, dtype=np.uint8)) if suffix != ".mseed" else
                     ResultTable({"x_px": np.zeros(3)}, np.arange(3)))  # fmt: skip
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "old"


@pytest.mark.parametrize(
    ("name", "changed", "said"),
    [
        ("r.doc", {}, [".doc", ".csv", ".parquet"]),
        ("none/r.csv", {}, ["none", "does not exist"]),
        ("folder.csv", {}, ["it is a folder"]),
        ("r.csv", {"status": ["tracked"] * COUNT}, ["status", "tracking", "tracked"]),
        ("r.csv", {"displacement_mm": MM[:-1]}, ["equal length"]),
    ],
)
def test_what_cannot_be_written_is_refused_with_its_remedy(
    tmp_path: Path, name: str, changed: dict[str, object], said: list[str]
) -> None:
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(UsageError) as caught:
        write_result(tmp_path / name, table(**changed))
    for word in said:
        assert word in str(caught.value)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_a_usage_error(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(UsageError, match="cannot be written"):
        write_result(tmp_path / "r.csv", table())
    tmp_path.chmod(0o700)


def test_a_target_can_be_checked_before_the_work(tmp_path: Path) -> None:
    check_target(tmp_path / "r.mat")
    for wrong in ("r.doc", "none/r.mat"):
        with pytest.raises(UsageError):
            check_target(tmp_path / wrong)
    assert {suffix for _, row, _ in FORMATS for suffix in row} >= set(SUFFIXES)
