"""The radar's stage frame by frame with the estimator: faults of all kinds."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases import rms
from benchmarks.radar_chain import accelerometer, sine
from benchmarks.radar_loop import run
from benchmarks.table import show
from midspan.engine.radar_target import FollowedTarget
from midspan.radar.chirp import ChirpProfile, RangeAxis
from midspan.radar.range_profile import bin_kernel, hann
from midspan.radar.target import Target, find_targets
from midspan.records import Floats
from midspan.simulate.motion.motion import Motion, Sines, random_motion
from midspan.simulate.radar.signal import LONG_RANGE, SHORT_RANGE, RadarModel, Reflector, noise_for

RATE, AMPLITUDE, WALL_M, PIER_M = 100.0, 1000.0, 2.054, 3.3
MEMS, FORCE_BALANCE = 3e-3, 5e-5
FRAMES, CALIBRATION = 4000, 1600


@dataclass(frozen=True)
class Case:
    """A view of 40 s; calibrated on another 16 s of it without faults. snr_db: a sample."""

    motion: Motion
    view: tuple[Reflector, ...] = (Reflector(WALL_M, AMPLITUDE, 1 / 1.27, 0.2),)
    clear: tuple[Reflector, ...] = ()
    snr_db: float = 10.0
    noise_m_s2: float = MEMS
    chirp: ChirpProfile = field(default_factory=lambda: SHORT_RANGE)
    phase_noise_rad: float = 0.0
    spoil: Callable[[np.random.Generator, Floats, NDArray[np.complex64], NDArray[np.bool_]], None] | None = None
    samples: Callable[[Floats], None] | None = None
    targets: int = 1


@dataclass(frozen=True)
class Drawn:
    """Frames at at (n,), s; profiles (n, 2 receivers, bins) from bin `first` on, valid; samples; targets; truth."""

    at: Floats
    profiles: NDArray[np.complex64]
    coarse: Floats
    valid: NDArray[np.bool_]
    samples: Floats
    targets: tuple[Target, ...]
    axis: RangeAxis
    case: Case


def half_kernel(place_bin: float, profile: ChirpProfile) -> NDArray[np.complex128]:
    """Weights (2, samples) of the first and the second half of the chirp at one bin, each with its own window."""
    half = profile.samples // 2
    place = np.arange(profile.samples) - (profile.samples - 1) / 2.0
    turn = np.exp(-2j * np.pi * place_bin * place / profile.samples)
    out = np.zeros((2, profile.samples), dtype=np.complex128)
    out[0, :half], out[1, -half:] = hann(half) * turn[:half], hann(half) * turn[-half:]
    return out


def coarse_range(turn: Floats, place_bin: float, profile: ChirpProfile) -> Floats:
    """Range in m (n,) by the phase (n,) between both halves of the chirp; unambiguous within a bin of `place_bin`."""
    step = profile.samples - profile.samples // 2  # from the centre of one half to that of the other
    return np.asarray((place_bin + turn * profile.samples / (2.0 * np.pi * step)) * profile.bin_m)


def profiles_of(model: RadarModel, motion: Motion, frames: int, seed: int) -> tuple[NDArray[np.complex64], Floats]:
    """Profiles (frames, receivers, bins) of the nearest bins, and the range (frames,) of the wall by its beat."""
    chirp = model.profile
    place = WALL_M / chirp.bin_m
    kernel = np.concatenate((bin_kernel(np.arange(90.0), chirp), half_kernel(place, chirp))).astype(np.complex64)
    rng = np.random.default_rng(seed)
    z = np.concatenate([cube[:, 0] @ kernel.T for cube in model.blocks(motion, frames, rng=rng)])
    turn = np.sum(z[:, :, 91] * z[:, :, 90].conj(), axis=1)
    return z[:, :, :90], coarse_range(np.angle(turn), place, chirp)


def drawn(case: Case, seed: int) -> Drawn:
    """A case with its noise."""
    chirp = replace(case.chirp, receivers=2)
    noise = noise_for(AMPLITUDE, case.snr_db)
    model = RadarModel(case.view, chirp, noise, case.phase_noise_rad)
    before = RadarModel(case.clear or case.view, chirp, noise, case.phase_noise_rad, start_s=100.0)
    axis = RangeAxis(np.arange(90) * chirp.bin_m, chirp.carrier_hz, chirp.slope_hz_s)
    learned, _ = profiles_of(before, case.motion, CALIBRATION, 500 + seed)
    end_s, times = 100.0 + CALIBRATION / RATE, before.frame_s(CALIBRATION)
    samples = accelerometer(case.motion, end_s, case.noise_m_s2, seed)
    found = find_targets(learned, times, samples=samples[samples[:, 0] > 98.0], axis=axis)
    ranges = (WALL_M, PIER_M)[: case.targets]
    targets = tuple(min(found, key=lambda one, r=r: abs(one.range_m - r)) for r in ranges)  # type: ignore[misc]
    assert not any(one.objection for one in targets), [one.objection for one in targets]
    profiles, coarse = profiles_of(model, case.motion, FRAMES, seed)
    valid = np.ones(profiles.shape[:2], dtype=np.bool_)
    samples = samples[samples[:, 0] < FRAMES / RATE]
    if case.spoil is not None:
        case.spoil(np.random.default_rng(900 + seed), model.frame_s(FRAMES), profiles, valid)
    if case.samples is not None:
        case.samples(samples)
    return Drawn(model.frame_s(FRAMES), profiles, coarse, valid, samples, targets, axis, case)


def of_chain(one: Drawn, **options: bool) -> tuple[Floats, Floats, str, int]:
    """The same frame by frame, NaN before the first row, and the frame that it counts from."""
    bin_m = float(one.axis.range_m[1])
    items = [
        FollowedTarget.of(target, one.axis.phase_per_m(target.range_m), bin_m, period_s=1 / RATE, bins=90)
        for target in one.targets
    ]
    offset = one.targets[0].time_offset_s
    density = one.case.noise_m_s2**2 / RATE
    found = run(items, (one.at + offset, one.profiles, one.valid), one.samples, density, **options)
    kinds = [event.kind for event in found.events]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    begin = int(np.argmax(np.isfinite(found.phase_rad).any(axis=1)))
    value, std = np.full((2, len(one.samples)), np.nan)
    rows = np.searchsorted(one.samples[:, 0], found.time_s - 1e-6)
    value[rows], std[rows] = found.value_m, found.std_m
    return value, std, counts, begin


def judged(one: Drawn, value: Floats, std: Floats, first: int = 0) -> tuple[float, float, float]:
    """Error rms and largest, mm, and the share within 1.96 deviations, from 2 s on, counted from the first frame."""
    time_s = one.samples[:, 0]
    begin = one.at[first : first + 1] + one.targets[0].time_offset_s
    true = one.case.motion.displacement(time_s) - one.case.motion.displacement(begin)
    used = (time_s > 2.0) & (time_s < one.at[-1])
    error = (value - true)[used]
    return 1e3 * rms(error), 1e3 * float(np.max(np.abs(error))), 100 * float(np.mean(np.abs(error) < 1.96 * std[used]))


def swing(size_m: float = 2e-3, seed: int = 3) -> Motion:
    """Motion of a footbridge."""
    return random_motion((0.5, 4.0), size_m / 2.5, rng=np.random.default_rng(seed))


def lost(rng: np.random.Generator, at: Floats, profiles: Floats, valid: NDArray[np.bool_]) -> None:
    """5 % of the frames are lost, in some only one receiver, and 0.3 s at once."""
    for k in np.flatnonzero((rng.random(len(at)) < 0.05) & (at > 2.0)):
        valid[k] = rng.random(2) < 0.3
    valid[2000:2030] = False
    profiles[~valid] = np.nan


def interference(rng: np.random.Generator, at: Floats, profiles: Floats, valid: NDArray[np.bool_]) -> None:
    """Another radar: in 5 % of the frames, and a burst of 0.5 s, noise as large as the target."""
    hit = ((rng.random(len(at)) < 0.05) & (at > 2.0)) | ((at > 20.0) & (at < 20.5))
    noise = rng.normal(size=profiles.shape) + 1j * rng.normal(size=profiles.shape)
    profiles[hit] += (0.7 * AMPLITUDE * noise[hit]).astype(np.complex64)


def dead(samples: Floats) -> None:
    """The accelerometer tells nothing from the middle on."""
    later = samples[:, 0] > 20.0
    samples[later, 1] = 0.02


def wall(*blocked: tuple[float, float], **more: object) -> tuple[Reflector, ...]:
    """The wall, hidden for a while."""
    return (Reflector(WALL_M, AMPLITUDE, 1 / 1.27, 0.2, blocked=blocked, **more),)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Course(Motion):
    """A motion of its own: at rest up to start_s, then at a speed (m/s), or a jump (m)."""

    start_s: float
    speed_m_s: float = 0.0
    jump_m: float = 0.0
    end_s: float = np.inf

    def displacement(self, time_s: Floats) -> Floats:
        late = np.clip(np.asarray(time_s), self.start_s, self.end_s) - self.start_s
        return np.asarray(self.speed_m_s * late + self.jump_m * (np.asarray(time_s) > self.start_s))

    def velocity(self, time_s: Floats) -> Floats:
        return np.zeros_like(time_s)

    def acceleration(self, time_s: Floats) -> Floats:
        return np.zeros_like(time_s)


PIER = Reflector(PIER_M, 0.8 * AMPLITUDE, -1 / 1.09, -0.3)
LIVELY = Sines(np.array([0.3 / (2 * np.pi * 1.3)]), np.array([1.3]), phase_rad=1.0)
TREE = random_motion((0.2, 1.5), 0.3e-3, rng=np.random.default_rng(4))
TWO = (*wall(), PIER)
CASES: dict[str, Case] = {
    "clean, MEMS": Case(swing()),
    "clean, force balance": Case(swing(), noise_m_s2=FORCE_BALANCE),
    "-10 dB a sample": Case(swing(), snr_db=-10.0),
    "hidden for 1 s": Case(swing(), wall((18.0, 19.0))),
    "hidden for 3 s": Case(swing(), wall((18.0, 21.0))),
    "hidden for 10 s": Case(swing(), wall((18.0, 28.0))),
    "hidden for 3 s, 0.64 GHz": Case(swing(), wall((18.0, 21.0)), chirp=LONG_RANGE),
    "hidden for 3 s, 10 % with it": Case(
        swing(), (*wall((18.0, 21.0)), Reflector(WALL_M + 0.02, 0.1 * AMPLITUDE, 0.4))
    ),
    "lost frames": Case(swing(), spoil=lost),
    "interference": Case(swing(), spoil=interference),
    "176 mm/s, 40 mm": Case(sine(0.04, 0.7)),
    "0.3 m/s from the middle of a swing": Case(LIVELY),
    "0.3 m/s, -8 dB a sample": Case(sine(0.3 / (2 * np.pi * 1.3), 1.3), snr_db=-8.0),
    "100 mm": Case(sine(0.1, 0.3)),
    "100 mm, calibrated on 100 mm with a plate of 10 %": Case(
        sine(0.1, 0.3), (*wall(), Reflector(WALL_M + 0.02, 0.1 * AMPLITUDE, 0.0))
    ),
    "10 % of clutter": Case(swing(4e-3), (*wall(), Reflector(WALL_M + 0.02, 0.1 * AMPLITUDE, 0.5, 0.5))),
    "10 % of clutter, 1 mm": Case(swing(1e-3), (*wall(), Reflector(WALL_M + 0.02, 0.1 * AMPLITUDE, 0.5, 0.5))),
    "20 % of clutter, 12 mm": Case(swing(12e-3), (*wall(), Reflector(WALL_M + 0.02, 0.2 * AMPLITUDE, 0.5, 0.5))),
    "20 % of clutter, 12 mm, force balance": Case(
        swing(12e-3), (*wall(), Reflector(WALL_M - 0.02, 0.2 * AMPLITUDE, -0.7, 0.5)), noise_m_s2=FORCE_BALANCE
    ),
    "phase noise of 0.02 rad": Case(swing(), phase_noise_rad=0.02),
    "accelerometer dead from 20 s": Case(sine(0.05, 1.0), samples=dead),
    "two targets": Case(swing(), TWO, targets=2),
    "two, one hidden for 10 s": Case(swing(), (*wall((18.0, 28.0)), PIER), TWO, targets=2),
    "two, one drives off at 20 mm/s": Case(swing(), (*wall(own=Course(20.0, 0.02)), PIER), TWO, targets=2),
    "two, one creeps at 3 mm/s for 3 s": Case(
        swing(), (*wall(own=Course(20.0, 3e-3, 0.0, 23.0)), PIER), TWO, targets=2
    ),
    "two, one jumps by 0.4 mm": Case(swing(), (*wall(own=Course(20.0, 0.0, 4e-4)), PIER), TWO, targets=2),
    "one jumps by 0.4 mm": Case(swing(), wall(own=Course(20.0, 0.0, 4e-4)), wall()),
    "two, one a tree (0.3 mm)": Case(swing(), (*wall(own=TREE), PIER), TWO, targets=2),
}


def main(names: tuple[str, ...] = tuple(CASES), seeds: int = 2) -> None:
    """Each case with some seeds."""
    rows = []
    for name in names:
        for seed in range(seeds):
            one = drawn(CASES[name], seed)
            new = of_chain(one)
            rows.append([name, seed, *judged(one, *new[:2], new[3]), new[2]])
    show(["case", "seed", "mm", "largest", "inside %", "said"], rows)
