"""Whole files of every format that is read, small and made here: what the damage is done to.

One motion is behind all of them, so that a recording of any two sensors can be calibrated and estimated.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import av
import cv2
import h5py
import numpy as np
import pandas as pd
import pymseed
import pyuff
from flir_files import black_body, block
from nptdms import ChannelObject, TdmsWriter
from radar_captures import settings as demo_settings
from radar_captures import words_by_hand
from scipy.io import savemat

AMPLITUDES_M = np.array([1.2e-3, 0.7e-3, 0.5e-3])
RATES_HZ = np.array([1.3, 2.1, 3.4])
TABLE_HZ, TABLE_ROWS = 128.0, 400
SCALE_M_PER_PX = -1.5e-3
START_NS = 1_714_564_800_123_456_789
CARRIER_HZ = 60.5e9
SPEED_OF_LIGHT_M_S = 299_792_458.0

# In every command: the damaged file, whatever the seed calls it.
FILE = "{file}"
RECORDING = (("inspect", ".", "--all-frames", "--json"),)
SINGLE = (("inspect", FILE), *RECORDING)


@dataclass(frozen=True)
class Seed:
    """A folder with a whole recording, the one file of it that is damaged, and what is run on it.

    reader: what the table of results calls it; text: whether its numbers and words can be changed as such; file: its
    name in the folder; commands: arguments, run in the folder one after the other.
    """

    name: str
    reader: str
    file: str
    make: Callable[[Path], None] = field(repr=False)
    text: bool = False
    commands: tuple[tuple[str, ...], ...] = SINGLE


def moved_m(time_s):
    """Displacement at times (n,), m."""
    return np.sin(2 * np.pi * np.multiply.outer(time_s, RATES_HZ)) @ AMPLITUDES_M


def accelerated(time_s):
    """Acceleration at times (n,), m/s²."""
    return -np.sin(2 * np.pi * np.multiply.outer(time_s, RATES_HZ)) @ (AMPLITUDES_M * (2 * np.pi * RATES_HZ) ** 2)


TIME_S = np.arange(TABLE_ROWS) / TABLE_HZ
TIME_NS = np.arange(TABLE_ROWS, dtype=np.int64) * 7_812_500
ACCEL = accelerated(TIME_S) + np.random.default_rng(7).normal(0.0, 5e-3, TABLE_ROWS)


def pictures(count=24, rate_hz=10.0, rows=48, columns=64, start_s=0.0):
    """Frames (count, rows, columns) of a smooth pattern that goes down as the structure goes up, 0 to 1."""
    rng = np.random.default_rng(11)
    y, x = np.mgrid[0:rows, 0:columns].astype(float)
    shift_px = moved_m(start_s + np.arange(count) / rate_hz) / SCALE_M_PER_PX
    waves = rng.normal(0.0, 0.35, (40, 2))
    phases = rng.uniform(0.0, 2 * np.pi, 40)
    stack = np.zeros((count, rows, columns))
    for (ky, kx), phase in zip(waves, phases, strict=True):
        stack += np.cos(ky * (y - shift_px[:, None, None]) + kx * x + phase)
    stack = 0.5 + stack / 30.0 + rng.normal(0.0, 0.004, stack.shape)
    return np.clip(stack, 0.0, 1.0)


def grey(bits=8, **keys):
    """The same frames as whole numbers."""
    return np.rint(pictures(**keys) * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)


def celsius(**keys):
    """The same frames as temperatures, °C."""
    return 10.0 + 15.0 * pictures(**keys)


def recording(folder, sections, time_s=TIME_S, value=ACCEL):
    """recording.toml with lines for the sections, and accel.csv."""
    if "[accelerometer]" not in sections:
        rows = "".join(f"{t:.6f},{v:.6f}\n" for t, v in zip(time_s, value, strict=True))
        (folder / "accel.csv").write_text("time_s,accel\n" + rows)
        sections = '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n' + sections
    (folder / "recording.toml").write_text(sections)


# ---- accelerometer tables -------------------------------------------------------------------------------------------


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
    Seed("tdms", "TDMS", "a.tdms", table(_tdms, "a.tdms", 'value = "a1"\n')),
    Seed("lvm", "LVM", "a.lvm", table(_lvm, "a.lvm", 'value = "acc"\nunit = "g"\n'), text=True),
    Seed("mseed2", "miniSEED 2", "a.mseed", table(_miniseed(2, STEIM1, "i"), "a.mseed")),
    Seed("mseed2-steim2", "miniSEED 2", "a.mseed", table(_miniseed(2, STEIM2, "i"), "a.mseed")),
    Seed("mseed3", "miniSEED 3", "a.mseed", table(_miniseed(3, STEIM2, "i"), "a.mseed")),
    Seed("mseed3-float", "miniSEED 3", "a.mseed",
         table(_miniseed(3, pymseed.DataEncoding.FLOAT64, "d"), "a.mseed")),
    Seed("uff", "UFF 58", "a.uff", table(_uff(0), "a.uff", 'value = "4:+Z"\n'), text=True),
    Seed("uff-binary", "UFF 58", "a.uff", table(_uff(1), "a.uff", 'value = "4:+Z"\n')),
    Seed("v2", "V2", "a.v2", table(_csmip, "a.v2", 'unit = "cm/s^2"\nvalue = "channel_1_acceleration"\n'), text=True),
    Seed("v2-cosmos", "V2", "a.v2c", table(_cosmos, "a.v2c", 'unit = "cm/s^2"\n'), text=True),
)  # fmt: skip


# ---- cameras --------------------------------------------------------------------------------------------------------


def camera(write: Callable[[Path], None], file: str, lines: str = "", kind: str = "camera") -> Callable[[Path], None]:
    """A recording whose camera is the file, or the folder of the file, that `write` makes."""

    def make(folder: Path) -> None:
        path = folder / file
        path.parent.mkdir(exist_ok=True)
        write(path)
        name = file.split("/")[0]
        recording(folder, f'\n[{kind}]\nfile = "{name}"\n{lines}\n')

    return make


def video(codec, pixels="gray", **options):
    """A video of 24 frames."""

    def write(path):
        frames = grey()
        with av.open(str(path), "w", options={"fflags": "+bitexact"}) as container:
            stream = container.add_stream(codec, rate=Fraction(10))
            stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], pixels
            stream.options = options
            stream.codec_context.time_base = Fraction(1, 10)
            for k, image in enumerate(frames):
                picture = av.VideoFrame.from_ndarray(image, format="gray").reformat(format=pixels)
                picture.pts, picture.time_base = k, Fraction(1, 10)
                container.mux(stream.encode(picture))
            container.mux(stream.encode(None))

    return write


def images(bits=8):
    """A folder of six pictures, of which the one that is damaged is in the middle."""

    def write(path):
        for k, frame in enumerate(grey(bits, count=6)):
            cv2.imwrite(str(path.with_name(f"f{k}{path.suffix}")), frame)

    return write


def _pages(path):
    cv2.imwritemulti(str(path), list(grey(16, count=6)))


def _photron(bits):
    def write(path):
        frames = grey(8 if bits == 8 else 16)
        head = (
            "#Camera Information Header\nDate : 2024/5/1\nRecord Rate(fps) : 50\nStart Frame : 0\nTotal Frame : 24\n"
            f"Image Width : 64\nImage Height : 48\nColor Type : Mono\nColor Bit : {bits}\nFile Format : MRaw\n"
        )
        path.with_suffix(".cih").write_text(head)
        path.with_suffix(".mraw").write_bytes(frames.astype("<u2" if bits == 16 else "u1").tobytes())

    return write


def _timed(path):
    video("ffv1")(path.with_name("camera.mkv"))
    path.write_text("time_s\n" + "".join(f"{k / 10}\n" for k in range(24)))


def _times(folder):
    _timed(folder / "times.csv")
    recording(folder, '\n[camera]\nfile = "camera.mkv"\ntimes = "times.csv"\n')


LENS = {"model": "pinhole", "matrix": [60.0, 60.0, 31.5, 23.5], "distortion": [-0.05, 0.01, 0.0, 0.0], "size": [64, 48]}


def _lens(folder):
    video("ffv1")(folder / "camera.mkv")
    (folder / "lens.json").write_text(json.dumps(LENS, indent=1))
    recording(folder, '\n[camera]\nfile = "camera.mkv"\n\n[camera.lens]\nfile = "lens.json"\n')


AT_10 = "rate_hz = 10.0\n"
TRACKED = ("track", ".", "--roi", "8,8,48,32", "-o", "track.csv", "--quiet")
CAMERAS = (
    Seed("mkv", "video mkv", "a.mkv", camera(video("ffv1"), "a.mkv")),
    Seed("mkv-h264", "video mkv", "a.mkv", camera(video("libx264", "yuv420p"), "a.mkv")),
    Seed("mp4", "video mp4, mov", "a.mp4", camera(video("libx264", "yuv420p"), "a.mp4")),
    Seed("mov", "video mp4, mov", "a.mov", camera(video("mjpeg", "yuvj420p"), "a.mov")),
    Seed("avi", "video avi", "a.avi", camera(video("mjpeg", "yuvj420p"), "a.avi")),
    Seed("avi-mpeg4", "video avi", "a.avi", camera(video("mpeg4", "yuv420p"), "a.avi")),
    Seed("avi-ffv1", "video avi", "a.avi", camera(video("ffv1"), "a.avi")),
    Seed("gif", "video gif", "a.gif", camera(video("gif", "gray"), "a.gif")),
    Seed("y4m", "video y4m", "a.y4m", camera(video("wrapped_avframe", "gray"), "a.y4m")),
    Seed("ts", "video ts", "a.ts", camera(video("libx264", "yuv420p"), "a.ts")),
    Seed("wmv", "video wmv", "a.wmv", camera(video("wmv2", "yuv420p"), "a.wmv")),
    Seed("png", "image png", "pictures/f3.png", camera(images(), "pictures/f3.png", AT_10)),
    Seed("png16", "image png", "pictures/f3.png", camera(images(16), "pictures/f3.png", AT_10)),
    Seed("bmp", "image bmp", "pictures/f3.bmp", camera(images(), "pictures/f3.bmp", AT_10)),
    Seed("jpeg", "image jpeg", "pictures/f3.jpg", camera(images(), "pictures/f3.jpg", AT_10)),
    Seed("pgm", "image pgm", "pictures/f3.pgm", camera(images(), "pictures/f3.pgm", AT_10)),
    Seed("tiff", "image tiff", "pictures/f3.tif", camera(images(), "pictures/f3.tif", AT_10)),
    Seed("tiff-pages", "image tiff", "a.tif", camera(_pages, "a.tif", AT_10)),
    Seed("stack-npy", "stack npy", "a.npy", camera(lambda path: np.save(path, grey()), "a.npy", AT_10)),
    Seed("stack-npz", "stack npz", "a.npz",
         camera(lambda path: np.savez(path, frames=grey(), time_s=np.arange(24) / 10), "a.npz")),
    Seed("stack-npz-packed", "stack npz", "a.npz",
         camera(lambda path: np.savez_compressed(path, frames=grey(16), time_s=np.arange(24) / 10), "a.npz")),
    Seed("cih", "Photron cih", "a.cih", camera(_photron(8), "a.cih"), text=True),
    Seed("mraw", "Photron mraw", "a.mraw", camera(_photron(16), "a.mraw")),
    Seed("times", "camera times", "times.csv", _times, text=True, commands=RECORDING),
    Seed("lens", "lens", "lens.json", _lens, text=True, commands=(*RECORDING, TRACKED)),
)  # fmt: skip


# ---- infrared -------------------------------------------------------------------------------------------------------


def infrared(write, file, lines=""):
    """The same for a thermal camera."""
    return camera(write, file, lines, kind="infrared")


def _flir(packed=False):
    def write(path):
        parts = []
        for k, counts in enumerate(black_body(celsius())):
            coded = None
            if packed:
                import jpeg_ls

                coded = bytes(jpeg_ls.encode_array(counts))
            parts.append(block(counts, stamp_ms=1_700_000_000_000 + 100 * k, packed=coded))
            if path.suffix == ".fff":
                path.with_name(f"f{k}.fff").write_bytes(parts[-1])
        if path.suffix != ".fff":
            path.write_bytes(b"".join(parts))

    return write


def _centikelvin(path):
    counts = np.rint(100.0 * (celsius(count=6) + 273.15)).astype(np.uint16)
    for k, frame in enumerate(counts):
        cv2.imwrite(str(path.with_name(f"f{k}{path.suffix}")), frame)


def _float_pages(path):
    cv2.imwritemulti(str(path), list(celsius(count=6).astype(np.float32)))


def _celsius_npz(save):
    return lambda path: save(path, celsius=celsius().astype(np.float32), time_s=np.arange(24) / 10)


INFRARED = (
    Seed("fff", "FLIR fff", "pictures/f3.fff", infrared(_flir(), "pictures/f3.fff")),
    Seed("seq", "FLIR seq", "a.seq", infrared(_flir(), "a.seq")),
    Seed("csq", "FLIR csq", "a.csq", infrared(_flir(packed=True), "a.csq")),
    Seed("centikelvin", "thermal tiff", "pictures/f3.tif", infrared(_centikelvin, "pictures/f3.tif", AT_10)),
    Seed("celsius-tiff", "thermal tiff", "a.tif", infrared(_float_pages, "a.tif", AT_10)),
    Seed("celsius-npz", "thermal npz", "a.npz", infrared(_celsius_npz(np.savez), "a.npz")),
    Seed("celsius-npz-packed", "thermal npz", "a.npz", infrared(_celsius_npz(np.savez_compressed), "a.npz")),
)


# ---- radar ----------------------------------------------------------------------------------------------------------


def radar(write, file, lines=""):
    """A recording whose radar file is what `write` makes, or lies beside the settings that it makes."""

    def make(folder):
        named = file if file.endswith((".bin", ".h5", ".npy")) else "adc_data.bin"
        write(folder / named)
        recording(folder, f'\n[radar]\nfile = "{named}"\n{lines}\n')

    return make


def echoes(frames=200, receivers=4, samples=64):
    """A cube (frames, 1, receivers, samples) of whole numbers: a wall at bin 11.3 whose range follows the motion."""
    rng = np.random.default_rng(5)
    phase = 4 * np.pi * moved_m(np.arange(frames) / 100.0) * 78.8e9 / SPEED_OF_LIGHT_M_S
    turns = 2 * np.pi * 11.3 * np.arange(samples) / samples
    cube = 1000 * np.exp(1j * (phase[:, None, None, None] + turns + rng.uniform(0, 6, (1, 1, receivers, 1))))
    cube = cube + rng.normal(0, 5, cube.shape) + 1j * rng.normal(0, 5, cube.shape)
    return np.rint(cube.real) + 1j * np.rint(cube.imag)


def _capture(path):
    demo_settings(path.parent)
    path.write_bytes(words_by_hand(echoes(), "IIQQ").tobytes())


def _packets(path):
    demo_settings(path.parent)
    data = words_by_hand(echoes(), "IIQQ").tobytes()
    heads = ((number, start) for number, start in enumerate(range(0, len(data), 1456), start=1))
    parts = (
        number.to_bytes(4, "little") + start.to_bytes(6, "little") + data[start : start + 1456]
        for number, start in heads
    )
    path.write_bytes(b"".join(parts))


STUDIO = {
    "mmWaveDevice": "AWR1642",
    "mmWaveDevices": [{
        "rfConfig": {
            "rlChanCfg_t": {"rxChannelEn": "0xF", "txChannelEn": "0x1"},
            "rlAdcOutCfg_t": {"fmt": {"b2AdcBits": 2, "b2AdcOutFmt": 1}},
            "rlProfiles": [{"rlProfileCfg_t": {
                "profileId": 0, "startFreqConst_GHz": 77.0, "idleTimeConst_usec": 7.0, "adcStartTimeConst_usec": 6.0,
                "rampEndTime_usec": 60.0, "freqSlopeConst_MHz_usec": 64.985, "numAdcSamples": 64,
                "digOutSampleRate": 6000.0,
            }}],
            "rlChirps": [{"rlChirpCfg_t": {"chirpStartIdx": 0, "chirpEndIdx": 0, "profileId": 0, "txEnable": "0x1"}}],
            "rlFrameCfg_t": {
                "chirpStartIdx": 0, "chirpEndIdx": 0, "numLoops": 1, "numFrames": 0, "framePeriodicity_msec": 10.0,
            },
        },
        "rawDataCaptureConfig": {"rlDevDataFmtCfg_t": {"iqSwapSel": 0, "chInterleave": 1}},
    }],
}  # fmt: skip


def _studio(path):
    (path.parent / "radar.mmwave.json").write_text(json.dumps(STUDIO, indent=1))
    path.write_bytes(words_by_hand(echoes(), "IIQQ").tobytes())


def phasors(rate_hz=100.0, count=300):
    """Slow-time I/Q (frames, channels, bins) at CARRIER_HZ."""
    rng = np.random.default_rng(9)
    phase = 4 * np.pi * moved_m(np.arange(count) / rate_hz) * CARRIER_HZ / SPEED_OF_LIGHT_M_S
    z = np.exp(1j * phase)[:, None, None] * np.array([0.2, 1.0, 0.3]) * np.exp(1j * np.arange(2))[:, None]
    return (z + rng.normal(0, 0.01, z.shape) + 1j * rng.normal(0, 0.01, z.shape)).astype(np.complex64)


def _slow_hdf5(form):
    def write(path):
        z = phasors()
        with h5py.File(path, "w") as file:
            if form == "complex":
                file.create_dataset("iq", data=z, chunks=True, compression="gzip")
            elif form == "fields":
                fields = np.zeros(z.shape, dtype=[("real", "<f4"), ("imag", "<f4")])
                fields["real"], fields["imag"] = z.real, z.imag
                file["iq"] = fields
            else:
                file["i"], file["q"] = z.real, z.imag
            file.attrs["carrier_hz"], file.attrs["rate_hz"] = CARRIER_HZ, 100.0
            file["range_m"] = np.array([1.0, 1.5, 2.0])

    return write


def _acconeer(path):
    frames = np.zeros((60, 5, 3), dtype=[("real", "<i2"), ("imag", "<i2")])
    z = phasors(count=300)[:, 0].reshape(60, 5, 3) * 1000
    frames["real"], frames["imag"] = z.real, z.imag
    sensor = {
        "sweep_rate": 500.0, "frame_rate": 100.0, "continuous_sweep_mode": False,
        "subsweeps": [{"start_point": 80, "step_length": 8, "num_points": 3, "enable_tx": True}],
    }  # fmt: skip
    metadata = {"subsweep_data_offset": [0], "subsweep_data_length": [3], "base_step_length_m": 0.0025}
    with h5py.File(path, "w") as file:
        entry = file.create_group("sessions/session_0/group_0/entry_0")
        entry.create_dataset("result/frame", data=frames, chunks=(10, 5, 3), compression="gzip")
        entry["result/tick"] = np.arange(60, dtype=np.int64) * 10
        entry["metadata"], entry["sensor_id"] = json.dumps(metadata), 1
        file["sessions/session_0/session_config"] = json.dumps({"groups": [{"1": sensor}]})
        file["server_info"] = json.dumps({"ticks_per_second": 1000})


CFG = 'config = "radar.cfg"\n'
JSON = 'config = "radar.mmwave.json"\n'
RADARS = (
    Seed("dca1000", "radar bin", "adc_data.bin", radar(_capture, "adc_data.bin", CFG)),
    Seed("dca1000-packets", "radar bin", "adc_data.bin", radar(_packets, "adc_data.bin", CFG), commands=RECORDING),
    Seed("cfg", "radar cfg", "radar.cfg", radar(_capture, "radar.cfg", CFG), text=True, commands=RECORDING),
    Seed("mmwave-json", "radar json", "radar.mmwave.json", radar(_studio, "radar.mmwave.json", JSON), text=True,
         commands=RECORDING),
    Seed("slow-h5", "radar h5", "slow.h5", radar(_slow_hdf5("complex"), "slow.h5")),
    Seed("slow-h5-fields", "radar h5", "slow.h5", radar(_slow_hdf5("fields"), "slow.h5")),
    Seed("slow-h5-two", "radar h5", "slow.h5", radar(_slow_hdf5("two"), "slow.h5")),
    Seed("slow-npy", "radar npy", "slow.npy",
         radar(lambda path: np.save(path, phasors()), "slow.npy", "rate_hz = 100.0\ncarrier_hz = 60.5e9\n"),
         commands=RECORDING),
    Seed("acconeer", "radar Acconeer", "acco.h5", radar(_acconeer, "acco.h5"), commands=RECORDING),
)  # fmt: skip


# ---- settings, calibration, results ---------------------------------------------------------------------------------

ESTIMATE = ("estimate", ".", "-c", "calibration.json", "-o", "out.csv", "--quiet")
SETTINGS = (("check-config", FILE), ("inspect", ".", "--quiet"), ESTIMATE)
LONG_S = 12.0


def whole(kind: str) -> Callable[[Path], None]:
    """A recording of 12 s with every key set that a user sets, calibrated by the command itself."""

    def make(folder: Path) -> None:
        time_s = np.arange(round(LONG_S * 100)) / 100.0
        noise = np.random.default_rng(3).normal(0.0, 5e-3, len(time_s))
        sections = (
            'name = "whole"\n[accelerometer]\nfile = "accel.csv"\ntime = "time_s"\nvalue = "accel"\nunit = "m/s^2"\n'
            "noise_std = 0.005\n"
        )
        rows = "".join(f"{t:.6f},{v:.6f}\n" for t, v in zip(time_s, accelerated(time_s) + noise, strict=True))
        (folder / "accel.csv").write_text("time_s,accel\n" + rows)
        sections += WHOLE[kind](folder)
        sections += "\n[calibration]\nwindow_s = [0.0, 12.0]\nband_hz = [0.5, 4.5]\nmax_offset_s = 0.5\n"
        sections += '\n[fusion]\nmethod = "smoother"\nlag_s = 0.5\n'
        recording(folder, sections)
        arguments = ["calibrate", str(folder), "--quiet"]
        _run(arguments)
        _run(
            ["estimate", str(folder), "-c", str(folder / "calibration.json"), "-o", str(folder / "out.csv"), "--quiet"]
        )

    return make


def _run(arguments: list[str]) -> None:
    from midspan.cli.main import run

    code = run(arguments)
    if code != 0:
        raise RuntimeError(f"midspan {' '.join(arguments)} ended with {code} on a file that is whole")


def _whole_camera(folder):
    count = round(LONG_S * 10) - 1
    np.savez(folder / "camera.npz", frames=grey(count=count), time_s=np.arange(count) / 10)
    return (
        '\n[camera]\nfile = "camera.npz"\nevery = 1\nstart_s = 0.0\nroi = [8, 8, 48, 32]\ndirection = "y"\n'
        'exposure_s = 0.005\nreadout_s = 0.001\ntracker = "registration"\n'
    )


def _whole_infrared(folder):
    count = round(LONG_S * 10) - 1
    np.savez(folder / "infrared.npz", celsius=celsius(count=count).astype(np.float32), time_s=np.arange(count) / 10)
    return (
        '\n[infrared]\nfile = "infrared.npz"\nroi = [8, 8, 48, 32]\ndirection = "y"\ntracker = "features"\n'
        "temperature_range_c = [10.0, 25.0]\nemissivity = 0.95\nzero_k = 0.0\n"
    )


def _whole_radar(folder):
    np.save(folder / "slow.npy", phasors(count=round(LONG_S * 100) - 10))
    return (
        '\n[radar]\nfile = "slow.npy"\niq_order = "auto"\nstart_s = 0.0\nrate_hz = 100.0\ncarrier_hz = 60.5e9\n'
        "targets = 2\n"
    )


def _whole_displacement(folder):
    time_s = np.arange(round(LONG_S * 10)) / 10.0
    noise = np.random.default_rng(4).normal(0.0, 0.2, len(time_s))
    rows = "".join(f"{t:.4f},{v:.4f}\n" for t, v in zip(time_s, 1e3 * moved_m(time_s) + noise, strict=True))
    (folder / "gnss.csv").write_text("time_s,height\n" + rows)
    (folder / "truth.csv").write_text("time_s,height\n" + rows)
    return (
        '\n[displacement]\nfile = "gnss.csv"\ntime = "time_s"\nvalue = "height"\nunit = "mm"\nnoise_std = 0.2\n'
        "estimate_offset = true\nestimate_scale = true\n"
        '\n[reference]\nfile = "truth.csv"\ntime = "time_s"\nvalue = "height"\nunit = "mm"\n'
    )


WHOLE = {
    "camera": _whole_camera, "infrared": _whole_infrared, "radar": _whole_radar, "displacement": _whole_displacement,
}  # fmt: skip
CONFIGURED = tuple(
    Seed(f"{kind}-{file.split('.')[0]}", file, file, whole(kind), text=True, commands=commands)
    for file, commands in (("recording.toml", SETTINGS), ("calibration.json", (ESTIMATE,)))
    for kind in WHOLE
)

COMPARED = (("compare", FILE, "truth.csv"), ("compare", "truth.csv", FILE, "--json"))


def result(file: str) -> Callable[[Path], None]:
    """A result as the command writes it, and its truth."""

    def make(folder: Path) -> None:
        whole("displacement")(folder)
        (folder / "truth.csv").write_text(
            "time_s,displacement_mm\n"
            + "".join(f"{t:.2f},{1e3 * moved_m(np.array([t]))[0]:.5f}\n" for t in np.arange(0, 11.9, 0.05))
        )
        _run(["estimate", str(folder), "-c", str(folder / "calibration.json"), "-o", str(folder / file), "--quiet"])

    return make


RESULTS = tuple(
    Seed(f"result-{suffix}", f"result {suffix}", f"result.{suffix}", result(f"result.{suffix}"),
         text=suffix in ("csv", "uff"), commands=COMPARED)
    for suffix in ("csv", "parquet", "h5", "mat", "mseed", "uff")
)  # fmt: skip

GROUPS: dict[str, tuple[Seed, ...]] = {
    "tables": TABLES,
    "cameras": CAMERAS,
    "infrared": INFRARED,
    "radar": RADARS,
    "settings": CONFIGURED,
    "results": RESULTS,
}
