"""What `inspect` and the result say of a channel: its range, its missing samples, a record of a quarter of a second."""

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from midspan.cli.main import run
from recording_edits import acceleration, write_acceleration

RNG = np.random.default_rng(8)


def said(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    assert run(arguments) == 0
    return capsys.readouterr().out


def test_a_range_shows_the_motion_and_a_time_has_one_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A total station's file: eastings that move by millimetres, and the time of day."""
    rows = [f"10:56:{27 + k // 10:02d}.{k % 10}00;{650134.1234 + 0.004 * np.sin(k):.4f};{k % 7}\n" for k in range(300)]
    (tmp_path / "rts.csv").write_text("time;easting [m];n\n" + "".join(rows))
    text = said(["inspect", str(tmp_path / "rts.csv")], capsys)
    assert "650134.1194 … 650134.1274 m" in text
    assert "39387.000 s … 39416.900 s\n" in text
    assert "0 … 6 (no unit)" in text
    tree = json.loads(said(["inspect", str(tmp_path / "rts.csv"), "--json"], capsys))
    assert tree["channels"][1]["smallest"] == 650134.1194


def test_a_recordings_range_shows_the_motion_too(footbridge_copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time, value = acceleration(footbridge_copy)
    write_acceleration(footbridge_copy, time, 5e5 + np.round(value, 3))
    text = said(["inspect", str(footbridge_copy)], capsys)
    low, high = (float(part) for part in re.search(r"values +(\S+) … (\S+) m/s", text).groups())  # type: ignore[union-attr]
    # Three digits of the difference: 1 % of it at worst.
    assert abs((high - low) / np.ptp(value) - 1.0) < 0.01


def test_two_seconds_without_numbers_are_a_warning_of_inspect_and_result(
    footbridge_copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time, value = acceleration(footbridge_copy)
    rate = 1.0 / np.median(np.diff(time))
    value[np.searchsorted(time, 3.0)] = np.nan
    value[np.searchsorted(time, 12.0) : np.searchsorted(time, 14.0)] = np.nan
    lost = int(np.isnan(value).sum())
    assert run(["calibrate", str(footbridge_copy), "-q"]) == 0
    write_acceleration(footbridge_copy, time, value)
    words = (f"{lost} samples", "are not numbers", f"the longest block for {(lost - 1) / rate:.3g} s from 12.0")
    tree = json.loads(said(["inspect", str(footbridge_copy), "--json"], capsys))
    (line,) = tree["accelerometer"]["warnings"]
    assert all(word in line for word in words)
    assert f"({lost} without a number)" in said(["inspect", str(footbridge_copy / "accel.csv")], capsys)
    calibration = str(footbridge_copy / "calibration.json")
    # Calibrated before the hole was there: the result must say it on its own.
    assert run(["estimate", str(footbridge_copy), "-c", calibration, "-o", str(footbridge_copy / "o.csv")]) == 0
    warnings = json.loads((footbridge_copy / "o.json").read_text())["warnings"]
    assert sum(all(word in line for word in words) for line in warnings) == 1


def test_values_beyond_any_physics_are_missing_and_no_raw_warning(
    footbridge_copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time, value = acceleration(footbridge_copy)
    rows = [
        f"{t:.6f},{'1e200' if k in (40, 41) else f'{v:.7f}'}" for k, (t, v) in enumerate(zip(time, value, strict=True))
    ]
    (footbridge_copy / "accel.csv").write_text("\n".join(["time_s,accel", *rows]) + "\n")
    tree = json.loads(said(["inspect", str(footbridge_copy), "--json"], capsys))
    assert tree["accelerometer"]["missing_samples"] == 2
    assert any("beyond" in note for note in tree["accelerometer"]["notes"])


def high_speed(folder: Path) -> float:
    """A quarter of a second at 15 000 frames/s and 50 kHz of a plate that rings at two tones; its mm per pixel."""
    duration_s, mm_per_px = 0.25, 0.2
    tones = ((0.3, 60.0, 0.3), (0.1, 210.0, 1.0))  # mm, Hz, rad

    def displacement_mm(time: np.ndarray) -> np.ndarray:
        return sum(a * np.sin(2 * np.pi * f * time + p) for a, f, p in tones)

    time = np.arange(round(duration_s * 50e3)) / 50e3
    value = sum(-1e-3 * a * (2 * np.pi * f) ** 2 * np.sin(2 * np.pi * f * time + p) for a, f, p in tones)
    value += RNG.normal(0.0, 0.5, time.size)
    rows = "".join(f"{t:.5f},{v:.4f}\n" for t, v in zip(time, value, strict=True))
    (folder / "accel.csv").write_text("time_s,accel\n" + rows)
    # A texture of waves, each moved exactly by its phase.
    shift = displacement_mm(np.arange(round(duration_s * 15e3)) / 15e3) / mm_per_px
    y, x = np.mgrid[0:40, 0:40].reshape(2, -1)
    waves = RNG.uniform(0.15, 0.9, (12, 2)) * RNG.choice([-1, 1], (12, 2))
    still = np.exp(1j * (waves @ np.array([x, y]) + RNG.uniform(0, 2 * np.pi, (12, 1))))
    pictures = 128 + 20 * np.real(np.exp(-1j * np.outer(shift, waves[:, 1])) @ still)
    pictures += RNG.normal(0.0, 1.5, pictures.shape)
    np.save(folder / "camera.npy", np.clip(np.rint(pictures), 0, 255).astype(np.uint8).reshape(-1, 40, 40))
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n'
        '[camera]\nfile = "camera.npy"\nrate_hz = 15000\ndirection = "y"\nroi = [6, 6, 28, 28]\ntracker = "template"\n'
    )
    return mm_per_px


def test_a_quarter_of_a_second_of_a_high_speed_camera_is_enough(tmp_path: Path) -> None:
    mm_per_px = high_speed(tmp_path)
    assert run(["estimate", str(tmp_path), "-o", str(tmp_path / "out.csv"), "-q"]) == 0
    found = json.loads((tmp_path / "out.json").read_text())["calibration"]["camera"]
    # The tones tell it to some 0.1 %; 1 % is far from any wrong lobe of the search.
    assert abs(found["scale_mm_per_px"] / mm_per_px - 1.0) < 0.01
    assert abs(found["time_offset_s"]) < 1e-4
    time, displacement = np.genfromtxt(tmp_path / "out.csv", delimiter=",", skip_header=1, usecols=(0, 1)).T
    truth = 0.3 * np.sin(2 * np.pi * 60 * time + 0.3) + 0.1 * np.sin(2 * np.pi * 210 * time + 1.0)
    # A frame is good for 0.01 px or 2 µm; the zero is one frame's.
    assert np.std(displacement - truth) < 2e-3


def test_a_dataset_larger_than_the_memory_is_listed_and_not_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("acc", data=np.arange(100.0)).attrs["unit"] = "m/s^2"
        # 800 GB by its header; nothing of it is written.
        file.create_dataset("spare", shape=(100_000_000_000,), dtype="f8", chunks=(1_000_000,))
    text = said(["inspect", str(path)], capsys)
    assert "acc: 100 samples, 0 … 99 m/s^2" in text
    assert re.search(r"spare: 100000000000 samples, not read: .* GiB", text)
    acc, spare = json.loads(said(["inspect", str(path), "--json"], capsys))["channels"]
    assert (acc["smallest"], acc["largest"], acc["missing"]) == (0.0, 99.0, 0)
    assert (spare["smallest"], spare["largest"], spare["missing"]) == (None, None, None)
    assert "GiB" in spare["not_read"]
