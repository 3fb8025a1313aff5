"""Targets of a tilting camera besides the two that tell the displacement: whether they move with these.

Displacement u and tilt t of the pair i, j say where a target k is seen, p_k = r_k u + t; what it differs by is

    e = p_k − α p_i − (1 − α) p_j,    α = (r_k − r_j) / (r_i − r_j)

With r as a regression on the displacement gives them, one constant added to all of them changes nothing here. Where
one of the pair moved instead of k, the displacement would be wrong by e / (r_j − r_k) or e / (r_i − r_k).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from midspan.calibration.camera.difference import difference
from midspan.calibration.scale import MIN_GAIN, REFUSED_ABOVE
from midspan.errors import UntrustedError
from midspan.records import Floats

# As between targets of a camera that does not tilt: less is in the noise of its frames.
DISAGREES = 2.5


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


def judged(seen: Seen, pair: tuple[int, int], gains: Mapping[tuple[int, int], float]) -> Bystanders:
    """Which targets do not move with the pair.

    gains: by how much more likely the acceleration makes the pair's difference than that of other targets, a logarithm
    of the likelihood without what their noise explains. Raises UntrustedError where the one that moves is not known and
    too much depends on it.
    """
    i, j = pair
    reasons, held_m = [""] * len(seen.names), 0.0
    for k, name in enumerate(seen.names):
        if k in pair:
            continue
        share = float((seen.ratios[k] - seen.ratios[j]) / (seen.ratios[i] - seen.ratios[j]))
        weights = np.zeros(len(seen.names))
        weights[[i, j, k]] = -share, share - 1.0, 1.0
        apart_px, variance = weights @ np.nan_to_num(seen.value_px), weights**2 @ np.nan_to_num(seen.variance_px2)
        known = np.all(np.isfinite(seen.value_px[[i, j, k]]), axis=0)
        found = difference(np.where(known, apart_px, np.nan), variance, seen.moved_m, np.inf)
        if not found.excess_m > DISAGREES * found.noise_m:
            continue
        reasons[k] = (
            f"it moves on its own: by {found.excess_m:.2g} px rms, which neither {seen.names[i]} and {seen.names[j]} "
            "nor the camera's tilt explain."
        )
        others = [gain for two, gain in gains.items() if k in two]
        if min(others, default=0.0) > MIN_GAIN:
            continue
        apart = min(abs(seen.ratios[one] - seen.ratios[k]) for one in pair)
        error_m, most_m = found.held_m / max(apart, 1e-300), REFUSED_ABOVE * float(np.std(seen.moved_m))
        if error_m > most_m:
            raise UntrustedError(
                f"The camera tilts, and one of the targets {', '.join(seen.names[one] for one in sorted((i, j, k)))} "
                f"moves on its own; the accelerometer does not show which. The displacement may be wrong by "
                f"{1e3 * error_m:.2g} mm rms; at most {1e3 * most_m:.2g} mm is accepted. Remove the doubtful one "
                f"from camera.target ({name} fits the others least), or add a target."
            )
        held_m = max(held_m, error_m)
    return Bystanders(tuple(reasons), held_m)
