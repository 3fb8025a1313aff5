"""What happens to a radar outdoors: the interference of other radars, its clock, the jitter of its frames."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.honest.frames import CARRIER_HZ, LIGHT_M_S
from benchmarks.honest.oscillators import after, in_band
from benchmarks.honest.station import Station
from midspan.records import Floats

LENGTH_S, FRAMES_HZ = 60.0, 50.0
BIN_M, BINS, TARGET_BIN = 0.11, 24, 9
BURSTS = ((10, 0.05), (40, 0.2), (150, 0.03))  # how many in the record, and how long each is, s


class Beam(Station):
    """A station with a radar. jammed (n,): frames during which another radar is in the band."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.jammed = np.zeros(len(self.true_s), dtype=np.bool_)
        self.taken_s: Floats = self.true_s


def installation(rng: np.random.Generator) -> Beam:
    """Oscillators of 2 to 6 mm rms at 0.5 to 4 Hz, a radar of 50 frames/s and 77 GHz before them."""
    motion = in_band(rng, (0.5, 4.0), float(rng.uniform(2e-3, 6e-3)), length_s=LENGTH_S)
    return Beam(rng, motion, FRAMES_HZ, float(rng.uniform(1.0, 1.8)), LENGTH_S, float(rng.uniform(-0.2, 0.2)))


def profiles(made: Beam) -> NDArray[np.complex64]:
    """Range profiles (frames, bins): target, three fixed reflectors, receiver noise, and the interference."""
    rng, turn = made.rng, 4 * np.pi * CARRIER_HZ / LIGHT_M_S
    place_m = (TARGET_BIN + rng.uniform(-0.2, 0.2)) * BIN_M
    range_m = place_m + made.motion.at(made.taken_s) / made.scale
    bins, shape = np.arange(BINS), (len(range_m), BINS)
    values = _spread(bins, range_m / BIN_M) * np.exp(1j * turn * range_m)[:, None]
    for fixed in rng.choice([1, 2, 14, 16, 19, 22], 3, replace=False) + rng.uniform(-0.3, 0.3, 3):
        values += rng.uniform(0.2, 0.8) * _spread(bins, np.array([fixed])) * np.exp(2j * np.pi * rng.uniform())
    noise = 10 ** (-rng.uniform(20, 30) / 20)
    # The other radar's chirps cross this one's: noise in every bin, 6 dB above the target.
    size = np.where(made.jammed, 2.0, noise)[:, None]
    values += size * (rng.normal(size=(*shape, 2)) @ [1, 1j]) / np.sqrt(2)
    return values.astype(np.complex64)


def _spread(bins: NDArray[np.int64], place: Floats) -> Floats:
    """How much of a reflector at places (n,) in bins is in each bin (n, bins), behind a Hann window."""
    away = np.subtract.outer(place, bins)
    # The transform of a Hann window; its limits at 0 and ±1 are met by the small shift.
    away = np.where(np.abs(np.abs(away) - 1) < 1e-9, away + 1e-7, away)
    return np.asarray(np.sinc(away) / (1 - away**2))


def write(made: Beam, folder: Path) -> None:
    """Slow-time phasors of a whole range profile."""
    import h5py

    with h5py.File(folder / "radar.h5", "w") as file:
        file.create_dataset("iq", data=profiles(made)[:, None, :])
        file.attrs["carrier_hz"] = CARRIER_HZ
        file["time_s"], file["range_m"] = made.stamps_s, BIN_M * np.arange(BINS)
    (folder / "recording.toml").write_text(
        f'{made.write_acceleration(folder)}[radar]\nfile = "radar.h5"\ntarget_range_m = {TARGET_BIN * BIN_M:.3f}\n'
    )


def calm(made: Beam) -> None:
    """Nothing is broken."""


def jam(made: Beam) -> None:
    """Another radar's interference: 10 bursts of 50 ms, 40 of 0.2 s or 150 of 30 ms, noise 6 dB above the target."""
    count, length_s = BURSTS[made.rng.integers(len(BURSTS))]
    for start in made.rng.uniform(made.true_s[0], made.true_s[-1], count):
        made.jammed |= (made.true_s >= start) & (made.true_s < start + length_s)
    # The first frames' phase is the zero, and a record that begins jammed has none.
    made.jammed[:5] = False


def jitter(made: Beam) -> None:
    """Frames are taken 1 to 4 ms, rms, beside their stamps."""
    made.taken_s = made.true_s + made.rng.uniform(1e-3, 4e-3) * made.rng.normal(size=len(made.true_s))


def clockstep(made: Beam) -> None:
    """The radar's clock is set forwards by 20 to 300 ms, or back by less than a frame."""
    size = 10 ** made.rng.uniform(np.log10(0.02), np.log10(0.3))
    step = size if made.rng.uniform() < 0.75 else -0.9 / FRAMES_HZ
    made.ahead_s, made.has_offset = after(made.true_s, made.rng.uniform(20, 40), step), False


def hum(made: Beam) -> None:
    """No anti-alias filter, and a machine near the accelerometer's rate: a narrow line in the acceleration alone."""
    made.hums()


Change = Callable[[Beam], None]
