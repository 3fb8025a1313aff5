"""The first measurements of a record, which a filter that has just begun would believe, judged by one run backwards."""

from dataclasses import dataclass, replace

import numpy as np

from midspan.fusion.gate import ACCEPTED, REJECTED
from midspan.fusion.kalman import KalmanFilter, KalmanSettings
from midspan.fusion.response import places
from midspan.records import NANOSECONDS, Acceleration, Displacement, Innovation, joined, part
from midspan.signals.health import Mask

# So many measurements are judged, by a filter that has met so many before them, over so many seconds at most.
JUDGED, MET_BEFORE, LONGEST_S = 20, 40, 120.0
# A prediction is sharp when its variance with the measurement's is below this many of the measurement's own.
SHARP_VARIANCES = 25.0


@dataclass(frozen=True, slots=True)
class Beginning:
    """Measurements (m,) at the start that are outliers, and those that a sharp prediction agrees with."""

    wrong: Mask
    right: Mask


def judged_backwards(acceleration: Acceleration, displacement: Displacement, settings: KalmanSettings) -> Beginning:
    """Judge a record's first measurements by what comes after them.

    Displacement and acceleration are the same in time turned round, only the velocity changes its sign; the filter run
    over the first minutes backwards knows the state when it meets the first measurements. Nothing is judged where the
    record is too short, or where more than half would be outliers.
    """
    wrong, right = (np.zeros(len(displacement.time_ns), dtype=bool) for _ in range(2))
    usable = np.flatnonzero(np.isfinite(displacement.value_m) & np.isfinite(displacement.variance_m2))
    if len(usable) < JUDGED + MET_BEFORE:
        return Beginning(wrong, right)
    last = usable[min(len(usable), 4 * (JUDGED + MET_BEFORE)) - 1]
    end = min(int(displacement.time_ns[last]), int(displacement.time_ns[usable[0]]) + round(LONGEST_S * NANOSECONDS))
    used = usable[displacement.time_ns[usable] <= end]
    samples = acceleration.time_ns <= end
    if len(used) < JUDGED + MET_BEFORE or np.count_nonzero(samples) < 2:
        return Beginning(wrong, right)
    turned = _turned(part(displacement, used), end)
    stream = KalmanFilter(settings)
    stream.push(turned)
    found = stream.push(_turned_acceleration(part(acceleration, samples), end))
    innovations = [item for item in found if isinstance(item, Innovation)]
    if not innovations:
        return Beginning(wrong, right)
    met = joined(innovations)
    which = used[::-1][places(turned, met)]
    first = which <= used[JUDGED - 1]
    sharp = met.variance_m2 < SHARP_VARIANCES * displacement.variance_m2[which]
    wrong[which[first]] = met.verdict[first] == REJECTED
    right[which[first]] = ((met.verdict == ACCEPTED) & sharp)[first]
    if np.count_nonzero(wrong) > JUDGED // 2:
        wrong[:] = False
    return Beginning(wrong, right)


def _turned(displacement: Displacement, end_ns: int) -> Displacement:
    backwards = part(displacement, slice(None, None, -1))
    return replace(backwards, time_ns=end_ns - backwards.time_ns)


def _turned_acceleration(acceleration: Acceleration, end_ns: int) -> Acceleration:
    """Acceleration in turned time; each noise density belongs to the interval that ended, and now begins, there."""
    backwards = part(acceleration, slice(None, None, -1))
    density = np.concatenate((acceleration.noise_density[-1:], acceleration.noise_density[:0:-1]))
    return Acceleration(end_ns - backwards.time_ns, backwards.value_m_s2, density)
