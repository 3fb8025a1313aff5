"""Settings, calibrations and results of whole recordings."""

import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd

from fuzz.radar_seeds import phasors
from fuzz.world import FILE, Seed, accelerated, celsius, grey, moved_m, recording

ESTIMATE = ("estimate", ".", "-c", "calibration.json", "-o", "out.csv", "--quiet")
SETTINGS = (("check-config", FILE), ("inspect", ".", "--quiet"), ESTIMATE)
LONG_S, LONG_HZ = 8.0, 50.0


def whole(kind: str) -> Callable[[Path], None]:
    """A recording of 8 s with every key set that a user sets, calibrated by the command itself.

    Made once in a folder of seeds, and copied.
    """

    def make(folder: Path) -> None:
        shared = folder.parent / f"whole-{kind}"
        if not shared.exists():
            own = Path(tempfile.mkdtemp(dir=folder.parent))
            _make_whole(kind, own)
            # Another process may have been quicker.
            with suppress(OSError):
                own.rename(shared)
        shutil.copytree(shared, folder, dirs_exist_ok=True)

    return make


def _make_whole(kind: str, folder: Path) -> None:
    time_s = np.arange(round(LONG_S * LONG_HZ)) / LONG_HZ
    noise = np.random.default_rng(3).normal(0.0, 5e-3, len(time_s))
    sections = (
        'name = "whole"\n[accelerometer]\nfile = "accel.csv"\ntime = "time_s"\nvalue = "accel"\nunit = "m/s^2"\n'
        "noise_std = 0.005\n"
    )
    rows = "".join(f"{t:.6f},{v:.6f}\n" for t, v in zip(time_s, accelerated(time_s) + noise, strict=True))
    (folder / "accel.csv").write_text("time_s,accel\n" + rows)
    sections += WHOLE[kind](folder)
    sections += "\n[calibration]\nwindow_s = [0.0, 8.0]\nband_hz = [0.5, 4.5]\nmax_offset_s = 0.5\n"
    sections += '\n[fusion]\nmethod = "smoother"\nlag_s = 0.5\n'
    recording(folder, sections)
    _run(["calibrate", str(folder), "--quiet"])
    _run(["estimate", str(folder), "-c", str(folder / "calibration.json"), "-o", str(folder / "out.csv"), "--quiet"])


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
    count = round(LONG_S * 5) - 1
    stack = celsius(count=count, rate_hz=5.0).astype(np.float32)
    np.savez(folder / "infrared.npz", celsius=stack, time_s=np.arange(count) / 5)
    return (
        '\n[infrared]\nfile = "infrared.npz"\nroi = [8, 8, 48, 32]\ndirection = "y"\ntracker = "features"\n'
        "temperature_range_c = [10.0, 25.0]\nemissivity = 0.95\nzero_k = 0.0\n"
    )


def _whole_radar(folder):
    np.save(folder / "slow.npy", phasors(LONG_HZ, count=round(LONG_S * LONG_HZ) - 5))
    return (
        '\n[radar]\nfile = "slow.npy"\niq_order = "auto"\nstart_s = 0.0\nrate_hz = 50.0\ncarrier_hz = 60.5e9\n'
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

COMPARED = {
    "result": ("compare", FILE, "truth.parquet"),
    "reference": ("compare", "truth.parquet", FILE, "--json"),
}


def result(file: str) -> Callable[[Path], None]:
    """A result as the command writes it, and its truth."""

    def make(folder: Path) -> None:
        whole("displacement")(folder)
        time_s = np.arange(0.0, LONG_S - 0.1, 0.05)
        truth = pd.DataFrame({"time_s": time_s, "displacement_mm": 1e3 * moved_m(time_s)})
        truth.to_parquet(folder / "truth.parquet")
        _run(["estimate", str(folder), "-c", str(folder / "calibration.json"), "-o", str(folder / file), "--quiet"])

    return make


RESULTS = tuple(
    Seed(f"{place}-{suffix}", f"result {suffix}", f"result.{suffix}", result(f"result.{suffix}"),
         text=suffix in ("csv", "uff"), commands=(command,))
    for suffix in ("csv", "parquet", "h5", "mat", "mseed", "uff")
    for place, command in COMPARED.items()
)  # fmt: skip
