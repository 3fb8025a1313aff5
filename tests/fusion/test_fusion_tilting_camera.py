"""Targets at several distances before a camera that tilts: the estimator's rows against a dense least squares.

The unknowns of the second route are written down one by one: the first state, what each interval's acceleration and
bias differ by, each target's zero and the tilt of every frame. Nothing of it is recursive.
"""

import numpy as np
import pytest
from fusion_oracles import input_over, walk_at_end

from midspan.fusion.estimator import Estimator
from midspan.fusion.model import START_S, EstimatorSettings
from midspan.fusion.streams import AS_DECLARED, NO_ERRORS
from midspan.records import Channel, Measured, Samples, Source, joined, nanoseconds

FOCAL_PX, NOISE_PX, DENSITY, WALK = 5000.0, 0.01, 1e-8, 1e-6
PLACE_STD, SPEED_STD, BIAS_STD, ZERO_STD = 0.02, 0.05, 0.02, 2e-5
# 10 mdeg, from one frame of 10 a second to the next.
TILT_RAD, STEP_S = np.radians(0.01), 0.1
TIME_S = 0.01 * np.arange(150)
# The first frame comes with the first sample, the others between samples and not evenly.
MET_S = STEP_S * np.arange(15) + 0.004 * np.sin(7.0 * np.arange(15))


def moved_m(time_s, order=0):
    """Displacement of two waves, or its derivative of that order."""
    omega = 2.0 * np.pi * np.array([1.3, 3.1])
    return np.sin(np.multiply.outer(time_s, omega) + 0.5 * np.pi * order) @ (2e-3 * omega**order)


class Scene:
    """Targets at distances (m), a camera that tilts anew in each frame; hidden: frames and targets that are not seen.

    memory_s: time constant of the tilt, as of `Channel.slow_time_s`.
    """

    def __init__(self, distances_m, hidden=(), memory_s=0.25 * STEP_S, seed=1):
        rng = np.random.default_rng(seed)
        self.factors, self.memory_s = [-FOCAL_PX / one for one in distances_m], memory_s
        self.input = moved_m(TIME_S, 2) + 0.01 + rng.normal(0.0, np.sqrt(DENSITY / 0.01), len(TIME_S))
        tilt_px = FOCAL_PX * TILT_RAD * rng.standard_normal(len(MET_S))
        # The first frame shows the first target alone, whose displacement the prior is about.
        self.seen = [
            (k, c)
            for k in range(len(MET_S))
            for c in range(len(self.factors))
            if (k, c) not in hidden and (k > 0 or c == 0)
        ]
        self.value = np.array(
            [self.factors[c] * moved_m(MET_S[k], 0) + tilt_px[k] + rng.normal(0.0, NOISE_PX) for k, c in self.seen]
        )

    @property
    def lead_m(self):
        """The tilt's standard deviation in metres of the first target."""
        return FOCAL_PX * TILT_RAD / abs(self.factors[0])

    def estimated(self):
        """Rows of the filter and of the smoother."""
        channels = tuple(
            Channel(
                "camera",
                Source.CAMERA,
                units_per_m=factor,
                target=str(c),
                zero_std_m=ZERO_STD if c else 0.0,
                slow_std_m=self.lead_m,
                slow_time_s=self.memory_s,
            )
            for c, factor in enumerate(self.factors)
        )
        settings = EstimatorSettings(
            channels,
            bias_std_m_s2=(BIAS_STD,),
            bias_walk=WALK,
            velocity_std_m_s=(SPEED_STD,),
            displacement_std_m=PLACE_STD,
            rates=NO_ERRORS,
            noise_memory=np.inf,
            noise_weight=AS_DECLARED,
        )
        estimator = Estimator(settings, log=True)
        frame, channel = np.array(self.seen).T
        count = len(channel)
        variance, none = np.full(count, NOISE_PX**2), np.zeros(count)
        outputs = estimator.push(Measured(nanoseconds(MET_S[frame]), channel, self.value, variance, none))
        samples = Samples(
            nanoseconds(TIME_S),
            self.input[:, None],
            np.full((len(TIME_S), 1), DENSITY),
            np.zeros(len(TIME_S), dtype=np.uint8),
        )
        outputs += [*estimator.push(samples), *estimator.finish()]
        rows = joined([one.estimates[0] for one in outputs if one.estimates])
        return rows, estimator.smoothed()[0]

    def dense(self, *, causal):
        """Displacement (n,) and its variance at the samples, given all measurements or those up to each.

        All unknowns are in their own standard deviations: z (m,) is as likely as exp(−|z|²/2).
        """
        states = self._states()
        zeros, tilts = np.eye(len(self.factors))[1:].T * ZERO_STD, self._tilts() * TILT_RAD * FOCAL_PX
        rows, left = [], []
        for (k, c), value in zip(self.seen, self.value, strict=True):
            mean, spread = states["met", k]
            factor = self.factors[c]
            rows.append(np.concatenate((factor * spread[0], factor * zeros[c], tilts[k])) / NOISE_PX)
            left.append((value - factor * mean[0]) / NOISE_PX)
        rows, left = np.array(rows), np.array(left)
        size = rows.shape[1]
        mean = np.array([states["sample", k][0][0] for k in range(len(TIME_S))])
        own = np.zeros((len(TIME_S), size))
        for k in range(len(TIME_S)):
            spread = states["sample", k][1][0]
            own[k, : len(spread)] = spread
        if not causal:
            q, r = np.linalg.qr(np.vstack((np.eye(size), rows)))
            z = np.linalg.solve(r, q.T @ np.concatenate((np.zeros(size), left)))
            return mean + own @ z, np.sum(np.linalg.solve(r.T, own.T) ** 2, axis=0)
        frame, found = np.array([k for k, _ in self.seen]), []
        for k, time in enumerate(TIME_S):
            # The same solution by its dual: there are fewer measurements than unknowns.
            used = rows[MET_S[frame] <= time]
            gain = np.linalg.solve(np.eye(len(used)) + used @ used.T, used @ own[k])
            found.append((mean[k] + gain @ left[: len(used)], own[k] @ own[k] - gain @ (used @ own[k])))
        return np.array(found).T

    def _states(self):
        """Mean (3,) of displacement, velocity and bias and its spread (3, m) over the unknowns, at every instant."""
        events = [(t, 0, "met", k) for k, t in enumerate(MET_S)] + [(t, 1, "sample", k) for k, t in enumerate(TIME_S)]
        events.sort()
        size = 3 * (len(events) + 1)
        edges, value = np.concatenate(([-START_S], TIME_S)), np.concatenate((self.input[:1], self.input))
        mean, spread = np.array([self.value[0] / self.factors[0], 0.0, 0.0]), np.zeros((3, size))
        spread[:, :3] = np.diag([PLACE_STD, SPEED_STD, BIAS_STD])
        found, now, k = {}, edges[0], 0
        for number, (time, kind, name, index) in enumerate(events, start=1):
            dt, slope = time - now, (value[k + 1] - value[k]) / (edges[k + 1] - edges[k])
            transition, noise = walk_at_end(dt, DENSITY, WALK)
            # The filter's velocity is that of Numerov's rule: the true one plus dt²/12 times the slope.
            lead = np.array([0.0, (edges[k + 1] - edges[k]) ** 2 / 12.0 * slope, 0.0])
            mean = lead + transition @ (mean - lead) + input_over(dt, now - edges[k], value[k], slope)
            spread = transition @ spread
            if dt > 0.0:
                root = np.zeros((3, 3))
                root[:2, :2], root[2, 2] = np.linalg.cholesky(noise[:2, :2]), np.sqrt(noise[2, 2])
                spread[:, 3 * number : 3 * number + 3] = root
            found[name, index] = mean, spread.copy()
            now, k = time, k + kind
        return found

    def _tilts(self):
        """The tilts' correlation as a root (frames, frames)."""
        if not self.memory_s:
            return np.eye(len(MET_S))
        return np.linalg.cholesky(np.exp(-np.abs(np.subtract.outer(MET_S, MET_S)) / self.memory_s))


SCENES = {
    "two": Scene((3.0, 10.0)),
    "the far one hidden": Scene((3.0, 10.0), hidden={(k, 1) for k in range(5, 10)}),
    "three, the best one hidden": Scene((10.0, 3.0, 63.0), hidden={(k, 1) for k in range(8)}, seed=2),
    "a tilt of a second": Scene((3.0, 10.0), memory_s=1.0, seed=3),
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("causal", [True, False])
def test_rows_and_their_variance_are_those_of_the_dense_least_squares(name, causal):
    scene = SCENES[name]
    value, variance = scene.dense(causal=causal)
    rows = scene.estimated()[0 if causal else 1]
    np.testing.assert_array_equal(rows.time_ns, nanoseconds(TIME_S))
    # Rounding: variances of 4e-4 m² to 1e-10 m² in one covariance leave ten of sixteen digits, of which the filter's
    # recursion over 150 samples costs three.
    np.testing.assert_allclose(rows.variance_m2, variance, rtol=1e-6)
    assert np.max(np.abs(rows.displacement_m - value) / np.sqrt(variance)) < 1e-5


@pytest.mark.parametrize("distances_m", [(3.0, 10.0), (10.0, 63.0)])
@pytest.mark.parametrize("causal", [True, False])
def test_a_quarter_of_an_interval_is_as_good_as_no_memory(distances_m, causal):
    remembered, white = Scene(distances_m), Scene(distances_m, memory_s=0.0)
    (value, variance), (expected, known) = (one.dense(causal=causal) for one in (remembered, white))
    # From frame to frame exp(-4), 1.8 %, is left of a tilt, and moves no row by a larger share of its deviation.
    np.testing.assert_allclose(variance, known, rtol=1e-3)
    assert np.max(np.abs(value - expected) / np.sqrt(known)) < np.exp(-4.0)
