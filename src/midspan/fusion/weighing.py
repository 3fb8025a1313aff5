"""How likely each is that a measurement may mean: the densities of its innovation, and how often each is met."""

import numpy as np
from numba import njit

from midspan.fusion.forward import APART, AT, CHANNEL, UNITS_PER_M, VALUE, ZERO
from midspan.fusion.forward import SENSOR as SENSOR_OF
from midspan.fusion.hypothesis import (
    ACCEPTED_AT,
    BEGAN_AT,
    CLOCK,
    CLOCK_RATE,
    DENSITY,
    DISTURBED,
    DOUBTED,
    GOOD,
    KEPT,
    LASTING,
    LOST,
    LOST_RATE,
    MET_AT,
    NOISE,
    NOISE_RATE,
    ONCE,
    OUTLIER,
    OUTLIER_AT,
    OUTLIER_OF,
    P_OUTLIER,
    P_STAYS,
    RETURN,
    RETURN_RATE,
    SHARE,
    SHIFT,
    SHIFT_AT,
    SHIFT_BY,
    SHIFT_OF,
    SHIFT_RATE,
    SHIFTED,
    STEPPED,
    WEIGHT,
    WRONG,
    WRONG_RATE,
)
from midspan.fusion.innovation import look

# Innovations beyond this number of standard deviations are asked what happened: one in 16 000 is by chance.
GATE = 4.0
# A measurement this many times (in variance) as far off as predicted is an outlier until the next one says otherwise:
# 100 deviations. The least weight of anything else would move the rows by that share of whatever size it has.
WILD = 1e4
# A prediction whose variance is this many times the measurement's own cannot tell an outlier from a measurement inside
# the gate: later ones decide. At 25 an outlier at the gate moves the state by five times what a sound one leaves.
VAGUE = 25.0
# The share of outliers is that of this number of measurements, and never more than this: a sensor that is mostly wrong
# cannot be distinguished from one that has shifted.
OUTLIER_MEMORY, MOST_OUTLIERS = 20.0, 0.3
LOG_2PI = np.log(2.0 * np.pi)
# Errors of unknown size lie within this number of decades above the noise.
DECADES = 4.0
# What goes on as an error of the acceleration is so often one of the bias, which a state led away holds too.
BIAS_TOO = 0.05
# Of the gaps and steps back in the stamps of a stream this share is one clock's step against the others.
P_STEPPED = 0.1
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
def led_away(size, lapse):  # type: ignore[no-untyped-def]
    """Density, (m/s²)²/Hz, of an error of the acceleration that leads a prediction `size` (m) away in `lapse` (s)."""
    return 3.0 * size * size / lapse**3


@njit(cache=True)
def tells_step(channel, total):  # type: ignore[no-untyped-def]
    """Whether an innovation's variance `total` is less than what a step of the clock makes; where clocks do not step
    there is nothing to tell.
    """
    return channel[APART] == 0.0 or total < channel[APART] * channel[UNITS_PER_M] ** 2


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
def noise_within(mark, is_sharp, options, lapse):  # type: ignore[no-untyped-def]
    """How likely a sensor's noise rose within a lapse (s); is_sharp: whether the prediction tells."""
    noisier = met_within(options[NOISE_RATE], lapse)
    if mark[DOUBTED] > ONCE and is_sharp:
        # A clock that is a little off is noise: the motion of some milliseconds. So is a tenth of those that step.
        noisier = max(noisier, P_STEPPED * P_STEPPED)
    return noisier


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
    told = (mark[DOUBTED] == LASTING or mark[DOUBTED] == ONCE) and tells_step(channel, total)
    if not asked[0] and (not inside or told):
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
    chances[WRONG] = prior + np.log(met_within(options[WRONG_RATE], lapse)) + size
    chances[NOISE] = prior + np.log(noise_within(mark, wider <= VAGUE * own, options, lapse)) + size
    led = np.log(met_within(options[LOST_RATE], lapse))
    if mark[DISTURBED] > 0.0:
        # The state was wrong before the first of them, so the others speak against it no more than against the sensor.
        led, size = min(led, np.log(options[P_OUTLIER])), kept
    chances[LOST] = max(chances[LOST], prior + led + size)
