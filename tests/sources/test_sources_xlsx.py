"""Workbooks of Excel: they give what the same table in a text file gives."""

import time
from datetime import datetime, timedelta
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from openpyxl import Workbook

from midspan.errors import DataError
from midspan.sources.accelerometer.formats import list_channels
from midspan.sources.accelerometer.select import SeriesRequest, read_series

COUNT = 500
TIME_S = np.arange(COUNT) / 200.0
ACCEL_G = np.random.default_rng(5).normal(0.0, 0.01, COUNT)


def workbook(path: Path, rows: list[list[object]], *, before: str | None = None) -> Path:
    book = Workbook()
    sheet = book.active
    if before is not None:
        sheet.title = "Info"
        sheet.append([before])
        sheet = book.create_sheet("Data")
    for row in rows:
        sheet.append(row)
    book.save(path)
    return path


def test_a_loggers_table_with_preamble_units_and_words_is_read(tmp_path: Path) -> None:
    head: list[list[object]] = [["Logger 7", "Kanal 2"], [], ["Zeit [s]", "Beschl Z [g]", "Temp [°C]", "Note"]]
    rows = [[float(t), float(a), 21.5, "ok"] for t, a in zip(TIME_S, ACCEL_G, strict=True)]
    path = workbook(tmp_path / "a.xlsx", [*head, *rows])
    found = list_channels(path)
    assert found.names == ("Zeit", "Beschl Z", "Temp")
    series = read_series(path, SeriesRequest("acceleration"))
    np.testing.assert_array_equal(series.time_ns, np.rint(TIME_S * 1e9))
    # Sixteen digits are written by the library.
    np.testing.assert_allclose(series.value, 9.80665 * ACCEL_G, rtol=1e-15)
    assert any("sheet 'Sheet'" in note for note in series.notes)
    assert not any("delimiter" in note or "encoding" in note for note in series.notes)


def test_the_first_sheet_with_numbers_is_taken_and_named(tmp_path: Path) -> None:
    rows = [["time_s", "accel [m/s^2]"], *([float(t), float(a)] for t, a in zip(TIME_S, ACCEL_G, strict=True))]
    path = workbook(tmp_path / "a.xlsx", rows, before="Measured on the north span")
    series = read_series(path, SeriesRequest("acceleration"))
    assert any("sheet 'Data'" in note for note in series.notes)
    np.testing.assert_allclose(series.value, ACCEL_G, rtol=1e-15)


def test_dates_of_excel_are_times(tmp_path: Path) -> None:
    begin = datetime(2024, 5, 4, 9, 30)
    rows = [["time", "acc [gal]"]]
    rows += [[begin + timedelta(milliseconds=5 * k), float(a)] for k, a in enumerate(ACCEL_G)]  # type: ignore[list-item]
    series = read_series(workbook(tmp_path / "a.xlsx", rows), SeriesRequest("acceleration"))  # type: ignore[arg-type]
    steps = np.diff(series.time_ns)
    # A workbook keeps days with sixteen digits: 1e-11 of 45 000 days is half a microsecond; two of them.
    assert np.abs(steps - 5_000_000).max() <= 1_000
    assert abs(series.time_ns[0] - 1_714_815_000_000_000_000) <= 1_000


def test_empty_and_wrong_cells_count_as_missing(tmp_path: Path) -> None:
    rows: list[list[object]] = [[float(t), float(a)] for t, a in zip(TIME_S, ACCEL_G, strict=True)]
    rows[7][1], rows[9][1] = None, "#N/A"
    path = workbook(tmp_path / "a.xlsx", [["time_s", "acc [g]"], *rows])
    value = read_series(path, SeriesRequest("acceleration")).value
    assert np.flatnonzero(np.isnan(value)).tolist() == [7, 9]


def test_a_sheet_that_declares_far_more_than_it_holds_is_read_at_once(tmp_path: Path) -> None:
    rows: list[list[object]] = [[float(t), float(a)] for t, a in zip(TIME_S, ACCEL_G, strict=True)]
    path = workbook(tmp_path / "a.xlsx", [["time_s", "acc [g]"], *rows])
    with ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = next(name for name in members if name.endswith("sheet1.xml"))
    assert members[name].count(b'<dimension ref="A1:B501"') == 1
    members[name] = members[name].replace(b"A1:B501", b"A1:XFD1048576")
    with ZipFile(path, "w") as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    begun_s = time.monotonic()
    assert list_channels(path).names == ("time_s", "acc")
    # A million rows of 16 384 cells each would take hours.
    assert time.monotonic() - begun_s < 30.0


def test_a_workbook_without_numbers_and_a_damaged_one_are_refused_by_name(tmp_path: Path) -> None:
    words = workbook(tmp_path / "words.xlsx", [["only", "words"], ["in", "it"]])
    with pytest.raises(DataError, match=r"words\.xlsx: none of its 1 sheets holds columns of numbers"):
        list_channels(words)
    whole = workbook(tmp_path / "whole.xlsx", [[float(t), float(t)] for t in TIME_S]).read_bytes()
    (tmp_path / "cut.xlsx").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DataError, match=r"cut\.xlsx cannot be read as Excel workbook"):
        list_channels(tmp_path / "cut.xlsx")
