"""A chirp radar on a moving structure: the raw intermediate-frequency samples of everything that it sees."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from midspan.checks import positive
from midspan.radar.chirp import SPEED_OF_LIGHT_M_S, ChirpProfile
from midspan.records import Floats
from midspan.simulate.motion.motion import Motion

Cubes = NDArray[np.complex64]

# A short-range chirp of 2.8 GHz at 77 GHz, and a long-range one of 0.64 GHz: 100 frames a second, one chirp a frame.
SHORT_RANGE = ChirpProfile(77e9, 64.985e12, 6e6, 256, 0.01)
LONG_RANGE = ChirpProfile(77e9, 15.015e12, 6e6, 256, 0.01)
FRAMES_AT_A_TIME = 500


@dataclass(frozen=True, slots=True)
class Reflector:
    """Something in view.

    range_m: at rest; amplitude: in ADC counts; ratio: its range change per displacement of the structure (the inverse
    conversion factor; 0: attached to the radar); azimuth_rad: from boresight, which the receivers see; own: its own
    range change; blocked: spans of true time (s) in which it is not seen.
    """

    range_m: float
    amplitude: float
    ratio: float = 1.0
    azimuth_rad: float = 0.0
    own: Motion | None = None
    blocked: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class RadarModel:
    """A radar and what it sees.

    noise_std: of the complex receiver noise a sample, ADC counts; phase_noise_rad: from chirp to chirp, common to all
    receivers and reflectors; time_offset_s: true time = the radar's clock + this; start_s: of the first frame on the
    radar's clock. jammed: spans of true time (s) in which another radar's chirps cross this one's, which is noise of
    jam_std, ADC counts, in every bin.
    """

    reflectors: tuple[Reflector, ...]
    profile: ChirpProfile = field(default_factory=lambda: SHORT_RANGE)
    noise_std: float = 10.0
    phase_noise_rad: float = 0.0
    time_offset_s: float = 0.0
    start_s: float = 0.0
    jammed: tuple[tuple[float, float], ...] = ()
    jam_std: float = 0.0

    def frame_s(self, frames: int) -> Floats:
        """Middle of each frame's chirps (frames,) on the radar's clock, s."""
        first = self.start_s + self.profile.middle_s
        return np.asarray(first + np.arange(frames) * self.profile.frame_period_s, dtype=np.float64)

    def blocks(self, motion: Motion, frames: int, *, rng: np.random.Generator) -> Iterator[Cubes]:
        """Cubes (frames, chirps, receivers, samples) of `frames` frames of the moving structure, in blocks."""
        for first in range(0, frames, FRAMES_AT_A_TIME):
            count = min(FRAMES_AT_A_TIME, frames - first)
            yield self._block(motion, first, count, rng)

    def _block(self, motion: Motion, first: int, count: int, rng: np.random.Generator) -> Cubes:
        profile = self.profile
        begin = self.start_s + (first + np.arange(count)) * profile.frame_period_s
        chirp_s = np.add.outer(begin, np.arange(profile.chirps) * profile.chirp_period_s + profile.centre_s)
        time = chirp_s + self.time_offset_s
        moved = motion.displacement(time)
        shape = (count, profile.chirps, profile.receivers, profile.samples, 2)
        loud = np.full(count, self.noise_std)
        for start, end in self.jammed:
            loud[(time[:, 0] >= start) & (time[:, 0] < end)] = self.jam_std
        parts = rng.standard_normal(shape, dtype=np.float32)
        parts *= (loud / np.sqrt(2.0)).astype(np.float32).reshape(-1, 1, 1, 1, 1)
        out = parts.view(np.complex64)[..., 0]
        for reflector in self.reflectors:
            place = reflector.range_m + reflector.ratio * moved
            if reflector.own is not None:
                place = place + reflector.own.displacement(time)
            amplitude = np.full(time.shape, reflector.amplitude)
            for start, end in reflector.blocked:
                amplitude[(time >= start) & (time < end)] = 0.0
            echo = amplitude[..., None] * beat(place, profile)
            out += (echo[:, :, None, :] * self._steering(reflector)[:, :, None]).astype(np.complex64)
        if self.phase_noise_rad:
            turn = np.exp(1j * rng.normal(0.0, self.phase_noise_rad, (count, profile.chirps, 1, 1)))
            out *= turn.astype(np.complex64)
        return out if profile.complex_samples else out.real.astype(np.complex64)

    def _steering(self, reflector: Reflector) -> NDArray[np.complex128]:
        """Phase factors (chirps, receivers) of antennas half a wavelength apart."""
        sine = np.sin(reflector.azimuth_rad)
        senders = {mask: k for k, mask in enumerate(dict.fromkeys(self.profile.transmitters))}
        sender = np.array([senders[mask] for mask in self.profile.transmitters])
        element = np.add.outer(self.profile.receivers * sender, np.arange(self.profile.receivers))
        return np.asarray(np.exp(1j * np.pi * sine * element))


def beat(range_m: Floats, profile: ChirpProfile) -> NDArray[np.complex128]:
    """Beat signal (…, samples) of amplitude 1 of a reflector at ranges (…,): 2π f₀ τ + 2π K τ t − π K τ²."""
    delay = 2.0 * np.asarray(range_m) / SPEED_OF_LIGHT_M_S
    slope = profile.slope_hz_s
    start = profile.start_frequency_hz * delay + slope * delay * (profile.adc_start_s - 0.5 * delay)
    step = slope * delay / profile.sample_rate_hz
    turns = np.remainder(start, 1.0)[..., None] + np.multiply.outer(step, np.arange(profile.samples))
    return np.asarray(np.exp(2j * np.pi * turns))


def noise_for(amplitude: float, snr_db: float) -> float:
    """Standard deviation of complex noise that gives `amplitude` a signal-to-noise ratio of `snr_db` a sample."""
    return positive("amplitude", amplitude) * 10 ** (-snr_db / 20)


def phase_bound_m(snr_db: float, profile: ChirpProfile, channels: int = 1) -> float:
    """Cramér-Rao bound in m of one frame's range change: λ / (4π √(2 · ratio after the transform)).

    snr_db: a sample, of one channel; a chirp's samples and the channels add up.
    """
    ratio = 10 ** (snr_db / 10) * profile.samples * channels * profile.chirps
    return float(1.0 / (profile.phase_per_m() * np.sqrt(2.0 * ratio)))
