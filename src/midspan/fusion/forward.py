"""The compiled algebra of the estimator's states: forward to a measurement and through it.

The motion of each axis is three states: displacement x, velocity v and bias b of the accelerometer, driven by the
measured acceleration as in `state_space`. Every other state is constant or walks at random: the datum of each axis (its
displacement at the instant that rows count from), and three parts of the zero of each channel. A channel is one target
of one sensor along one axis; its measurement y, in the sensor's own unit, is

    y = units_per_m · ((1 − e) x + z + s + r + v d + blur (a − b)) + noise

with zero z, the shift s of this zero since, the error r of the reference that is compared with (key frames; of a
sensor without any its slow error, a first-order Gauss-Markov process), relative scale error e and clock offset d. The
two last are parameters, and so is the share of the measured acceleration that is the accelerometer's wrong gain:
constants whose effect on every estimate and innovation is carried along as a sensitivity. The columns of the state
matrix X (n, 1 + parameters) are the estimate, and what one unit of each parameter moves it by; they obey the same
equations and share the gains, so that covariance and gains are those of the filter without parameters (separate bias
estimation: B. Friedland, Treatment of bias in recursive filtering, IEEE Trans. Automat. Contr. 14 (1969) 359-367, doi
10.1109/TAC.1969.1099223).
"""

from numba import njit

from midspan.fusion.state_space import GAP_STEPS, response_to

# Columns of `motion` (axes, 3): acceleration at the last sample, its slope, the velocity state's lead.
INPUT, SLOPE, LEAD = range(3)
MOTION_COLUMNS = 3
# `clock` (4,): time of the last sample and length of the last interval, s; how many hypotheses there are; how many of
# the next measurements are judged both ways.
TIME, STEP, COUNT, JUDGED = range(4)
# Columns of the measurements; REFERENCE: reference variance in m².
AT, CHANNEL, VALUE, VARIANCE, REFERENCE = range(5)
MEASUREMENT_COLUMNS = 5
# In the place of a channel: the datum of all axes is set at this instant; a stream's stamps have gone back here.
SET_DATUM, WENT_BACK = -1.0, -2.0
# Columns of the channels: units per metre, blur (exposure²/24, s²), axis, the first of its three zero states (zero,
# shift, reference), number of its sensor, variance of its zero in m² (infinite: unknown), code of its source, age of
# its last accepted measurement from which on rows are coasting, lost; variance (m²) of the difference between two
# instants of the motion that are far apart, and rate (1/s) at which the motion forgets where it was; variance (m²) of
# the sensor's slow error, and rate (1/s) at which that forgets.
(
    UNITS_PER_M,
    BLUR,
    AXIS,
    ZERO,
    SENSOR,
    ZERO_VARIANCE,
    SOURCE,
    COASTING_S,
    LOST_S,
    APART,
    FORGETS,
    SLOW_VARIANCE,
    SLOW_RATE,
) = range(13)
CHANNEL_COLUMNS = 13
# What a parameter is to a channel: entries of the table (channels, parameters).
NOTHING, SCALE, CLOCK = range(3)
# A scale that was learnt from the accelerometer is too large by what its gain is too large, the opposite of SCALE.
GAIN = -SCALE
# Columns of the table of parameters: time (s) from which on each is estimated, density of its walk, least square of the
# sensitivity over the prediction's variance that tells it, and the axis whose accelerometer's gain it is (-1: none).
FROM_S, WALK, CLEAR, GAIN_OF = range(4)
PARAMETER_COLUMNS = 4


@njit(cache=True, inline="always")
def find_uncertain(p, moving, walks, uncertain):  # type: ignore[no-untyped-def]
    """Write to `uncertain` which of the states after the motion's `moving` have a variance or walk; returns how many.

    All others are known for certain: their covariances are 0 and stay so until a measurement changes them.
    """
    count = 0
    for j in range(moving, len(p)):
        if p[j, j] != 0.0 or walks[j] != 0.0:
            uncertain[count] = j
            count += 1
    return count


@njit(cache=True, inline="always")
def predict_across(p, i, k, dt, half):  # type: ignore[no-untyped-def]
    """Phi P Phi' of the covariances between the motions of two axes, whose first states are `i` and `k`."""
    for j in range(k, k + 3):
        p[i, j] += dt * p[i + 1, j] - half * p[i + 2, j]
        p[i + 1, j] -= dt * p[i + 2, j]
    for j in range(i, i + 3):
        p[j, k] += dt * p[j, k + 1] - half * p[j, k + 2]
        p[j, k + 1] -= dt * p[j, k + 2]
        for c in range(k, k + 3):
            p[c, j] = p[j, c]


@njit(cache=True, inline="always")
def predict_covariance(p, axes, dt, walks, uncertain, count):  # type: ignore[no-untyped-def]
    """Phi P Phi' over `dt` seconds, and the walks (n,) of all states; the acceleration's noise is `add_noise`.

    uncertain, count: as of `find_uncertain`; nothing is to be done for the other constants.
    """
    moving, half = 3 * axes, 0.5 * dt * dt
    for i in range(0, moving, 3):
        p01, p02, p11, p12, p22 = p[i, i + 1], p[i, i + 2], p[i + 1, i + 1], p[i + 1, i + 2], p[i + 2, i + 2]
        m01 = p01 + (dt * p11 - half * p12)
        m02 = p02 + (dt * p12 - half * p22)
        m12 = p12 - dt * p22
        p[i, i] += (dt * p01 - half * p02) + (dt * m01 - half * m02)
        p[i, i + 1] = p[i + 1, i] = m01 - dt * m02
        p[i, i + 2] = p[i + 2, i] = m02
        p[i + 1, i + 1] = (p11 - dt * p12) - dt * m12
        p[i + 1, i + 2] = p[i + 2, i + 1] = m12
        p[i + 2, i + 2] = p22 + walks[i + 2] * dt
        for k in range(i + 3, moving, 3):
            predict_across(p, i, k, dt, half)
        for q in range(count):
            j = uncertain[q]
            v, b = p[i + 1, j], p[i + 2, j]
            p[i, j] = p[j, i] = p[i, j] + (dt * v - half * b)
            p[i + 1, j] = p[j, i + 1] = v - dt * b
    for q in range(count):
        p[uncertain[q], uncertain[q]] += walks[uncertain[q]] * dt


@njit(cache=True, inline="always")
def add_noise(p, i, dt, density):  # type: ignore[no-untyped-def]
    """Noise of the acceleration over `dt` seconds, along the axis whose displacement is state `i`."""
    half = 0.5 * density * dt * dt
    p[i, i] += density * dt * dt * dt / 3.0
    p[i, i + 1] += half
    p[i + 1, i] += half
    p[i + 1, i + 1] += density * dt


@njit(cache=True, inline="always")
def predict_mean(x, i, dt, before, after, gain_of):  # type: ignore[no-untyped-def]
    """Move the motion whose first state is `i` by `dt`; the input's response moves the estimate, and the sensitivity to
    the gain of the axis's accelerometer.
    """
    for c in range(x.shape[1]):
        v, b = x[i + 1, c], x[i + 2, c]
        x[i, c] += dt * v - 0.5 * dt * dt * b
        x[i + 1, c] = v - dt * b
    moved, faster = after[0] - before[0] - dt * before[1], after[1] - before[1]
    x[i, 0] += moved
    x[i + 1, 0] += faster
    for q in range(len(gain_of)):
        if 3 * gain_of[q] == i:
            x[i, 1 + q] -= moved
            x[i + 1, 1 + q] -= faster


@njit(cache=True, inline="always")
def predict(x, p, motion, samples, k, way, walks, gain_of, uncertain, count):  # type: ignore[no-untyped-def]
    """Move mean and covariance from one fraction of the interval that ends at sample `k` to another.

    motion: as `begin_interval` left it; way = (fraction reached, fraction wanted, length of the interval in s); samples
    (s, 1 + 2 axes): time, accelerations, noise densities; walks (n,); gain_of (k,): the axis whose accelerometer's gain
    error a parameter is; uncertain, count: as of `find_uncertain`.
    """
    was, theta, dt = way
    axes, step = len(motion), (theta - was) * dt
    for a in range(axes):
        a0, slope, lead = motion[a, INPUT], motion[a, SLOPE], motion[a, LEAD]
        before, after = response_to(was * dt, a0, slope, lead), response_to(theta * dt, a0, slope, lead)
        predict_mean(x, 3 * a, step, before, after, gain_of)
    predict_covariance(p, axes, step, walks, uncertain, count)
    for a in range(axes):
        add_noise(p, 3 * a, step, samples[k, 1 + axes + a])


@njit(cache=True, inline="always")
def begin_interval(xs, clock, motion, samples, k, gain_of):  # type: ignore[no-untyped-def]
    """Bring the velocity states of all axes to the interval that ends at sample `k`; see `state_space`.

    xs (hypotheses, n, 1 + k), of which as many are in use as the clock says. Returns the interval's length in s.
    """
    dt = samples[k, 0] - clock[TIME]
    lead = dt * dt / 12.0 if dt <= GAP_STEPS * clock[STEP] else 0.0
    for a in range(len(motion)):
        slope = (samples[k, 1 + a] - motion[a, INPUT]) / dt
        if lead != motion[a, LEAD]:
            moved = (lead - motion[a, LEAD]) * 0.5 * (motion[a, SLOPE] + slope)
            for b in range(int(clock[COUNT])):
                xs[b, 3 * a + 1, 0] += moved
                for q in range(len(gain_of)):
                    if gain_of[q] == a:
                        xs[b, 3 * a + 1, 1 + q] -= moved
        motion[a, LEAD], motion[a, SLOPE] = lead, slope
    clock[STEP] = min(dt, GAP_STEPS * clock[STEP])
    return dt


@njit(cache=True, inline="always")
def innovate(x, motion, channels, kinds, c, acceleration, value, e):  # type: ignore[no-untyped-def]
    """Innovation of a `value` of channel `c` and its sensitivities, to `e` (1 + k).

    channels, kinds: the tables; acceleration at the instant.
    """
    a, z, g, blur = int(channels[c, AXIS]), int(channels[c, ZERO]), channels[c, UNITS_PER_M], channels[c, BLUR]
    i = 3 * a
    for q in range(len(e)):
        e[q] = -g * (x[i, q] - blur * x[i + 2, q] + x[z, q] + x[z + 1, q] + x[z + 2, q])
    e[0] += value - g * blur * acceleration
    for q in range(len(e) - 1):
        if kinds[c, q] == SCALE or kinds[c, q] == GAIN:
            e[1 + q] += kinds[c, q] * g * x[i, 0]
        elif kinds[c, q] == CLOCK:
            e[1 + q] -= g * (x[i + 1, 0] - motion[a, LEAD] * motion[a, SLOPE])


@njit(cache=True, inline="always")
def linearise(moved, theta, kinds, units_per_m, e):  # type: ignore[no-untyped-def]
    """Take the innovation `e` (1 + k) at the parameters as estimated (k,): a scale error times displacement is no sum.

    moved (1 + k): the displacement's row of the state; kinds (k,): what each parameter is to the channel. The term left
    out at 0 is (scale error)² of the displacement, 0.4 % of it where the scale is 6 % off.
    """
    for q in range(len(theta)):
        if (kinds[q] == SCALE or kinds[q] == GAIN) and theta[q] != 0.0:
            more, g = 0.0, kinds[q] * units_per_m
            for r in range(len(theta)):
                more += theta[r] * moved[1 + r]
                e[1 + r] += g * theta[q] * moved[1 + r]
            e[1 + q] += g * more
            e[0] -= g * theta[q] * more


@njit(cache=True, inline="always")
def move_to_updated(e, kinds, estimated, moved):  # type: ignore[no-untyped-def]
    """Take the sensitivities `e` (1 + k) to a gain and to estimated scale errors at the displacement after the update.

    estimated (k,): which are; moved: by which the update moves the expected measurement. While place and velocity at
    the start are not known that is most of the motion: the sensitivity at the prediction would leave the scale error's
    share of it in the state.
    """
    for q in range(len(e) - 1):
        if kinds[q] == GAIN or (kinds[q] == SCALE and estimated[q]):
            e[1 + q] += kinds[q] * moved


@njit(cache=True, inline="always")
def project(p, channels, c, ph):  # type: ignore[no-untyped-def]
    """h' P h of channel `c`; P h goes to `ph` (n,)."""
    i, z, g, blur = 3 * int(channels[c, AXIS]), int(channels[c, ZERO]), channels[c, UNITS_PER_M], channels[c, BLUR]
    for j in range(len(p)):
        ph[j] = g * (p[i, j] - blur * p[i + 2, j] + p[z, j] + p[z + 1, j] + p[z + 2, j])
    return g * (ph[i] - blur * ph[i + 2] + ph[z] + ph[z + 1] + ph[z + 2])


@njit(cache=True, inline="always")
def update(x, p, gain, e, total):  # type: ignore[no-untyped-def]
    """Take a measurement: X += K e', P − K S K'; `gain` (n,) holds P h before, K after."""
    n = len(p)
    for i in range(n):
        # Of a state that is known for certain nothing is learnt.
        if gain[i] != 0.0:
            gain[i] /= total
            for c in range(len(e)):
                x[i, c] += gain[i] * e[c]
    for i in range(n):
        if gain[i] != 0.0:
            scaled = gain[i] * total
            for j in range(i, n):
                p[i, j] -= scaled * gain[j]
                p[j, i] = p[i, j]


@njit(cache=True)
def begin_zero(x, p, channels, c, gain, e, own):  # type: ignore[no-untyped-def]
    """Take the first measurement of a channel of whose zero nothing is known: what it differs by is the zero.

    It is the limit of `update` for an endless variance of that state, which would leave nothing of the others in double
    precision; own: the measurement's variance. `gain` (n,) holds K after.
    """
    z, g = int(channels[c, ZERO]), channels[c, UNITS_PER_M]
    p[z], p[:, z] = 0.0, 0.0
    known = project(p, channels, c, gain)
    for j in range(len(p)):
        p[z, j] = p[j, z] = -gain[j] / g
    p[z, z] = (known + own) / (g * g)
    gain[:] = 0.0
    gain[z] = 1.0 / g
    for q in range(len(e)):
        x[z, q] += e[q] / g


@njit(cache=True)
def copy_datum(x, p, axes):  # type: ignore[no-untyped-def]
    """The datum of each axis becomes a copy of its displacement."""
    for a in range(axes):
        i, d = 3 * a, 3 * axes + a
        x[d] = x[i]
        p[d] = p[i]
        p[:, d] = p[:, i]
        p[d, d] = p[i, i]


@njit(cache=True)
def scale_state(x, p, i, factor):  # type: ignore[no-untyped-def]
    """State `i` times a factor: 0 makes it known to be 0."""
    x[i] *= factor
    p[i] *= factor
    p[:, i] *= factor


@njit(cache=True)
def move_reference(x, p, i, was, now):  # type: ignore[no-untyped-def]
    """Bring the reference's state `i` from one variance (m²) to another; returns the factor that it is scaled by.

    A farther reference adds an error of its own; a nearer one is without what was added since: of an error that is a
    sum of independent steps, the part up to a variance `now` is now / was of it on the mean, and as uncertain as a
    Brownian bridge there. So the first reference again is exact, and a variance that goes up and down tells nothing of
    the error's size.
    """
    if now < was:
        factor = now / was
        scale_state(x, p, i, factor)
        p[i, i] += now * (1.0 - factor)
        return factor
    p[i, i] += now - was
    return 1.0


@njit(cache=True)
def quadratic(u, m):  # type: ignore[no-untyped-def]
    """u' M u of the sensitivities u (k,) and a covariance M (k, k)."""
    total = 0.0
    for q in range(len(u)):
        for r in range(len(u)):
            total += u[q] * m[q, r] * u[r]
    return total
