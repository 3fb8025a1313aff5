"""Receivers taken together: one phasor a frame with the noise of all averaged, and how far the receivers agree."""

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats

Phasors = NDArray[np.complexfloating]

# Fewer bins than this are stored targets, and no profile most of which is empty.
MIN_BINS = 8


def channel_weights(phasors: Phasors) -> NDArray[np.complex128]:
    """Unit weights (channels,) that add a target's phasors (frames, channels) in phase: of largest power."""
    z = np.asarray(phasors, dtype=np.complex128)
    _, vectors = np.linalg.eigh(z.conj().T @ z)
    weights = vectors[:, -1].conj()
    strongest = weights[np.argmax(np.abs(weights))]
    return np.asarray(weights * np.conj(strongest) / np.abs(strongest))


def combined(phasors: Phasors, weights: NDArray[np.complex128], valid: NDArray[np.bool_] | None = None) -> Phasors:
    """One phasor a frame (frames,) of phasors (frames, channels), scaled to the amplitude of a typical channel.

    valid (frames, channels): channels that are whole; a frame without any is NaN.
    """
    if valid is None or valid.all():
        return np.asarray(phasors @ weights.conj() / np.sqrt(len(weights)))
    total = (valid * np.abs(weights) ** 2).sum(axis=1)
    summed = np.where(valid, phasors, 0.0) @ weights.conj()
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(total > 0, summed / total / np.sqrt(len(weights)), np.nan))


def combined_bins(phasors: Phasors, weights: NDArray[np.complex128], valid: NDArray[np.bool_] | None = None) -> Phasors:
    """The same for each of several bins: phasors (frames, k) of phasors (frames, channels, k)."""
    return np.stack([combined(phasors[..., k], weights, valid) for k in range(phasors.shape[2])], axis=1)


def disagreement_rad(phasors: Phasors, weights: NDArray[np.complex128]) -> Floats:
    """Standard deviation in rad of each channel's phase (channels,) about that of all together."""
    together = phasors @ weights.conj()
    turned = np.asarray(phasors) * weights.conj() * np.conj(together)[:, None]
    centre = np.exp(-1j * np.angle(turned.mean(axis=0)))
    return np.asarray(np.sqrt(np.mean(np.angle(turned * centre) ** 2, axis=0)))


def noise_variance(profiles: Phasors) -> float:
    """Variance of the complex noise of one channel and bin, from profiles (frames, channels, bins).

    Half the mean square of frame-to-frame differences holds nothing that is static; the median over the bins
    leaves out the few with something moving in them. Where only targets are stored, the amplitudes' differences tell
    it, which motion leaves alone.
    """
    z = np.asarray(profiles)
    if z.shape[2] < MIN_BINS:
        return float(np.median(np.mean(np.diff(np.abs(z), axis=0) ** 2, axis=0)))
    return float(np.median(np.mean(np.abs(np.diff(z, axis=0)) ** 2, axis=(0, 1))) / 2.0)


def phase_variance(phasors: Phasors, noise: float) -> Floats:
    """Variance in rad² of the phase of each phasor (n,) with complex noise of variance `noise`; infinite for NaN."""
    with np.errstate(divide="ignore", invalid="ignore"):
        value = noise / (2.0 * np.abs(phasors) ** 2)
    return np.asarray(np.where(np.isfinite(value), value, np.inf))
