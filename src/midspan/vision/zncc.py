"""Zero-mean normalised cross-correlation (ZNCC) of a template with every window of a patch."""

import numpy as np

from midspan import _core
from midspan.records import Floats
from midspan.vision.spline import Floats32


def zncc_map(patch: Floats32, template: Floats32) -> Floats:
    """ZNCC (-1 to 1) of `template` at every whole-pixel position in `patch`.

    `patch` (rows, columns), float32 and roughly free of its mean (float32 sums lose the difference otherwise);
    `template` (h, w), float32 with zero mean. Returns (rows - h + 1, columns - w + 1); 0 where a window is constant.
    """
    return _core.zncc_map(patch, template)


def zncc_matrix(patch: Floats, template: Floats) -> Floats:
    """The same in double precision by the Fourier transform, for many positions: equation 2 of the two-stage paper."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    rows, columns = template.shape
    size = [next_fast_len(length, real=True) for length in patch.shape]
    product = irfft2(rfft2(patch, size) * np.conj(rfft2(template, size)), size)
    energy = _core.window_energies(patch, rows, columns)
    product = product[: energy.shape[0], : energy.shape[1]]
    seen = energy > 1e-12 * (np.max(energy) + 1e-30)
    norm = np.sqrt(np.where(seen, energy, 1.0) * np.sum(template**2))
    return np.where(seen, product / norm, 0.0)


def smooth(patch: Floats32, taps: Floats32) -> Floats32:
    """Filter `patch` along both axes with the symmetric `taps` (2 m + 1,); the result loses m px on every side."""
    return _core.smooth(patch, taps)


def shrink(patch: Floats32, factor: int) -> Floats32:
    """Means of the blocks of `factor` by `factor` px; what does not fill a block is left out."""
    return _core.shrink(patch, factor)
