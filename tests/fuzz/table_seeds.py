"""Accelerometer tables of every format."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pymseed
import pyuff
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat

from fuzz.world import ACCEL, START_NS, TABLE_HZ, TABLE_ROWS, TIME_NS, TIME_S, Seed, recording


def table(write: Callable[[Path], None], file: str, lines: str = "") -> Callable[[Path], None]:
    """A recording whose accelerometer is the file that `write` makes; its displacement is another table."""

    def make(folder: Path) -> None:
        write(folder / file)
        (folder / "slow.csv").write_text("time_s,height\n" + "".join(f"{k / 4},{k % 5}\n" for k in range(12)))
        unit = "" if "unit" in lines else 'unit = "m/s^2"\n'
        recording(
            folder,
            f'[accelerometer]\nfile = "{file}"\n{unit}{lines}\n[displacement]\nfile = "slow.csv"\nunit = "mm"\n',
        )

    return make


def _plain_csv(path):
    pd.DataFrame({"time_s": TIME_S, "accel": ACCEL.round(6)}).to_csv(path, index=False)


def _logger_csv(path):
    head = "# Logger: X9\n# Sampling rate: 128 Hz\nTime,Acc X,Acc Y\n(s),(g),(g)\n"
    rows = "".join(f"{t:.6f},{v:.5f},{-v:.4f}\n" for t, v in zip(TIME_S, ACCEL / 9.80665, strict=True))
    path.write_text(head + rows)


def _iso_semicolon(path):
    stamps = np.datetime_as_string((START_NS + TIME_NS).astype("datetime64[ns]"), unit="us")
    rows = "".join(f"{s};{f'{v:.5f}'.replace('.', ',')}\n" for s, v in zip(stamps, ACCEL, strict=True))
    path.write_text("Zeit;acc\n" + rows)


def _tabs(path):
    np.savetxt(path, np.column_stack((TIME_S, ACCEL, 2 * ACCEL)), delimiter="\t", fmt="%.6e")


def _parquet(compression):
    frame = pd.DataFrame({"time_s": TIME_S, "accel": ACCEL, "word": ["a", "b"] * (TABLE_ROWS // 2)})
    return lambda path: frame.to_parquet(path, compression=compression)


def _stamped_parquet(path):
    pd.DataFrame({"stamp": pd.to_datetime(START_NS + TIME_NS, utc=True), "accel": ACCEL}).to_parquet(path)


def _structured(path):
    rows = np.zeros(TABLE_ROWS, dtype=[("time", "datetime64[ns]"), ("accel", "f4")])
    rows["time"], rows["accel"] = (START_NS + TIME_NS).astype("datetime64[ns]"), ACCEL
    np.save(path, rows)


def _matlab(compressed):
    tree = {"t": TIME_S, "rec": {"acc": ACCEL, "fs": TABLE_HZ, "info": "deck"}, "xyz": np.outer(ACCEL, [1, 2, 3])}
    return lambda path: savemat(path, tree, do_compression=compressed)


def _matlab_73(path):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in {"t": TIME_S[None, :], "acc": ACCEL[None, :], "xyz": np.outer([1, 2, 3], ACCEL)}.items():
            file.create_dataset(name, data=values).attrs["MATLAB_class"] = np.bytes_(b"double")
        file.create_dataset("s/acc2", data=2 * ACCEL[:, None]).attrs["MATLAB_class"] = np.bytes_(b"double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def _hdf5(**how):
    def write(path):
        with h5py.File(path, "w") as file:
            file.attrs["sampling_rate"] = TABLE_HZ
            file.create_dataset("time_s", data=TIME_S, **how)
            file.create_dataset("deck/accel", data=ACCEL, **how).attrs["unit"] = "m/s^2"
            file.create_dataset("deck/xyz", data=np.outer(ACCEL, [1, 2, 3]), **how)
            file["names"] = [b"deck", b"pier"]

    return write


def _xlsx(path):
    pd.DataFrame({"time_s": TIME_S, "accel": ACCEL, "word": ["a", "b"] * (TABLE_ROWS // 2)}).to_excel(path, index=False)


def _tdms(path):
    properties = {"wf_increment": 1 / TABLE_HZ, "wf_start_time": np.datetime64("2024-05-01T12:00:00", "us"),
                  "wf_start_offset": 0.0, "unit_string": "m/s^2"}  # fmt: skip
    with TdmsWriter(str(path)) as writer:
        for half in np.split(ACCEL, 2):
            writer.write_segment(
                [ChannelObject("deck", "a1", half, properties), ChannelObject("deck", "n", half[:9].astype("i2"))]
            )


def _lvm(path):
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
        "Multi_Headings\tYes\nX_Columns\tOne\nTime_Pref\tRelative\nDate\t2024/05/01\nTime\t12:00:00.25\n"
        "***End_of_Header***\t\n\t\nChannels\t2\t\t\t\nSamples\t{n}\t{n}\t\t\nDate\t2024/05/01\t2024/05/01\t\t\n"
        "Time\t12:00:00.25\t12:00:00.25\t\t\nY_Unit_Label\tg\tVolts\t\t\nDelta_X\t0.0078125\t0.0078125\t\t\n"
        "X0\t0.0E+0\t0.0E+0\t\t\n***End_of_Header***\t\t\t\t\nX_Value\tacc\tbridge\tComment\n"
    )
    rows = "".join(f"{t:.7f}\t{v:.6f}\t{-v:.6f}\n" for t, v in zip(TIME_S, ACCEL, strict=True))
    path.write_text(head.format(n=TABLE_ROWS) + rows)


def _bare_lvm(path):
    path.write_text("".join(f"{t:.7f}\t{v:.6f}\n" for t, v in zip(TIME_S, ACCEL, strict=True)))


def _knet(path):
    head = (
        "Origin Time       2024/05/01 12:00:00\nLat.              38.1\nLong.             142.8\nDepth. (km)       24\n"
        "Mag.              5.0\nStation Code      MYG004\nStation Lat.      38.7\nStation Long.     141.0\n"
        "Station Height(m) 40\nRecord Time       2024/05/01 12:00:38\nSampling Freq(Hz) 128Hz\nDuration Time(s)  5\n"
        "Dir.              N-S\nScale Factor      3920(gal)/6182761\nMax. Acc. (gal)   2.6\n"
        "Last Correction   2024/05/01 12:00:00\nMemo.             \n"
    )
    counts = np.rint(ACCEL * 1e5).astype(int)
    rows = ("".join(f"{v:9d}" for v in counts[k : k + 8]) for k in range(0, TABLE_ROWS, 8))
    path.write_text(head + "\n".join(rows) + "\n")


def _obspy(kind, dtype):
    def write(path):
        import obspy

        header = {
            "sampling_rate": TABLE_HZ,
            "station": "STA",
            "channel": "HNZ",
            "starttime": obspy.UTCDateTime(2024, 5, 1),
        }
        obspy.Trace(np.rint(ACCEL * 1e5).astype(dtype), header).write(str(path), format=kind)

    return write


def _volume(path):
    _miniseed(2, STEIM2, "i")(path)
    path.write_bytes(b"000001V 0100090 2.4".ljust(512) + path.read_bytes())


def _miniseed(version, encoding, kind):
    values = (
        np.rint(ACCEL * 1e5).astype(np.int32) if kind == "i" else ACCEL.astype(np.float32 if kind == "f" else float)
    )

    def write(path):
        traces = pymseed.MS3TraceList()
        half = TABLE_ROWS // 2
        for part, start in ((values[:half], START_NS), (values[half:], START_NS + int(TIME_NS[half]) + 10**8)):
            traces.add_data("FDSN:XX_ABC_00_H_N_Z", part, kind, TABLE_HZ, starttime=start)
        traces.to_file(str(path), encoding=encoding, max_record_length=512, format_version=version)

    return write


def _uff(binary):
    def write(path):
        sets = {
            "type": 58, "binary": binary, "func_type": 1, "rsp_node": 4, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0,
            "data": ACCEL, "x": TIME_S, "id1": "NONE", "abscissa_spacing": 1, "abscissa_spec_data_type": 17,
            "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 0, "z_axis_spec_data_type": 0,
        }  # fmt: skip
        file = pyuff.UFF(str(path))
        file.write_sets(sets, "add")
        file.write_sets({**sets, "id1": "deck", "ordinate_axis_units_lab": "g"}, "add")

    return write


def _fixed_width(values, width, digits, columns):
    fields = [f"{value:.{digits}f}".rjust(width) for value in values]
    return "\n".join("".join(fields[k : k + columns]) for k in range(0, len(fields), columns))


def _csmip(path):
    text = ""
    for number, direction in ((1, "90 Deg"), (2, "Up")):
        text += f"Corrected accelerogram   58667-L2866          Chan  {number}:  {direction}         from\n"
        text += "58667-L2866-14236.52                 Start time:  8/24/14, 10:20:33.0 UTC (GPS)\n"
        text += "    1  100    1    3    3  200\n  .0101833  .6400000 75.000000\n"
        for kind, unit in (("accel", "cm/sec2"), ("veloc", "cm/sec"), ("displ", "cm")):
            text += f"{100:6d} points of {kind} data equally spaced at  .005 sec, in {unit}. (8f10.6)    \n"
            text += _fixed_width(ACCEL[:100] * 40 / number, 10, 6, 8) + "\n"
        text += f"/&  ---------- End of data for channel  {number} ----------\n"
    path.write_text(text)


def _cosmos(path):
    reals = np.full(100, -999.0)
    reals[33] = 0.005
    text = "Corrected acceleration    (Format v01.20 with 13 text lines)\n"
    text += "Sta Chan   1:270 deg (Rcrdr Chan  1) Location:10\n"
    text += "Rcrd start time:12/20/2021, 20:13:55.850 UTC (Q= ) RcrdId:(see comment)\n"
    text += " 100 Real-header values follow on  17 lines, Format= (6F13.6)\n" + _fixed_width(reals, 13, 6, 6) + "\n"
    text += '   2 Comment line(s) follow, each starting with a "|":\n| Sensor: X\n|<PROCESS>by hand\n'
    text += "  100 acceleration pts, approx    0 secs, units=cm/s^2 (4),Format=(10F8.5)\n"
    path.write_text(text + _fixed_width(ACCEL[:100] * 10, 8, 5, 10) + "\nEnd-of-data for Chan  1 acceleration\n")


STEIM1, STEIM2 = pymseed.DataEncoding.STEIM1, pymseed.DataEncoding.STEIM2
TABLES = (
    Seed("csv", "text columns", "a.csv", table(_plain_csv, "a.csv"), text=True),
    Seed("csv-logger", "text columns", "a.txt",
         table(_logger_csv, "a.txt", 'unit = "g"\nvalue = "Acc X"\n'), text=True),
    Seed("csv-iso", "text columns", "a.csv", table(_iso_semicolon, "a.csv"), text=True),
    Seed("tabs", "text columns", "a.dat", table(_tabs, "a.dat", 'time = "column_1"\nvalue = "column_2"\n'), text=True),
    Seed("parquet", "Parquet", "a.parquet", table(_parquet("snappy"), "a.parquet", 'value = "accel"\n')),
    Seed("parquet-plain", "Parquet", "a.parquet", table(_parquet(None), "a.parquet", 'value = "accel"\n')),
    Seed("parquet-stamps", "Parquet", "a.parquet", table(_stamped_parquet, "a.parquet")),
    Seed("npy", "NumPy", "a.npy", table(lambda path: np.save(path, np.column_stack((TIME_S, ACCEL))), "a.npy")),
    Seed("npy-fields", "NumPy", "a.npy", table(_structured, "a.npy")),
    Seed("npz", "NumPy", "a.npz", table(lambda path: np.savez(path, acc=ACCEL, fs=TABLE_HZ), "a.npz")),
    Seed("npz-packed", "NumPy", "a.npz",
         table(lambda path: np.savez_compressed(path, time_s=TIME_S, acc=ACCEL), "a.npz")),
    Seed("mat5", "MATLAB 5", "a.mat", table(_matlab(False), "a.mat", 'time = "t"\nvalue = "rec.acc"\n')),
    Seed("mat5-packed", "MATLAB 5", "a.mat", table(_matlab(True), "a.mat", 'time = "t"\nvalue = "rec.acc"\n')),
    Seed("mat73", "MATLAB 7.3", "a.mat", table(_matlab_73, "a.mat", 'time = "t"\nvalue = "acc"\n')),
    Seed("hdf5", "HDF5", "a.h5", table(_hdf5(), "a.h5", 'value = "deck/accel"\n')),
    Seed("hdf5-packed", "HDF5", "a.h5",
         table(_hdf5(chunks=True, compression="gzip", fletcher32=True), "a.h5", 'value = "deck/accel"\n')),
    Seed("xlsx", "Excel workbook", "a.xlsx", table(_xlsx, "a.xlsx")),
    Seed("tdms", "TDMS", "a.tdms", table(_tdms, "a.tdms", 'value = "a1"\n')),
    Seed("lvm", "LVM", "a.lvm", table(_lvm, "a.lvm", 'value = "acc"\nunit = "g"\n'), text=True),
    Seed("mseed2", "miniSEED 2", "a.mseed", table(_miniseed(2, STEIM1, "i"), "a.mseed")),
    Seed("mseed2-steim2", "miniSEED 2", "a.mseed", table(_miniseed(2, STEIM2, "i"), "a.mseed")),
    Seed("mseed3", "miniSEED 3", "a.mseed", table(_miniseed(3, STEIM2, "i"), "a.mseed")),
    Seed("mseed3-float", "miniSEED 3", "a.mseed",
         table(_miniseed(3, pymseed.DataEncoding.FLOAT64, "d"), "a.mseed")),
    Seed("seed-volume", "full SEED", "a.seed", table(_volume, "a.seed")),
    Seed("lvm-bare", "LVM", "a.lvm", table(_bare_lvm, "a.lvm"), text=True),
    Seed("knet", "K-NET", "a.knet", table(_knet, "a.knet"), text=True),
    Seed("sac", "SAC", "a.sac", table(_obspy("SAC", np.float32), "a.sac")),
    Seed("gse2", "GSE2", "a.gse2", table(_obspy("GSE2", np.int32), "a.gse2"), text=True),
    Seed("uff", "UFF 58", "a.uff", table(_uff(0), "a.uff", 'value = "4:+Z"\n'), text=True),
    Seed("uff-binary", "UFF 58", "a.uff", table(_uff(1), "a.uff", 'value = "4:+Z"\n')),
    Seed("v2", "V2", "a.v2", table(_csmip, "a.v2", 'unit = "cm/s^2"\nvalue = "channel_1_acceleration"\n'), text=True),
    Seed("v2-cosmos", "V2", "a.v2c", table(_cosmos, "a.v2c", 'unit = "cm/s^2"\n'), text=True),
)  # fmt: skip
