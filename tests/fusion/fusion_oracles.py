"""Independent routes to what the filter computes: dense Gaussian conditioning and plain matrix recursions."""

import numpy as np
from scipy.linalg import block_diag, expm

from midspan.fusion import streams
from midspan.fusion.model import START_S
from midspan.records import Acceleration, Displacement, nanoseconds

# x' = v, v' = −b (the input is kept apart), b' = 0; noise enters v and b.
DRIFT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])


def acceleration_block(time_s, value, density):
    time_ns = nanoseconds(np.asarray(time_s, dtype=float))
    return Acceleration(time_ns, np.asarray(value, dtype=float), np.broadcast_to(density, len(time_ns)).astype(float))


def displacement_block(time_s, value, variance, source=4):
    time_ns = nanoseconds(np.asarray(time_s, dtype=float))
    variance = np.broadcast_to(variance, len(time_ns)).astype(float)
    return Displacement(
        time_ns, np.asarray(value, dtype=float), variance, np.full(len(time_ns), source, dtype=np.uint8)
    )


def filtered(acceleration, displacement, settings=None):
    """The causal estimate of a whole record, and all that came with it."""
    found = streams.filtered(acceleration, displacement, settings)
    return found.estimate, found


def van_loan(dt, density, bias_walk):
    """Transition (3, 3) and noise covariance (3, 3) over dt (Van Loan 1978, doi 10.1109/TAC.1978.1101743)."""
    block = np.zeros((6, 6))
    block[:3, :3] = -DRIFT
    block[:3, 3:] = np.diag([0.0, density, bias_walk])
    block[3:, 3:] = DRIFT.T
    whole = expm(block * dt)
    transition = whole[3:, 3:].T
    return transition, transition @ whole[:3, 3:]


def walk_at_end(dt, density, bias_walk):
    """The same with the walk of the bias entering at the end of the step, as the filter does: its way into v and x
    within one step (walk · dt³/3 and dt⁵/20) is below a millionth for steps of milliseconds and left out."""
    transition, noise = van_loan(dt, density, 0.0)
    noise[2, 2] = bias_walk * dt
    return transition, noise


def input_over(dt, start, a0, slope):
    """What acceleration a0 + slope · t adds to x, v, b from `start` to `start + dt` (by the matrix exponential)."""
    system = np.zeros((4, 4))
    system[0, 1] = system[1, 2] = system[2, 3] = 1.0
    moved = expm(system * dt) @ np.array([0.0, 0.0, a0 + slope * start, slope])
    return np.array([moved[0], moved[1], 0.0])


def chain(acceleration, displacement, settings):
    """The joint Gaussian of the states at all samples and measurements in time order.

    Returns mean (n, 3), covariance (3n, 3n), and for each instant its time, kind ("a" or "d") and index. The state's
    velocity is the true one inside an interval; at the samples it steps with the change of slope (Numerov's rule).
    """
    first = acceleration.time_ns[0]
    t = (acceleration.time_ns - first) / 1e9
    td = (displacement.time_ns - first) / 1e9
    edges = np.concatenate(([t[0] - START_S], t))
    a = np.concatenate((acceleration.value_m_s2[:1], acceleration.value_m_s2))
    usable = np.flatnonzero(np.isfinite(displacement.variance_m2) & np.isfinite(displacement.value_m))
    events = [(td[i], 0, i) for i in usable] + [(t[k], 1, k) for k in range(len(t))]
    events = sorted(e for e in events if edges[0] <= e[0] <= t[-1])
    # Nothing better is known of the place than the first measurement.
    mean = np.array([displacement.value_m[usable[0]], 0.0, settings.bias])
    noises = [np.diag([settings.displacement_std**2, settings.velocity_std**2, settings.bias_std**2])]
    rows, means, kinds = [np.eye(3)], [], []
    now, k = edges[0], 0
    for time, kind, index in events:
        dt, slope = time - now, (a[k + 1] - a[k]) / (edges[k + 1] - edges[k])
        transition, noise = walk_at_end(dt, acceleration.noise_density[k], settings.bias_walk)
        # The state's velocity is that of Numerov's rule: the true one plus dt²/12 times the slope.
        lead = np.array([0.0, (edges[k + 1] - edges[k]) ** 2 / 12.0 * slope, 0.0])
        mean = lead + transition @ (mean - lead) + input_over(dt, now - edges[k], a[k], slope)
        rows.append(np.hstack((transition @ rows[-1], np.eye(3))))
        noises.append(noise)
        means.append(mean)
        kinds.append(("a" if kind else "d", index, lead))
        now = time
        if kind:
            k += 1
    size = 3 * len(noises)
    spread = np.vstack([np.hstack((row, np.zeros((3, size - row.shape[1])))) for row in rows[1:]])
    return np.array(means), spread @ block_diag(*noises) @ spread.T, kinds


def condition(chained, displacement, *, causal):
    """Displacement, velocity and displacement variance at each sample given the measurements (all, or those before)."""
    means, covariance, kinds = chained
    out = []
    met = [i for i, (kind, _, _) in enumerate(kinds) if kind == "d"]
    for i, (kind, _, lead) in enumerate(kinds):
        if kind != "a":
            continue
        used = [j for j in met if j < i] if causal else met
        at = 3 * np.array(used, dtype=int)
        value = np.array([displacement.value_m[kinds[j][1]] for j in used])
        noise = np.diag([displacement.variance_m2[kinds[j][1]] for j in used])
        cross = covariance[3 * i : 3 * i + 3][:, at]
        gain = np.linalg.solve(covariance[np.ix_(at, at)] + noise, cross.T).T if used else np.zeros((3, 0))
        state = means[i] + gain @ (value - means[used, 0] if used else np.zeros(0))
        left = covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] - gain @ cross.T
        out.append((state[0], state[1] - lead[1], left[0, 0]))
    return np.array(out)


def riccati_bound(acceleration_std, rate_hz, displacement_std, every):
    """Least std (m) of filter and smoother in the steady state, bias known: plain matrices, averaged over a period."""
    dt, density = 1.0 / rate_hz, acceleration_std**2 / rate_hz
    transition = np.array([[1.0, dt], [0.0, 1.0]])
    noise = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    p, filtered_p, predicted_p = np.eye(2), [], []
    for k in range(120 * every):
        p = transition @ p @ transition.T + noise
        predicted_p.append(p)
        if k % every == 0:
            gain = p[:, :1] / (p[0, 0] + displacement_std**2)
            p = p - gain @ p[:1]
            p = 0.5 * (p + p.T)
        filtered_p.append(p)
    smoothed_p = [filtered_p[-1]]
    for k in range(len(filtered_p) - 2, -1, -1):
        gain = filtered_p[k] @ transition.T @ np.linalg.inv(predicted_p[k + 1])
        smoothed_p.append(filtered_p[k] + gain @ (smoothed_p[-1] - predicted_p[k + 1]) @ gain.T)
    middle = slice(50 * every, 70 * every)
    return tuple(float(np.sqrt(np.mean([p[0, 0] for p in rows[middle]]))) for rows in (filtered_p, smoothed_p[::-1]))
