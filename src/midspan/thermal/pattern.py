"""The fixed pattern of a thermal camera: what stays on its pixels while the scene moves over them.

A pattern in the reference frame and in the present one draws every translation towards zero, and it is the larger the
weaker the scene. Where the scene has moved by some tenths of a pixel or more, both can be distinguished: the mean of
the frames moved back is the scene, the mean of what is left on each pixel is the pattern. Translations found before
are too small by a share, and a pattern estimated with them holds that share of the scene's second derivative, which
draws later ones as much: scene, pattern and translations are therefore improved in turn. What the frames then leave
open of the share is stated.

With the scene S, its gradient ∇S, the pattern p and translations d_k the frames are S(x - d_k) + p(x) + noise. If the
translations are too small by the share a, the frames differ by a·u_k, u_k = -d_k·∇S(x - d_k). What of u_k is neither a
scene nor a pattern is u⊥; the frames show a = ⟨u⊥, frames⟩ / ⟨u⊥, u⟩ with the variance noise² / ⟨u⊥, u⟩. By what an
error e of the pattern scales translations measured with the scene is Σ u_k e / Σ u_k². All sums are made per spatial
frequency, where a shift is a factor; docs/infrared.md has the derivation.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.checks import finite, refuse
from midspan.records import Floats
from midspan.signals.medians import MEDIAN_DEVIATION

EDGE_PX = 3  # from the edge inwards gradient and spline know too little
GRADIENT = 0.5  # of white noise: power of the difference between the two neighbours of a pixel, halved
WIDTH_PX = 0.8  # standard deviation of the distance at which pixels, low-passed as trackers do, have noise in common
TAPERED = 0.25  # of the sides: what is shifted in frequencies must not meet what lies beyond the other edge
MIN_DETERMINED = 1e-9  # of the frames' number squared: below it scene and pattern are the same
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
    determined = np.where(determined < MIN_DETERMINED * count**2, np.inf, determined)
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
    power = np.maximum(np.sum(np.abs(turns - mean) ** 2, axis=0), MIN_DETERMINED)
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


MIN_TRAVEL_PX = 0.4  # standard deviation of the motion below which scene and pattern are one
MIN_FRAMES = 8
TURNS, SHARED_EVERY = 20, 5  # every this many turns the share, which single turns find slowly, is estimated as a whole
_ORDER = 5  # of the spline that moves the scene
_KNOTS, _BINOMIALS = 3.0 - np.arange(7), np.array([1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0])  # of its basis function
_EDGE_PX = 2  # from the edge inwards the spline is disturbed by what it takes to lie beyond


@dataclass(frozen=True, slots=True, eq=False)
class FixedPattern:
    """A fixed pattern (rows, columns) in K, mean 0.

    share_std: standard deviation of the share by which translations are too small with the pattern taken out of
    reference and frames; kept_share_std: with the pattern left in, for a tracker of least squares. pictured: the scene,
    its translations and both deviations that these rest on. known: False where it could not be distinguished from the
    scene, and is 0 here.
    """

    values_k: Floats
    share_std: float
    kept_share_std: float
    pictured: Pictured
    known: bool = True

    def removed(self, celsius: NDArray[np.generic]) -> NDArray[np.float32]:
        """The picture (rows, columns) without the pattern."""
        return np.asarray(celsius, dtype=np.float32) - self.values_k.astype(np.float32)


def estimate_pattern(frames: Floats, translation_px: Floats) -> FixedPattern:
    """The fixed pattern of pictures in °C whose scene has moved by translations, which it may have drawn to zero.

    frames (n, rows, columns), 8 or more, of one place on the sensor; translation_px (n, 2): x to the right and y down.
    Not `known` where the scene has moved so little that the two cannot be distinguished. Raises UsageError for arrays
    of other shapes.
    """
    stack = finite("frames", frames)
    moved = finite("translation_px", translation_px)
    if stack.ndim != 3 or len(stack) < MIN_FRAMES or moved.shape != (len(stack), 2):
        raise refuse(
            f"frames and translation_px of shapes (n, rows, columns) and (n, 2), n from {MIN_FRAMES} on",
            "given",
            (stack.shape, moved.shape),
        )
    # A frame's level is what it has in common with the others after the scene was moved back; its median will do.
    stack = stack - np.median(stack, axis=(1, 2), keepdims=True)
    if float(np.sqrt(np.sum(np.var(moved, axis=0)))) < MIN_TRAVEL_PX:
        return _unknown_pattern(stack, moved)
    pattern, known = np.zeros(stack.shape[1:]), Pictured(np.zeros(stack.shape[1:]), moved, 0.0, math.inf)
    share_std = 0.0
    for turn in range(TURNS):
        pattern, known = _improved(stack, pattern, known)
        if (turn + 1) % SHARED_EVERY == 0:
            share, share_std = share_left(stack, known)
            centre = np.mean(known.moved_px, axis=0)
            known = replace(known, moved_px=known.moved_px + share * (known.moved_px - centre))
    return FixedPattern(pattern, share_std, max(kept_share(known), share_std), known)


def shifted_scene(scene: Floats, moved_px: Floats) -> list[Floats]:
    """A picture (rows, columns) moved by each translation (n, 2), px, its edge repeated beyond it."""
    grid = _spline(scene)
    return [_shifted(grid, x, y) for x, y in moved_px]


def _unknown_pattern(stack: Floats, moved: Floats) -> FixedPattern:
    """No pattern, and what it does at most to a tracker of least squares."""
    scene = np.mean(stack, axis=0)
    noise = _grain(stack[1:] - stack[:-1]) / math.sqrt(2.0)
    finest = math.sqrt(max(_grain(scene) ** 2 - noise**2 / len(stack), 0.0))
    pictured = Pictured(scene, moved, noise, pattern_spread(stack, moved, noise, finest))
    kept = kept_share(pictured)
    return FixedPattern(np.zeros_like(scene), kept, kept, pictured, known=False)


def _grain(pictures: Floats) -> float:
    """Standard deviation of white noise in pictures (…, rows, columns), from their finest detail."""
    fine = np.diff(np.diff(pictures, 2, axis=-1), 2, axis=-2) / 6.0  # the squares of 1 -2 1, twice, sum to 36
    return float(np.median(np.abs(fine))) / MEDIAN_DEVIATION


def _roughness(pattern: Floats) -> float:
    """Standard deviation of white noise or stripes in a picture (rows, columns) with NaN around, from second
    differences along its rougher axis.
    """
    fine = [np.diff(pattern, 2, axis=axis) / math.sqrt(6.0) for axis in (0, 1)]
    known = [np.abs(one[np.isfinite(one)]) for one in fine]
    return max(float(np.median(one)) / MEDIAN_DEVIATION if len(one) else 0.0 for one in known)


def _improved(stack: Floats, pattern: Floats, known: Pictured) -> tuple[Floats, Pictured]:
    """One turn: the scene that the pattern leaves, the pattern that the scene leaves (0 where it does not reach), and
    the translations. A scene that warms or cools has another contrast in each frame, which would pass for pattern.
    """
    moved, shape = known.moved_px, pattern.shape
    free = stack - pattern
    inside = [_covered(shape, -x, -y) for x, y in moved]
    reached = np.any(inside, axis=0).astype(np.float64)
    reach = _spline(reached)
    seen = np.array([_covered(shape, x, y) & (_shifted(reach, x, y) > 0.999) for x, y in moved])
    scene = _scene(free, inside, moved, known.scene)
    smooth = _spline(scene)
    there = np.array([np.where(mask, _shifted(smooth, x, y), 0.0) for mask, (x, y) in zip(seen, moved, strict=True)])
    shares = _straight([_amount(f, expected, mask) for f, expected, mask in zip(free, there, seen, strict=True)])
    there *= shares[:, None, None]
    rest = np.where(seen, stack - there, 0.0)
    number = np.maximum(np.sum(seen, axis=0), 1)
    full = number >= MIN_FRAMES
    if not full.any():
        return pattern, replace(known, scene=scene)
    mean = np.sum(rest, axis=0) / number
    variance = np.sum(rest**2, axis=0) / number - mean**2
    noise2 = float(np.median(variance[full]))
    mean -= np.mean(mean[full])
    # The mean of n noisy values, drawn to zero as far as it may be noise; a body that came by makes single pixels so.
    unsure = np.maximum(variance, noise2) / number
    # Coarse parts of the scene pass for pattern where the motion is small: the finest ones tell how strong it is.
    spread2 = max(_roughness(np.where(full, mean, np.nan)) ** 2 - float(np.median(unsure[full])), 0.0)
    pattern = np.where(full, mean * spread2 / np.maximum(spread2 + unsure, 1e-12), 0.0)
    steps = [_step(f - pattern, e, mask) for f, e, mask in zip(rest, there, seen, strict=True)]
    return pattern, Pictured(scene, moved - np.array(steps), math.sqrt(noise2), math.sqrt(spread2))


def _scene(free: Floats, inside: list[NDArray[np.bool_]], moved: Floats, before: Floats) -> Floats:
    """The mean (rows, columns) of frames (n, rows, columns) moved back; 0 where none reaches."""
    # before: the scene so far, by which each frame's contrast is weighed; all 0 at first.
    total, weight = np.zeros_like(before), np.zeros_like(before)
    back = [_shifted(_spline(f), -x, -y) for f, (x, y) in zip(free, moved, strict=True)]
    shares = (
        [_amount(f, before, mask) for f, mask in zip(back, inside, strict=True)] if before.any() else [1.0] * len(back)
    )
    for image, mask, share in zip(back, inside, _straight(shares), strict=True):
        total += np.where(mask, share * image, 0.0)
        weight += share**2 * mask
    return total / np.maximum(weight, 1e-3)


def _step(rest: Floats, scene: Floats, mask: NDArray[np.bool_]) -> Floats:
    """How far (2,) in px the scene must go back to explain what is left, over the mask without its rim."""
    rim = mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:]
    down, right = np.gradient(scene, axis=0), np.gradient(scene, axis=1)
    slopes = np.array([right[1:-1, 1:-1][rim], down[1:-1, 1:-1][rim]])
    return np.asarray(np.linalg.pinv(slopes @ slopes.T) @ (slopes @ rest[1:-1, 1:-1][rim]))


def _amount(seen: Floats, expected: Floats, mask: NDArray[np.bool_]) -> float:
    """How much of what is expected (rows, columns; 0 beyond the mask) is seen over the mask, apart from levels."""
    count = max(np.count_nonzero(mask), 1)
    free = np.where(mask, expected - expected.sum() / count, 0.0)
    return float(np.sum(free * seen) / max(float(np.sum(free**2)), 1e-12))


def _straight(shares: list[float]) -> Floats:
    """The straight line (n,) of mean 1 through shares: contrast fades slowly; what differs from frame to frame is what
    the spline makes of another fraction of a pixel, and would come to stand in the pattern.
    """
    place = np.arange(len(shares)) - 0.5 * (len(shares) - 1)
    mean = max(float(np.mean(shares)), 1e-3)
    slope = float(place @ np.array(shares)) / float(place @ place) / mean
    return np.maximum(np.asarray(1.0 + slope * place, dtype=np.float64), 0.05)


def _spline(image: Floats) -> Floats:
    """Coefficients (rows, columns) of the quintic spline through a picture whose edge is repeated beyond it."""
    from scipy.ndimage import spline_filter

    return np.asarray(spline_filter(image, order=_ORDER, mode="nearest"), dtype=np.float64)


def _shifted(grid: Floats, x_px: float, y_px: float) -> Floats:
    """The picture of these coefficients moved by x (right) and y (down) px; its edge is repeated beyond it."""
    from scipy.ndimage import correlate1d

    whole_x, whole_y = round(x_px), round(y_px)
    for axis, (whole, exact) in enumerate(((whole_y, y_px), (whole_x, x_px))):
        # Weights (7,) of the coefficients around a pixel for the value at a fraction of a pixel before it.
        distance = np.abs(np.arange(-3, 4) + (exact - whole))
        powers = _BINOMIALS[:, None] * np.maximum(_KNOTS[:, None] - distance, 0.0) ** _ORDER
        weights = np.sum(powers, axis=0) / math.factorial(_ORDER)
        grid = correlate1d(grid, weights, axis=axis, mode="nearest")
        places = np.clip(np.arange(grid.shape[axis]) - whole, 0, grid.shape[axis] - 1)
        grid = np.take(grid, places, axis=axis)
    return np.asarray(grid, dtype=np.float64)


def _covered(shape: tuple[int, ...], x_px: float, y_px: float) -> NDArray[np.bool_]:
    """Pixels (rows, columns) of a picture moved by x and y px that come from inside it, not from its repeated edge."""
    masks = []
    for size, moved in zip(shape, (y_px, x_px), strict=True):
        place = np.arange(size) - moved
        masks.append((place >= _EDGE_PX) & (place <= size - 1 - _EDGE_PX))
    return np.asarray(masks[0][:, None] & masks[1][None, :])
