"""Recordings of a structure in lively motion from the first sample to the last, written from physics alone.

The motion is an exact sum of sines; its acceleration and the pictures of a moving pattern of waves are in closed form.
Nothing here comes from the package, so that it cannot share a mistake with it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

SPEED_OF_LIGHT_M_S = 299792458.0
CARRIER_HZ, CONVERSION = 77.5e9, 1.25
SCALE_MM_PER_PX, PIXELS = -1.5, 84
# °C of one grey level of the pattern, and where it lies.
KELVIN_PER_LEVEL, COLDEST_C = 0.05, 15.0


@dataclass(frozen=True)
class Lively:
    """What is recorded.

    first_s, rate_hz: first instant and rate of the slow sensor, on the accelerometer's clock, which begins at 0;
    rms_m: of the motion, even over band_hz; tones: instead of that, pairs of amplitude (m) and Hz; noise_m_s2: of a
    sample of acceleration at 100 Hz, with the same density at other rates; noise_m: of a measurement of a
    [displacement] sensor. late_s: to be added to the slow sensor's stamps; mm_per_px: of a camera; moved: instant (s)
    from which on the slow sensor itself has moved by so much (m); nods: amplitude (px) and frequency (Hz) of a camera's
    tilt in the image.
    """

    seed: int = 0
    accelerometer_hz: float = 100.0
    first_s: float = 1.0
    rate_hz: float = 10.0
    duration_s: float = 25.0
    rms_m: float = 4e-3
    band_hz: tuple[float, float] = (2.0, 3.0)
    tones: tuple[tuple[float, float], ...] = ()
    noise_m_s2: float = 2e-3
    noise_m: float = 0.1e-3
    bias_m_s2: float = 0.02
    late_s: float = 0.0
    mm_per_px: float = SCALE_MM_PER_PX
    moved: tuple[float, float] = (np.inf, 0.0)
    nods: tuple[float, float] = (0.0, 0.0)

    def motion(self, time_s, order=0):
        """Displacement of a sum of sines at times (n,) in s, or its derivative of that order; m, m/s, m/s²."""
        rng = np.random.default_rng(1000 + self.seed)
        if self.tones:
            amplitude_m, hertz = np.array(self.tones).T
        else:
            low, high = self.band_hz
            hertz = low + (high - low) * (np.arange(40) + rng.uniform(0, 1, 40)) / 40.0
            amplitude_m = np.full(40, self.rms_m * np.sqrt(2.0 / 40.0))
        omega = 2.0 * np.pi * hertz
        phase = rng.uniform(0, 2.0 * np.pi, len(omega))
        return np.sin(np.multiply.outer(time_s, omega) + phase + 0.5 * np.pi * order) @ (amplitude_m * omega**order)

    @property
    def met_s(self):
        """The instants of the slow sensor, s."""
        return np.arange(self.first_s, self.duration_s - 0.3, 1.0 / self.rate_hz)

    @property
    def met_m(self):
        """What the slow sensor sees at its instants, without noise, m."""
        at_s, step_m = self.moved
        return self.motion(self.met_s) + np.where(self.met_s < at_s, 0.0, step_m)

    def from_zero_mm(self, time_s):
        """The true displacement at times (n,), counted from the slow sensor's first instant, mm."""
        return 1e3 * (self.motion(time_s) - self.motion(self.met_s[:1]))


def write(folder: Path, case: Lively, sensor: str, more: str = "") -> Path:
    """A recording of an accelerometer and a `sensor`: camera, infrared, radar or displacement.

    more: further lines of recording.toml.
    """
    rng = np.random.default_rng(case.seed)
    head = _accelerometer(folder, case, rng)
    section = SENSORS[sensor](folder, case, rng)
    (folder / "recording.toml").write_text(f"{head}\n[{sensor}]\n{section}\n{more}\n", encoding="utf-8")
    return folder


def write_several(folder: Path, case: Lively, sensor: str, named: dict[str, Lively], more: str = "") -> Path:
    """A recording of an accelerometer, as `case` says, and several sensors of one kind, each as its own case says.

    named: their names in the order of the file; more: further lines of each section.
    """
    return write_kinds(folder, case, {name: (sensor, own) for name, own in named.items()}, more)


def write_kinds(folder: Path, case: Lively, named: dict[str, tuple[str, Lively]], more: str = "") -> Path:
    """A recording of an accelerometer, as `case` says, and sensors of several kinds, each as its own case says.

    named: kind and case by name, in the order of the file; more: further lines of each section.
    """
    sections = [_accelerometer(folder, case, np.random.default_rng(case.seed))]
    for number, (name, (sensor, own)) in enumerate(named.items()):
        (folder / name).mkdir()
        lines = SENSORS[sensor](folder / name, own, np.random.default_rng((case.seed, number)))
        lines = lines.replace('file = "', f'file = "{name}/')
        sections.append(f'[[{sensor}]]\nname = "{name}"\n{lines}\n{more}')
    (folder / "recording.toml").write_text("\n".join(sections), encoding="utf-8")
    return folder


def _accelerometer(folder, case, rng):
    folder.mkdir(parents=True, exist_ok=True)
    time_s = np.arange(round(case.duration_s * case.accelerometer_hz)) / case.accelerometer_hz
    noise = case.noise_m_s2 * np.sqrt(case.accelerometer_hz / 100.0)
    value = case.motion(time_s, 2) + case.bias_m_s2 + rng.normal(0.0, noise, len(time_s))
    table = np.column_stack((time_s, value))
    np.savetxt(folder / "accel.csv", table, delimiter=",", header="time_s,accel", comments="", fmt="%.9f")
    return '[accelerometer]\nfile = "accel.csv"\ntime = "time_s"\nvalue = "accel"\nunit = "m/s^2"\n'


def _film(case, rng):
    """Grey levels (frames, rows, columns) of waves of 6 to 40 px that the structure's motion shifts downwards."""
    count, place = 60, np.arange(PIXELS, dtype=np.float64)
    length, heading = rng.uniform(6.0, 40.0, count), rng.uniform(0.0, np.pi, count)
    across, down = 2.0 * np.pi * np.cos(heading) / length, 2.0 * np.pi * np.sin(heading) / length
    still = np.exp(1j * (np.multiply.outer(down, place)[:, :, None] + np.multiply.outer(across, place)[:, None, :]))
    still *= np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, count))[:, None, None]
    size_px, hertz = case.nods
    shifted_px = 1e3 * case.met_m / case.mm_per_px + size_px * np.sin(2.0 * np.pi * hertz * case.met_s)
    turn = np.exp(-1j * np.multiply.outer(shifted_px, down))
    waves = (turn @ still.reshape(count, -1)).real.reshape(-1, PIXELS, PIXELS)
    return 128.0 + 4.5 * waves


def _times(case):
    return f"rate_hz = {case.rate_hz!r}\nstart_s = {case.first_s - case.late_s!r}"


def _camera(folder, case, rng):
    film = _film(case, rng)
    film += rng.normal(0.0, 1.0, film.shape)
    np.save(folder / "camera.npy", np.clip(np.rint(film), 0, 255).astype(np.uint8))
    return f'file = "camera.npy"\n{_times(case)}\ndirection = "y"\nroi = [18, 18, 48, 48]'


def _infrared(folder, case, rng):
    film = _film(case, rng)
    film += rng.normal(0.0, 1.0, film.shape)
    np.savez(folder / "infrared.npz", celsius=(COLDEST_C + KELVIN_PER_LEVEL * film).astype(np.float32))
    limits = f"temperature_range_c = [{COLDEST_C}, {COLDEST_C + 255 * KELVIN_PER_LEVEL}]"
    return f'file = "infrared.npz"\n{_times(case)}\ndirection = "y"\nroi = [18, 18, 48, 48]\n{limits}'


def _radar(folder, case, rng):
    phase = 4.0 * np.pi * CARRIER_HZ / SPEED_OF_LIGHT_M_S * case.met_m / CONVERSION
    noise = rng.normal(0.0, 0.02, (2, len(phase)))
    np.save(folder / "radar.npy", (np.exp(1j * (phase + 0.7)) + noise[0] + 1j * noise[1]).astype(np.complex64))
    return f'file = "radar.npy"\n{_times(case)}\ncarrier_hz = {CARRIER_HZ!r}'


def _displacement(folder, case, rng):
    value = 1e3 * (case.met_m + rng.normal(0.0, case.noise_m, len(case.met_s)))
    table = np.column_stack((case.met_s - case.late_s, value))
    np.savetxt(folder / "slow.csv", table, delimiter=",", header="time_s,height", comments="", fmt="%.9f")
    return 'file = "slow.csv"\ntime = "time_s"\nvalue = "height"\nunit = "mm"'


SENSORS = {"camera": _camera, "infrared": _infrared, "radar": _radar, "displacement": _displacement}

# Focal length of a camera by which its tilt moves the image, px.
FOCAL_PX = 2000.0


def add_velocity(folder: Path, case: Lively) -> Path:
    """Put a vibrometer of 50 values a second with 0.1 mm/s to a recording."""
    time_s = np.arange(0.2, case.duration_s - 0.2, 0.02)
    noise = np.random.default_rng(case.seed + 1).normal(0.0, 1e-4, len(time_s))
    return _add(folder, "velocity", time_s, 1e3 * (case.motion(time_s, 1) + noise), 'value = "value"\nunit = "mm/s"')


def add_gyroscope(folder: Path, case: Lively) -> Path:
    """Put a gyroscope of 100 values a second to a recording with a camera that tilts: 0.005 °/s/√Hz, biased."""
    time_s = np.arange(0.0, case.duration_s, 0.01)
    size_px, hertz = case.nods
    rate = size_px / FOCAL_PX * 2.0 * np.pi * hertz * np.cos(2.0 * np.pi * hertz * time_s)
    rate += np.radians(0.1 + np.random.default_rng(case.seed + 1).normal(0.0, 0.005 * np.sqrt(50.0), len(time_s)))
    return _add(folder, "gyroscope", time_s, np.degrees(rate), 'value_x = "value"\nunit = "deg/s"')


def _add(folder: Path, kind: str, time_s, value, lines: str) -> Path:
    table = np.column_stack((time_s, value))
    np.savetxt(folder / f"{kind}.csv", table, delimiter=",", header="time_s,value", comments="", fmt="%.9f")
    with (folder / "recording.toml").open("a", encoding="utf-8") as file:
        file.write(f'[{kind}]\nfile = "{kind}.csv"\ntime = "time_s"\n{lines}\n')
    return folder
