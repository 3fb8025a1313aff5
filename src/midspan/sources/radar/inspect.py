"""What is in a radar's file: chirp settings, rates, holes, and the peaks of its range profile."""

from typing import Any

import numpy as np

from midspan.errors import DataError
from midspan.progress import Progress
from midspan.radar.channels import noise_variance
from midspan.radar.chirp import ChirpProfile
from midspan.radar.frames import RadarFrames, collected, without_holes
from midspan.radar.target import peaks
from midspan.records import Nanoseconds
from midspan.sources.radar.radar_source import RadarSource

# Frames looked at unless all are asked for, and peaks that are told.
LOOKED_AT, MOST_PEAKS = 600, 12

Tree = dict[str, Any]


def inspect_radar(source: RadarSource, every_frame: bool, progress: Progress) -> tuple[Tree, Nanoseconds]:
    """A branch of plain values, and the stamps of the frames; every_frame: look for holes in all of them.

    Raises DataError where the file holds no frames.
    """
    info, times = source.info, source.times_ns()
    if not len(times):
        raise DataError("radar.file: holds no frames.")
    count = min(len(times), LOOKED_AT)
    frames = collected(source.profiles(0, count), count, progress, "looking at radar frames")
    holes, looked = int(np.count_nonzero(~frames.valid.all(axis=1))), count
    if every_frame and len(times) > count:
        for block in source.slow_time(np.zeros(1), count):
            holes += int(np.count_nonzero(~block.valid.all(axis=1)))
            looked += len(block.time_ns)
            progress(looked, len(times), "looking at radar frames")
    branch = {
        "kind": info.kind,
        "frames": len(times),
        "channels": info.channels,
        "bins": info.bins,
        "carrier_hz": info.carrier_hz,
        "cycle_mm": 1e3 * info.cycle_m,
        "limit_speed_mm_s": 1e3 * info.limit_speed_m_s,
        "range_resolution_m": _resolution_m(info.range_m),
        "largest_range_m": float(np.nanmax(info.range_m)) if np.isfinite(info.range_m).any() else None,
        "iq_order": info.iq_order,
        "chirp": None if info.profile is None else _chirp(info.profile),
        "frames_looked_at": looked,
        "frames_with_holes": holes,
        "peaks": _peaks(frames, info.range_m),
        "notes": list(info.notes),
        "warnings": list(info.warnings),
    }
    return branch, times


def _resolution_m(range_m: np.ndarray[Any, np.dtype[np.float64]]) -> float | None:
    """Distance of neighbouring bins, None where the file does not say it or stores single targets."""
    steps = np.diff(range_m)
    return float(steps[0]) if len(steps) and np.allclose(steps, steps[0]) else None


def _chirp(profile: ChirpProfile) -> Tree:
    return {
        "start_frequency_hz": profile.start_frequency_hz,
        "bandwidth_hz": profile.bandwidth_hz,
        "slope_hz_s": profile.slope_hz_s,
        "samples": profile.samples,
        "sample_rate_hz": profile.sample_rate_hz,
        "chirps": profile.chirps,
        "receivers": profile.receivers,
        "bits": profile.bits,
        "complex_samples": profile.complex_samples,
    }


def _peaks(frames: RadarFrames, range_m: np.ndarray[Any, np.dtype[np.float64]]) -> list[Tree]:
    """The strongest peaks of the mean profile, the strongest first, in dB over the noise of one frame and channel."""
    if not frames.valid.any() or len(frames.time_ns) < 2:
        return []
    z = without_holes(frames).phasors
    noise = noise_variance(z)
    power = np.mean(np.abs(z) ** 2, axis=(0, 1))
    if not noise > 0.0:
        return []
    found = sorted(peaks(z, noise), key=lambda place: -power[round(place)])[:MOST_PEAKS]
    return [
        {
            "bin": place,
            "range_m": float(np.interp(place, np.arange(len(range_m)), range_m)),
            "level_db": float(10.0 * np.log10(max(power[round(place)] / noise, 1e-6))),
        }
        for place in found
    ]
