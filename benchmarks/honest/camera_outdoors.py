"""What happens to a camera or an infrared camera outdoors: masts, lenses, hot air, reflections, railings."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.honest.oscillators import after, gauss_markov, in_band, on_a_spring, oscillator, oscillators
from benchmarks.honest.station import Station
from benchmarks.honest.warped import Bend, Course, texture
from midspan.records import Floats

LENGTH_S, FRAMES_HZ, SIZE_PX, INFRARED_PX = 75.0, 8.0, 160, 112


@dataclass
class Seen(Station):
    """A station with a camera.

    shift_px (n, 2), magnified (n,), axis_px (2,), bend: as `warped.Course` has them; readout_s: from the first row to
    the last; blobs: of a warm reflection.
    """

    size_px: int = SIZE_PX
    shift_px: Floats = field(init=False)
    magnified: Floats = field(init=False)
    axis_px: Floats = field(init=False)
    bend: Bend | None = None
    readout_s: float = 0.0
    reflection: "Reflection | None" = None

    def __post_init__(self) -> None:
        super().__post_init__()
        count = len(self.true_s)
        self.shift_px, self.magnified, self.axis_px = np.zeros((count, 2)), np.zeros(count), np.zeros(2)

    def course(self) -> Course:
        """Where it shows what, frame by frame."""
        moments = np.add.outer(self.true_s, self.readout_s * np.linspace(0, 1, self.size_px))
        down = self.motion.at(moments) / self.scale
        return Course(self.size_px, down, self.shift_px, self.magnified, self.axis_px, self.bend)


def installation(
    rng: np.random.Generator,
    *,
    size_px: int = SIZE_PX,
    band_hz: tuple[float, float] = (0.5, 4.0),
    length_s: float = LENGTH_S,
) -> Seen:
    """Oscillators of 1.5 to 5 mm rms at 0.5 to 4 Hz, 1 to 2 mm/px, 8 frames/s, accelerometer of 2 mm/s²."""
    rms = float(rng.uniform(1.5e-3, 5e-3))
    motion = in_band(rng, band_hz, rms, length_s=length_s)
    scale = -1e-3 * float(rng.uniform(1.0, 2.0))
    return Seen(rng, motion, FRAMES_HZ, scale, length_s, float(rng.uniform(-0.2, 0.2)), size_px=size_px)


def write_camera(made: Seen, folder: Path) -> None:
    """Frames of 8 bits as a stack with a file of stamps: texture of 30 DN, noise of 1.5 DN."""
    noise, size = made.rng, (made.size_px, made.size_px)
    films = made.course().pictures(texture(made.rng, made.size_px))
    stack = [np.clip(np.rint(110 + 30 * film + 1.5 * noise.standard_normal(size)), 0, 255) for film in films]
    np.save(folder / "camera.npy", np.array(stack, dtype=np.uint8))
    np.savetxt(folder / "camera_times.csv", made.stamps_s, "%.9f", header="time_s", comments="")
    (folder / "recording.toml").write_text(
        f'{made.write_acceleration(folder)}[camera]\nfile = "camera.npy"\ntimes = "camera_times.csv"\ndirection = "y"\n'
    )


def write_infrared(made: Seen, folder: Path) -> None:
    """Temperatures: contrast of 1 K, noise of 0.05 K."""
    size = (made.size_px, made.size_px)
    films = made.course().pictures(texture(made.rng, made.size_px))
    stack = [20 + film + 0.05 * made.rng.standard_normal(size) for film in films]
    if made.reflection is not None:
        stack = [picture + made.reflection.at(k) for k, picture in enumerate(stack)]
    np.savez(folder / "infrared.npz", celsius=np.array(stack, dtype=np.float32), time_s=made.stamps_s)
    (folder / "recording.toml").write_text(
        f'{made.write_acceleration(folder)}[infrared]\nfile = "infrared.npz"\ndirection = "y"\n'
    )


class Reflection:
    """Something warm that the wall reflects: spots of 8 to 25 px which wander by 10 px or so in some seconds."""

    SPOTS = 5

    def __init__(self, rng: np.random.Generator, size_px: int, time_s: Floats, *, kelvin: float, correlation_s: float):
        self.grid = np.arange(size_px)
        self.width_px, self.start_px = rng.uniform(8, 25, self.SPOTS), rng.uniform(0, size_px, (self.SPOTS, 2))
        self.kelvin = kelvin * rng.uniform(0.5, 1.0, self.SPOTS)
        wander = [gauss_markov(rng, time_s, std=10.0, correlation_s=correlation_s) for _ in range(2)]
        self.wander_px = np.array(wander).T

    def at(self, frame: int) -> Floats:
        """What it adds (rows, columns) to a frame, K."""
        spots = zip(self.start_px + self.wander_px[frame], self.width_px, self.kelvin, strict=True)
        shapes = ((np.exp(-(((self.grid - p[:, None]) / w) ** 2) / 2), k) for p, w, k in spots)
        return np.asarray(sum(k * np.outer(down, right) for (down, right), k in shapes))


# ---- kinds


def calm(made: Seen) -> None:
    """Nothing is broken."""


def mast(made: Seen) -> None:
    """The camera's mast nods in the wind: 0.05 to 0.5 Hz, 2 to 5 % of damping, 0.15 to 1 px rms."""
    frequency, size = 10 ** made.rng.uniform(np.log10(0.05), np.log10(0.5)), 10 ** made.rng.uniform(-0.82, 0.0)
    damping = made.rng.uniform(0.02, 0.05)
    nod = oscillator(made.rng, frequency, size, length_s=made.length_s, damping=damping)
    made.shift_px[:, 0] = nod.at(made.true_s)


def breathe(made: Seen) -> None:
    """The autofocus hunts: 0.1 to 0.3 % of magnification in 3 to 20 s, the region 60 to 300 px beside the axis."""
    made.magnified = _slow(made, made.rng.uniform(1e-3, 3e-3), made.rng.uniform(3, 20))
    made.axis_px = _beside(made, (60, 300))


def grow(made: Seen) -> None:
    """The target moves in depth: ±0.3 to 0.5 % of magnification at 0.1 to 0.4 Hz, 100 to 300 px beside the axis."""
    frequency, size = made.rng.uniform(0.1, 0.4), made.rng.uniform(3e-3, 5e-3) / np.sqrt(2)
    made.magnified = oscillator(made.rng, frequency, size, length_s=made.length_s).at(made.true_s)
    made.axis_px = _beside(made, (100, 300))


def _slow(made: Seen, std: float, correlation_s: float) -> Floats:
    """A course (n,) that is smooth, as a lens's drive is: two Gauss-Markov lags one behind the other."""
    path = gauss_markov(made.rng, made.true_s, std=1.0, correlation_s=correlation_s)
    behind, keep = np.empty_like(path), np.exp(-1 / (made.frames_hz * correlation_s / 3))
    last = path[0]
    for k, value in enumerate(path):
        last = behind[k] = keep * last + (1 - keep) * value
    return np.asarray(std * (behind - behind[0]) / np.std(behind))


def _beside(made: Seen, distance_px: tuple[float, float]) -> Floats:
    """An optical axis (down, right) so far above or below the picture's middle, and up to half as far to the side."""
    down = made.rng.choice([-1, 1]) * made.rng.uniform(*distance_px)
    return np.array([down, down * made.rng.uniform(-0.5, 0.5)])


def haze(made: Seen) -> None:
    """Air over warm ground: the picture wanders by 0.2 to 0.5 px rms in 1 to 10 s, and its parts by a third of that."""
    size, tau = made.rng.uniform(0.2, 0.5), 10 ** made.rng.uniform(0, 1)
    for axis in range(2):
        made.shift_px[:, axis] = gauss_markov(made.rng, made.true_s, std=size, correlation_s=tau)
    made.bend = Bend(made.rng, made.size_px, made.true_s, std_px=size / 3, correlation_s=tau)


def railing(made: Seen) -> None:
    """The accelerometer stands on a railing of its own resonance, 6 to 12 Hz with 2 to 5 % of damping."""
    made.felt = on_a_spring(made.felt, made.rng.uniform(6, 12), made.rng.uniform(0.02, 0.05))


def rolling(made: Seen) -> None:
    """The sensor's rows are read one after the other, 15 to 25 ms from first to last, and nobody says so."""
    made.readout_s = made.rng.uniform(0.015, 0.025)
    # Which row a stamp belongs to is a convention.
    made.has_offset = made.has_zero = False


def clockstep(made: Station) -> None:
    """The camera's clock is set by 20, 60 or 300 ms, forwards or back, somewhere in the middle."""
    step = made.rng.choice([-1, 1]) * made.rng.choice([0.02, 0.06, 0.3])
    made.ahead_s, made.has_offset = after(made.true_s, made.rng.uniform(25, 50), step), False


def hum(made: Station) -> None:
    """No anti-alias filter, and a machine near the accelerometer's rate: a narrow line in the acceleration alone."""
    made.hums()


def highrise(rng: np.random.Generator) -> Seen:
    """A high-rise of 0.06 and 0.2 Hz, 40 mm rms, seen with 12 mm/px; an accelerometer of 50 mm/s² (5 mg)."""
    length_s = 120.0
    motion = oscillators(rng, (0.06, 0.2), 0.040, length_s=length_s)
    return Seen(rng, motion, FRAMES_HZ, -12e-3, length_s, float(rng.uniform(-0.2, 0.2)), noise_m_s2=0.05)


def reflection(made: Seen) -> None:
    """Something warm is reflected by the wall, 0.3 to 1.5 K, and wanders over it in 3 to 20 s."""
    kelvin, tau = made.rng.uniform(0.3, 1.5), made.rng.uniform(3, 20)
    made.reflection = Reflection(made.rng, made.size_px, made.true_s, kelvin=kelvin, correlation_s=tau)


Change = Callable[[Seen], None]
