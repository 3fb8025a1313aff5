"""Range profiles of whole chirps, and in replay only the range that is wanted, straight from the stored words.

A symmetric window and a phase referred to the centre of the chirp make the phase of a target the same in every bin of
its main lobe, so a bin may be changed, or lie between two, without a step.
"""

import numpy as np
from numpy.typing import NDArray

from midspan.radar.chirp import ChirpProfile
from midspan.radar.layout import Cube, Layout, Words, block_words, sign_extended, word_weights
from midspan.records import Floats

# Raw blocks that are turned into floating point at a time, so that they stay in the cache.
BLOCKS_AT_A_TIME = 512


def hann(samples: int) -> Floats:
    """The Hann window (samples,), symmetric, of sum 1; it has no zero at its ends. White noise keeps 1.5 / samples."""
    n = np.arange(samples)
    window = np.sin(np.pi * (n + 0.5) / samples) ** 2
    return np.asarray(window / window.sum())


def range_profile(cube: Cube, profile: ChirpProfile) -> Cube:
    """Complex range profile (…, bins) of chirps (…, samples), scaled so that a target keeps its amplitude.

    Phase grows with range and belongs to the centre of the chirp; real samples give half as many bins.
    """
    from scipy.fft import fft

    window = hann(profile.samples).astype(np.float32)
    spectrum = fft(cube * window, axis=-1)[..., : profile.bins]
    turn = np.exp(1j * np.pi * np.arange(profile.bins) * (profile.samples - 1) / profile.samples)
    scale = 1.0 if profile.complex_samples else 2.0
    return np.asarray(spectrum * (scale * turn).astype(np.complex64))


def bin_kernel(bins: Floats, profile: ChirpProfile) -> NDArray[np.complex128]:
    """Weights (k, samples) whose products with a chirp are its range profile at the bins (k,), whole or between."""
    place = np.arange(profile.samples) - (profile.samples - 1) / 2.0
    turn = np.exp(-2j * np.pi * np.multiply.outer(np.atleast_1d(bins), place) / profile.samples)
    scale = 1.0 if profile.complex_samples else 2.0
    return np.asarray(scale * hann(profile.samples) * turn)


def slow_time(words: Words, layout: Layout, bins: Floats) -> NDArray[np.complex64]:
    """Products (frames, channels, k) at the bins (k,) of whole frames of raw words (frames · words a frame,).

    Channels: transmitters times receivers; chirps of a frame with the same transmitters are averaged. Nothing else of
    the profile is computed, and the order of I and Q is in the weights, so this is what a long replay runs on.
    """
    weights = word_weights(bin_kernel(np.asarray(bins, dtype=np.float64), layout.profile), layout)
    return averaged(weighted_products(words, layout, weights), layout.profile)


def weighted_products(words: Words, layout: Layout, weights: NDArray[np.float32]) -> NDArray[np.complex64]:
    """Products (frames, chirps, receivers, k) of raw words (frames · words a frame,) with weights of `word_weights`."""
    blocks = words.reshape(-1, block_words(layout))
    out = np.empty((len(blocks), weights.shape[1]), dtype=np.float32)
    part = np.empty((min(BLOCKS_AT_A_TIME, len(blocks)), blocks.shape[1]), dtype=np.float32)
    for start in range(0, len(blocks), BLOCKS_AT_A_TIME):
        some = sign_extended(blocks[start : start + BLOCKS_AT_A_TIME], layout.profile.bits)
        part[: len(some)] = some
        np.matmul(part[: len(some)], weights, out=out[start : start + len(some)])
    receivers, together = (layout.stored, 1) if layout.lanes == 2 else (layout.profile.receivers,) * 2
    shape = (-1, layout.profile.chirps, receivers, weights.shape[1] // (2 * together))
    return out.view(np.complex64).reshape(shape)


def averaged(products: NDArray[np.complex64], profile: ChirpProfile) -> NDArray[np.complex64]:
    """Products (frames, channels, k) of products (frames, chirps, receivers, k): the mean for each transmitter."""
    masks = np.array(profile.transmitters)
    if profile.chirps == 1:
        return products[:, 0]
    means = [products[:, masks == mask].mean(axis=1) for mask in dict.fromkeys(profile.transmitters)]
    return np.asarray(np.concatenate(means, axis=1))


def whole_channels(valid: NDArray[np.bool_], profile: ChirpProfile) -> NDArray[np.bool_]:
    """Channels (frames, transmitters · receivers) of which no chirp of valid (frames, chirps, receivers) has a hole."""
    masks = np.array(profile.transmitters)
    return np.concatenate([valid[:, masks == mask].all(axis=1) for mask in dict.fromkeys(profile.transmitters)], axis=1)
