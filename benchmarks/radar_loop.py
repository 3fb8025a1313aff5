"""The radar's stage and the estimator as a closed loop, frame by frame, on simulated range profiles."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from midspan.engine.radar import FollowedTarget, RadarChain
from midspan.fusion import forward
from midspan.fusion.hypotheses import Hypotheses, Rates
from midspan.records import Event, Floats, RangeFrame, Status, nanoseconds

# The gate's limit, standard deviations; deviations of place, speed and bias before the first sample.
LIMIT, START = 4.0, (1.0, 1.0, 0.3)


@dataclass(frozen=True)
class Run:
    """Rows (s,) at the samples: displacement since the first frame, m, its standard deviation, and the truth's place.

    phase_rad, status (frames, targets): of the chain; events; hypotheses: most at a time.
    """

    time_s: Floats
    value_m: Floats
    std_m: Floats
    phase_rad: Floats
    status: NDArray[np.uint8]
    events: tuple[Event, ...]
    hypotheses: int


class Loop:
    """`Hypotheses` with one channel a target, driven sample by sample; predicts what a channel will show."""

    def __init__(
        self, units_per_m: Floats, priors: tuple[Floats, float], density: float, bias_walk: float = 1e-8, bias: float = 0
    ) -> None:
        count = len(units_per_m)
        channels = np.array([[g, 0.0, LIMIT, 4.0 + 2 * k] for k, g in enumerate(units_per_m)])
        # A relative error of each factor, and one clock offset.
        kinds = np.zeros((count, count + 1), dtype=np.int64)
        kinds[np.arange(count), np.arange(count)], kinds[:, count] = forward.SCALE, forward.CLOCK
        self.units, self.prior = units_per_m, np.append(np.square(priors[0]), priors[1] ** 2)
        self.stream = Hypotheses(START, channels, kinds, Rates(), bias_walk=bias_walk, bias=bias)
        self.density, self.reference = density, np.zeros(count)
        self.known = np.zeros(count, dtype=bool)
        self.last, self.rows = np.empty(0), []
        self.nodes, self.covariances = np.empty(0), np.empty(0)

    def sample(self, row: Floats) -> tuple[float, float]:
        """Take a sample (time in s, acceleration in m/s², density); returns the row and its standard deviation."""
        rows = np.array(self.rows).reshape(-1, forward.MEASUREMENT_COLUMNS)
        self.rows, self.last = [], row
        nodes, covariances = self.stream.push(row[None], rows)
        self.nodes, self.covariances = nodes[0], covariances[0]
        x, p = self.nodes, self.covariances
        sensitivity = x[0, 1:] - x[3, 1:]
        variance = p[0, 0] + p[3, 3] - 2 * p[0, 3] + float(sensitivity**2 @ self.prior)
        return float(x[0, 0] - x[3, 0]), float(np.sqrt(max(variance, 0.0)))

    def predict(self, channel: int, time_s: float) -> tuple[float, float] | None:
        """Expected measurement at a time after the last sample, and its variance."""
        if not self.known[channel]:
            return None
        x, p, g, z = self.nodes, self.covariances, self.units[channel], 4 + 2 * channel
        n, dt = len(p), time_s - self.last[0]
        h = np.zeros(n)
        h[[0, 1, 2, z]] = 1.0, dt, -0.5 * dt * dt, 1.0
        speed = x[n, 0]
        value = x[0, 0] + dt * speed + 0.5 * dt * dt * (self.last[1] - x[2, 0]) + x[z, 0]
        sensitivity = x[0, 1:] + dt * x[1, 1:] + x[z, 1:]
        sensitivity[channel] += x[0, 0]
        sensitivity[-1] -= speed
        variance = h @ p @ h + self.density * dt**3 / 3.0 + float(sensitivity**2 @ self.prior)
        return g * float(value), g * g * float(variance)

    def meet(self, channel: int, time_s: float, value: float, variance: float, reference: float) -> None:
        """Take a measurement; when its zero's variance rises that of the state does, when it falls the old one holds."""
        z, g, hyps = 4 + 2 * channel, self.units[channel], self.stream._hyps
        first = not self.known.any()
        if not self.known[channel] and not first:
            hyps[1][: self.stream.count, z, z] = 1.0
        rise = reference - self.reference[channel]
        for b in range(self.stream.count):
            if rise > 0.0:
                if rise > 1.0:
                    _copy(hyps[0][b], hyps[1][b], z + 1, z)
                hyps[1][b, z, z] += rise / g**2
            elif rise < -1.0:
                _copy(hyps[0][b], hyps[1][b], z, z + 1)
        self.reference[channel], self.known[channel] = reference, True
        self.rows.append([time_s, 0.0, channel, value, variance])
        if first:
            self.rows.append([time_s, 0.0, forward.SET_DATUM, 0.0, 0.0])


def _copy(x: Floats, p: Floats, to: int, of: int) -> None:
    x[to], p[to] = x[of], p[of]
    p[:, to] = p[:, of]
    p[to, to] = p[of, of]


def run(
    targets: list[FollowedTarget],
    frames: tuple[Floats, NDArray[np.complex64], NDArray[np.bool_]],
    samples: Floats,
    density: float,
    *,
    bias: float | None = None,
    give: bool = True,
    common: bool = True,
    clock_std_s: float = 1e-5,
) -> Run:
    """A record through chain and loop.

    frames: instants (n,) on the accelerometer's clock, s, profiles (n, channels, bins), valid (n, channels); samples
    (m, 2); density of the acceleration's noise; give: whether the chain gets the loop's predictions; common: whether
    the loop gets the part of the variance that is common.
    """
    chain = RadarChain(targets)
    units = np.array([item.phase_per_m / item.target.conversion_factor for item in targets])
    relative = np.array([item.target.relative_std for item in targets])
    level = float(np.mean(samples[:200, 1])) if bias is None else bias
    loop = Loop(units, (relative, clock_std_s), density, bias=level)
    at, profiles, valid = frames
    seen = profiles[:, :, chain.bins.astype(int)] if profiles.shape[2] != len(chain.bins) else profiles
    stamps = nanoseconds(at)
    found, events, phases, status, most = [], [], [], [], 0
    edges = np.searchsorted(at, samples[:, 0])
    for (k, row), (first, last) in zip(enumerate(samples), pairwise([0, *edges]), strict=True):
        del k
        for f in range(first, last):
            given = [loop.predict(c, at[f]) if give else None for c in range(len(targets))] if len(loop.last) else None
            met = chain.push(RangeFrame(int(stamps[f]), seen[f], valid[f]), given)
            for c, one in enumerate(met):
                events += one.events
                if one.status == Status.TRACKING:
                    loop.meet(c, at[f], one.phase_rad, one.variance_rad2, one.reference_variance_rad2 * common)
            phases.append([one.phase_rad for one in met])
            status.append([one.status for one in met])
        found.append(loop.sample(np.array([row[0], row[1], density])))
        most = max(most, loop.stream.count)
    value, std = np.array(found).T
    return Run(samples[:, 0], value, std, np.array(phases), np.array(status), tuple(events), most)
