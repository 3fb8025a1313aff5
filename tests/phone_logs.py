"""Logs of a phone as the apps Sensor Logger and phyphox export them, written from the apps' descriptions alone."""

import zipfile
from pathlib import Path

import numpy as np

GRAVITY_M_S2 = 9.80665
BEGUN_NS = 1_790_000_000_000_000_000


def axes_of(value, upright="x", sign=1.0, seed=0, gravity=GRAVITY_M_S2):
    """The readings (n, 3) of a phone whose axis `upright` reads the motion, gravity with it."""
    rng = np.random.default_rng(seed)
    readings = rng.normal(0.0, 1e-3, (len(value), 3))
    readings[:, "xyz".index(upright)] = sign * (gravity + value)
    return readings


def sensor_table(time_s, readings):
    """A table of Sensor Logger: nanoseconds since 1970, seconds of the record, then z, y, x."""
    lines = ["time,seconds_elapsed,z,y,x"]
    for at, (x, y, z) in zip(time_s, readings, strict=True):
        lines.append(f"{BEGUN_NS + round(at * 1e9)},{at:.6f},{z:.9f},{y:.9f},{x:.9f}")
    return "\n".join(lines) + "\n"


def sensor_logger(time_s, readings, linear=False, platform="android"):
    """The files of Sensor Logger: with gravity, as on Android; `linear`: without it, as on an iPhone."""
    still = np.full_like(readings, readings.mean(axis=0))
    files = {
        "Metadata.csv": "version,device name,recording epoch time,platform\n3,phone,1790000000000," + platform + "\n",
        "Accelerometer.csv": sensor_table(time_s, readings - still),
        "Gravity.csv": sensor_table(time_s, still),
        "Gyroscope.csv": sensor_table(time_s, 1e-3 * readings),
        "Orientation.csv": "time,seconds_elapsed,qz,qy,qx,qw,roll,pitch,yaw\n1,0.0,0,0,0,1,0,0,0\n",
    }
    if not linear:
        files["TotalAcceleration.csv"] = sensor_table(time_s, readings)
    return files


def phyphox_table(time_s, readings, names, delimiter=",", decimal="."):
    """A table of phyphox; names: of time and the axes with their unit."""
    lines = [delimiter.join(f'"{name}"' for name in names)]
    for at, row in zip(time_s, readings, strict=True):
        lines.append(delimiter.join(f"{value:.9E}".replace(".", decimal) for value in (at, *row)))
    return "\n".join(lines) + "\n"


PHYPHOX_NAMES = ("Time (s)", *(f"Acceleration {axis} (m/s^2)" for axis in "xyz"), "Absolute acceleration (m/s^2)")


def phyphox(time_s, readings, delimiter=",", decimal=".", pauses=0):
    """The files of phyphox's experiment "Acceleration with g"."""
    whole = np.column_stack((readings, np.linalg.norm(readings, axis=1)))
    times = '"event","experiment time","system time","system time text"\n' + "".join(
        f'"START",{k}.0E0,{1790000000 + 9 * k}.000,"2026-09-21 07:13:20.000 UTC-07:00"\n' for k in range(1 + pauses)
    )
    return {
        "Raw Data.csv": phyphox_table(time_s, whole, PHYPHOX_NAMES, delimiter, decimal),
        "meta/device.csv": '"property","value"\n"version","1.2.0"\n"deviceModel","phone"\n',
        "meta/time.csv": times,
    }


def phyphox_sensors(time_s, readings):
    """The files of a simple experiment with accelerometer and gyroscope."""
    names = ("X", "Y", "Z")
    return {
        "Accelerometer.csv": phyphox_table(time_s, readings, ("Time (s)", *(f"{k} (m/s^2)" for k in names))),
        "Gyroscope.csv": phyphox_table(time_s, 1e-3 * readings, ("Time (s)", *(f"{k} (rad/s)" for k in names))),
        "meta/device.csv": '"property","value"\n',
    }


def folder_of(where: Path, files) -> Path:
    """A folder with these files; their content is text, bytes or the path of a file."""
    for name, content in files.items():
        (where / name).parent.mkdir(parents=True, exist_ok=True)
        (where / name).write_bytes(_bytes(content))
    return where


def zip_of(where: Path, files) -> Path:
    """A zip with these files."""
    with zipfile.ZipFile(where, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, _bytes(content))
    return where


def _bytes(content):
    if isinstance(content, Path):
        return content.read_bytes()
    return content if isinstance(content, bytes) else content.encode()
