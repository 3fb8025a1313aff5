"""Binary and other logger formats: files written by an independent library must come back number for number."""

import os
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pymseed
import pytest
import pyuff
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from midspan.errors import DataError, UsageError
from midspan.sources.accelerometer.channel import ChannelSet
from midspan.sources.accelerometer.formats import FORMATS, list_channels
from midspan.sources.accelerometer.select import SeriesRequest, read_series

COUNT = 700
RNG = np.random.default_rng(7)
VALUES = RNG.normal(size=COUNT)
TIME_S = np.arange(COUNT) / 128.0
# 1/128 s is 7 812 500 ns exactly, so every stamp below is a whole number.
TIME_NS = np.arange(COUNT, dtype=np.int64) * 7_812_500
EPOCH_NS = 1_714_564_800_123_456_789 + TIME_NS
G = 9.80665

DATA = Path(os.environ.get("MIDSPAN_DATA", Path(__file__).parents[3] / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"real data are not in {DATA} (set MIDSPAN_DATA)")


def request(**keys: object) -> SeriesRequest:
    return SeriesRequest("acceleration", **keys)  # type: ignore[arg-type]


def by_name(found: ChannelSet, name: str) -> np.ndarray:
    return found.channels[found.names.index(name)].values


def test_parquet_keeps_time_stamps_to_the_nanosecond(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    frame = pd.DataFrame({"stamp": pd.to_datetime(EPOCH_NS, utc=True), "acc_g": VALUES, "text": ["x"] * COUNT})
    frame.to_parquet(path)
    series = read_series(path, request(time="stamp", value="acc_g"))
    np.testing.assert_array_equal(series.time_ns, EPOCH_NS)
    np.testing.assert_array_equal(series.value, VALUES * G)


def test_parquet_with_missing_cells_gives_nan(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    pd.DataFrame({"time_s": TIME_S, "acc": pd.array([None, *VALUES[1:]], dtype="Float64")}).to_parquet(path)
    series = read_series(path, request(unit="m/s^2"))
    assert np.isnan(series.value[0])
    np.testing.assert_array_equal(series.value[1:], VALUES[1:])


def test_npy_columns_are_numbered(tmp_path: Path) -> None:
    path = tmp_path / "log.npy"
    np.save(path, np.column_stack([TIME_S, VALUES]))
    series = read_series(path, request(unit="g"))
    np.testing.assert_array_equal(series.time_ns, TIME_NS)
    np.testing.assert_array_equal(series.value, VALUES * G)


def test_a_structured_npy_gives_its_fields(tmp_path: Path) -> None:
    path = tmp_path / "log.npy"
    table = np.zeros(COUNT, dtype=[("time", "datetime64[ns]"), ("acc", "f4")])
    table["time"], table["acc"] = EPOCH_NS.astype("datetime64[ns]"), VALUES
    np.save(path, table)
    series = read_series(path, request(unit="m/s^2"))
    np.testing.assert_array_equal(series.time_ns, EPOCH_NS)
    np.testing.assert_array_equal(series.value, VALUES.astype(np.float32))


def test_npz_takes_its_rate_from_a_single_number(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, acc=VALUES, fs=128.0)
    np.testing.assert_array_equal(read_series(path, request(unit="m/s^2")).time_ns, TIME_NS)


def test_pickled_arrays_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.npy"
    np.save(path, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(DataError, match="cannot be read as NumPy"):
        list_channels(path)


def test_matlab_5_variables_structures_and_matrices_are_channels(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    savemat(
        path, {"t": TIME_S, "rec": {"acc": VALUES, "fs": 128.0, "info": "bridge"}, "xyz": np.outer(VALUES, [1, 2, 3])}
    )
    found = list_channels(path)
    assert set(found.names) == {"t", "rec.acc", "xyz_1", "xyz_2", "xyz_3"}
    for value in ("rec.acc", "acc", "xyz_1", "xyz[0]", "xyz[:,0]"):
        series = read_series(path, request(time="t", value=value, unit="m/s^2"))
        np.testing.assert_array_equal(series.value, VALUES)
        np.testing.assert_array_equal(series.time_ns, TIME_NS)


def write_matlab_73(path: Path) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in {"t": TIME_S[None, :], "acc": VALUES[None, :], "xyz": np.outer([1, 2, 3], VALUES)}.items():
            file.create_dataset(name, data=values).attrs["MATLAB_class"] = np.bytes_(b"double")
        file.create_dataset("s/acc2", data=2 * VALUES[:, None]).attrs["MATLAB_class"] = np.bytes_(b"double")
        file.create_dataset("note", data=np.array([[98], [114]], dtype="u2")).attrs["MATLAB_class"] = np.bytes_(b"char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def test_matlab_73_is_read_with_the_same_words_as_matlab_5(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    write_matlab_73(path)
    assert set(list_channels(path).names) == {"t", "acc", "xyz_1", "xyz_2", "xyz_3", "s.acc2"}
    for value, factor in (("acc", 1), ("xyz_3", 3), ("xyz[1]", 2), ("s.acc2", 2), ("acc2", 2)):
        series = read_series(path, request(time="t", value=value, unit="m/s^2"))
        np.testing.assert_array_equal(series.value, factor * VALUES)
        np.testing.assert_array_equal(series.time_ns, TIME_NS)


def test_hdf5_attributes_tell_unit_and_rate(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file.attrs["sampling_rate"] = 128.0
        file.create_dataset("deck/a1", data=VALUES).attrs["unit"] = "mg"
        file.create_dataset("deck/images", data=np.zeros((3, 4, 5)))
        file.create_dataset("pier/a1", data=2 * VALUES).attrs["units"] = np.bytes_(b"g")
        file["pier/a1"].attrs["fs"] = 64.0
    deck = read_series(path, request(value="deck/a1"))
    np.testing.assert_allclose(deck.value, VALUES * G / 1000, rtol=1e-15)  # one rounding of the factor
    np.testing.assert_array_equal(deck.time_ns, TIME_NS)
    np.testing.assert_array_equal(read_series(path, request(value="pier/a1")).time_ns, 2 * TIME_NS)
    with pytest.raises(UsageError, match=r"stands for 2 channels.*'deck/a1', 'pier/a1'"):
        read_series(path, request(value="a1"))


def test_hdf5_text_times_and_whole_number_epochs_are_exact(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file["time"] = [str(np.datetime64(int(t), "ns")).encode() for t in EPOCH_NS]
        file["stamp_ns"] = EPOCH_NS
        file["acc"] = VALUES
    for time in ("time", "stamp_ns"):
        series = read_series(path, request(time=time, value="acc", unit="m/s^2"))
        np.testing.assert_array_equal(series.time_ns, EPOCH_NS)


def test_tdms_waveform_properties_give_rate_start_and_unit(tmp_path: Path) -> None:
    path = tmp_path / "log.tdms"
    start = np.datetime64("2024-05-01T12:00:00.250", "us")
    properties = {"wf_increment": 1 / 128, "wf_start_time": start, "wf_start_offset": 0.0, "unit_string": "g"}
    with TdmsWriter(str(path)) as writer:
        writer.write_segment([ChannelObject("deck", "a1", VALUES, properties), ChannelObject("deck", "n", VALUES[:9])])
    series = read_series(path, request(value="a1"))
    assert series.time_ns[0] == start.astype("datetime64[ns]").astype(np.int64)
    np.testing.assert_array_equal(np.diff(series.time_ns), np.diff(TIME_NS))
    np.testing.assert_array_equal(series.value, VALUES * G)


LVM = """LabVIEW Measurement\t
Writer_Version\t2
Reader_Version\t2
Separator\tTab
Decimal_Separator\t{sign}
Multi_Headings\tYes
X_Columns\t{columns}
Time_Pref\tRelative
Date\t2024/05/01
Time\t12:00:00{sign}25
***End_of_Header***\t
\t
Channels\t2\t\t\t
Samples\t3\t3\t\t
Date\t2024/05/01\t2024/05/01\t\t
Time\t12:00:00{sign}2500000\t12:00:00{sign}2500000\t\t
Y_Unit_Label\tg\tVolts\t\t
Delta_X\t0{sign}250000\t0{sign}250000\t\t
X0\t0{sign}0000000000000000E+0\t0{sign}0000000000000000E+0\t\t
***End_of_Header***\t\t\t\t
X_Value\tacc\tbridge\tComment
{rows}"""


@pytest.mark.parametrize("sign", [".", ","])
@pytest.mark.parametrize("columns", ["One", "No"])
def test_lvm_is_read_with_and_without_a_time_column(tmp_path: Path, sign: str, columns: str) -> None:
    path = tmp_path / "log.lvm"
    rows = [f"{k * 0.25 if columns == 'One' else ''}\t{1.5 * k}\t{-k}.0".replace(".", sign) for k in range(3)]
    path.write_text(LVM.format(sign=sign, columns=columns, rows="\n".join(rows) + "\n"))
    series = read_series(path, request(value="acc"))
    np.testing.assert_array_equal(series.time_ns, [0, 250_000_000, 500_000_000])
    np.testing.assert_allclose(series.value, np.array([0, 1.5, 3.0]) * G, rtol=1e-15)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["log.lvm"], (
        "no pickle may be left together with the user's file"
    )


def write_mseed(path: Path, encoding: pymseed.DataEncoding, values: np.ndarray, kind: str) -> None:
    traces = pymseed.MS3TraceList()
    half = COUNT // 2
    # A gap of 13 samples in the middle; each half in many records of 512 bytes.
    traces.add_data("FDSN:XX_ABC_00_H_N_Z", values[:half], kind, 128.0, starttime=int(EPOCH_NS[0]))
    traces.add_data("FDSN:XX_ABC_00_H_N_Z", values[half:], kind, 128.0, starttime=int(EPOCH_NS[half] + 13 * 7_812_500))
    traces.to_file(str(path), encoding=encoding, max_record_length=512, format_version=3)


def test_miniseed_gaps_stay_gaps_with_exact_stamps(tmp_path: Path) -> None:
    path = tmp_path / "log.mseed"
    counts = np.round(VALUES * 1e5).astype(np.int32)
    write_mseed(path, pymseed.DataEncoding.STEIM2, counts, "i")
    series = read_series(path, request(unit="mm/s^2"))
    expected = EPOCH_NS + np.where(np.arange(COUNT) >= COUNT // 2, 13 * 7_812_500, 0)
    np.testing.assert_array_equal(series.time_ns, expected)
    np.testing.assert_array_equal(series.value, counts * 0.001)
    assert series.name == "XX.ABC.00.HNZ"
    assert any("1 gaps" in note for note in series.notes)


def uff_set(**keys: object) -> dict[str, object]:
    base = {
        "type": 58, "binary": 0, "func_type": 1, "rsp_node": 4, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0,
        "data": VALUES, "x": TIME_S, "id1": "NONE", "abscissa_spacing": 1, "abscissa_spec_data_type": 17,
        "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 0, "z_axis_spec_data_type": 0,
    }  # fmt: skip
    return {**base, **keys}


@pytest.mark.filterwarnings("ignore:Exception ignored:pytest.PytestUnraisableExceptionWarning")  # left open by pyuff
@pytest.mark.parametrize("binary", [0, 1])
def test_uff_58_is_read_as_text_and_binary(tmp_path: Path, binary: int) -> None:
    path = tmp_path / "log.uff"
    file = pyuff.UFF(str(path))
    file.write_sets(uff_set(binary=binary), "add")
    file.write_sets(uff_set(binary=binary, id1="deck", ordinate_axis_units_lab="g"), "add")
    file.write_sets(uff_set(binary=binary, func_type=4, data=VALUES + 1j), "add")
    assert list_channels(path).names == ("4:+Z", "deck")
    # Text has twelve digits.
    tolerance = 0 if binary else 1e-11
    series = read_series(path, request(value="4:+Z"))
    np.testing.assert_allclose(series.value, VALUES, rtol=tolerance)
    np.testing.assert_array_equal(series.time_ns, TIME_NS)
    np.testing.assert_allclose(read_series(path, request(value="deck")).value, VALUES * G, rtol=tolerance)


def test_a_uff_step_of_six_digits_is_taken_as_the_whole_rate_behind_it(tmp_path: Path) -> None:
    path = tmp_path / "log.uff"
    pyuff.UFF(str(path)).write_sets(uff_set(x=np.arange(COUNT) / 300.0), "add")
    series = read_series(path, request())
    np.testing.assert_array_equal(series.time_ns, np.rint(np.arange(COUNT) * 1e9 / 300).astype(np.int64))


def test_uneven_uff_abscissas_are_taken_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "log.uff"
    uneven = np.cumsum(RNG.integers(1, 5, COUNT)) * 0.25  # at most 700, so six digits hold every value
    pyuff.UFF(str(path)).write_sets(uff_set(x=uneven, abscissa_spacing=0), "add")
    series = read_series(path, request())
    np.testing.assert_array_equal(series.time_ns, np.rint(uneven * 1e9).astype(np.int64))


def fixed_width(values: np.ndarray, width: int, digits: int, columns: int) -> str:
    """Fortran's F format: no zero before the point, so that neighbours can touch."""
    fields = []
    for value in values:
        text = f"{value:.{digits}f}".replace("-0.", "-.")
        fields.append((text[1:] if text.startswith("0.") else text).rjust(width))
    return "\n".join("".join(fields[k : k + columns]) for k in range(0, len(fields), columns))


def test_csmip_v2_gives_three_blocks_a_channel_even_where_numbers_touch(tmp_path: Path) -> None:
    path = tmp_path / "station.v2"
    values = np.round(VALUES[:20] * 40, 6)
    values[3:6] = [-21.39103, -15.9931, -3.874385]  # as in real files: -21.391030-15.993100
    text = ""
    for number, direction in ((1, "90 Deg"), (2, "Up")):
        text += f"Corrected accelerogram   58667-L2866          Chan  {number}:  {direction}         from\n"
        text += "58667-L2866-14236.52                 Start time:  8/24/14, 10:20:33.0 UTC (GPS)\n"
        text += "    1  100    1    3    3  200\n  .0101833  .6400000 75.000000\n"
        for kind, unit, scale in (("accel", "cm/sec2", 1), ("veloc", "cm/sec", 0.5), ("displ", "cm", 0.1)):
            text += f"{20:6d} points of {kind} data equally spaced at  .005 sec, in {unit}. (8f10.6)    \n"
            text += fixed_width(np.round(scale / number * values, 6), 10, 6, 8) + "\n"
        text += f"/&  ---------- End of data for channel  {number} ----------\n"
    path.write_text(text)
    series = read_series(path, request(value="channel_2_acceleration"))
    np.testing.assert_allclose(series.value, np.round(values / 2, 6) / 100, rtol=1e-14, atol=1e-12)
    np.testing.assert_array_equal(series.time_ns, np.arange(20) * 5_000_000)
    displacement = read_series(path, SeriesRequest("displacement", value="channel_1_displacement"))
    np.testing.assert_allclose(displacement.value, np.round(0.1 * values, 6) / 100, rtol=1e-14, atol=1e-12)
    assert any("channel 2: direction Up" in note for note in series.notes)


def test_an_older_v2_file_counts_in_tenths_of_g(tmp_path: Path) -> None:
    path = tmp_path / "old.v2"
    heading = "    16 points of accel data equally spaced at  .020 sec, in g/10. (8f10.6)"
    path.write_text(f"Chan  1:  90 Deg\n{heading}\n" + fixed_width(np.arange(16) / 8, 10, 6, 8) + "\n")
    series = read_series(path, request())
    np.testing.assert_allclose(series.value, np.arange(16) / 80 * G, rtol=1e-14)


def test_cosmos_v2_takes_its_step_from_the_real_header(tmp_path: Path) -> None:
    path = tmp_path / "station.v2c"
    reals = np.full(100, -999.0)
    reals[33] = 0.005
    text = "Corrected acceleration    (Format v01.20 with 13 text lines)\n"
    text += "Sta Chan   1:270 deg (Rcrdr Chan  1) Location:10\n"
    text += "Rcrd start time:12/20/2021, 20:13:55.850 UTC (Q= ) RcrdId:(see comment)\n"
    text += " 100 Real-header values follow on  17 lines, Format= (6F13.6)\n" + fixed_width(reals, 13, 6, 6) + "\n"
    text += '   2 Comment line(s) follow, each starting with a "|":\n| Sensor: X\n|<PROCESS>by hand\n'
    text += "  20 acceleration pts, approx    0 secs, units=cm/s^2 (4),Format=(10F8.5)\n"
    text += fixed_width(np.round(VALUES[:20], 5), 8, 5, 10) + "\nEnd-of-data for Chan  1 acceleration\n"
    path.write_text(text)
    series = read_series(path, request())
    np.testing.assert_allclose(series.value, np.round(VALUES[:20], 5) / 100, rtol=1e-14)
    np.testing.assert_array_equal(series.time_ns, np.arange(20) * 5_000_000)


def test_a_v2_file_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cut.v2"
    path.write_text(
        "  7500 points of accel data equally spaced at  .010 sec, in cm/sec2. (8f10.6)\n  -.001239  -.001228\n"
    )
    with pytest.raises(DataError, match="7500 values are announced, 2 are there"):
        list_channels(path)


def test_a_given_rate_does_not_replace_the_files_own_clock_silently(tmp_path: Path) -> None:
    path = tmp_path / "log.mseed"
    write_mseed(path, pymseed.DataEncoding.FLOAT64, VALUES, "d")
    series = read_series(path, request(unit="m/s^2", rate_hz=100.0))
    assert series.time_ns[1] - series.time_ns[0] == 7_812_500
    assert any("rate_hz = 100 Hz not used" in note for note in series.notes)


def test_channels_of_unequal_length_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, t=TIME_S[:-1], acc=VALUES)
    with pytest.raises(DataError, match="equal length; received 699 and 700"):
        read_series(path, request(time="t", value="acc", unit="g"))


def test_every_format_of_the_table_has_a_reader_and_own_suffixes() -> None:
    suffixes = [suffix for _, row, _ in FORMATS for suffix in row]
    assert len(suffixes) == len(set(suffixes))
    for needed in (".csv", ".parquet", ".npz", ".mat", ".h5", ".tdms", ".lvm", ".mseed", ".uff", ".v2"):
        assert needed in suffixes


@needs_data
def test_the_broad_recording_has_gravity_and_its_rate() -> None:
    path = DATA / "broad" / "10_undisturbed_slow_translation_A.hdf5"
    axes = [read_series(path, request(value=f"imu_acc[{k}]", unit="m/s^2")) for k in range(3)]
    length = np.sqrt(sum(axis.value**2 for axis in axes))
    # A body moved slowly by hand: the mean length is gravity, with 3 % for the sensor's scale and the movement itself.
    assert abs(float(np.nanmean(length)) - 9.81) < 0.3
    rate_hz = 1e9 * (axes[0].time_ns.size - 1) / (axes[0].time_ns[-1] - axes[0].time_ns[0])
    assert abs(rate_hz - 2000 / 7) < 1e-6  # the file's attribute sampling_rate


@needs_data
def test_the_contract_example_reads_as_it_stands() -> None:
    folder = DATA / "contract-example"
    series = read_series(folder / "accel.csv", request(time="time_s", value="accel", unit="m/s^2"))
    truth = read_series(folder / "truth.csv", SeriesRequest("displacement", "time_s", "displacement_mm", "mm"))
    np.testing.assert_array_equal(np.diff(series.time_ns), 10_000_000)
    assert series.time_ns.size == truth.time_ns.size


@pytest.mark.parametrize(("decimal", "head"), [(".", ""), (",", ""), (".", "Time\tacc\n")])
def test_lvm_without_labviews_header_is_read_as_text_columns(tmp_path: Path, decimal: str, head: str) -> None:
    path = tmp_path / "log.lvm"
    rows = "".join(f"{k / 200:.6f}\t{0.5 * np.sin(k / 9):.6f}\n" for k in range(300)).replace(".", decimal)
    path.write_text(head + rows)
    series = read_series(path, request(unit="g"))
    np.testing.assert_array_equal(np.diff(series.time_ns), 5_000_000)
    np.testing.assert_allclose(series.value, np.round(0.5 * np.sin(np.arange(300) / 9), 6) * G, rtol=1e-12)
    assert "no header of LabVIEW: read as text columns" in series.notes


def test_an_lvm_header_without_its_separator_shows_it(tmp_path: Path) -> None:
    path = tmp_path / "log.lvm"
    text = LVM.format(sign=".", columns="One", rows="".join(f"{0.25 * k}\t{1.5 * k}\t-1.0\n" for k in range(3)))
    kept = [line for line in text.splitlines(keepends=True) if not line.startswith("Separator")]
    for separator in ("\t", ","):
        path.write_text("".join(kept).replace("\t", separator))
        np.testing.assert_allclose(read_series(path, request(value="acc")).value, np.array([0, 1.5, 3.0]) * G)
