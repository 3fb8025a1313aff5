"""Small recordings of a radar with a accelerometer, whose truth is known."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from midspan.radar.chirp import ChirpProfile
from midspan.radar.layout import Layout
from midspan.simulate.motion.motion import Motion, Window, random_motion
from midspan.simulate.radar.setup import Capture, demo_settings, write_capture
from midspan.simulate.radar.signal import RadarModel, Reflector, noise_for

# 0.69 GHz in 64 samples: bins of 0.22 m.
PROFILE = ChirpProfile(77e9, 64.985e12, 6e6, 64, 0.01, receivers=2)
PLATE = Reflector(0.1, 2500.0, ratio=0.0)
SAMPLE_S = 0.01


@dataclass(frozen=True)
class Case:
    """What is recorded; snr_db: of an amplitude of 900 a sample; lost: packets; sign: of the accelerometer's axis."""

    reflectors: tuple[Reflector, ...]
    seed: int = 0
    frames: int = 2500
    offset_s: float = 0.083
    snr_db: float = 10.0
    noise_m_s2: float = 3e-3
    lost: tuple[int, ...] = ()
    sign: float = 1.0
    rms_m: float = 2e-3
    motion: Motion | None = None


def write(folder: Path, case: Case, more: str = "") -> Path:
    """A folder with adc_data.bin, radar.cfg, accel.csv, truth.csv and recording.toml; more: lines under [radar]."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(case.seed)
    motion = case.motion or Window(random_motion((0.5, 4.0), case.rms_m, rng=rng), start_s=0.5, ramp_s=2.0)
    noise = noise_for(900.0, case.snr_db)
    model = RadarModel(case.reflectors, PROFILE, noise_std=noise, time_offset_s=case.offset_s)
    blocks = model.blocks(motion, case.frames, rng=rng)
    write_capture(folder / "adc_data.bin", blocks, Capture(Layout(PROFILE, "QQII"), lost=case.lost))
    (folder / "radar.cfg").write_text(demo_settings(PROFILE, frames=case.frames))
    time = np.arange(0.0, case.frames * PROFILE.frame_period_s + case.offset_s + 0.1, SAMPLE_S)
    value = case.sign * motion.acceleration(time) + rng.normal(0.0, case.noise_m_s2, len(time)) + 0.05
    zero = motion.displacement(np.array([PROFILE.middle_s + case.offset_s]))[0]
    moved = case.sign * 1e3 * (motion.displacement(time) - zero)
    _table(folder / "accel.csv", "time_s,accel", (time, value))
    _table(folder / "truth.csv", "time_s,displacement_mm", (time, moved))
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n\n[radar]\nfile = "adc_data.bin"\n'
        f'config = "radar.cfg"\n{more}\n'
    )
    return folder


def true_mm(folder: Path, time_s: np.ndarray) -> np.ndarray:
    """The true displacement at times (n,) on the accelerometer's clock, mm."""
    time, value = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1).T
    from scipy.interpolate import CubicSpline

    return CubicSpline(time, value)(time_s)


def _table(path: Path, header: str, columns: tuple[np.ndarray, ...]) -> None:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.8f")
