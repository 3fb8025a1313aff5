"""Targets of a tilting camera besides the two that tell the displacement: whether they move with these.

Displacement u and tilt t of the pair i, j say where a target k is seen, p_k = r_k u + t; what it differs by is

    e = p_k − α p_i − (1 − α) p_j,    α = (r_k − r_j) / (r_i − r_j)

With r as a regression on the displacement gives them, one constant added to all of them changes nothing here. Any of
the three explains e: where it is i, the pair's difference p_i − p_j holds −e / α and the displacement is wrong by
e / (r_j − r_k); where it is j, e / (1 − α) and e / (r_i − r_k). Which shares of e the difference may hold the
accelerometer tells, octave by octave: what it excludes of a little fast motion says nothing of slow motion. Among four
targets the one that moves is that without which the other three agree, and no accelerometer is needed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from midspan.calibration.camera.difference import Course, Difference, Share, difference
from midspan.calibration.scale import REFUSED_ABOVE
from midspan.errors import UntrustedError
from midspan.records import Floats

# As between targets of a camera that does not tilt: less is in the noise of its frames.
DISAGREES = 2.5
# Fewer targets do not show among themselves which one moves.
MIN_TO_NAME = 4


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Targets along one axis, frame by frame of the calibration window.

    time_s (n,): on the camera's clock; value_px, variance_px2 (k, n): of each target, NaN where it is not seen; ratios
    (k,): px per metre of displacement; moved_m (n,): the displacement; left_px (k, n): the targets without it.
    """

    names: Sequence[str]
    time_s: Floats
    value_px: Floats
    variance_px2: Floats
    ratios: Floats
    moved_m: Floats
    left_px: Floats


@dataclass(frozen=True, slots=True)
class Bystanders:
    """Why each target is not used (empty: it is), and rms (m) of what that may cost where one of the pair moves."""

    reasons: tuple[str, ...]
    held_m: float = 0.0

    def without(self, number: int, reason: str) -> "Bystanders":
        """The same without a target."""
        return replace(self, reasons=(*self.reasons[:number], reason, *self.reasons[number + 1 :]))


def moves_alone(value_px: Floats, variance_px2: Floats) -> int | None:
    """The one target of at least four without which all others agree; None where none or several are.

    value_px, variance_px2 (k, n): of each target, NaN where it is not seen.
    """
    count = len(value_px)
    if count < MIN_TO_NAME:
        return None
    apart = [set(three) for three in combinations(range(count), 3) if _differ(value_px, variance_px2, three)]
    movers = [k for k in range(count) if apart and all(k in three for three in apart)]
    return movers[0] if len(movers) == 1 else None


def _differ(value_px: Floats, variance_px2: Floats, three: Sequence[int]) -> bool:
    """Whether no displacement and tilt explain three targets; of their two most different ones, as k lies between."""
    value = value_px[list(three)]
    known = np.all(np.isfinite(value), axis=0)
    if not known.any():
        return False
    value = value - np.mean(value[:, known], axis=1, keepdims=True)
    i, j = max(combinations(range(3), 2), key=lambda two: float(np.var((value[two[0]] - value[two[1]])[known])))
    other = value[3 - i - j] - value[j]
    moved = np.interp(np.arange(len(known)), np.flatnonzero(known), (value[i] - value[j])[known])
    share = float(moved[known] @ other[known]) / max(float(moved[known] @ moved[known]), 1e-300)
    weights = np.zeros(3)
    weights[[i, j, 3 - i - j]] = -share, share - 1.0, 1.0
    variance = weights**2 @ np.nan_to_num(variance_px2[list(three)])
    found = difference(np.where(known, other - share * moved, np.nan), variance, moved, np.inf)
    return found.excess_m > DISAGREES * found.noise_m


def moves_text(name: str) -> str:
    """Why a target is left out that the others show to move."""
    return f"it moves on its own: the other targets agree without {name} and contradict each other with it."


@dataclass(frozen=True, slots=True, eq=False)
class _Apart:
    """What a target k differs by from a pair i, j (px), and α."""

    numbers: tuple[int, int, int]
    share: float
    found: Difference
    part_of_noise: float


def judged(seen: Seen, pair: tuple[int, int], others: Sequence[int], share_in: Callable[[Course], Share]) -> Bystanders:
    """Which of other targets do not move with the pair.

    share_in: the share of a course (px) in the pair's difference, as the accelerometer tells it. Raises UntrustedError
    where the one that moves is not known and too much depends on it.
    """
    reasons, held_m = [""] * len(seen.names), 0.0
    for k in others:
        apart = _apart(seen, pair, k)
        found = apart.found
        if not found.excess_m > 0.0:
            continue
        left_out = found.excess_m > DISAGREES * found.noise_m
        error_m = _error_m(seen, apart, share_in, left_out=left_out)
        if error_m > REFUSED_ABOVE * float(np.std(seen.moved_m)):
            raise UntrustedError(_refused(seen, apart, error_m))
        held_m = max(held_m, error_m)
        if left_out:
            reasons[k] = _reason(seen, apart, error_m)
    return Bystanders(tuple(reasons), held_m)


def _apart(seen: Seen, pair: tuple[int, int], k: int) -> _Apart:
    i, j = pair
    share = float((seen.ratios[k] - seen.ratios[j]) / (seen.ratios[i] - seen.ratios[j]))
    weights = np.array([-share, share - 1.0, 1.0])
    value, variances = seen.value_px[[i, j, k]], seen.variance_px2[[i, j, k]]
    known = np.all(np.isfinite(value), axis=0)
    variance = weights**2 @ np.nan_to_num(variances)
    found = difference(np.where(known, weights @ np.nan_to_num(value), np.nan), variance, seen.moved_m, np.inf)
    usual = np.nanmedian(variances, axis=1)
    noise = float((weights * np.array([1.0, -1.0, 0.0])) @ usual / (weights**2 @ usual))
    return _Apart((i, j, k), share, found, noise)


def _error_m(seen: Seen, apart: _Apart, share_in: Callable[[Course], Share], *, left_out: bool) -> float:
    """What the displacement may be wrong by, rms, m: in each octave by the worst that the accelerometer allows.

    Where it excludes all but k for the larger part of e, the rest is taken for the same motion.
    """
    i, j, k = apart.numbers
    # For each that may move: the share of e that the pair's difference then holds, and px per m of its error.
    only = (0.0, np.inf if left_out else abs(seen.ratios[i] - seen.ratios[j]))
    moving = (
        only,
        (-1.0 / (apart.share or 1e-300), abs(seen.ratios[j] - seen.ratios[k])),
        (1.0 / ((1.0 - apart.share) or 1e-300), abs(seen.ratios[i] - seen.ratios[k])),
    )
    decided, undecided, error_m2 = 0.0, 0.0, 0.0
    for octave in apart.found.octaves():
        measured = share_in(Course(seen.time_s, octave.course_m, octave.shaped, octave.noise_m, apart.part_of_noise))
        allowed = [one for one in moving if measured.allows(one[0])]
        if allowed == [only]:
            decided += octave.excess_m**2
        else:
            undecided += octave.excess_m**2
        error_m2 += (octave.held_m / max(min(px for _, px in allowed or moving), 1e-300)) ** 2
    return float(apart.found.held_m / only[1] if decided > undecided else np.sqrt(error_m2))


def _reason(seen: Seen, apart: _Apart, error_m: float) -> str:
    i, j = (seen.names[one] for one in apart.numbers[:2])
    by = f"by {apart.found.excess_m:.2g} px rms"
    if error_m == 0.0:
        return f"it moves on its own: {by}, which neither {i} and {j} nor the camera's tilt explain."
    return (
        f"it, {i} or {j} moves on its own: {by}, which the camera's tilt does not explain; the accelerometer does not "
        f"exclude slow motion of {i} or {j}, and the error band includes {1e3 * error_m:.2g} mm for it."
    )


def _refused(seen: Seen, apart: _Apart, error_m: float) -> str:
    most_m = REFUSED_ABOVE * float(np.std(seen.moved_m))
    another = "a fourth" if len(seen.names) < MIN_TO_NAME else "another"
    return (
        f"The camera tilts, and one of the targets {', '.join(seen.names[one] for one in sorted(apart.numbers))} "
        f"moves on its own; the accelerometer does not show which. The displacement may be wrong by "
        f"{1e3 * error_m:.2g} mm rms; at most {1e3 * most_m:.2g} mm is accepted. Add {another} target at another "
        "distance, which shows it, or remove the doubtful one from camera.target."
    )
