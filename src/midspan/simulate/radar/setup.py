"""The radar of a scenario: what it sees, and how its recording is written, as raw samples or as slow-time I/Q."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Any

import numpy as np

from midspan.radar.chirp import ChirpProfile
from midspan.radar.layout import PACKET_BYTES, Layout, pack
from midspan.radar.range_profile import bin_kernel
from midspan.records import Floats
from midspan.simulate.files.folder import Progress, counted
from midspan.simulate.motion.motion import Motion
from midspan.simulate.radar.signal import Cubes, RadarModel, Reflector, phase_bound_m


@dataclass(frozen=True, slots=True)
class Capture:
    """How a capture is written: lost packets (by number, from 0) are zeros; `cut_bytes` are missing at the end."""

    layout: Layout
    lost: tuple[int, ...] = ()
    cut_bytes: int = 0


def write_capture(path: Path, cubes: Iterable[Cubes], capture: Capture) -> int:
    """Write cubes (frames, chirps, receivers, samples) as a .bin; returns the bytes written."""
    position = 0
    with path.open("wb") as file:
        for cube in cubes:
            data = bytearray(pack(cube, capture.layout).tobytes())
            for packet in capture.lost:
                start = max(packet * PACKET_BYTES - position, 0)
                end = min((packet + 1) * PACKET_BYTES - position, len(data))
                if start < end:
                    data[start:end] = bytes(end - start)
            file.write(data)
            position += len(data)
        if capture.cut_bytes:
            position -= capture.cut_bytes
            file.truncate(position)
    return position


def packets(words: "np.ndarray[tuple[int], np.dtype[np.int16]]") -> Iterator[bytes]:
    """The datagrams of a capture card: number from 1, count of bytes before, and up to 1456 bytes of the words."""
    data = words.astype("<i2").tobytes()
    for number, start in enumerate(range(0, len(data), PACKET_BYTES), start=1):
        head = number.to_bytes(4, "little") + start.to_bytes(6, "little")
        yield head + data[start : start + PACKET_BYTES]


def demo_settings(profile: ChirpProfile, *, frames: int = 0, order: str = "QQII", device: str = "xWR1642") -> str:
    """Settings as the demo firmware takes them over its serial line (.cfg); `frames` 0 is without end."""
    slope, ramp_us = profile.slope_hz_s / 1e12, 1e6 * (2.0 * profile.centre_s - profile.adc_start_s) + 2.0
    idle_us = 1e6 * profile.chirp_period_s - ramp_us
    swapped = 1 if order.startswith("Q") else 0
    lines = [
        f"% {device}",
        "sensorStop",
        "flushCfg",
        "dfeDataOutputMode 1",
        f"channelCfg {2**profile.receivers - 1} {reduce(or_, profile.transmitters)} 0",
        f"adcCfg {(12, 14, 16).index(profile.bits)} {1 if profile.complex_samples else 0}",
        f"adcbufCfg -1 {0 if profile.complex_samples else 1} {swapped} 1 1",
        f"profileCfg 0 {profile.start_frequency_hz / 1e9:.9g} {idle_us:.6g} {1e6 * profile.adc_start_s:.9g} "
        f"{ramp_us:.6g} 0 0 {slope:.9g} 1 {profile.samples} {profile.sample_rate_hz / 1e3:.9g} 0 0 30",
        *(f"chirpCfg {k} {k} 0 0 0 0 0 {mask}" for k, mask in enumerate(profile.transmitters)),
        f"frameCfg 0 {profile.chirps - 1} 1 {frames} {1e3 * profile.frame_period_s:.9g} 1 0",
        "lvdsStreamCfg -1 0 1 0",
        "sensorStart",
    ]
    return "\n".join(lines) + "\n"


RAW, CONFIG, SLOW_TIME = "adc_data.bin", "radar.cfg", "radar.h5"

# 128 samples at 6 MHz of a chirp of 65 MHz/µs from 77 GHz: 1.4 GHz of bandwidth, bins of 0.11 m, up to 13.8 m.
NEAR = ChirpProfile(77e9, 64.985e12, 6e6, 128, 0.01, receivers=2)
# The same of 15 MHz/µs: 0.32 GHz, bins of 0.47 m, up to 60 m.
FAR = ChirpProfile(77e9, 15.015e12, 6e6, 128, 0.01, receivers=2)


@dataclass(frozen=True, slots=True)
class RadarSetup:
    """A radar of a scenario; spans are in s of true time.

    reflectors: draws what it sees, the fixed targets first; targets: how many those are; noise_std: of the receivers,
    ADC counts; start_s: time of the first frame on the radar's clock; true time = that clock + time_offset_s; lost:
    packets of the capture card that never arrived; jammed: spans of interference, jam_db above the strongest of the
    targets in every bin; order: of I and Q in the file; slow_time: the phasors of the targets
    alone are stored, as HDF5, instead of all samples.
    """

    reflectors: Callable[[np.random.Generator], tuple[Reflector, ...]]
    targets: int = 1
    profile: ChirpProfile = NEAR
    noise_std: float = 450.0
    phase_noise_rad: float = 3e-3
    start_s: float = 0.0
    time_offset_s: float = 0.083
    lost: tuple[tuple[float, float], ...] = ()
    jammed: tuple[tuple[float, float], ...] = ()
    jam_db: float = 6.0
    order: str = "QQII"
    slow_time: bool = False

    def frames(self, duration_s: float) -> int:
        """Frames that are stored of a recording of `duration_s` s of true time."""
        # The last tenth of a second is left to the accelerometer.
        usable = duration_s - 0.1 - self.time_offset_s - self.start_s
        return int(usable * self.profile.frame_rate_hz)

    @property
    def first_s(self) -> float:
        """True time in s of the first frame: the middle of its chirps."""
        return self.start_s + self.profile.middle_s + self.time_offset_s

    def model(self, rng: np.random.Generator) -> RadarModel:
        """The radar with everything in view drawn from `rng`."""
        reflectors = self.reflectors(rng)
        # A chirp's samples and the chirps add up for a target, and not for what crosses them.
        gathered = np.sqrt(self.profile.samples * self.profile.chirps)
        strongest = max(target.amplitude for target in reflectors[: self.targets])
        return RadarModel(
            reflectors,
            self.profile,
            noise_std=self.noise_std,
            phase_noise_rad=self.phase_noise_rad,
            time_offset_s=self.time_offset_s,
            start_s=self.start_s,
            jammed=self.jammed,
            jam_std=10 ** (self.jam_db / 20.0) * strongest * float(gathered),
        )

    def settings(self) -> dict[str, Any]:
        """What recording.toml says about it."""
        found: dict[str, Any] = {"file": SLOW_TIME} if self.slow_time else {"file": RAW, "config": CONFIG}
        return found | ({"start_s": self.start_s} if self.start_s else {})

    def write(
        self, folder: Path, motion: Motion, *, duration_s: float, rng: np.random.Generator, progress: Progress
    ) -> dict[str, Any]:
        """Write the files of the radar on a motion into `folder`, in blocks; returns what an estimate should find.

        progress: called with frames done and frames in all.
        """
        frames = self.frames(duration_s)
        rng_view, rng_noise = rng.spawn(2)
        model = self.model(rng_view)
        targets = model.reflectors[: self.targets]
        blocks = counted(model.blocks(motion, frames, rng=rng_noise), len, lambda done: progress(done, frames))
        if self.slow_time:
            places = np.array([target.range_m for target in targets])
            write_slow_time(folder / SLOW_TIME, blocks, (self.profile, frames, places))
        else:
            layout = Layout(self.profile, self.order)
            write_capture(folder / RAW, blocks, Capture(layout, lost=setup_lost(self, layout)))
            text = demo_settings(self.profile, frames=frames, order=self.order)
            (folder / CONFIG).write_text(text, encoding="utf-8")
        speed = 1e3 * self.profile.limit_speed_m_s
        expected = [self._expected(target) for target in targets]
        return {"time_offset_s": self.time_offset_s, "limit_speed_mm_s": speed, "targets": expected}

    def _expected(self, target: Reflector) -> dict[str, float]:
        ratio_db = float(20.0 * np.log10(target.amplitude / self.noise_std))
        bound_m = phase_bound_m(ratio_db, self.profile, self.profile.receivers) / target.ratio
        return {
            "range_m": target.range_m,
            "conversion_factor": 1.0 / target.ratio,
            "snr_db_a_sample": ratio_db,
            "cramer_rao_std_mm": 1e3 * abs(bound_m),
        }


def setup_lost(setup: RadarSetup, layout: Layout) -> tuple[int, ...]:
    """Numbers of the packets, from 0, that hold the frames in the setup's `lost` spans."""
    found: set[int] = set()
    for start, end in setup.lost:
        frame = (np.array([start, end]) - setup.first_s) * setup.profile.frame_rate_hz
        first, last = (frame * layout.frame_bytes / PACKET_BYTES).astype(np.int64)
        found.update(range(max(int(first), 0), int(last)))
    return tuple(sorted(found))


def write_slow_time(path: Path, cubes: Iterator[Cubes], stored: tuple[ChirpProfile, int, Floats]) -> None:
    """Write the phasors (frames, receivers, targets) of cubes (frames, chirps, receivers, samples) as HDF5.

    stored: the chirp, how many frames there will be, and the ranges (targets,) in m that are kept.
    """
    import h5py

    profile, frames, range_m = stored
    kernel = bin_kernel(range_m / profile.bin_m, profile).astype(np.complex64)
    with h5py.File(path, "w") as file:
        shape = (frames, profile.receivers, len(range_m))
        data = file.create_dataset("iq", shape, np.complex64)
        file.attrs["carrier_hz"], file.attrs["rate_hz"] = profile.carrier_hz, profile.frame_rate_hz
        file["range_m"] = range_m
        done = 0
        for cube in cubes:
            data[done : done + len(cube)] = (cube @ kernel.T).mean(axis=1)
            done += len(cube)
