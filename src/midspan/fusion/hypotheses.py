"""What a measurement far from its prediction means: hypotheses, each a filter of its own, weighed by their likelihood.

While measurements agree with their predictions there is one hypothesis: that they are good. One that does not agree
splits each hypothesis by what may have happened just then:

    GOOD     it is one of the few that lie so far off by chance
    OUTLIER  it is wrong, by any amount; the next ones may be so too, and may keep its value
    SHIFT    the channel's zero has moved, and stays
    RETURN   the channel's zero is back where it was before its shift, or the sensor's clock is
    WRONG    the prediction is: the acceleration errs by more than its noise, and may go on to do so
    LOST     the motion's state is wrong, its bias too: an earlier measurement led it away
    NOISE    the channel's noise has risen
    CLOCK    the sensor's clock has stepped against the accelerometer's: it measures the motion of another time

Each goes on as a filter of its own; the likelihood of what is measured later, by any channel, decides. Hypotheses that
fall behind the best by `ODDS` are dropped, those that have come to agree are one again, and no more than a fixed number
is kept. The priors are rates: how often each is met in the field.

The variance of each channel's noise is followed in each hypothesis by the variational Bayes filter (S. Särkkä, A.
Nummenmaa, Recursive noise adaptive Kalman filtering by variational Bayesian approximations, IEEE Trans. Automat.
Contr. 54 (2009) 596-600, doi 10.1109/TAC.2008.2008348): a mean, over so many measurements as are remembered, of what
is left of each innovation after its update and of what the updated state's variance adds to it.
"""

import numpy as np
from numba import njit

from midspan.fusion.forward import (
    APART,
    AT,
    AXIS,
    CHANNEL,
    CLEAR,
    FORGETS,
    FROM_S,
    REFERENCE,
    SLOW_RATE,
    SLOW_VARIANCE,
    UNITS_PER_M,
    VALUE,
    VARIANCE,
    WALK,
    ZERO,
    ZERO_VARIANCE,
    add_noise,
    begin_zero,
    innovate,
    linearise,
    move_reference,
    move_to_updated,
    project,
    scale_state,
    update,
)
from midspan.fusion.forward import SENSOR as SENSOR_OF
from midspan.fusion.steps import (
    APART_BY,
    INSTANTS,
    NUMBER,
    SINCE,
    TAKEN_OVER,
    begin_instant,
    carry,
    group_of,
    meet_innovation,
    moved_probability,
    scale_changed,
    step_of,
    take_step,
)

GOOD, OUTLIER, SHIFT, RETURN, WRONG, LOST, NOISE, CLOCK = range(8)
KINDS = 8
# In the code of what happened: the error of the acceleration has just ended.
ENDED = KINDS
# The setting of the datum.
DATUM = 2 * KINDS
# A good measurement, by which the innovations up to it tell that the sensor's zero has stepped at an earlier one.
STEPPED_BEFORE = 3 * KINDS
# The prediction was wrong, and the samples' noise has it since the last good measurement (see `second_pass`).
SPREAD = 4 * KINDS
# A shift of a size that its own measurement does not tell, but those after it (see `second_pass`).
SINCE_THEN = 8 * KINDS
# How many hypotheses are kept while the first measurements are judged, any of which may be outliers, and later.
MOST, LATER = 64, 32
# Then one may fall behind by so many times the odds: three outliers in a row may look like motion until the fifth.
FIRST_ODDS = 2.0
# Two are one again where every state agrees to a fifth of its standard deviation, its variance to a tenth and the
# noise to a fifth: what is lost by that is below a hundredth of the band.
SAME_MEAN, SAME_VARIANCE, SAME_NOISE, TINY = 0.05, 0.1, 0.2, 1e-24
# Innovations beyond so many standard deviations are asked what happened: one in 16 000 is by chance.
GATE = 4.0
# The share of outliers is what it was of so many measurements, and never more than this: a sensor that is mostly wrong
# cannot be distinguished from one that has shifted.
OUTLIER_MEMORY, MOST_OUTLIERS = 20.0, 0.3
# Columns of what each hypothesis remembers besides its filter: logarithm of its weight; density of the error of the
# acceleration that goes on (0: none) and along which axis; of the last measurement the hypothesis before it, what it
# was taken for, its innovation (with the parameters as estimated) and its predicted variance; then what happened to
# several targets of a sensor in the same frame: time, sensor and size (m) of the last shift, time and sensor of the
# last outlier; how many measurements were good since anything else was; when the parameters were met last; when the
# record began; of a step found by the last measurement size (m), variance (m²), and how long ago (s) it was.
(
    WEIGHT,
    DENSITY,
    ALONG,
    PARENT,
    CODE,
    ERROR,
    TOTAL,
    SHIFT_AT,
    SHIFT_OF,
    SHIFT_BY,
    OUTLIER_AT,
    OUTLIER_OF,
    AGE,
    LAST_AT,
    BEGAN_AT,
    STEP_BY,
    STEP_VARIANCE,
    STEP_AGO,
) = range(18)
MEMORY_COLUMNS = 18
# And for each channel: factor on its variance, and how many measurements it rests on; how many outliers in a row the
# last ones were, and the value of the first of these; whether its zero has shifted; whether it was met; variance of its
# reference (m²); when it was last met, when last accepted, and with which variance (m²), its reference's included;
# whether its clock has stepped, and whether that is in doubt: stamps were missing or went back since the last
# measurement; share of its last measurements that were outliers; mean square of its last innovations over variance.
(
    FACTOR,
    RESTS_ON,
    DISTURBED,
    KEPT,
    SHIFTED,
    BEGUN,
    REFERENCE_NOW,
    MET_AT,
    ACCEPTED_AT,
    ACCEPTED_VARIANCE,
    STEPPED,
    DOUBTED,
    SHARE,
    RECENT,
) = range(14)
MARK_COLUMNS = 14
# Options, see `Rates`; MEMORY: as of `EstimatorSettings.noise_memory`; BIAS_STD: of the bias at the start, m/s².
(
    P_OUTLIER,
    P_STAYS,
    SHIFT_RATE,
    RETURN_RATE,
    WRONG_RATE,
    ROUGH_RATE,
    NOISE_RATE,
    LOST_RATE,
    CLOCK_RATE,
    ODDS,
    MEMORY,
    BIAS_STD,
) = range(12)
LOG_2PI = np.log(2.0 * np.pi)
# Errors of unknown size lie within this number of decades above the noise.
DECADES = 4.0
# A prediction whose variance is so many times the measurement's own cannot tell an outlier from a measurement inside
# the gate: later ones decide. At 25 an outlier at the gate moves the state by five times what a sound one leaves.
VAGUE = 25.0
# A zero of which nothing is known is taken to lie within so many times (in variance) what the first measurement is off,
# where it is asked whether that is an outlier.
UNKNOWN_ZERO = 1e6
# A measurement so many times (in variance) as far off as predicted is an outlier until the next one says otherwise: 100
# deviations. The least weight of anything else would move the rows by that share of whatever size it has.
WILD = 1e4
# What the noise's factor rests on after a sudden rise or fall, in measurements. It has fallen where over so many the
# mean square of the innovations is less than this share of their variance: by chance once in 100 000 measurements.
ANEW, FALLEN = 12.0, 0.25
# What goes on as an error of the acceleration is so often one of the bias, which a state led away holds too.
BIAS_TOO = 0.05
# After so many good measurements half the odds are enough to drop a hypothesis, after twice as many a third: what they
# have not distinguished they will not.
SETTLES = 20.0
# Of the gaps and steps back in the stamps of a stream so many are one clock's step against the others.
P_STEPPED = 0.1
# Iterations of the variance's fixed point: the third changes it by less than a thousandth.
ITERATIONS = 3
# Errors of the acceleration up to this many times (in variance) its noise are met more often: 30 deviations. At 100
# lively records (`python -m benchmarks broad`) had measurements rejected that were right.
ROUGH = 1000.0
# Shortest time (s) that a rate is taken over.
SHORTEST_S = 1e-3


@njit(cache=True)
def log_normal(e, total):  # type: ignore[no-untyped-def]
    """Logarithm of the normal density of an innovation."""
    return -0.5 * (LOG_2PI + np.log(total) + e * e / total)


@njit(cache=True)
def log_any_size(e, total):  # type: ignore[no-untyped-def]
    """Logarithm of the density of an error of unknown size: alike in all decades from the predicted deviation on."""
    return -np.log(2.0 * DECADES * np.log(10.0)) - 0.5 * np.log(max(e * e, total))


@njit(cache=True)
def log_wrong(e, total, own):  # type: ignore[no-untyped-def]
    """Logarithm of the density of a measurement that is wrong: its error is alike in all decades from its own deviation
    on, and those decades that the prediction cannot tell leave what is predicted.
    """
    hidden = min(0.5 * np.log10(total / own) / DECADES, 1.0)
    return np.log(hidden * np.exp(log_normal(e, total)) + np.exp(log_any_size(e, total)))


@njit(cache=True)
def met_within(rate, lapse):  # type: ignore[no-untyped-def]
    """Probability that what is met so often a second (Poisson) is met in a lapse, s."""
    return -np.expm1(-rate * lapse)


@njit(cache=True)
def one_of(hyps, b):  # type: ignore[no-untyped-def]
    """Hypothesis `b`: its states X (n, 1 + k), P (n, n), marks (c, ...), memory, parameters (k,), their covariance, and
    the sums of steps that may have been (groups, ...), see `steps`.
    """
    return hyps[0][b], hyps[1][b], hyps[2][b], hyps[3][b], hyps[4][b], hyps[5][b], hyps[6][b]


@njit(cache=True)
def meet_zero(hyp, row, channel):  # type: ignore[no-untyped-def]
    """Before a channel's measurement: its zero begins with the first, and follows the reference, or its slow error goes
    on; returns the factor by which that state was scaled. An unknown zero is wide for the hypotheses' weights alone:
    the first measurement that is accepted begins it, see `begin_zero`.
    """
    x, p, marks, _, theta, _, tests = hyp
    mark, z = marks[int(row[CHANNEL])], int(channel[ZERO])
    if mark[BEGUN] == 0.0:
        if channel[ZERO_VARIANCE] < np.inf:
            mark[BEGUN], p[z, z] = 1.0, channel[ZERO_VARIANCE]
        else:
            g, i = channel[UNITS_PER_M], 3 * int(channel[AXIS])
            p[z, z] = UNKNOWN_ZERO * ((row[VALUE] / g - x[i, 0]) ** 2 + row[VARIANCE] / (g * g)) + p[i, i]
    if channel[SLOW_VARIANCE] > 0.0:
        factor = np.exp(-channel[SLOW_RATE] * (row[AT] - mark[MET_AT]))
        scale_state(x, p, z + 2, factor)
        scale_changed(tests, z + 2, factor, len(theta), len(p))
        p[z + 2, z + 2] += (1.0 - factor * factor) * channel[SLOW_VARIANCE]
        return factor
    was = mark[REFERENCE_NOW]
    if was == row[REFERENCE]:
        return 1.0
    mark[REFERENCE_NOW] = row[REFERENCE]
    factor = move_reference(x, p, z + 2, was, row[REFERENCE])
    scale_changed(tests, z + 2, factor, len(theta), len(p))
    return factor


@njit(cache=True)
def follow_clock(hyp, row, channel):  # type: ignore[no-untyped-def]
    """Where a sensor's clock has stepped, let the difference between its time's displacement and this one's go on to
    change as the motion does (first-order Gauss-Markov), in the place of a shift; returns the factor on that state.
    """
    _, p, marks, _, _, _, _ = hyp
    mark, s = marks[int(row[CHANNEL])], int(channel[ZERO]) + 1
    if mark[STEPPED] == 0.0:
        return 1.0
    # The correlation of a smooth motion over so short a time.
    factor = np.exp(-0.5 * (channel[FORGETS] * (row[AT] - mark[MET_AT])) ** 2)
    scale_state(hyp[0], p, s, factor)
    p[s, s] += (1.0 - factor * factor) * channel[APART]
    return factor


@njit(cache=True)
def step_rate(marks, channels, c, at, rates):  # type: ignore[no-untyped-def]
    """How likely it is that the clock of a channel's sensor has stepped; rates: of itself, and where another channel of
    the sensor has found it. 0 where another one of the same frame agrees with its prediction.
    """
    for o in range(len(channels)):
        if o != c and channels[o, SENSOR_OF] == channels[c, SENSOR_OF]:
            if marks[o, STEPPED] > 0.0:
                return rates[1]
            if marks[o, ACCEPTED_AT] == at:
                return 0.0
    return rates[0]


@njit(cache=True)
def look(hyp, row, scene, tables, scratch):  # type: ignore[no-untyped-def]
    """Innovation of a measurement in one hypothesis, variance of its prediction, and of its own noise.

    scene = (motion, acceleration at the instant, density of its noise); the sensitivities go to `scratch`, and P h with
    them. The variance of the prediction is (without, with) the parameters' part.
    """
    x, p, marks, _, theta, spread, _ = hyp
    channels, kinds = tables[1], tables[2]
    gain, e = scratch
    c = int(row[CHANNEL])
    innovate(x, scene[0], channels, kinds, c, scene[1], row[VALUE], e)
    linearise(x[3 * int(channels[c, AXIS])], theta, kinds[c], channels[c, UNITS_PER_M], e)
    error, known = e[0], project(p, channels, c, gain)
    wider = known
    for q in range(len(theta)):
        error += e[1 + q] * theta[q]
        for r in range(len(theta)):
            wider += e[1 + q] * spread[q, r] * e[1 + r]
    return error, known, wider, row[VARIANCE] * marks[c, FACTOR]


@njit(cache=True)
def adapt(marks, c, error, known, own, memory):  # type: ignore[no-untyped-def]
    """Follow the variance of a channel's noise after an accepted innovation; known, own: parts of its variance."""
    # Noise that is taken as declared does not fall.
    if marks[c, RECENT] < FALLEN and memory < np.inf:
        marks[c, RESTS_ON] = min(marks[c, RESTS_ON], ANEW)
    rests = min(marks[c, RESTS_ON], memory - 1.0)
    ratio = 1.0
    for _ in range(ITERATIONS):
        share = ratio * own / (known + ratio * own)
        left = (error * share) ** 2 / own + share * known / own
        ratio = (rests + left) / (rests + 1.0)
    marks[c, FACTOR] *= ratio
    marks[c, RESTS_ON] = rests + 1.0
    if known < own:
        # Else the innovation tells more of the prediction than of the noise.
        marks[c, RECENT] += (error * error / (known + own) - marks[c, RECENT]) / ANEW


@njit(cache=True)
def learn_parameters(theta, spread, e, error, variances, times, learning):  # type: ignore[no-untyped-def]
    """Estimate those parameters (k,) that are to be from an innovation, and let them walk since the last one.

    e (1 + k): the innovation's sensitivities; variances = (that of the prediction without the parameters, of the
    innovation with all that is uncertain); times = (now, last, s); learning (k, 4): the table of the parameters. The
    gain of those that are not estimated is 0, and the covariance stays that of the errors (S. F. Schmidt's consider
    parameters).
    """
    known, total = variances
    k = len(theta)
    gain, mu = np.zeros(k), np.zeros(k)
    for q in range(k):
        spread[q, q] += learning[q, WALK] * max(times[0] - times[1], 0.0)
        for r in range(k):
            mu[q] += spread[q, r] * e[1 + r]
        if times[0] >= learning[q, FROM_S] and e[1 + q] * e[1 + q] >= learning[q, CLEAR] * known:
            gain[q] = mu[q] / total
    for q in range(k):
        theta[q] -= gain[q] * error
        for r in range(k):
            spread[q, r] += gain[q] * gain[r] * total - gain[q] * mu[r] - mu[q] * gain[r]


@njit(cache=True)
def ask_for_step(hyp, row, share, tables, options):  # type: ignore[no-untyped-def]
    """Let a step of the sensor's zero be asked for from this measurement on, where the last such instant is far enough
    away; share: what the update takes over of the innovation.
    """
    _, p, marks, memory, theta, _, tests = hyp
    c, axes = int(row[CHANNEL]), len(tables[5])
    own, k, n = tests[group_of(tables[1][c], axes)], len(theta), len(p)
    carry(tests, row[AT], axes, k, n)
    if marks[c, STEPPED] > 0.0 or marks[c, BEGUN] == 0.0:
        # What it measures is of another instant, or begins its zero.
        own[:] = 0.0
        return
    newest = (int(own[INSTANTS, NUMBER]) - 1) % INSTANTS
    own[INSTANTS, TAKEN_OVER] += share
    if options[SHIFT_RATE] > 0.0 and own[INSTANTS, TAKEN_OVER] >= APART_BY and own[newest, SINCE] != row[AT]:
        last = max(marks[c, ACCEPTED_AT], memory[BEGAN_AT])
        lapse = max(row[AT] - last, SHORTEST_S)
        moved = moved_probability(lapse, tables[1][c], options[SHIFT_RATE])
        priors = (np.log(moved), np.log(min(met_within(options[WRONG_RATE], lapse), 0.5)))
        begin_instant(tests, c, tables[1], axes, (row[AT], row[AT] - lapse), priors, k, n)


@njit(cache=True)
def find_step(hyp, row, tables, least):  # type: ignore[no-untyped-def]
    """Whether innovations tell by odds (logarithm) of `least` that the sensor's zero has stepped; then it is taken out
    of the states, what it may be off by included, and the hypothesis remembers it.
    """
    x, p, marks, memory, theta, _, tests = hyp
    channels, axes, c = tables[1], len(tables[5]), int(row[CHANNEL])
    own, a = tests[group_of(channels[c], axes)], int(channels[c, AXIS])
    best, odds = step_of(own, theta, tables[5][a], -np.log(2.0 * DECADES * np.log(10.0)), len(p))
    if best < 0 or odds < least:
        return False
    since = own[best, SINCE]
    memory[STEP_BY], memory[STEP_VARIANCE] = take_step(x, p, own[best], theta)
    memory[STEP_AGO], memory[CODE] = row[AT] - since, STEPPED_BEFORE
    memory[SHIFT_AT], memory[SHIFT_OF], memory[SHIFT_BY] = since, channels[c, SENSOR_OF], memory[STEP_BY]
    for o in range(len(channels)):
        if group_of(channels[o], axes) == group_of(channels[c], axes):
            marks[o, SHIFTED] = 1.0
    # The states have changed: all other sums were of those before.
    tests[:] = 0.0
    return True


@njit(cache=True)
def accept(hyp, row, seen, tables, options, scratch):  # type: ignore[no-untyped-def]
    """Update one hypothesis with a measurement; seen: what `look` returned, P h and sensitivities in `scratch`.

    Returns the innovation's variance that it was taken with, infinite where it began the channel's zero.
    """
    x, p, marks, memory, theta, spread, tests = hyp
    gain, e = scratch
    c = int(row[CHANNEL])
    error, known, wider, own = seen
    ask_for_step(hyp, row, known / (known + own), tables, options)
    g = tables[1][c, UNITS_PER_M]
    memory[ERROR], memory[TOTAL] = error, wider + own
    total = np.inf
    if marks[c, BEGUN] == 0.0:
        marks[c, BEGUN] = 1.0
        begin_zero(x, p, tables[1], c, gain, e, own)
    else:
        adapt(marks, c, error, wider, own, options[MEMORY])
        own = row[VARIANCE] * marks[c, FACTOR]
        total = known + own
        if len(theta) > 0:
            learn_parameters(theta, spread, e, error, (known, wider + own), (row[AT], memory[LAST_AT]), tables[4])
            memory[LAST_AT] = row[AT]
            move_to_updated(e, tables[2][c], row[AT] >= tables[4][:, FROM_S], error * known / total)
        update(x, p, gain, e, total)
    meet_innovation(tests, c, tables[1], len(tables[5]), gain, e, total)
    marks[c, DISTURBED] = 0.0
    marks[c, SHARE] -= marks[c, SHARE] / OUTLIER_MEMORY
    marks[c, ACCEPTED_AT], marks[c, ACCEPTED_VARIANCE] = row[AT], own / (g * g) + marks[c, REFERENCE_NOW]
    return total


@njit(cache=True)
def led_away(size, lapse):  # type: ignore[no-untyped-def]
    """Density, (m/s²)²/Hz, of an error of the acceleration that leads a prediction `size` (m) away in `lapse` (s)."""
    return 3.0 * size * size / lapse**3


@njit(cache=True)
def weigh_return(hyp, row, seen, channel, options, scratch, chances):  # type: ignore[no-untyped-def]
    """The weight of a return; seen = (innovation, variance of its prediction, of its noise), P h in `scratch`.

    A shift is asked for its return outside the gate only; a clock that has stepped explains every measurement.
    """
    x, p, marks, memory, _, _, _ = hyp
    mark, (error, wider, own) = marks[int(row[CHANNEL])], seen
    if mark[STEPPED] == 0.0 and error * error <= GATE * GATE * (wider + own):
        return
    s, g = int(channel[ZERO]) + 1, channel[UNITS_PER_M]
    # Without the shift's state: its mean comes back to the innovation, its variance goes.
    rest = wider - 2.0 * g * scratch[0][s] + g * g * p[s, s]
    returned = log_normal(error + g * x[s, 0], max(rest, 0.0) + own)
    rate = options[CLOCK_RATE] if mark[STEPPED] > 0.0 else options[RETURN_RATE]
    lapse = max(row[AT] - mark[MET_AT], SHORTEST_S)
    chances[RETURN] = memory[WEIGHT] + np.log(met_within(rate, lapse)) + returned


@njit(cache=True)
def weigh_step(hyp, row, seen, channels, options, chances):  # type: ignore[no-untyped-def]
    """The weight of a clock that steps; seen = (innovation, its variance, time in which it may have happened, s)."""
    _, _, marks, memory, _, _, _ = hyp
    c, (error, total, lapse) = int(row[CHANNEL]), seen
    mark, apart = marks[c], channels[c][APART]
    if mark[SHIFTED] > 0.0 or apart == 0.0:
        return
    own_rate = P_STEPPED if mark[DOUBTED] > 0.0 else met_within(options[CLOCK_RATE], lapse)
    rate = step_rate(marks, channels, c, row[AT], (own_rate, options[P_STAYS]))
    if rate > 0.0:
        stepped = log_normal(error, total + apart * channels[c][UNITS_PER_M] ** 2)
        chances[CLOCK] = memory[WEIGHT] + np.log(rate) + stepped


@njit(cache=True)
def weigh(hyp, row, scene, tables, options, scratch, asked, chances):  # type: ignore[no-untyped-def]
    """Logarithms of the weights (8,) of what a hypothesis may become by a measurement; -inf: not looked at.

    asked = (whether it is one of the first and may be an outlier even inside the gate, variance of the sharpest
    prediction that any hypothesis has of it).
    """
    _, _, marks, memory, _, _, _ = hyp
    c = int(row[CHANNEL])
    channel, mark, prior = tables[1][c], marks[c], memory[WEIGHT]
    error, _, wider, own = look(hyp, row, scene, tables, scratch)
    total = wider + own
    chances[:] = -np.inf
    if mark[STEPPED] > 0.0:
        # What it measures of another instant neither is an outlier nor says that the motion's state is wrong.
        chances[GOOD] = prior + log_normal(error, max(total, error * error))
        weigh_return(hyp, row, (error, wider, own), channel, options, scratch, chances)
        return
    same_frame = memory[OUTLIER_AT] == row[AT] and memory[OUTLIER_OF] == channel[SENSOR_OF]
    runs = mark[DISTURBED] > 0.0 or same_frame
    p_out = max(options[P_OUTLIER], min(mark[SHARE], MOST_OUTLIERS))
    p_out = options[P_STAYS] if runs else p_out
    chances[GOOD] = prior + log_normal(error, total) + np.log(1.0 - p_out)
    size, wrong = log_any_size(error, total), log_wrong(error, total, own)
    kept = wrong
    inside, doubted = error * error <= GATE * GATE * total, asked[0] or wider > VAGUE * own
    if mark[DISTURBED] > 0.0:
        # A value near the first outlier's says nothing against the sensor where no hypothesis can tell the motion.
        kept = max(wrong, log_normal(row[VALUE] - mark[KEPT], max(2.0 * own, asked[1])))
        chances[OUTLIER] = prior + np.log(0.5) + kept + np.log(p_out)
    elif runs or doubted or not inside:
        chances[OUTLIER] = prior + wrong + np.log(p_out)
    if memory[DENSITY] > 0.0:
        chances[LOST] = prior + np.log(BIAS_TOO) + log_normal(error, total)
    # Among outliers it may have happened at any time since the last measurement that was none.
    lapse = max(row[AT] - max(mark[ACCEPTED_AT], memory[BEGAN_AT]), SHORTEST_S)
    if mark[SHIFTED] > 0.0:
        weigh_return(hyp, row, (error, wider, own), channel, options, scratch, chances)
    if not asked[0] and (not inside or mark[DOUBTED] > 0.0):
        weigh_step(hyp, row, (error, total, lapse), tables[1], options, chances)
    # Of the first measurements it is asked only which are outliers: what is met once an hour is not met just then.
    if inside or asked[0] or (mark[DISTURBED] == 0.0 and error * error > WILD * total):
        return
    if memory[SHIFT_AT] == row[AT] and memory[SHIFT_OF] == channel[SENSOR_OF]:
        # The sensor moved: all its targets shift, mostly by the same.
        alike_size = log_normal(error - channel[UNITS_PER_M] * memory[SHIFT_BY], 2.0 * own)
        chances[SHIFT] = prior + np.log(0.5 * options[P_STAYS]) + max(size, alike_size)
    else:
        chances[SHIFT] = prior + np.log(met_within(options[SHIFT_RATE], lapse)) + size
    rough = led_away(error / channel[UNITS_PER_M], lapse) < ROUGH * scene[2]
    chances[WRONG] = prior + np.log(met_within(options[ROUGH_RATE if rough else WRONG_RATE], lapse)) + size
    chances[NOISE] = prior + np.log(met_within(options[NOISE_RATE], lapse)) + size
    led = np.log(met_within(options[LOST_RATE], lapse))
    if mark[DISTURBED] > 0.0:
        # With each outlier it becomes more likely that the state was wrong before the first of them.
        led = min(led - mark[DISTURBED] * np.log(0.5 * options[P_STAYS]), np.log(options[P_OUTLIER]))
        size = kept
    chances[LOST] = max(chances[LOST], prior + led + size)


@njit(cache=True)
def reject(mark, memory, row, sensor):  # type: ignore[no-untyped-def]
    """Leave out a measurement of a sensor as an outlier."""
    if mark[DISTURBED] == 0.0:
        # From value to value a fast sensor always keeps its own; stuck is one that keeps the first.
        mark[KEPT] = row[VALUE]
    mark[DISTURBED] += 1.0
    mark[SHARE] += (1.0 - mark[SHARE]) / OUTLIER_MEMORY
    memory[OUTLIER_AT], memory[OUTLIER_OF] = row[AT], sensor


@njit(cache=True)
def go_back(hyp, row, scene, tables, options, scratch):  # type: ignore[no-untyped-def]
    """Let a channel's zero be where it was before its shift, or its clock; as well as one measurement tells, where that
    comes later than returns do on the mean: what does not go back soon has moved for good, and a second shift has
    nearly undone the first.
    """
    x, p, marks, memory, _, _, _ = hyp
    channel, mark = tables[1][int(row[CHANNEL])], marks[int(row[CHANNEL])]
    s = int(channel[ZERO]) + 1
    scale_state(x, p, s, 0.0)
    if mark[STEPPED] == 0.0:
        seen = look(hyp, row, scene, tables, scratch)
        own_shift = memory[SHIFT_OF] == channel[SENSOR_OF]
        if not own_shift or (row[AT] - memory[SHIFT_AT]) * options[RETURN_RATE] > 1.0:
            p[s, s] += (seen[2] + seen[3]) / channel[UNITS_PER_M] ** 2
    mark[SHIFTED] = mark[STEPPED] = 0.0


@njit(cache=True)
def let_go(p, i, missed, spread):  # type: ignore[no-untyped-def]
    """Let an axis' state from place `i` on be what it may: missed = (by how much, m; in which time, s; bias' most).

    spread: displacement and velocity have their noise already.
    """
    size, lapse, most = missed
    bias = min(size / lapse**2, most)
    p[i + 2, i + 2] += bias * bias
    if not spread:
        p[i, i] += size * size
        p[i + 1, i + 1] += (size / lapse) ** 2


@njit(cache=True)
def forget_steps(tests, kind, channel, axes):  # type: ignore[no-untyped-def]
    """No step before a change of a sensor's zero is asked for any more."""
    if kind in (SHIFT, RETURN, CLOCK):
        tests[group_of(channel, axes)] = 0.0


@njit(cache=True)
def shift_zero(hyp, row, channel, seen, since_then):  # type: ignore[no-untyped-def]
    """Let a channel's zero have shifted; seen = (innovation, its variance). Where only later measurements tell the
    size, nothing is known of it here: the prior takes a fiftieth of its deviation.
    """
    _, p, marks, memory, _, _, _ = hyp
    s, (error, total), unit = int(channel[ZERO]) + 1, seen, channel[UNITS_PER_M]
    p[s, s] += (VAGUE * total if since_then else error * error) / (unit * unit)
    marks[int(row[CHANNEL]), SHIFTED] = 1.0
    memory[SHIFT_AT], memory[SHIFT_OF], memory[SHIFT_BY] = row[AT], channel[SENSOR_OF], error / unit


@njit(cache=True)
def become(code, hyp, row, scene, tables, options, scratch):  # type: ignore[no-untyped-def]
    """Turn a hypothesis into what a measurement makes of it, as `code` says; returns the innovation's variance that
    it was taken with (0: not at all) and the factor by which the shift's state was scaled.
    """
    _, p, marks, memory, _, _, tests = hyp
    c = int(row[CHANNEL])
    channel, mark = tables[1][c], marks[c]
    a, s, scaled = int(channel[AXIS]), int(channel[ZERO]) + 1, 1.0
    kind, lapse, spread = code % KINDS, max(row[AT] - mark[MET_AT], SHORTEST_S), (code // SPREAD) % 2 == 1
    since_then, code = code >= SINCE_THEN, code % SPREAD
    memory[CODE] = code
    memory[AGE] = memory[AGE] + 1.0 if code == GOOD else 0.0
    mark[MET_AT], mark[DOUBTED] = row[AT], 0.0
    seen = look(hyp, row, scene, tables, scratch)
    # Whether the samples' noise since then explains it: then it was the prediction that was wrong.
    spread = spread and seen[0] ** 2 <= GATE * GATE * (seen[2] + seen[3])
    if spread and kind == OUTLIER:
        kind = GOOD
    if kind == OUTLIER:
        reject(mark, memory, row, channel[SENSOR_OF])
        memory[ERROR], memory[TOTAL] = seen[0], seen[2] + seen[3]
        if code >= ENDED:
            memory[DENSITY] = 0.0
        return 0.0, scaled
    error, total = seen[0], seen[2] + seen[3]
    size = error / channel[UNITS_PER_M]
    forget_steps(tests, kind, channel, len(tables[5]))
    if kind == SHIFT:
        shift_zero(hyp, row, channel, (error, total), since_then)
    elif kind == RETURN:
        scaled = 0.0
        go_back(hyp, row, scene, tables, options, scratch)
    elif kind == CLOCK:
        p[s, s], mark[STEPPED] = p[s, s] + channel[APART], 1.0
    elif kind == WRONG:
        memory[DENSITY], memory[ALONG] = led_away(size, lapse), a
        if not spread:
            add_noise(p, 3 * a, lapse, memory[DENSITY])
    elif kind == LOST:
        lapse = max(row[AT] - max(mark[ACCEPTED_AT], memory[BEGAN_AT]), SHORTEST_S)
        size = max(abs(size), np.sqrt(total) / abs(channel[UNITS_PER_M]))
        let_go(p, 3 * a, (size, lapse, options[BIAS_STD]), spread)
        memory[DENSITY] = 0.0
    elif kind == NOISE:
        mark[RECENT] = 1.0
        mark[FACTOR], mark[RESTS_ON] = mark[FACTOR] * error * error / total, min(mark[RESTS_ON], ANEW)
    if kind != GOOD:
        seen = look(hyp, row, scene, tables, scratch)
    if mark[STEPPED] > 0.0 and seen[0] ** 2 > GATE * GATE * (seen[2] + seen[3]):
        # The two instants are farther apart than usual, as in a passage: rejected, or taken for an error of the
        # motion's state, it would leave the acceleration alone or begin a velocity that nothing moves with.
        p[s, s] += seen[0] ** 2 / channel[UNITS_PER_M] ** 2
        seen = look(hyp, row, scene, tables, scratch)
    taken = accept(hyp, row, seen, tables, options, scratch)
    memory[ERROR], memory[TOTAL] = error, total
    if code == STEPPED_BEFORE:
        find_step(hyp, row, tables, -np.inf)
    elif code >= ENDED:
        memory[DENSITY] = 0.0
    return taken, scaled


@njit(cache=True)
def copy_hypothesis(hyps, to, of):  # type: ignore[no-untyped-def]
    """Hypothesis `to` becomes a copy of `of`."""
    xs, ps, marks, memory, thetas, spreads, tests = hyps
    xs[to], ps[to], marks[to], memory[to] = xs[of], ps[of], marks[of], memory[of]
    thetas[to], spreads[to], tests[to] = thetas[of], spreads[of], tests[of]


@njit(cache=True)
def alike(hyps, b, o):  # type: ignore[no-untyped-def]
    """Whether two hypotheses have come to say the same of every state, of the noise and of what goes on."""
    xs, ps, marks, memory, _, _, _ = hyps
    if memory[o, DENSITY] != memory[b, DENSITY]:
        return False
    for c in range(marks.shape[1]):
        if (marks[o, c, DISTURBED] > 0.0) != (marks[b, c, DISTURBED] > 0.0) or marks[o, c, STEPPED] != marks[
            b, c, STEPPED
        ]:
            return False
        if abs(marks[o, c, FACTOR] / marks[b, c, FACTOR] - 1.0) > SAME_NOISE:
            return False
    for i in range(ps.shape[1]):
        mine, other = ps[b, i, i], ps[o, i, i]
        if (xs[b, i, 0] - xs[o, i, 0]) ** 2 > SAME_MEAN * (mine + other) + TINY:
            return False
        if abs(mine - other) > SAME_VARIANCE * max(mine, other) + TINY:
            return False
    return True


@njit(cache=True)
def prune(hyps, count, odds):  # type: ignore[no-untyped-def]
    """Drop what fell behind or repeats a better one; the best comes first. Returns how many are left."""
    memory = hyps[3]
    best = 0
    for b in range(1, count):
        if memory[b, WEIGHT] > memory[best, WEIGHT]:
            best = b
    if best != 0:
        copy_hypothesis(hyps, 2 * MOST, 0)
        copy_hypothesis(hyps, 0, best)
        copy_hypothesis(hyps, best, 2 * MOST)
    top, left = memory[0, WEIGHT], 0
    for b in range(count):
        age = min(memory[b, AGE], memory[0, AGE])
        keep = b == 0 or memory[b, WEIGHT] > top - odds / (1.0 + age / SETTLES)
        for o in range(left):
            if keep and alike(hyps, b, o):
                keep = False
                high, low = max(memory[o, WEIGHT], memory[b, WEIGHT]), min(memory[o, WEIGHT], memory[b, WEIGHT])
                memory[o, WEIGHT] = high + np.log1p(np.exp(low - high))
        if keep:
            if left != b:
                copy_hypothesis(hyps, left, b)
            left += 1
    top = memory[0, WEIGHT]
    for b in range(left):
        memory[b, WEIGHT] -= top
    return left


@njit(cache=True)
def split(hyps, count, row, scene, tables, options, scratch, doubted, chances):  # type: ignore[no-untyped-def]
    """Split, weigh and prune all hypotheses by one measurement; returns how many are left. doubted: as of `weigh`."""
    memory, sharpest = hyps[3], np.inf
    for b in range(count):
        seen = look(one_of(hyps, b), row, scene, tables, scratch)
        sharpest = min(sharpest, seen[2] + seen[3])
    for b in range(count):
        weigh(one_of(hyps, b), row, scene, tables, options, scratch, (doubted, sharpest), chances[b])
        if memory[b, DENSITY] > 0.0:
            # The error of the acceleration may just have ended.
            chances[b] += np.log(options[P_STAYS])
    flat = chances[:count].ravel()
    order = np.argsort(-flat)
    most, odds = (MOST, FIRST_ODDS * options[ODDS]) if doubted else (LATER, options[ODDS])
    made = rejecting = 0
    for place in order:
        if made == most // 2 or not flat[place] > flat[order[0]] - odds:
            break
        b, kind = place // KINDS, place % KINDS
        if kind == OUTLIER:
            # Those that reject learn nothing: all of them together would keep out for ever what could take it.
            if rejecting == most // 4:
                continue
            rejecting += 1
        copy_hypothesis(hyps, MOST + made, b)
        become(kind, one_of(hyps, MOST + made), row, scene, tables, options, scratch)
        memory[MOST + made, WEIGHT], memory[MOST + made, PARENT] = flat[place], b
        made += 1
    for b in range(made):
        copy_hypothesis(hyps, b, MOST + b)
    for b in range(made):
        if memory[b, DENSITY] > 0.0 and made < most:
            copy_hypothesis(hyps, made, b)
            memory[made, DENSITY], memory[made, CODE] = 0.0, memory[b, CODE] + ENDED
            memory[made, WEIGHT] += np.log(1.0 - options[P_STAYS]) - np.log(options[P_STAYS])
            made += 1
    return prune(hyps, made, odds)
