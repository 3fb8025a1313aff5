"""What makes the ratio of translation and acceleration depend on frequency: removed where it shows, else in σ.

A calibration has one ratio s of the translation p and the acceleration integrated twice, D. Five shapes make it a
smooth function of frequency:

    exposure T        p = s · mean of D over T         falls with the frequency's square, later as a sinc
    resonance c, q    p = s (D + c D'' + q D''')       falls with the frequency's square
    lean gκ           u = D + gκ ∬u                    rises, most at low frequencies
    sight a           u = D + gκ ∬u + a ∬T             as the tilt that the camera sees
    logger q, r       u = D + q D''' − r D''           delay and ratio rise with the frequency's square

The exposure is the camera's, or its rows are read one after the other; only its mean over the frame's interval is
without doubt. A tower leans by κ radians for each metre that it moves, so that gravity takes gκ u from the acceleration
of its horizontal axis; faster modes have slopes of their own. Where targets at two distances show the tilt, T is what
they have in common (px) that does not go with u: gravity takes a T more, a = ± g over the focal length (px) where the
camera looks up or down. A logger's low-pass delays fast motion more than slow motion, whose delay is a clock offset,
and may weaken it. A bracket or railing below the accelerometer that resonates at ω = 1/√c with a damping ratio ζ makes
it feel fast motion too strongly: inverted, its transmissibility is 1 − r² / (1 + 2jζ r) = 1 − r² + 2jζ r³ + … with r =
frequency over resonance, so that q = −2ζ c^(3/2) (A. K. Chopra, Dynamics of structures, section 3.6).

They are compared as whole shapes by likelihood: the best is taken, and another on top only where that gains as clearly
again. How far the ratio would be another with a shape that is nearly as likely, and what a further one changes, is
in σ.

Each number of a shape is a row of TERMS, and one more column of the regression of the whitened translation (see
`whitening`): likelihood, step towards the most likely value and covariance come from one run of the filter. ∬u is that
of the translation over the ratio.

A sensor of first order is the rival of one that averages: both weaken fast motion, and the first delays it too.

    mean over T       1 − (ω T)²/24 + …
    first order τ     1/(1 + jω τ) = exp(−jω τ) (1 − (ω τ)²/2 + j (ω τ)³/3 + …)

With τ² = T²/12, and its delay of slow motion taken for a clock offset, it does the same but for the third power. Motion
that does not distinguish them shows no exposure: an accelerometer that errs in proportion to its motion (its gain, an
attitude that follows, a lever arm) leaves the same slope.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.fit import Fit, Pair, best_corner, refine
from midspan.calibration.frequency_shapes import (
    ALIKE,
    FALLING,
    FIRST,
    RESPONSE,
    SHAPES,
    TERMS,
    VELOCITY,
    Columns,
    Kind,
    free_columns,
    seen_by,
    solved,
    with_logger,
)
from midspan.calibration.minimum import minimum
from midspan.calibration.own_noise import most_density
from midspan.notices import Notice
from midspan.records import Floats
from midspan.signals.acceleration import GRAVITY_M_S2
from midspan.signals.health import dominant_frequency

# Standard deviation of an exposure that is neither declared nor shown by the motion: 1/50 s, the longest of ordinary
# video under light from the mains. It is the frame's interval where that is shorter.
USUAL_EXPOSURE_S = 0.02
# The same of the slope, radians a metre: a cantilever of height h leans by 1.4/h (first bending mode), a tower of 70 m
# by this; one of 20 m is within four of these standard deviations.
USUAL_SLOPE = 0.02
# A cantilever's second mode has its first one's slope times this, with the other sign (Chopra, section 17.3): the
# standard deviation of what faster modes differ by.
MODE_SLOPE = 2.5
# What is slower than the motion by this is judged by sines, of this number at most.
SLOWER, MAX_WAVES = 0.5, 10
# A tilt moves the image by this many px a radian, where nothing is known of the lens: a phone's.
USUAL_FOCAL_PX = 2000.0
# Gain in the logarithm of the likelihood from which a kind counts as found: chance alone reaches it in one of two
# thousand. One that gains less is in the deviations.
MIN_GAIN = 6.0
# Shapes in one record at most: of each sensor one.
MAX_SHAPES = 2
# Damping ratio of a bracket or railing at most; bolted steel has 0.02 to 0.07 (Chopra, table 11.2.1).
MAX_DAMPING = 0.3
# The accelerometer's noise shows where at least this share of what its readings can have is found.
SHOWN_NOISE = 0.1
# What is less likely by this (logarithm) is excluded: one in a million.
EXCLUDED = 14.0
# The resonance (Hz) that does what an exposure (s) does, but for the frequency's fourth power: (f π T)²/6 = f²/f_r².
RESONANCE_OF_EXPOSURE = np.sqrt(6.0) / np.pi
# Where the ratio together with a kind is known to no better than this (relative), the kind is not found: motion of
# nearly one frequency fits any of them.
MAX_OPEN = 0.01
# Steps towards the most likely values, at most; one within this share of its standard deviation is the last.
STEPS, LAST_STEP = 5, 0.1
# A step of the clock offset, in intervals of the translation, at most.
MAX_LATE = 0.1
# Time constants of a first order that are tried, in that of the same weakening, and how well the best is found (share).
SHORTEST, LONGEST, TOLERANCE = 0.3, 1.5, 0.03
# ∫ exp(−u) f(u) du by the points of Gauss and Laguerre: right to 1e-3 up to ω τ = 0.7, where 18 % are left out.
NODES, WEIGHTS = np.polynomial.laguerre.laggauss(12)


@dataclass(frozen=True, slots=True)
class FrequencyResponse:
    """What was found, and what it and the rest leave open in addition to the noise.

    known: the kinds found; exposure_s: the camera's own; slope: radians a metre; lag_s3, droop_s2: q and r above;
    resonance_s2: c above; open_s: an exposure that explains the ratio no better than other causes, and is not taken
    out; open_resonance_hz: the same as a resonance, where the exposure is declared; other_m: what an exposure makes of
    the motion, by the probability that it is a resonance instead, rms, and all that the open one does; relative_std,
    offset_variance: what all kinds add to the deviation of the ratio (relative) and to the variance of the clock offset
    (s²).
    """

    known: tuple[Kind, ...] = ()
    exposure_s: float = 0.0
    slope: float = 0.0
    lag_s3: float = 0.0
    droop_s2: float = 0.0
    resonance_s2: float = 0.0
    open_s: float = 0.0
    open_resonance_hz: float = 0.0
    other_m: float = 0.0
    relative_std: float = 0.0
    offset_variance: float = 0.0

    @property
    def accelerometer_errs(self) -> bool:
        """Whether what was found stays in the acceleration: a low-pass or a resonance cannot be undone there."""
        return bool({Kind.LAG, Kind.DROOP, Kind.RESONANCE} & {*self.known})

    def texts(self, motion_hz: float) -> Iterator[Notice]:
        """A sentence for each kind that was found, or is open; motion_hz: middle frequency of the motion."""
        square = (2.0 * np.pi * motion_hz) ** 2
        falls = "camera: fast motion is attenuated, as by an exposure or rolling-shutter read-out of"
        open_text = (
            "the motion cannot distinguish these: the scale factor lies between both, and the error band includes both"
        )
        if Kind.EXPOSURE in self.known:
            yield Notice(
                "exposure",
                f"{falls} {1e3 * self.exposure_s:.2g} ms that was not declared. It is corrected; declare exposure_s "
                "or readout_s."
                + (
                    " The error band includes the alternative, an accelerometer mount that resonates near "
                    f"{RESONANCE_OF_EXPOSURE / self.exposure_s:.2g} Hz."
                    if self.other_m > 0.0
                    else ""
                ),
            )
        if self.open_s > 0.0:
            yield Notice(
                "exposure",
                f"{falls} {1e3 * self.open_s:.2g} ms that was not declared, or by an accelerometer that errs with "
                f"its motion or whose mount resonates; {open_text}. Declare exposure_s or readout_s.",
            )
        if self.open_resonance_hz > 0.0:
            yield Notice(
                "accelerometer-resonates",
                "accelerometer: it amplifies fast motion, as on a bracket that resonates near "
                f"{self.open_resonance_hz:.2g} Hz, or the camera attenuates it; {open_text}. Mount the accelerometer "
                "on the structure itself.",
            )
        if Kind.LEAN in self.known:
            yield Notice(
                "tilt",
                f"accelerometer: it tilts by {1e3 * self.slope:.2g} mrad per metre of motion, as on a leaning tower, "
                "and measures part of gravity. The scale factor is corrected.",
            )
        if Kind.DROOP in self.known:
            yield Notice(
                "logger-low-pass",
                f"accelerometer: motion of {motion_hz:.2g} Hz is attenuated by {100.0 * self.droop_s2 * square:.2g} "
                "%, as by a logger's low-pass. The scale factor is corrected; the error band is wider. Set the "
                "logger's low-pass far above the motion.",
            )
        if Kind.RESONANCE in self.known:
            yield Notice(
                "accelerometer-resonates",
                f"accelerometer: motion of {motion_hz:.2g} Hz is amplified by "
                f"{100.0 * self.resonance_s2 * square:.2g} %, as on a bracket or railing that resonates near "
                f"{1.0 / (2.0 * np.pi * np.sqrt(self.resonance_s2)):.2g} Hz. The scale factor is corrected; the "
                "error band includes the effect. Mount the accelerometer on the structure itself.",
            )
        if Kind.LAG in self.known and Kind.RESONANCE not in self.known:
            yield Notice(
                "logger-low-pass",
                f"accelerometer: its delay varies with frequency, by {-1e3 * self.lag_s3 * square:+.2g} ms from 0 to "
                f"{motion_hz:.2g} Hz, as with a logger's low-pass. The clock offset is that of slow motion; the "
                "error band is wider. Set the logger's low-pass far above the motion.",
            )


@dataclass(frozen=True, slots=True)
class Explained:
    """A pair without what of the kinds shows in it, and which of them do.

    doubt: how far (relative, rms) the ratio would be another if it were what explains nearly as much; open_s2: T²/24 of
    an exposure, or what a resonance does alike, that explains the ratio no better than a sensor of first order; it is
    not taken out. open_change: by how much it would move the ratio, relative.
    """

    pair: Pair
    known: list[Kind]
    doubt: float = 0.0
    open_s2: float = 0.0
    open_change: float = 0.0


def with_response(
    pair: Pair, fit: Fit, kinds: Sequence[Kind], known: Sequence[Kind] = (), most_open: float = MAX_OPEN
) -> Explained:
    """The pair without what of `kinds` shows in it; known: those that it is without already; most_open: how well the
    ratio is known together with a kind that is found, relative.

    The likeliest shape is taken where it gains MIN_GAIN for each of its columns, and once more where that gains as much
    on top. An exposure and a resonance must also be likelier than a first-order response by as much.
    """
    pair, fit = settled(pair, fit, known)
    explained = Explained(pair, list(known))
    for _ in range(MAX_SHAPES):
        able = _able(pair, fit, kinds, explained.known, most_open)
        if not able:
            break
        best = max(able, key=_evidence)
        falls, bare = _more_falling(pair, best.pair)
        if {*best.more} & {*FALLING} and not (
            lead_over_first_order(best.pair, bare, best.fit, falls) > MIN_GAIN and _explains_all(best)
        ):
            kinds = [kind for kind in kinds if kind not in FALLING or kind in explained.known]
            explained = replace(explained, open_s2=falls, open_change=best.fit.ratio / fit.ratio - 1.0)
            continue
        doubts = [explained.doubt, _doubt(best, able)]
        if explained.known:
            # One shape usually is the cause; what another does to the ratio may be a flaw of the first one.
            doubts.append(best.fit.ratio / fit.ratio - 1.0)
        if Kind.LEAN in best.more and Kind.SIGHT not in best.more:
            doubts.append(_lean_doubt(pair, fit, (*explained.known, *best.more)))
        pair, fit = best.pair, best.fit
        taken = [*explained.known, *best.more]
        explained = replace(explained, pair=pair, known=taken, doubt=float(np.linalg.norm(doubts)))
    return explained


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A shape: the kinds that it adds, and the pair without them with its fit."""

    more: tuple[Kind, ...]
    pair: Pair
    fit: Fit


def _evidence(one: _Candidate) -> float:
    # Each number that is fitted costs; an exposure is more usual than a resonance.
    return one.fit.likelihood - MIN_GAIN * (len(one.more) + (Kind.RESONANCE in one.more))


def _explains_all(one: _Candidate) -> bool:
    """Whether a shape leaves no more than noise: then the accelerometer's own shows.

    What a loose accelerometer errs by resembles a long exposure as well, and what is left of it hides that noise; of a
    mounting that resonates its damping is left.
    """
    return Kind.EXPOSURE not in one.more or one.pair.input_noise(
        one.fit.input_density
    ).density > SHOWN_NOISE * most_density(one.pair)


def _able(pair: Pair, fit: Fit, kinds: Sequence[Kind], found: Sequence[Kind], most_open: float) -> list[_Candidate]:
    """The shapes that explain the translation clearly better than those found already do, and may be."""
    columns = Columns(pair, fit)
    tried = {more: columns.regressed((*found, *more)) for more in _shapes(kinds, found)}
    without = columns.regressed(found).likelihood
    # What explains far more is of an impossible size: a drift, say, which a resonance only resembles.
    most = max((one.likelihood for one in tried.values()), default=-np.inf) - MIN_GAIN
    able = []
    for more, one in tried.items():
        # Errors that are no white noise gain by chance in proportion to their own scatter.
        gains = one.likelihood - without > MIN_GAIN * len(more) * one.scatter
        likely = Kind.RESONANCE not in more or one.likelihood >= most
        possible = all(TERMS[kind].possible(pair, one.of(FIRST + kind)[0]) for kind in more)
        if not (gains and likely and possible and one.of(RESPONSE)[1] < most_open):
            continue
        candidate = _Candidate(more, *settled(pair, fit, (*found, *more)))
        if _physical(candidate.pair, (*found, *more)):
            able.append(candidate)
    return able


def _shapes(kinds: Sequence[Kind], found: Sequence[Kind]) -> list[tuple[Kind, ...]]:
    """What each shape adds to the kinds found: those whose kinds may be there, and do not exclude each other."""
    shapes = []
    for shape in SHAPES:
        more = tuple(kind for kind in shape if kind not in found)
        excluded = any(kind in alike and alike & {*found} for kind in more for alike in ALIKE)
        if more and {*more} <= {*kinds} and not excluded and more not in shapes:
            shapes.append(more)
    return shapes


def _physical(pair: Pair, known: Sequence[Kind]) -> bool:
    """Whether what is taken out of a pair may be: of each kind, and the damping of a resonance."""
    square, cube = pair.logger
    damped = Kind.RESONANCE not in known or -2.0 * MAX_DAMPING * max(square, 0.0) ** 1.5 <= cube <= 0.0
    return damped and all(TERMS[kind].possible(pair, 0.0) for kind in known)


def _more_falling(pair: Pair, other: Pair) -> tuple[float, Pair]:
    """By how much (s², as T²/24) another pair has more of an exposure or a resonance, and that pair without it."""
    exposed = (other.exposure_s**2 - pair.exposure_s**2) / 24.0
    falls = exposed + max(other.logger[0], 0.0) - max(pair.logger[0], 0.0)
    logger = (min(other.logger[0], pair.logger[0]), other.logger[1])
    return falls, replace(other, exposure_s=pair.exposure_s, logger=logger)


def _doubt(best: _Candidate, others: Sequence[_Candidate]) -> float:
    """How far (relative, rms) the ratio would be another with the other shapes, each by its odds against the best."""
    odds = [np.exp(min(_evidence(other) - _evidence(best), 0.0)) for other in others]
    apart = [other.fit.ratio / best.fit.ratio - 1.0 for other in others]
    return float(np.sqrt(sum(a**2 * o / (1.0 + o) for a, o in zip(apart, odds, strict=True))))


def _lean_doubt(pair: Pair, fit: Fit, known: Sequence[Kind]) -> float:
    """How far (relative, rms) the ratio would be another with slopes of faster modes that are not the slowest one's,
    and with any tilt that is slower than the motion, as by the sun.
    """
    own_hz = dominant_frequency(seen_by(pair, fit).moved_m, pair.sample_rate_hz)
    others = (Columns(pair, fit), Columns(pair, fit, slow=True), Columns(pair, fit, waves=_waves(pair, own_hz)))
    alike, slowest, free = (one.regressed(known).coefficients[0] for one in others)
    return float(np.hypot(MODE_SLOPE * (slowest / alike - 1.0), free / alike - 1.0))


def _waves(pair: Pair, motion_hz: float) -> list[Callable[[Floats], Floats]]:
    """Sines and cosines that are slower than the motion."""
    first_s, length_s = pair.samples[0, 0], pair.samples[-1, 0] - pair.samples[0, 0]
    count = min(int(SLOWER * motion_hz * length_s), MAX_WAVES)

    def wave(k: int, function: Callable[[Floats], Floats]) -> Callable[[Floats], Floats]:
        return lambda time_s: function(2.0 * np.pi * k * (time_s - first_s) / length_s)

    return [wave(k, function) for k in range(1, count + 1) for function in (np.sin, np.cos)]


def settled(pair: Pair, fit: Fit, known: Sequence[Kind]) -> tuple[Pair, Fit]:
    """The pair without the most likely values of some kinds, and its fit, near that of the pair with them."""
    most_s = MAX_LATE / pair.rate_hz
    for _ in range(STEPS if known else 0):
        columns = Columns(pair, fit)
        found = columns.regressed(known)
        steps = [found.of(FIRST + kind) for kind in known]
        for kind, (change, _) in zip(known, steps, strict=True):
            pair = TERMS[kind].changed(pair, change, columns.seen)
        late_s = float(np.clip(found.of(VELOCITY)[0], -most_s, most_s))
        fit = best_corner(pair, fit.offset_s + late_s, found.corner)
        if all(abs(change) < LAST_STEP * std for change, std in steps):
            break
    return pair, fit


def exposure_shows(pair: Pair, fit: Fit) -> bool:
    """Whether an exposure explains the translation better than any ratio and any delay do, by MIN_GAIN."""
    columns = Columns(pair.changed(ratio=None, exposure_s=0.0), fit)
    found = columns.regressed((Kind.EXPOSURE,))
    return found.likelihood - columns.regressed(()).likelihood > MIN_GAIN * found.scatter


def lead_over_first_order(found: Pair, without: Pair, fit: Fit, square_s2: float, *, offset_cost: float = 0.0) -> float:
    """By how much a pair with an exposure is more likely (logarithm) than one with a first-order response instead.

    Each at its best ratio and clock offset. found, without: the pair with and without the exposure; fit: of the first;
    square_s2: T²/24 of the exposure; offset_cost: what a clock offset other than 0 costs, in likelihood.
    """
    found, without = (replace(one, ratio=None, reference=None) for one in (found, without))
    usual_s = float(np.sqrt(2.0 * square_s2))

    def likelihood(pair: Pair, delay_s: float) -> float:
        free = refine(pair, best_corner(pair, fit.offset_s + delay_s, fit.corner), usual_s).likelihood
        return max(free - offset_cost, best_corner(pair, 0.0, fit.corner).likelihood) if offset_cost > 0.0 else free

    def cost(share: float) -> float:
        # The acceleration that a sensor of first order would follow: its delays are exponentially distributed.
        time_constant_s, (time_s, value) = share * usual_s, without.samples[:, :2].T
        parts = (
            w * np.interp(time_s - u * time_constant_s, time_s, value) for u, w in zip(NODES, WEIGHTS, strict=True)
        )
        samples = np.column_stack((time_s, sum(parts), without.samples[:, 2:]))
        return -likelihood(replace(without, samples=samples), time_constant_s)

    return likelihood(found, 0.0) + cost(minimum(cost, SHORTEST, LONGEST, TOLERANCE))


def response_of(
    pair: Pair, fit: Fit, kinds: Sequence[Kind], known: Sequence[Kind], *, declared_s: float = 0.0, open_s2: float = 0.0
) -> FrequencyResponse:
    """What was found, and what uncertainty it and those of `kinds` that were not found add.

    Each that was not found adds its own, with the found ones; two at once whose effects cancel are not covered.
    A lag that does not show moves the clock offset alone, together with the motion. declared_s: exposure that is no
    part of what was found; open_s2: as of `Explained`.
    """
    undeclared_s2 = open_s2 if Kind.EXPOSURE in kinds else 0.0
    w = Columns(pair, fit).whitened(fit.corner)
    usual = {
        Kind.EXPOSURE: min(USUAL_EXPOSURE_S, 1.0 / pair.rate_hz) ** 2 / 24.0,
        Kind.LEAN: GRAVITY_M_S2 * USUAL_SLOPE,
        Kind.SIGHT: GRAVITY_M_S2 / USUAL_FOCAL_PX,
    }

    def variances(free: Sequence[Kind], std: float | None = None) -> Floats:
        covariance = solved(w, free_columns(free), None if std is None else std * fit.ratio)[1]
        return np.array([covariance[0, 0], covariance[1, 1]]) / fit.ratio**2

    own = variances(known)
    more = own - variances(())
    for kind in kinds:
        if kind not in known and kind in usual:
            more = more + variances((*known, kind), usual[kind]) - own
    relative, offset = np.maximum(more, 0.0)
    return FrequencyResponse(
        known=tuple(known),
        exposure_s=pair.exposure_s if Kind.EXPOSURE in known else 0.0,
        slope=pair.lean / GRAVITY_M_S2,
        lag_s3=pair.logger[1],
        droop_s2=-pair.logger[0] if Kind.DROOP in known else 0.0,
        resonance_s2=pair.logger[0] if Kind.RESONANCE in known else 0.0,
        open_s=float(np.sqrt(24.0 * undeclared_s2)),
        open_resonance_hz=0.0 if open_s2 == undeclared_s2 else float(1.0 / (2.0 * np.pi * np.sqrt(open_s2))),
        other_m=float(np.hypot(_other_m(pair, fit, known, declared_s), _exposed_m(pair, fit, undeclared_s2))),
        relative_std=float(np.sqrt(relative)),
        offset_variance=float(offset),
    )


def _other_m(pair: Pair, fit: Fit, known: Sequence[Kind], declared_s: float) -> float:
    """What an exposure beyond the declared one makes, m rms, by the probability that it is a resonance instead."""
    if Kind.EXPOSURE not in known or declared_s >= pair.exposure_s:
        return 0.0
    square = (pair.exposure_s**2 - declared_s**2) / 24.0
    resonant = with_logger(pair.changed(exposure_s=declared_s), square, 0.0)
    exposed, other = (best_corner(one, fit.offset_s, fit.corner).likelihood for one in (pair, resonant))
    if other < exposed - EXCLUDED:
        return 0.0
    odds = np.exp(min(other - exposed, EXCLUDED))
    return _exposed_m(pair, fit, square) * float(np.sqrt(odds / (1.0 + odds)))


def _exposed_m(pair: Pair, fit: Fit, square_s2: float) -> float:
    """What an exposure T makes of the displacement by its first term, m rms; square_s2: T²/24."""
    time_s = pair.rows[pair.used(fit.offset_s), 0] + fit.offset_s
    return square_s2 * float(np.std(pair.responses[0].derivative(time_s, 2)))
