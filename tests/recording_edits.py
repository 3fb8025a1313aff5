"""Changes to a recording's files, as a user's own recording might have them."""

import tomllib
from pathlib import Path

import av
import numpy as np
import tomli_w


def set_keys(folder: Path, section: str, **keys: object) -> None:
    """Set keys of a section of recording.toml; None takes a key away."""
    file = folder / "recording.toml"
    tree = tomllib.loads(file.read_text(encoding="utf-8"))
    values = {**tree.get(section, {}), **keys}
    tree[section] = {key: value for key, value in values.items() if value is not None}
    file.write_text(tomli_w.dumps(tree), encoding="utf-8")


def append(folder: Path, text: str) -> None:
    """Add lines to recording.toml."""
    file = folder / "recording.toml"
    file.write_text(file.read_text(encoding="utf-8") + "\n" + text + "\n", encoding="utf-8")


def replace_text(folder: Path, old: str, new: str) -> None:
    """Change one place of recording.toml."""
    file = folder / "recording.toml"
    text = file.read_text(encoding="utf-8")
    assert text.count(old) == 1
    file.write_text(text.replace(old, new), encoding="utf-8")


def read_columns(file: Path) -> np.ndarray:
    """The numbers of a CSV with one header line, (rows, columns)."""
    return np.genfromtxt(file, delimiter=",", skip_header=1)


def acceleration(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Time (s) and acceleration (m/s²) of a simulated recording."""
    time, value = read_columns(folder / "accel.csv").T
    return time, value


def write_acceleration(folder: Path, time: np.ndarray, value: np.ndarray) -> None:
    """Write accel.csv; what is not a number becomes an empty field, as spreadsheets have it."""
    rows = [
        f"{t:.6f},{v:.7f}" if np.isfinite(v) else f"{t:.6f},"
        for t, v in zip(time.tolist(), value.tolist(), strict=True)
    ]
    (folder / "accel.csv").write_text("\n".join(["time_s,accel", *rows]) + "\n", encoding="utf-8")


def write_displacement(folder: Path, shaken: tuple[np.ndarray, np.ndarray], met: tuple[np.ndarray, np.ndarray]) -> None:
    """A recording of an accelerometer, times (s) and m/s², and a displacement sensor, times (s) and mm."""
    for name, table in (("a", shaken), ("d", met)):
        np.savetxt(folder / f"{name}.csv", np.column_stack(table), "%.9f", ",", header="time_s,value", comments="")
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "a.csv"\nunit = "m/s^2"\n[displacement]\nfile = "d.csv"\nunit = "mm"\n'
    )


def frames(folder: Path) -> np.ndarray:
    """All frames of camera.mkv, (frames, rows, columns)."""
    with av.open(str(folder / "camera.mkv")) as container:
        return np.stack([frame.to_ndarray(format="gray") for frame in container.decode(video=0)])


def write_stack(folder: Path, stack: np.ndarray) -> None:
    """Put a stack (frames, rows, columns) in the video's place."""
    np.save(folder / "camera.npy", stack)
    set_keys(folder, "camera", file="camera.npy")


def truth(folder: Path) -> np.ndarray:
    """Rows (n, 3) of time (s), displacement (mm), velocity (mm/s)."""
    return read_columns(folder / "truth.csv")


def error_mm(folder: Path, time_s: np.ndarray, displacement_mm: np.ndarray) -> np.ndarray:
    """Displacement minus the truth at the same instants, mm; the truth is exact there, being on the sensor's grid."""
    known = truth(folder)
    return displacement_mm - np.interp(time_s, known[:, 0], known[:, 1])
