"""The targets of a camera as one displacement: each compared with the path that all and the accelerometer agree on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.camera.view import SeenTarget
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.calibration.sensors.camera_scale import CameraScale
from midspan.calibration.whitening import BIAS_WALK_RATIO
from midspan.fusion.path import at
from midspan.fusion.streams import KalmanSettings, smooth
from midspan.fusion.targets import AGREE_STD
from midspan.records import NANOSECONDS, Acceleration, Displacement, Estimate, Floats, Innovation, part
from midspan.signals.acceleration import PreparedAcceleration
from midspan.signals.averaging import at_instants

# A target whose displacement leaves the others' by this many times what noise and scale explain moves on its own.
DISAGREES = 2.5
# Innovations count up to this many standard deviations squared: one wrong frame is no step, which is wrong for seconds.
MAX_POWER = (2.0 * AGREE_STD) ** 2
# A target whose own innovations, or estimated noise, stand out by these ratios contradicts the acceleration more than
# another. Steady targets' innovations were within 4 % of each other, their estimated noise (variance) within 40 %; a
# step of 0.5 px in a minute raises the innovations by 70 %.
TELLING_POWER = 1.3
TELLING_NOISE = 2.0
# Less than this of the zero's own standard deviation is no disagreement: no model fits to the last digit.
MIN_APART_M = 1e-5


@dataclass(frozen=True, slots=True)
class Contradiction:
    """The target (number from 0) that differs most from the one that the acceleration and most targets agree with.

    beside: the number of the latter; apart_m: rms of their difference; undecided: whether neither acceleration nor
    majority tells which of the two moves.
    """

    target: int
    beside: int
    apart_m: float
    undecided: bool


def camera_blocks(
    targets: Sequence[SeenTarget], camera: CameraCalibration, acceleration: Acceleration
) -> list[Displacement]:
    """The displacement that each target in use says, on the accelerometer's clock, without the exposure's averaging."""
    pairs = list(zip(targets, camera.mappings(), strict=True))
    # An exposure that was found is that of a camera of which none was declared.
    blocks = [
        at_instants(m.displacement(t.rows), float(np.hypot(t.blur_s, camera.exposure_s)), acceleration)
        for t, m in pairs
    ]
    # What the reference frame makes is not among what the factor was estimated from.
    more = [m.scale_m_per_px**2 * t.reference_px2[:, "xy".index(m.direction)] for t, m in pairs]
    return [replace(b, variance_m2=b.variance_m2 + v) for b, v in zip(blocks, more, strict=True)]


def filter_settings(prepared: PreparedAcceleration, density: float, bias: float | None = None) -> KalmanSettings:
    """First guesses for the filter: the bias (the mean when left out) and how well it is known.

    density: of the acceleration's noise, (m/s²)²/Hz. Without any acceleration the motion is that noise, and its slow
    part is left to the bias as it was when the density was estimated.
    """
    value = prepared.value_m_s2
    if not value.any():
        return KalmanSettings(bias_walk=BIAS_WALK_RATIO * density, bias_std=float(np.sqrt(density)) + 1e-9)
    noise = float(np.sqrt(density * prepared.rate_hz))
    # A mean over motion is off by some of the motion.
    return KalmanSettings(
        bias=float(np.mean(value)) if bias is None else bias, bias_std=float(0.3 * np.std(value) + 10.0 * noise + 1e-4)
    )


def _usual(block: Displacement) -> float:
    """The usual variance of a target, m²; infinite for one that was never seen."""
    known = block.variance_m2[np.isfinite(block.variance_m2)]
    return float(np.median(known)) if len(known) else np.inf


def _window(block: Displacement, window_ns: tuple[int, int]) -> slice:
    """The frames in the window; all of them where it holds too few."""
    first, last = (int(i) for i in np.searchsorted(block.time_ns, window_ns))
    return slice(first, last) if last - first >= 20 else slice(0, len(block.time_ns))


def _beside(
    blocks: Sequence[Displacement], scales: Sequence[CameraScale], path: Estimate
) -> tuple[Floats, Floats, Floats]:
    """Each target's displacement minus the path, what its scale factor may make of it, and its variance: (k, n)."""
    expected = np.array([at(path, block.time_ns)[0] for block in blocks])
    relative = np.array([[scale.relative_std] for scale in scales])
    value = np.array([block.value_m for block in blocks])
    return value - expected, relative * expected, np.array([block.variance_m2 for block in blocks])


def _apart(residual: Floats, variance: Floats, window: slice) -> tuple[Floats, Floats]:
    """How far each target lies from the path in the window: over what is explained, and rms in m.

    In the former, single wrong frames do not count for more than eight standard deviations.
    """
    residual, variance = residual[:, window], variance[:, window]
    usable = np.isfinite(residual) & np.isfinite(variance)
    share, size = np.zeros(len(residual)), np.zeros(len(residual))
    for k, known in enumerate(usable):
        if known.any():
            own = residual[k, known] - float(np.median(residual[k, known]))
            std = np.sqrt(variance[k, known])
            held = np.clip(own, -2.0 * AGREE_STD * std, 2.0 * AGREE_STD * std)
            share[k] = float(np.sqrt(np.mean((held / std) ** 2)))
            size[k] = float(np.sqrt(np.mean(own**2)))
    return share, size


def moves_by_itself(
    blocks: Sequence[Displacement],
    scales: Sequence[CameraScale],
    acceleration: Acceleration,
    kalman: KalmanSettings,
    window_ns: tuple[int, int],
) -> Contradiction | None:
    """The target that moves on its own, or None where the targets agree; arguments as in `together`.

    Each target has a path of its own, so that none draws the others'. The one to trust contradicts the acceleration
    least; of those alike in that, it agrees with most others; of those, it is the sharpest.
    """
    count = len(blocks)
    if count < 2:
        return None
    acceleration, window = _around(acceleration, blocks), _window(blocks[0], window_ns)
    apart, apart_m, power = np.zeros((count, count)), np.zeros((count, count)), np.zeros(count)
    for k, block in enumerate(blocks):
        own = smooth(acceleration, block, kalman)
        path = own.estimate
        residual, slack, variance = _beside(blocks, scales, path)
        # Where this target is hidden the path is vague.
        known = variance + slack**2 + at(path, blocks[0].time_ns)[1]
        apart[k], apart_m[k] = _apart(residual, known, window)
        power[k] = _power(own.innovation, window_ns)
    moved = (apart > DISAGREES) & (apart_m > MIN_APART_M)
    noise = np.array([scale.variance_factor for scale in scales])
    score = np.maximum(power, 1.0) * np.maximum(noise / (TELLING_NOISE * noise.min()), 1.0)
    agreed = np.where(score <= TELLING_POWER * score.min(), np.sum(~(moved | moved.T), axis=0), 0)
    trusted = np.flatnonzero(agreed == agreed.max())
    best = min((int(k) for k in trusted), key=lambda k: _usual(blocks[k]))
    if not moved[best].any():
        return None
    rivals = trusted[moved[best][trusted]]
    worst = int(np.argmax(np.where(moved[best], apart[best], 0.0)))
    if len(rivals):
        worst = int(rivals[np.argmax(apart[best][rivals])])
    return Contradiction(worst, best, float(apart_m[best, worst]), len(rivals) > 0)


def _around(acceleration: Acceleration, blocks: Sequence[Displacement]) -> Acceleration:
    """The acceleration of the frames' time and a second on either side: frames of a minute need no day of it."""
    first = min(int(block.time_ns[0]) for block in blocks) - NANOSECONDS
    last = max(int(block.time_ns[-1]) for block in blocks) + NANOSECONDS
    return part(acceleration, slice(*(int(i) for i in np.searchsorted(acceleration.time_ns, (first, last)))))


def _power(innovation: Innovation, window_ns: tuple[int, int]) -> float:
    """Mean square of a target's innovations in the window over what the filter expects: 1 where all is explained."""
    inside = (innovation.time_ns >= window_ns[0]) & (innovation.time_ns <= window_ns[1])
    inside &= np.isfinite(innovation.value_m) & (innovation.variance_m2 > 0.0)
    if not inside.any():
        return 1.0
    squared = innovation.value_m[inside] ** 2 / innovation.variance_m2[inside]
    return float(np.mean(np.minimum(squared, MAX_POWER)))
