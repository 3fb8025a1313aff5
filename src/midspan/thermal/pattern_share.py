"""By which share a fixed pattern draws translations towards zero, and what frames leave open of it.

With the scene S, its gradient ∇S, the pattern p and translations d_k the frames are S(x - d_k) + p(x) + noise. If the
translations are too small by the share a, the frames differ by a·u_k, u_k = -d_k·∇S(x - d_k). What of u_k is neither a
scene nor a pattern is u⊥; the frames show a = ⟨u⊥, frames⟩ / ⟨u⊥, u⟩ with the variance noise² / ⟨u⊥, u⟩. By what an
error e of the pattern scales translations measured with the scene is Σ u_k e / Σ u_k². All sums are made per spatial
frequency, where a shift is a factor; docs/infrared.md has the derivation.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats

EDGE_PX = 3  # from the edge inwards gradient and spline know too little
GRADIENT = 0.5  # of white noise: power of the difference between the two neighbours of a pixel, halved
WIDTH_PX = 0.8  # standard deviation of the distance at which pixels, low-passed as trackers do, have noise in common
TAPERED = 0.25  # of the sides: what is shifted in frequencies must not meet what lies beyond the other edge
LEAST_DETERMINED = 1e-9  # of the frames' number squared: below it scene and pattern are the same
FINEST = 0.25  # cycles/px from which the pattern's strength is read: a lens leaves little of the scene there
SPREAD_STEPS = 20  # of the weights, which settle within ten
MAIN_LOBE = 3.0  # frequencies that the taper makes one


@dataclass(frozen=True, slots=True, eq=False)
class Pictured:
    """Scene (rows, columns), K; translations (n, 2), px; deviations (std) of a pixel's noise and of the pattern, K."""

    scene: Floats
    moved_px: Floats
    noise_k: float
    spread_k: float


def share_left(frames: Floats, known: Pictured) -> tuple[float, float]:
    """The share by which the translations (n, 2) are too small as frames (n, rows, columns) show it, and the standard
    deviation of the share by which later ones will be, with the pattern found with these taken out.
    """
    count, size = len(frames), frames[0].size
    taper = _taper(known)
    down, right = (taper * part for part in np.gradient(known.scene))
    level = np.mean(known.moved_px, axis=0)
    frequencies = [np.fft.fftfreq(side) for side in known.scene.shape]
    turns, of_scene, of_pattern = (np.zeros(known.scene.shape, dtype=np.complex128) for _ in range(3))
    seen_scene, seen_pattern = np.zeros_like(turns), np.zeros_like(turns)
    power = seen = 0.0
    for frame, (x, y) in zip(frames, known.moved_px, strict=True):
        # The factor that a shift is in frequencies.
        turn = np.exp(-2j * np.pi * np.add.outer(frequencies[0] * y, frequencies[1] * x))
        change = -np.fft.fft2((x - level[0]) * right + (y - level[1]) * down) * turn
        shown = np.fft.fft2(frame)
        turns += turn
        of_scene += np.conj(turn) * change
        of_pattern += change
        seen_scene += np.conj(turn) * shown
        seen_pattern += shown
        power += _product(change, change) / size
        seen += _product(change, shown) / size
    spread2 = max(known.spread_k**2, 1e-12)
    ridge = known.noise_k**2 / spread2
    determined = count * (count + ridge) - np.abs(turns) ** 2
    determined = np.where(determined < LEAST_DETERMINED * count**2, np.inf, determined)
    pattern = (count * of_pattern - turns * of_scene) / determined
    scene = (of_scene - np.conj(turns) * pattern) / count
    free = power - (_product(scene, of_scene) + _product(pattern, of_pattern)) / size
    if free <= 0.0 or power <= 0.0:
        return 0.0, kept_share(known)
    share = (seen - (_product(scene, seen_scene) + _product(pattern, seen_pattern)) / size) / free
    variance = known.noise_k**2 / free
    # The pattern takes over what the share changes in it, and each of its frequencies has an error of its own.
    taken = _product(of_pattern, pattern) / size / power
    own = 1.0 / (1.0 / spread2 + (count - np.abs(turns) ** 2 / count) / max(known.noise_k**2, 1e-12))
    noise = float(np.sum(np.abs(of_pattern) ** 2 * own)) / size / power**2
    return share, float(np.sqrt(taken**2 * (variance + share**2) + noise))


def kept_share(known: Pictured) -> float:
    """The share (standard deviation) by which translations are too small with the pattern left in reference and frames.

    It is the pattern's power over both powers in the gradients along the motion, as far as frames lie within a pixel of
    the reference. Noise stays in the scene's gradient: its mean of many frames has hardly any.
    """
    away = known.moved_px - np.mean(known.moved_px, axis=0)
    steep = np.array([np.mean(part[1:-1, 1:-1] ** 2) for part in np.gradient(known.scene)[::-1]])
    along = np.sum(away**2, axis=0)
    power = float(np.sum(along * steep) / np.sum(along)) if np.any(along) else float(np.mean(steep))
    pattern = GRADIENT * known.spread_k**2
    # How much of the pattern's pull on small motion is left at these distances from the middle, 0 to 1.
    distance2 = np.sum(away**2, axis=1)
    total = float(np.sum(distance2))
    near = float(np.sum(distance2 * np.exp(-0.5 * distance2 / WIDTH_PX**2))) / total if total > 0.0 else 1.0
    # The scene's mean holds the pattern as well.
    return near * pattern / max(power, pattern, 1e-12)


def pattern_spread(frames: Floats, moved_px: Floats, noise_k: float, largest_k: float) -> float:
    """Standard deviation of a pixel's fixed pattern, K, with one deviation of its own added; `largest_k` at most.

    frames (n, rows, columns) less their levels, whose scene has moved by moved_px (n, 2) about its mean. Per spatial
    frequency what moves with the factor exp(-2πi f·d_k) is the scene and what stays the pattern, by least squares; the
    pattern's power is what the noise leaves of its estimates (R. DerSimonian and N. Laird, Controlled Clinical Trials
    7, 1986, 177, doi 10.1016/0197-2456(86)90046-2). Motion of a twentieth of a pixel tells it.
    """
    rows, columns = frames.shape[1:]
    taper = np.outer(np.hanning(rows + 2)[1:-1], np.hanning(columns + 2)[1:-1])
    down, right = np.fft.fftfreq(rows)[:, None], np.fft.fftfreq(columns)
    fine = np.hypot(down, right) > FINEST
    shown = np.fft.fft2(frames * taper)[:, fine]
    along_y, along_x = (axis[fine] for axis in np.broadcast_arrays(down, right))
    turns = np.exp(-2j * np.pi * (moved_px[:, 1, None] * along_y + moved_px[:, 0, None] * along_x))
    mean = np.mean(turns, axis=0)
    power = np.maximum(np.sum(np.abs(turns - mean) ** 2, axis=0), LEAST_DETERMINED)
    scene = np.sum(np.conj(turns - mean) * shown, axis=0) / power
    square = np.abs(np.mean(shown, axis=0) - scene * mean) ** 2 / np.sum(taper**2)
    variance = noise_k**2 * (1.0 / len(frames) + np.abs(mean) ** 2 / power)
    spread2 = largest_k**2
    weights = np.zeros_like(variance)
    for _ in range(SPREAD_STEPS):
        weights = 1.0 / np.maximum(variance + spread2, 1e-12) ** 2
        spread2 = max(float(np.sum(weights * (square - variance)) / np.sum(weights)), 0.0)
    scatter = np.sqrt(2.0 * MAIN_LOBE * np.sum((weights * (variance + spread2)) ** 2)) / np.sum(weights)
    return float(np.sqrt(min(spread2 + scatter, largest_k**2)))


def _taper(known: Pictured) -> Floats:
    """Weights (rows, columns): 0 where a shifted scene would come from beyond the edge, 1 in the middle."""
    from scipy.signal.windows import tukey

    sides = []
    reach = np.max(np.abs(known.moved_px), axis=0)[::-1]
    for size, far in zip(known.scene.shape, reach, strict=True):
        edge = min(EDGE_PX + int(np.ceil(far)), (size - 1) // 2)
        side = np.zeros(size)
        side[edge : size - edge] = tukey(size - 2 * edge, 2.0 * TAPERED)
        sides.append(side)
    return np.outer(*sides)


def _product(one: NDArray[np.complex128], other: NDArray[np.complex128]) -> float:
    return float(np.vdot(one, other).real)
