"""Recordings with a camera, an infrared camera or a radar: textures moved in the Fourier domain, and phasors."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.honest.lines import GRAVITY_M_S2, Lines, acceleration, butterworth, low_passed, mode, modes
from midspan.records import Floats

LENGTH_S, BEGIN_S = 60.0, 0.7
CANVAS_PX, FRAME_PX = 128, 88
CARRIER_HZ, LIGHT_M_S = 77e9, 299_792_458.0
MOMENTS = 7  # within one exposure
BETWEEN = 0.37  # of the accelerometer's interval, by which frames fall between its samples


@dataclass
class View:
    """One recording before it is written; a kind changes it in place.

    motion: true displacement (m); felt: what the accelerometer measures (m/s²); seen: what moves the picture or the
    range (m); scale_m_per_px: displacement of one pixel down the frame, or displacement per range for a radar.
    """

    rng: np.random.Generator
    motion: Lines
    frames_hz: float
    scale: float
    noise_m_s2: float
    offset_s: float
    exposure_s: float = 0.0
    pattern_k: float = 0.0
    rate_hz: float = 100.0
    felt: Lines = field(init=False)
    seen: Lines = field(init=False)

    def __post_init__(self) -> None:
        self.felt, self.seen = acceleration(self.motion), self.motion

    @property
    def true_s(self) -> Floats:
        """True instants of the frames."""
        first = BEGIN_S + BETWEEN / self.rate_hz
        return first + np.arange(int((LENGTH_S - 2 * BEGIN_S) * self.frames_hz)) / self.frames_hz

    def moved_px(self) -> Floats:
        """Translation down the frame (n, MOMENTS) px within each exposure."""
        within = ((np.arange(MOMENTS) + 0.5) / MOMENTS - 0.5) * self.exposure_s
        moments = np.add.outer(self.true_s, within)
        return self.seen.at(moments.ravel()).reshape(moments.shape) / self.scale


def view(rng: np.random.Generator, *, frames_hz: float, rms_px: float = 1.5) -> View:
    """A structure of 1 to 6 mm rms at 0.5 to 4 Hz, lively from the first frame."""
    rms = 1e-3 * 10 ** rng.uniform(0, 0.8)
    return View(
        rng,
        modes(rng, (0.5, 4.0), rms, length_s=LENGTH_S),
        frames_hz,
        -rms / (rms_px * 10 ** rng.uniform(-0.3, 0.2)),
        noise_m_s2=1e-3 * 10 ** rng.uniform(-0.3, 0.7),
        offset_s=rng.uniform(-0.2, 0.2),
        rate_hz=float(rng.choice([100.0, 200.0])),
    )


def texture(rng: np.random.Generator) -> NDArray[np.complex128]:
    """Spectrum of a periodic texture of standard deviation 1, like 1/f, blurred by a lens of 0.8 px."""
    f = np.hypot(np.fft.fftfreq(CANVAS_PX)[:, None], np.fft.fftfreq(CANVAS_PX)[None, :])
    blur = np.exp(-2 * (np.pi * 0.8 * f) ** 2) / np.maximum(f, 1 / 24)
    spectrum = np.fft.fft2(rng.normal(size=(CANVAS_PX, CANVAS_PX))) * blur * (f > 0) * (f < 0.5)
    return np.asarray(spectrum / np.std(np.fft.ifft2(spectrum).real))


def pictures(spectrum: NDArray[np.complex128], moved_px: Floats) -> Iterator[Floats]:
    """The texture's middle (FRAME_PX, FRAME_PX), moved down by the mean of each row's translations (n, MOMENTS)."""
    turns = np.fft.fftfreq(CANVAS_PX)
    part = slice((CANVAS_PX - FRAME_PX) // 2, (CANVAS_PX + FRAME_PX) // 2)
    for row in moved_px:
        shift = np.exp(-2j * np.pi * np.multiply.outer(turns, row)).mean(axis=1)
        yield np.fft.ifft2(spectrum * shift[:, None]).real[part, part]


def _accelerometer(made: View, folder: Path) -> str:
    time = np.arange(round(LENGTH_S * made.rate_hz)) / made.rate_hz
    value = made.felt.at(time) + 0.05 + made.rng.normal(0, made.noise_m_s2, len(time))
    table = np.column_stack((time, value))
    np.savetxt(folder / "accel.csv", table, "%.9f", ",", header="time_s,accel", comments="")
    return '[accelerometer]\nfile = "accel.csv"\ntime = "time_s"\nvalue = "accel"\nunit = "m/s^2"\n'


def write_camera(made: View, folder: Path) -> None:
    """Frames of 8 bits as a stack: texture of 30 DN, noise of 1.5 DN."""
    films = pictures(texture(made.rng), made.moved_px())
    size = (FRAME_PX, FRAME_PX)
    stack = [np.clip(np.rint(110 + 30 * film + made.rng.normal(0, 1.5, size)), 0, 255) for film in films]
    np.save(folder / "camera.npy", np.array(stack, dtype=np.uint8))
    start = float(made.true_s[0]) - made.offset_s
    (folder / "recording.toml").write_text(
        f'{_accelerometer(made, folder)}[camera]\nfile = "camera.npy"\nrate_hz = {made.frames_hz}\n'
        f'start_s = {start:.9f}\ndirection = "y"\n'
    )


def write_infrared(made: View, folder: Path) -> None:
    """Temperatures: contrast of 1 K, noise of 0.05 K, and the sensor's fixed pattern."""
    films, size = pictures(texture(made.rng), made.moved_px()), (FRAME_PX, FRAME_PX)
    pattern = made.rng.normal(0, 1, size) * made.pattern_k
    stack = [20 + film + pattern + made.rng.normal(0, 0.05, size) for film in films]
    times = made.true_s - made.offset_s
    np.savez(folder / "infrared.npz", celsius=np.array(stack, dtype=np.float32), time_s=times)
    (folder / "recording.toml").write_text(
        f'{_accelerometer(made, folder)}[infrared]\nfile = "infrared.npz"\ndirection = "y"\n'
    )


def write_radar(made: View, folder: Path) -> None:
    """Phasors of one target at 20 to 30 dB a frame."""
    import h5py

    turn = 4 * np.pi * CARRIER_HZ / LIGHT_M_S
    range_m = 5.0 + made.seen.at(made.true_s) / made.scale
    noise = 10 ** (-made.rng.uniform(20, 30) / 20) * made.rng.normal(size=(len(range_m), 2)) @ [1, 1j] / np.sqrt(2)
    with h5py.File(folder / "radar.h5", "w") as file:
        file.create_dataset("iq", data=(np.exp(1j * turn * range_m) + noise).astype(np.complex64)[:, None, None])
        file.attrs["carrier_hz"] = CARRIER_HZ
        file["time_s"], file["range_m"] = made.true_s - made.offset_s, np.array([5.0])
    (folder / "recording.toml").write_text(f'{_accelerometer(made, folder)}[radar]\nfile = "radar.h5"\n')


def plain(made: View) -> None:
    """Nothing is broken."""


def exposure(made: View) -> None:
    """The camera exposes for 50 to 90 % of its interval and does not say so."""
    made.exposure_s = made.rng.uniform(0.5, 0.9) / made.frames_hz


def bracket(made: View) -> None:
    """The camera's bracket vibrates against the accelerometer, above the camera's Nyquist frequency."""
    f = made.frames_hz * made.rng.uniform(0.6, 0.95)
    shake = mode(made.rng, f, made.rng.uniform(0.05, 0.15) * made.motion.rms, length_s=LENGTH_S)
    made.seen = made.seen + shake


def tilt(made: View) -> None:
    """A tower of 20 to 60 m leans as it moves: gravity reaches the accelerometer."""
    slope = 1.5 / made.rng.uniform(20, 60)
    made.felt = made.motion.passed(lambda s: s**2 - GRAVITY_M_S2 * slope)


def axis(made: View) -> None:
    """The accelerometer is turned by 3 to 15 degrees towards an axis that moves as much."""
    angle = np.radians(made.rng.uniform(3, 15))
    cross = acceleration(modes(made.rng, (0.5, 4.0), made.motion.rms, length_s=LENGTH_S))
    made.felt = made.felt.passed(lambda s: np.cos(angle)) + cross.passed(lambda s: np.sin(angle))


def logger(made: View) -> None:
    """The accelerometer's logger has a low-pass of 5 to 12 Hz, 4th to 8th order, its delay at 0 Hz taken off.

    That delay would be a clock offset like any other.
    """
    corner, order = made.rng.uniform(5, 12), int(made.rng.choice([4, 6, 8]))
    delay = float(np.sum(-1 / butterworth(corner, order)).real)
    made.felt = low_passed(made.felt, corner, order).passed(lambda s: np.exp(s * delay))


def own(made: View) -> None:
    """The target moves on its own at 0.2 to 1 Hz, a twentieth to a fifth of the structure's motion."""
    share = made.rng.uniform(0.05, 0.2)
    made.seen = made.seen + modes(made.rng, (0.2, 1.0), share * made.motion.rms, length_s=LENGTH_S)


def pattern(made: View) -> None:
    """The sensor has a fixed pattern of 0.1 K."""
    made.pattern_k = 0.1


Change = Callable[[View], None]
