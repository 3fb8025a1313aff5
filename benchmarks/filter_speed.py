"""Every recursive method per sample against filterpy and scipy's lfilter on the same record in the same run."""

import time
import warnings
from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from benchmarks.cases import even, fused
from benchmarks.table import goal, show
from midspan.records import Acceleration, Displacement

SAMPLES, FEW = 1_000_000, 5_000
# Goals for a sample of a whole record, one thread.
LIMITS_NS = {
    "kalman": 100.0,
    "smoother": 150.0,
    "lag": 150.0,
    "adaptive-kalman": 30.0,
    "adaptive-kalman --literal": 30.0,
}


def record(count: int) -> tuple[Acceleration, Displacement]:
    """Noise at 100 Hz and 10 Hz: the work does not depend on the values."""
    rng = np.random.default_rng(0)
    time_ns, met_ns = even(100.0, count / 100.0), even(10.0, count / 100.0)
    acceleration = Acceleration(time_ns, rng.normal(0, 0.01, len(time_ns)), np.full(len(time_ns), 1e-6))
    value = rng.normal(0, 1e-4, len(met_ns))
    source = np.full(len(met_ns), 4, dtype=np.uint8)
    return acceleration, Displacement(met_ns, value, np.full(len(met_ns), 1e-8), source)


def filterpy_printed(acceleration: Acceleration, displacement: Displacement) -> None:
    """The printed adaptive filter's work with filterpy: two states, acceleration held, R by eq. 20, synchronous."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from filterpy.kalman import KalmanFilter
    dt, beta = 0.01, 0.95
    model = KalmanFilter(dim_x=2, dim_z=1, dim_u=1)
    model.F, model.B = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[dt * dt / 2], [dt]])
    model.Q, model.H = 1e-4 * model.B @ model.B.T, np.array([[1.0, 0.0]])
    model.P, model.R = np.diag([1e-8, 0.0]), np.array([[1e-8]])
    for k, a in enumerate(acceleration.value_m_s2):
        model.predict(u=a)
        if k % 10 == 0:
            value = displacement.value_m[k // 10]
            eta = value - model.x[0, 0]
            model.R = beta * model.R + (1.0 - beta) * (eta**2 - model.P[0, 0])
            model.update(value)


def filterpy_filter(acceleration: Acceleration, displacement: Displacement, *, backwards: bool) -> None:
    """The same three states with filterpy, synchronous."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from filterpy.kalman import KalmanFilter
    dt = 0.01
    model = KalmanFilter(dim_x=3, dim_z=1, dim_u=1)
    model.F = np.array([[1.0, dt, -dt * dt / 2], [0.0, 1.0, -dt], [0.0, 0.0, 1.0]])
    model.B = np.array([[dt * dt / 2], [dt], [0.0]])
    model.Q = 1e-6 * np.array([[dt**3 / 3, dt**2 / 2, 0], [dt**2 / 2, dt, 0], [0, 0, 1e-4]])
    model.H, model.R = np.array([[1.0, 0.0, 0.0]]), np.array([[1e-8]])
    means, covariances = [], []
    for k, a in enumerate(acceleration.value_m_s2):
        model.predict(u=a)
        if k % 10 == 0:
            model.update(displacement.value_m[k // 10])
        means.append(model.x.copy())
        covariances.append(model.P.copy())
    if backwards:
        model.rts_smoother(np.array(means), np.array(covariances))


def nanoseconds_per_sample(work: Callable[[], object], count: int, repeats: int = 3) -> float:
    """The best of a few runs, in processor time: others may be at work on the machine."""
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return 1e9 * best / count


def main() -> None:
    for name in LIMITS_NS:
        fused(*record(1000), name)
    many, few = record(SAMPLES), record(FEW)
    ours = {name: nanoseconds_per_sample(lambda name=name: fused(*many, name), SAMPLES) for name in LIMITS_NS}
    causal, both, printed = (
        nanoseconds_per_sample(work, FEW, 1)
        for work in (
            lambda: filterpy_filter(*few, backwards=False),
            lambda: filterpy_filter(*few, backwards=True),
            lambda: filterpy_printed(*few),
        )
    )
    peer = dict(zip(LIMITS_NS, (causal, both, both, causal, printed), strict=True))
    # Six poles and zeros: about the arithmetic of a three-state filter in its steady state.
    b, a = np.ones(7) / 7, np.array([1.0, -0.5, 0.2, -0.1, 0.05, -0.02, 0.01])
    linear = nanoseconds_per_sample(lambda: lfilter(b, a, many[0].value_m_s2), SAMPLES)
    rows = [[n, ours[n], peer[n], peer[n] / ours[n], linear, ours[n] / linear] for n in ours]
    show(["method", "ns/sample", "filterpy ns", "times faster", "lfilter ns", "lfilters"], rows)
    for name, limit in LIMITS_NS.items():
        goal(f"{name}: a sample", ours[name], limit, unit="ns")
        goal(f"{name}: times faster than filterpy", peer[name] / ours[name], 50.0, at_least=True)
