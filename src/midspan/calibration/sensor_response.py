"""What weakens fast motion between a displacement sensor and the accelerometer: an exposure, or a logger's low-pass.

Averaging over T leaves sin(π f T)/(π f T) of a motion at f Hz; a wrong gain is the same at all frequencies. A low-pass
delays all motion, fast motion more, and weakens what is fast; the delay of slow motion is no different from a clock
offset, and what it takes away altogether looks like noise of the sensor.
"""

from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from midspan import _core
from midspan.calibration.agreement import at_rate, misfit, straightened
from midspan.calibration.causes import PLAYS, Cause, Comparison, named_cause
from midspan.calibration.fit import Fit, Pair, best_corner, likelihood_of, refine
from midspan.calibration.frequency_response import (
    EXCLUDED,
    MAX_LATE,
    MIN_GAIN,
    exposure_shows,
    lead_over_first_order,
    settled,
    with_response,
)
from midspan.calibration.frequency_shapes import Kind
from midspan.calibration.minimum import global_minimum
from midspan.calibration.time_offset import first_part
from midspan.records import Floats

# The exposure is found to this share of the longest one; number of exposures that are tried first.
TOLERANCE, TRIED = 0.001, 11
# A gain farther from 1 than this has another cause.
MAX_GAIN_ERROR = 0.2
# Its standard deviation is first sought with this step, as a share of it, and then with one of its size.
STEP, ROUNDS = 0.05, 3


@dataclass(frozen=True, slots=True)
class Play:
    """Play (backlash) in the joint of a displacement sensor: its width, and what it makes of the displacement but for
    a gain and a delay, rms.
    """

    width_m: float
    taken_m: float


@dataclass(frozen=True, slots=True)
class Exposed:
    """The pair with the exposure found, and its fit; spread: what the exposure's error makes of a gain, relative.

    doubt: of what the exposure makes of the displacement, the share (rms) that is uncertain. open_s: an exposure that
    explains the readings no better than other causes do; play: what explains them clearly better than any exposure.
    Neither is in the pair.
    """

    pair: Pair
    fit: Fit
    spread: float = 0.0
    doubt: float = 1.0
    open_s: float = 0.0
    play: Play | None = None


def find_exposure(pair: Pair, fit: Fit, *, offset_cost: float) -> Exposed:
    """The pair with the most likely exposure of its measurements, none where the motion does not show it, and its fit.

    An exposure is taken where it gains more likelihood, with any gain, than a parameter without effect would (as in
    `fit.with_input_noise`), explains the readings better than any delay and any first-order response, and explains
    more than it leaves. It is no longer than the interval of the measurements.
    Where none is taken those that the motion does not exclude make the gain uncertain. Play in a joint, and a mounting
    of the accelerometer that resonates, are its rivals. offset_cost: as of
    `lead_over_first_order`.
    """
    longest_s, free = 1.0 / pair.rate_hz, pair.changed(ratio=None)

    @cache
    def fitted(share: float) -> Fit:
        return best_corner(replace(free, exposure_s=share * longest_s), fit.offset_s, fit.corner)

    share = global_minimum(lambda one: -fitted(one).likelihood, 0.0, 1.0, tried=TRIED, tolerance=TOLERANCE)
    best = fitted(share)
    none = fitted(0.0)
    gained = best.likelihood - none.likelihood >= 0.5 * np.log(max(len(fit.whitened.variance), 1))
    # What leaves more than it explains, where it leaves most, is something else, which averaging happens to resemble.
    found = replace(free, exposure_s=share * longest_s)
    explained = none.noise > misfit(found, best).factor * best.noise
    if abs(best.ratio - 1.0) > MAX_GAIN_ERROR:
        return Exposed(pair, fit)
    shows = False
    if gained and explained:
        # A clock that runs at another rate blurs the motion as well.
        straight = straightened(free, fit)
        even = (free, fit) if straight is None else (at_rate(free, fit.offset_s, straight[1]), straight[0])
        shows = exposure_shows(*even)
    bare, square = replace(free, exposure_s=0.0), (share * longest_s) ** 2 / 24.0
    # The rivals are compared on the first part of the record, for time, each at its best clock offset.
    part = first_part(bare)
    exposed = _refined(part.changed(exposure_s=share * longest_s), fit).likelihood if shows else 0.0
    stuck, play = likeliest_play(part, fit) if shows else (none, None)
    if play is not None and stuck.likelihood - exposed > MIN_GAIN:
        return Exposed(pair, fit, abs(stuck.ratio - none.ratio), play=play)
    if not (shows and lead_over_first_order(found, bare, best, square, offset_cost=offset_cost) > MIN_GAIN):
        # What the motion does not exclude, the gain may be off by: over all exposures, each by its likelihood.
        tried = [fitted(float(one)) for one in np.linspace(0.0, 1.0, TRIED)]
        weights = np.exp([one.likelihood - best.likelihood for one in tried])
        away = np.array([one.ratio - none.ratio for one in tried])
        spread = float(np.sqrt(np.average(away**2, weights=weights)))
        return Exposed(pair, fit, spread, open_s=share * longest_s if shows else 0.0)
    step, spread = STEP * share, 0.0
    for _ in range(ROUNDS):
        below, above = fitted(share - step), fitted(share + step)
        curved = (2.0 * best.likelihood - below.likelihood - above.likelihood) / step**2
        std = min(1.0 / float(np.sqrt(max(curved, 1e-300))), share)
        spread, step = std * abs(above.ratio - below.ratio) / (2.0 * step), std
    # A mounting that resonates may do the same.
    resonant = settled(part, best_corner(part, fit.offset_s, fit.corner), (Kind.RESONANCE, Kind.LAG))[1].likelihood
    rivals = [resonant - exposed, stuck.likelihood - exposed]
    odds = sum(float(np.exp(min(lead, EXCLUDED))) for lead in rivals if lead > -EXCLUDED)
    # What an exposure makes goes with its square.
    doubt = float(np.hypot(np.sqrt(odds / (1.0 + odds)), 2.0 * std / share))
    pair = pair.changed(exposure_s=share * longest_s)
    return Exposed(pair, best_corner(pair, fit.offset_s, fit.corner), spread, doubt)


def likeliest_play(pair: Pair, fit: Fit) -> tuple[Fit, Play]:
    """The most likely play in the joint of a displacement sensor, near the clock offset of a fit, and that fit.

    The readings are taken to follow the acceleration's displacement, without slow motion, with a play.
    """
    compared = Comparison.of(pair, len(pair.rows))
    path = compared.path()
    even = np.arange(compared.start_s, float(pair.rows[-1, 0]) + fit.offset_s + 1.0, 1.0 / pair.sample_rate_hz)
    moved, time_s = path(even), pair.rows[:, 0] + fit.offset_s
    behind = partial(_behind, even, moved, time_s)

    def fitted(width_m: float) -> Fit:
        rows = pair.rows.copy()
        rows[:, 1] -= behind(width_m)
        return _refined(pair.changed(rows=rows), fit)

    fits = {width: fitted(width) for width in (float(share * np.std(moved)) for share in PLAYS)}
    width_m = max(fits, key=lambda width: likelihood_of(fits[width]))
    # A gain and a clock offset, which are fitted as well, make the rest of it.
    shared = np.column_stack([np.interp(time_s, even, one) for one in (moved, np.gradient(moved))])
    taken = behind(width_m)
    taken = taken - shared @ np.linalg.lstsq(shared, taken, rcond=None)[0]
    return fits[width_m], Play(width_m, float(np.std(taken)))


def _refined(pair: Pair, fit: Fit) -> Fit:
    """The most likely fit of a pair near that of another."""
    return refine(pair, best_corner(pair, fit.offset_s, fit.corner), MAX_LATE / pair.rate_hz)


def _behind(even_s: Floats, moved_m: Floats, time_s: Floats, width_m: float) -> Floats:
    """By how much (n,), m, what follows a displacement with a play is behind it at times (n,)."""
    return np.interp(time_s, even_s, _core.follow_with_play(moved_m, width_m) - moved_m)


@dataclass(frozen=True, slots=True)
class LowPass:
    """What shows of a low-pass: of motion of frequency_hz, relative to slow motion, the delay (s) and what is lost
    (share); offset_s: clock offset of slow motion, its delay included; taken_m: what it makes of the displacement but
    for that delay, rms; stands_out: whether it explains the readings clearly better than all other causes.
    """

    frequency_hz: float
    late_s: float
    lost: float
    offset_s: float
    taken_m: float
    stands_out: bool = True

    def text(self) -> str:
        """What it does, in words."""
        later = [f"{1e3 * self.late_s:.2g} ms later"] if self.late_s > 0.0 else []
        weaker = [f"{100.0 * self.lost:.2g} % weaker"] if self.lost > 0.0 else []
        doubt = "" if self.stands_out else " (more likely than a clock offset; a clock step is not excluded)"
        return (
            f"a low-pass in the accelerometer's logger delays and attenuates fast motion: at {self.frequency_hz:.2g} "
            f"Hz it is {' and '.join((*later, *weaker))} than slow motion{doubt}"
        )


def find_low_pass(pair: Pair, fit: Fit) -> LowPass | None:
    """The low-pass that shows between a displacement sensor and the accelerometer at the clock offset of a fit; None
    where none shows.

    It shows where the delay grows with the frequency, or the acceleration weakens, and that explains the readings
    better by frequency_response.MIN_GAIN (logarithm of the likelihood), with any gain of the accelerometer, and no
    other cause does so clearly.
    """
    free = pair.changed(ratio=None, reference=None)
    before = best_corner(free, fit.offset_s, fit.corner)
    explained = with_response(free, before, (Kind.LAG, Kind.DROOP), most_open=np.inf)
    without = explained.pair
    droop, lag = without.logger
    if not explained.known or lag > 0.0:
        return None
    cause = named_cause(pair, fit.offset_s)
    if cause is not None and cause.cause is not Cause.LOW_PASS:
        return None
    after = refine(without, best_corner(without, fit.offset_s), MAX_LATE / pair.rate_hz)
    if after.likelihood - before.likelihood < MIN_GAIN:
        return None
    if likeliest_play(first_part(free), before)[0].likelihood > _refined(first_part(without), after).likelihood:
        return None
    frequency_hz = after.motion_hz
    square = (2.0 * np.pi * frequency_hz) ** 2
    path, time_s = pair.responses[0], pair.samples[:, 0]
    taken_m = float(np.std(droop * path.shaken(time_s, 0) + lag * path.shaken(time_s, 1)))
    figures = (frequency_hz, -lag * square, min(-droop * square, 1.0), after.offset_s, taken_m)
    return LowPass(*figures, stands_out=cause is not None)
