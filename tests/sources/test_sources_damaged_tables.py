"""Damage that a format itself detects, and files that are cut off: reported, and never taken for data."""

import io
import json
import os
import struct
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pymseed
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from midspan.cli.main import run
from midspan.errors import DataError
from midspan.sources.accelerometer.formats import list_channels
from midspan.sources.accelerometer.select import SeriesRequest, read_series

RATE_HZ, COUNT = 100.0, 3000
TIME_S = np.arange(COUNT) / RATE_HZ
# Two modes of a footbridge, mm and Hz: the displacement is exact, its second derivative is the acceleration.
MODES = ((4.0, 1.3, 0.4), (1.5, 3.1, 1.1))
COUNTS_PER_M_S2 = 1e5
# Rows of a table that is read again for each place of a cut.
FEW = 120


def displacement_mm(time_s: np.ndarray) -> np.ndarray:
    return sum(a * np.sin(2 * np.pi * f * time_s + p) for a, f, p in MODES)


def acceleration(time_s: np.ndarray) -> np.ndarray:
    return sum(-1e-3 * a * (2 * np.pi * f) ** 2 * np.sin(2 * np.pi * f * time_s + p) for a, f, p in MODES)


NOISY = acceleration(TIME_S) + np.random.default_rng(3).normal(0.0, 0.005, COUNT)


def write_recording(folder: Path, accelerometer: str, keys: str = "") -> Path:
    """A recording.toml around an accelerometer's file, with a displacement sensor of 10 Hz and 0.1 mm."""
    time_s = np.arange(0.0, TIME_S[-1], 0.1)
    value = displacement_mm(time_s) + np.random.default_rng(4).normal(0.0, 0.1, time_s.size)
    rows = "".join(f"{t:.3f},{v:.5f}\n" for t, v in zip(time_s, value, strict=True))
    (folder / "laser.csv").write_text(f"time_s,laser_mm\n{rows}")
    (folder / "recording.toml").write_text(
        f'[accelerometer]\nfile = "{accelerometer}"\n{keys}\n[displacement]\nfile = "laser.csv"\nunit = "mm"\n'
    )
    return folder


def inspected(path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    capsys.readouterr()
    assert run(["inspect", str(path), "--json"]) == 0
    return json.loads(capsys.readouterr().out)  # type: ignore[no-any-return]


def estimated(folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[list[str], str]:
    """The warnings in the result's JSON, and what was said on standard error."""
    capsys.readouterr()
    assert run(["estimate", str(folder), "-o", str(folder / "out.csv")]) == 0
    return json.loads((folder / "out.json").read_text())["warnings"], capsys.readouterr().err


def refused(path: Path, capsys: pytest.CaptureFixture[str], code: int = 3) -> str:
    capsys.readouterr()
    assert run(["inspect", str(path)]) == code
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert "internal error" not in said
    return said


def miniseed(path: Path, encoding: pymseed.DataEncoding, version: int = 2) -> bytearray:
    counts = np.round(COUNTS_PER_M_S2 * NOISY).astype(np.int32)
    traces = pymseed.MS3TraceList()
    traces.add_data("FDSN:XX_DECK_00_H_N_Z", counts, "i", RATE_HZ, starttime=0)
    traces.to_file(str(path), encoding=encoding, max_record_length=512, format_version=version)
    return bytearray(path.read_bytes())


@pytest.mark.parametrize("encoding", [pymseed.DataEncoding.STEIM1, pymseed.DataEncoding.STEIM2])
def test_a_miniseed_record_that_does_not_end_at_its_last_sample_is_a_gap(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], encoding: pymseed.DataEncoding
) -> None:
    path = tmp_path / "a.mseed"
    whole = miniseed(path, encoding)
    for byte in (150, 301, 433):
        damaged = bytearray(whole)
        damaged[4 * 512 + byte] ^= 0x04
        path.write_bytes(damaged)
        series = read_series(path, SeriesRequest("acceleration", unit="m/s^2"))
        kept = np.round(series.time_ns * 1e-9 * RATE_HZ).astype(int)
        # What is left is exact, and one record is gone.
        np.testing.assert_array_equal(series.value, np.round(COUNTS_PER_M_S2 * NOISY)[kept])
        assert 50 < COUNT - kept.size < 600
        (line,) = inspected(path, capsys)["warnings"]
        for words in ("XX.DECK.00.HNZ", "1 of ", f"{COUNT - kept.size} samples", "1970-01-01T00:00:"):
            assert words in line


def test_a_damaged_miniseed_record_is_a_warning_of_the_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged = miniseed(tmp_path / "a.mseed", pymseed.DataEncoding.STEIM2)
    damaged[3 * 512 + 200] ^= 0x10
    (tmp_path / "a.mseed").write_bytes(damaged)
    folder = write_recording(tmp_path, "a.mseed", f'unit = "V"\nsensitivity = {COUNTS_PER_M_S2}')
    warnings, said = estimated(folder, capsys)
    assert sum("records are damaged" in line for line in warnings) == 1
    assert "records are damaged" in said
    assert any("records are damaged" in line for line in inspected(folder, capsys)["accelerometer"]["warnings"])


def test_a_calibration_made_elsewhere_does_not_hide_the_damage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = miniseed(tmp_path / "a.mseed", pymseed.DataEncoding.STEIM2)
    folder = write_recording(tmp_path, "a.mseed", f'unit = "V"\nsensitivity = {COUNTS_PER_M_S2}')
    assert run(["calibrate", str(folder), "-q"]) == 0
    whole[3 * 512 + 200] ^= 0x10
    (tmp_path / "a.mseed").write_bytes(whole)
    assert run(["estimate", str(folder), "-c", str(folder / "calibration.json"), "-o", str(folder / "out.csv")]) == 0
    assert any("records are damaged" in line for line in json.loads((folder / "out.json").read_text())["warnings"])


def test_a_miniseed_file_without_a_sound_record_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.mseed"
    whole = miniseed(path, pymseed.DataEncoding.STEIM2)
    for start in range(0, len(whole), 512):
        whole[start + 140] ^= 0x02
    path.write_bytes(whole)
    assert "records are damaged" in refused(path, capsys)


@pytest.mark.parametrize("version", [2, 3])
def test_a_miniseed_file_that_is_cut_loses_its_last_record_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], version: int
) -> None:
    path = tmp_path / "a.mseed"
    whole = miniseed(path, pymseed.DataEncoding.STEIM2, version)
    path.write_bytes(whole[: len(whole) // 2 + 100])
    tree = inspected(path, capsys)
    assert tree["warnings"] == ["its last record is cut off and left out"]
    assert COUNT // 3 < tree["channels"][0]["samples"] < 2 * COUNT // 3


def write_text(
    path: Path, row: str, cut: int, encoding: str = "utf-8", head: str = "time_s,accel", *, count: int = COUNT
) -> int:
    """A table that lacks its last line end and `cut` characters more; the length of its last line."""
    lines = [row.format(t=t, a=a, n=round(1e4 * a)) for t, a in zip(TIME_S[:count], NOISY[:count], strict=True)]
    text = "\n".join([head, *lines])
    path.write_bytes(text[: len(text) - cut].encode(encoding))
    return len(lines[-1])


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize(
    ("row", "head"),
    [
        ("{t:.6f},{a:.6f}", "time_s,accel"),
        ("{t:.2f};{n}", "time_s;accel"),
        ("{t:.3f} {a:.6e}", "time_s accel"),
        ("{t},{a}", "time_s,accel"),
        ("{t:g}\t{a:g}", "time_s\taccel"),
        ("2024-05-01T12:00:{t:06.3f}Z,{a:.5f},", "time_s,accel,"),
        ("{a:.4f},{t:08.3f}", "accel,time_s"),
    ],
)
def test_no_cut_of_the_last_line_gives_a_wrong_sample(tmp_path: Path, row: str, head: str, encoding: str) -> None:
    path = tmp_path / "a.csv"
    request = SeriesRequest("acceleration", time="time_s", value="accel", unit="m/s^2")
    length = write_text(path, row, 0, encoding, head, count=FEW)
    path.write_bytes(path.read_bytes() + "\n".encode(encoding)[-2 if encoding == "utf-16" else -1 :])
    whole = read_series(path, request)
    assert whole.value.size == FEW
    assert whole.damage == ()
    for cut in range(length + 1):
        write_text(path, row, cut, encoding, head, count=FEW)
        found = read_series(path, request)
        count = found.value.size
        np.testing.assert_array_equal(found.time_ns, whole.time_ns[:count])
        # What is kept is right to nine digits: more than any sensor has.
        np.testing.assert_allclose(found.value, whole.value[:count], rtol=1e-8)
        assert count >= FEW - 1
        # Nothing of the line is left where the cut was just before it: the line end above it is whole.
        assert bool(found.damage) == (count < FEW and cut < length)


@pytest.mark.parametrize("row", ["{t:.6f},{a:.6f}", "{t:.2f},{a:.9e}", "2024-05-01T12:00:{t:06.3f},{a:.4f}"])
def test_a_whole_last_line_without_a_line_end_is_kept(tmp_path: Path, row: str) -> None:
    path = tmp_path / "a.csv"
    write_text(path, row, 0)
    series = read_series(path, SeriesRequest("acceleration", unit="m/s^2"))
    assert series.value.size == COUNT
    assert series.damage == ()


@pytest.mark.parametrize(
    ("head", "rows", "cut"),
    [
        ("t,acc", [f"{k / 100:.2f},{96 + k % 7}" for k in range(116)] + ["1.16,1008"], "1.16,100"),
        ("acc,t_ms", [f"0.{k % 7},{10 * k}" for k in range(600, 1000)] + ["0.5,10000"], "0.5,1000"),
        ("t_ms,acc", [f"{10 * k},0.{k % 7}" for k in range(600, 1000)] + ["99990,0.5"], "99990,0.5"),
    ],
)
def test_a_cut_whole_number_is_left_out_and_a_whole_one_is_read(
    tmp_path: Path, head: str, rows: list[str], cut: str
) -> None:
    path = tmp_path / "a.csv"
    request = SeriesRequest("acceleration", time=head.split(",")[head.startswith("acc")], value="acc", unit="m/s^2")
    path.write_text("\n".join([head, *rows[:-1], cut]))
    found = read_series(path, request)
    assert found.value.size == len(rows) - 1
    assert "cut off" in " ".join(found.damage)
    if head == "acc,t_ms":
        # Times of one length and step: the last line is whole without a line end.
        path.write_text("\n".join([head, *rows[:-1]]))
        found = read_series(path, request)
        assert (found.value.size, found.damage) == (len(rows) - 1, ())


@pytest.mark.parametrize("end", ["\n\x1a", "\r\n\x1a\x1a", "\x1a", "\n5.00,NaN"])
def test_an_end_mark_of_dos_and_a_missing_value_are_no_cut(tmp_path: Path, end: str) -> None:
    path = tmp_path / "a.csv"
    rows = "\n".join(f"{k / 100:.2f},{k % 7 / 10:.1f}" for k in range(500))
    path.write_bytes(f"time_s,accel\n{rows}{end}".encode())
    series = read_series(path, SeriesRequest("acceleration", unit="m/s^2"))
    assert series.value.size == 500 + ("NaN" in end)
    assert series.damage == ()


@pytest.mark.parametrize("encoding", ["utf-32", "utf-32-le", "utf-32-be"])
def test_utf_32_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str], encoding: str) -> None:
    path = tmp_path / "a.csv"
    write_text(path, "{t:.6f},{a:.6f}", 0, encoding, count=FEW)
    assert "this is UTF-32" in refused(path, capsys)


def test_a_short_table_without_a_last_line_end_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,a\n0,1\n1,2\n2,3")
    np.testing.assert_array_equal(read_series(path, SeriesRequest("acceleration", unit="m/s^2")).value, [1, 2, 3])


@pytest.mark.parametrize("cut", [7, 12])
def test_a_cut_last_line_is_a_warning_of_inspect_and_result(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], cut: int
) -> None:
    write_text(tmp_path / "accel.csv", "{t:.6f},{a:.6f}", cut)
    folder = write_recording(tmp_path, "accel.csv", 'unit = "m/s^2"')
    (line,) = inspected(tmp_path / "accel.csv", capsys)["warnings"]
    assert "29.99" in line
    assert "cut off" in line
    warnings, said = estimated(folder, capsys)
    assert any("accel.csv" in text and "cut off" in text for text in warnings)
    assert "cut off" in said


@pytest.mark.parametrize("zeros", [1, 500, 3_000_000])
def test_zeros_behind_a_loss_of_power_are_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], zeros: int
) -> None:
    path = tmp_path / "a.csv"
    write_text(path, "{t:.6f},{a:.6f}", 4)
    path.write_bytes(path.read_bytes() + bytes(zeros))
    tree = inspected(path, capsys)
    assert tree["channels"][1]["samples"] == COUNT - 1
    assert "never written" in tree["warnings"][0]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_tables_of_windows_loggers_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str], encoding: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes("Zeit [s];Beschl [m/s²]\r\n0,00;1,5\r\n0,01;-2,5\r\n0,02;0,5\r\n".encode(encoding))
    tree = inspected(path, capsys)
    assert [(c["name"], c["unit"], c["samples"]) for c in tree["channels"]] == [("Zeit", "s", 3), ("Beschl", "m/s²", 3)]
    assert (tree["channels"][1]["smallest"], tree["channels"][1]["largest"]) == (-2.5, 1.5)
    assert tree["warnings"] == []


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".mseed", ".xyz"])
def test_a_pipe_is_refused_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str) -> None:
    path = tmp_path / f"pipe{suffix}"
    os.mkfifo(path)
    assert "pipe" in refused(path, capsys)
    folder = write_recording(tmp_path, path.name, 'unit = "m/s^2"')
    if suffix != ".xyz":
        assert run(["estimate", str(folder), "-o", str(tmp_path / "out.csv")]) == 3
        assert "must be a file" in capsys.readouterr().err


def test_a_name_that_no_file_can_have_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    # 255 bytes are what file systems take; the command refuses more before it opens anything.
    assert "at most 255 bytes" in refused(Path("a" * 300 + ".csv"), capsys, code=2)
    with pytest.raises(DataError, match="Correct the path"):
        read_series(Path("a" * 300 + ".csv"), SeriesRequest("acceleration"))
    with pytest.raises(DataError, match="without zero characters"):
        read_series(Path("a\0b.csv"), SeriesRequest("acceleration"))


def test_a_folder_with_a_tables_name_is_no_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.csv").mkdir()
    folder = write_recording(tmp_path, "a.csv", 'unit = "m/s^2"')
    assert run(["calibrate", str(folder)]) == 3
    assert "it is a folder" in capsys.readouterr().err


def test_inspect_says_what_a_raw_capture_needs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "adc_data.bin"
    path.write_bytes(bytes(1000))
    said = refused(path, capsys, code=2)
    for words in ("[radar]", "config", "adc_data.bin"):
        assert words in said
    assert ".csv" not in said


def write_tdms(path: Path) -> bytes:
    with TdmsWriter(str(path)) as writer:
        for part in np.split(np.arange(COUNT), 3):
            properties = {"wf_increment": 1.0 / RATE_HZ, "unit_string": "m/s^2"}
            time_s, value = TIME_S[part], NOISY[part]
            writer.write_segment([ChannelObject("deck", "t", time_s), ChannelObject("deck", "acc", value, properties)])
    return path.read_bytes()


@pytest.mark.parametrize("share", [0.4, 0.5, 0.6, 0.8, 0.99, 1.0])
def test_a_tdms_file_that_is_cut_says_so_and_nothing_else_does(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], share: float
) -> None:
    path = tmp_path / "a.tdms"
    whole = write_tdms(path)
    assert inspected(path, capfd)["warnings"] == []
    path.write_bytes(whole[: min(round(share * len(whole)), len(whole) - 1)])
    tree = inspected(path, capfd)
    assert "cut off" in tree["warnings"][0]
    assert run(["inspect", str(path), "--quiet"]) == 0
    assert capfd.readouterr().err == ""
    series = read_series(path, SeriesRequest("acceleration", time="deck/t", value="deck/acc"))
    np.testing.assert_array_equal(series.value, NOISY[: series.value.size])
    np.testing.assert_array_equal(series.time_ns, np.round(1e9 * TIME_S[: series.value.size]).astype(np.int64))


@pytest.mark.parametrize("junk", [5, 27, 40])
def test_a_tdms_file_that_ends_in_the_head_of_a_segment_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], junk: int
) -> None:
    path = tmp_path / "a.tdms"
    whole = write_tdms(path)
    path.write_bytes(whole + whole[:junk])
    tree = inspected(path, capsys)
    assert "cut off" in tree["warnings"][0]
    assert [channel["samples"] for channel in tree["channels"]] == [COUNT, COUNT]


def test_a_cut_tdms_file_is_a_warning_of_the_result(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    whole = write_tdms(tmp_path / "a.tdms")
    (tmp_path / "a.tdms").write_bytes(whole[:-1000])
    warnings, said = estimated(write_recording(tmp_path, "a.tdms", 'value = "acc"'), capfd)
    assert any("a.tdms" in line and "cut off" in line for line in warnings)
    assert "nptdms" not in said


LVM = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t.
X_Columns\tOne
***End_of_Header***\t
\t
Channels\t1\t\t
Samples\t{samples}\t\t
Y_Unit_Label\tm/s^2\t\t
***End_of_Header***\t\t
X_Value\tacc\tComment
"""


def write_lvm(path: Path, cut: int) -> None:
    rows = "".join(f"{t:.6f}\t{a:.6f}\n" for t, a in zip(TIME_S[:FEW], NOISY[:FEW], strict=True))
    path.write_text((LVM.format(samples=FEW) + rows)[: -cut or None])


@pytest.mark.parametrize(("cut", "rows"), [(1, FEW), (2, FEW - 1), (9, FEW - 1), (15, FEW - 1), (60, FEW - 4)])
def test_an_lvm_file_that_is_cut_loses_its_last_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], cut: int, rows: int
) -> None:
    path = tmp_path / "a.lvm"
    write_lvm(path, 0)
    assert inspected(path, capsys)["warnings"] == []
    write_lvm(path, cut)
    series = read_series(path, SeriesRequest("acceleration"))
    np.testing.assert_allclose(series.value, NOISY[:rows], atol=5.1e-7)
    said = " ".join(inspected(path, capsys)["warnings"])
    assert (f"{rows} of {FEW} samples" in said) == (rows < FEW)
    assert ("no line end" in said) == (rows < FEW)
    assert os.listdir(tmp_path) == ["a.lvm"]


def test_a_group_of_a_group_of_itself_ends(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nine levels of ten hard links to the level below: a thousand million ways to one dataset."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        below = file.create_group("level0")
        below["acc"] = NOISY
        for level in range(1, 10):
            group = file.create_group(f"level{level}")
            for k in range(10):
                group[f"way{k}"] = below
            below = group
        file["level0/itself"] = file
    tree = inspected(path, capsys)
    assert [channel["samples"] for channel in tree["channels"]] == [COUNT]
    assert any("same group" in note for note in tree["notes"])


def test_groups_deeper_than_any_logger_writes_are_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["acc"] = NOISY
        file["/".join(["deep"] * 2000) + "/acc"] = NOISY
    tree = inspected(path, capsys)
    assert [channel["name"] for channel in tree["channels"]] == ["acc"]
    assert any("groups deep" in note for note in tree["notes"])


def outside(kind: str, file: h5py.File, folder: Path) -> None:
    """A dataset `acc` whose values lie elsewhere."""
    (folder / "raw").write_bytes(NOISY.tobytes())
    with h5py.File(folder / "other.h5", "w") as other:
        other["acc"] = NOISY
    if kind == "external storage":
        file.create_dataset("acc", (COUNT,), "f8", external=[(str(folder / "raw"), 0, h5py.h5f.UNLIMITED)])
    elif kind == "virtual":
        layout = h5py.VirtualLayout((COUNT,), "f8")
        layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "acc", (COUNT,))
        file.create_virtual_dataset("acc", layout)
    else:
        file["acc"] = h5py.ExternalLink(str(folder / "other.h5"), "acc")


@pytest.mark.parametrize("matlab", [False, True])
@pytest.mark.parametrize(
    ("kind", "words"), [("external storage", "another file"), ("virtual", "virtual"), ("link", "another file")]
)
def test_values_outside_an_hdf5_file_are_refused_with_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, words: str, matlab: bool
) -> None:
    path = tmp_path / ("a.mat" if matlab else "a.h5")
    with h5py.File(path, "w", userblock_size=512 if matlab else 0) as file:
        outside(kind, file, tmp_path)
    assert words in refused(path, capsys)
    with h5py.File(path, "r+") as file:
        file["t"] = TIME_S
    assert [channel["name"] for channel in inspected(path, capsys)["channels"]] == ["t"]
    with pytest.raises(DataError, match=words):
        read_series(path, SeriesRequest("acceleration", time="t", value="acc", unit="g"))


HUGE = 10**13  # values: 73 TiB, more than any machine that this runs on has


def npy_header(count: int) -> bytes:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (count,)})
    return head.getvalue()


def mat_variable(kind: int, shape: tuple[int, int], stored: int, called: bytes = b"acc") -> bytes:
    """The head of a compressed variable of MATLAB 5 that declares `stored` bytes (format description, 2019)."""
    flags = struct.pack("<IIII", 6, 8, kind, 0)
    name = struct.pack("<HH4s", 1, len(called), called)
    inner = struct.pack("<II", 14, stored) + flags + struct.pack("<IIii", 5, 8, *shape) + name
    packed = zlib.compress(inner + struct.pack("<II", 9, stored - 48) + bytes(10_000))
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    return header + struct.pack("<II", 15, len(packed)) + packed


def write_huge(path: Path) -> None:
    """A file of some kB that declares more than there is memory for."""
    if path.suffix == ".h5":
        with h5py.File(path, "w") as file:
            file.create_dataset("acc", (HUGE,), "f8", chunks=(10**6,), compression="gzip")
    elif path.name == "v73.mat":
        with h5py.File(path, "w", userblock_size=512) as file:
            file.create_dataset("acc", (1, HUGE), "f8", chunks=(1, 10**6), compression="gzip")
    elif path.suffix == ".npz":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("acc.npy", npy_header(HUGE) + bytes(1000))
    elif path.suffix == ".npy":
        path.write_bytes(npy_header(HUGE) + bytes(1000))
    elif path.name == "numbers.mat":
        path.write_bytes(mat_variable(6, (2**31 - 1, 2**10), 2**32 - 16))
    else:
        path.write_bytes(mat_variable(2, (1, 1), 2**32 - 16))


@pytest.mark.parametrize("name", ["a.h5", "v73.mat", "a.npz", "a.npy", "numbers.mat", "structure.mat"])
def test_a_declared_size_beyond_the_memory_is_refused_before_it_is_taken(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    path = tmp_path / name
    write_huge(path)
    assert path.stat().st_size < 100_000
    said = refused(path, capsys)
    assert name in said
    # An npy file has its values as they are: it is not compressed, and too short for them.
    assert "larger than file" in said or "greater than file size" in said or "available memory" in said


def test_a_parquet_table_of_equal_values_is_refused_under_a_memory_limit(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    batch = pa.table({"acc": np.zeros(1_000_000)})
    with pq.ParquetWriter(path, batch.schema) as writer:
        for _ in range(60):
            writer.write_table(batch)
    assert path.stat().st_size < 300_000
    # 60 million values need 1.4 GB in all; the process may take 1 GB more than it has at its start.
    code = (
        "import resource, sys; from midspan.cli.main import run; import pyarrow.parquet, pandas; "
        "size = int(open('/proc/self/statm').read().split()[0]) * 4096 + 10**9; "
        "resource.setrlimit(resource.RLIMIT_AS, (size, size)); sys.exit(run(['inspect', sys.argv[1]]))"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 3, done.stderr
    assert "available memory" in done.stderr
    assert "a.parquet" in done.stderr


@pytest.mark.parametrize("suffix", [".h5", ".npz", ".mat", ".parquet"])
def test_a_channel_is_read_from_a_file_with_one_that_no_memory_holds(tmp_path: Path, suffix: str) -> None:
    """Only the channels that are named are read: another one may be as large or as damaged as it likes."""
    path = tmp_path / f"a{suffix}"
    if suffix == ".h5":
        with h5py.File(path, "w") as file:
            file["t"], file["acc"] = TIME_S, NOISY
            file.create_dataset("other", (HUGE,), "f8", chunks=(10**6,), compression="gzip")
    elif suffix == ".npz":
        np.savez(path, t=TIME_S, acc=NOISY)
        with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("other.npy", npy_header(HUGE))
    elif suffix == ".mat":
        savemat(path, {"t": TIME_S, "acc": NOISY})
        path.write_bytes(path.read_bytes() + mat_variable(6, (2**31 - 1, 2**10), 2**32 - 16, b"big")[128:])
    else:
        pd.DataFrame({"other": NOISY[::-1], "t": TIME_S, "acc": NOISY}).to_parquet(path, compression="none")
        whole = bytearray(path.read_bytes())
        whole[10:2000] = bytes(1990)
        path.write_bytes(whole)
    series = read_series(path, SeriesRequest("acceleration", time="t", value="acc", unit="m/s^2"))
    np.testing.assert_array_equal(series.value, NOISY)
    np.testing.assert_array_equal(series.time_ns, np.round(1e9 * TIME_S).astype(np.int64))


def test_a_column_of_true_and_missing_does_not_stop_the_others(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    flags = pa.array([True, None] * (COUNT // 2) + [False] * (COUNT % 2))
    pq.write_table(pa.table({"flag": flags, "t": TIME_S, "acc": NOISY}), path)
    found = {channel.name: channel.values for channel in list_channels(path).channels}
    np.testing.assert_array_equal(found["acc"], NOISY)
    assert np.isnan(found["flag"][1])
    assert found["flag"][0] == 1.0
