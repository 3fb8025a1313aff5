"""By how much one series comes later than another, finer than a sample."""

from collections.abc import Callable

import numpy as np

from midspan.evaluate.interpolation import Piecewise
from midspan.records import Floats

# The correlation is taken over this many instants at most, chosen at random: evenly thinned ones could always meet a
# periodic motion at the same phase.
MAX_INSTANTS = 5_000
MIN_INSTANTS = 20
MAX_LAGS = 2_000
CANDIDATES = 5
# Of maxima that differ by less than this, as a periodic motion has them, the one with the smallest lag is meant.
ALIKE = 1e-3


def correlation(a: Floats, b: Floats) -> float | None:
    """Pearson's correlation of two arrays (n,); None where either one is constant."""
    a, b = a - a.mean(), b - b.mean()
    power = float(np.sqrt(np.dot(a, a) * np.dot(b, b)))
    floor = 1e-12 * len(a) * float(np.finfo(float).tiny + np.max(np.abs(a)) * np.max(np.abs(b)))
    return float(np.dot(a, b)) / power if power > floor else None


def find_lag(time_s: Floats, value: Floats, reference: Piecewise, max_lag_s: float) -> float | None:
    """Seconds by which `value` (n,) at `time_s` (n,) comes later than the reference; positive: later.

    The lag maximises the correlation of value(t) with reference(t − lag) within ±max_lag_s, or a quarter of the span in
    common where that is shorter: scanned in steps of the finer of both intervals, the best maxima then refined on the
    reference's spline. None where either is constant, or no maximum lies inside.
    """
    span = float(np.sum(reference.end_s - reference.start_s))
    limit = min(max_lag_s, 0.25 * min(span, float(time_s[-1] - time_s[0])))
    inside = np.flatnonzero(reference.covers(time_s, limit))
    if len(inside) < MIN_INSTANTS or limit <= 0.0:
        return None
    if len(inside) > MAX_INSTANTS:
        inside = np.sort(np.random.default_rng(0).choice(inside, MAX_INSTANTS, replace=False))
    at, own = time_s[inside], value[inside]

    def score(lag_s: float) -> float:
        found = correlation(own, reference.at(at - lag_s))
        return -2.0 if found is None else found

    step = min(float(np.median(np.diff(time_s))), reference.step_s)
    lags = np.linspace(-limit, limit, min(2 * int(np.ceil(limit / step)) + 1, MAX_LAGS + 1))
    return _best(lags, np.array([score(lag) for lag in lags]), score)


def _best(lags: Floats, scores: Floats, score: Callable[[float], float]) -> float | None:
    """The refined lag of the highest maximum inside, None without one."""
    from scipy.optimize import minimize_scalar

    peaks = np.flatnonzero((scores[1:-1] >= scores[:-2]) & (scores[1:-1] > scores[2:])) + 1
    peaks = peaks[np.argsort(scores[peaks])[::-1][:CANDIDATES]]
    if not len(peaks) or max(scores[0], scores[-1]) > scores[peaks[0]] + ALIKE:
        return None
    found = []
    for i in peaks:
        bracket = (float(lags[i - 1]), float(lags[i + 1]))
        options = {"xatol": 1e-7}
        refined = minimize_scalar(lambda lag: -score(lag), bounds=bracket, method="bounded", options=options)
        found.append((float(refined.x), -float(refined.fun)))
    best = max(value for _, value in found)
    return min((lag for lag, value in found if value > best - ALIKE), key=abs)
