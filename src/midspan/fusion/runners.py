"""How each fusion method is run over a whole record: one table, so that a new method is one entry."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from midspan.checks import option
from midspan.fusion.adaptive import AdaptiveSettings, adapt
from midspan.fusion.branches import LONGEST_STEPS, StreamSettings
from midspan.fusion.causal import filter_record
from midspan.fusion.complementary import run as run_branches
from midspan.fusion.fir import FirFilter, FirSettings
from midspan.fusion.kalman import KalmanSettings
from midspan.fusion.lag import LagSettings, smooth_with_lag
from midspan.fusion.smoother import Smoothed, collected, smooth
from midspan.fusion.two_stage import TwoStageFir, TwoStageSettings
from midspan.records import Acceleration, Displacement

# The filters are made for the rate of the sensor that begins; one that comes in its place is solved by least squares
# where its intervals are this much longer: what it folds, they would not know of.
LONGEST_IN_TURN = 1.5


@dataclass(frozen=True, slots=True)
class MethodSettings:
    """What any method may need: the filter's settings, and the keys of [fusion] that single methods use.

    lag_s: delay of `lag`, s. literal: a paper's method exactly as printed. forgetting: factor beta of
    `adaptive-kalman`, above 0 and below 1.
    """

    kalman: KalmanSettings = field(default_factory=KalmanSettings)
    lag_s: float = 0.5
    literal: bool = False
    forgetting: float = AdaptiveSettings().forgetting


@dataclass(frozen=True, slots=True)
class Runner:
    """How a method is run, and what follows from it.

    run: acceleration, displacement and settings → result. both_ways: it uses what comes later without limit, so that
    its own row is the best that is known of the zero. has_state: it carries a state across the interval after a sample
    that was put before the first one; to the others that interval is a gap. one_series: its filters are made for the
    displacement of one sensor at even instants; of several each has its turn. response: the method whose linear
    response to an error of the measurements is taken for its own, given the variances that it used.
    """

    run: Callable[[Acceleration, Displacement, MethodSettings], Smoothed]
    both_ways: bool
    has_state: bool
    response: str
    one_series: bool = False


def _smoother(acceleration: Acceleration, displacement: Displacement, settings: MethodSettings) -> Smoothed:
    return smooth(acceleration, displacement, settings.kalman)


def _kalman(acceleration: Acceleration, displacement: Displacement, settings: MethodSettings) -> Smoothed:
    return filter_record(acceleration, displacement, settings.kalman)


def _lag(acceleration: Acceleration, displacement: Displacement, settings: MethodSettings) -> Smoothed:
    return smooth_with_lag(acceleration, displacement, LagSettings(settings.lag_s, settings.kalman))


def _adaptive(acceleration: Acceleration, displacement: Displacement, settings: MethodSettings) -> Smoothed:
    adaptive = AdaptiveSettings(literal=settings.literal, forgetting=settings.forgetting, kalman=settings.kalman)
    return adapt(acceleration, displacement, adaptive)


def _fir(acceleration: Acceleration, displacement: Displacement, settings: MethodSettings) -> Smoothed:
    fir = FirSettings(literal=settings.literal, stream=_stream(displacement, settings))
    return collected(run_branches(FirFilter(fir), acceleration, displacement))


def _two_stage(acceleration: Acceleration, displacement: Displacement, settings: MethodSettings) -> Smoothed:
    two_stage = TwoStageSettings(literal=settings.literal, stream=_stream(displacement, settings))
    return collected(run_branches(TwoStageFir(two_stage), acceleration, displacement))


def _stream(displacement: Displacement, settings: MethodSettings) -> StreamSettings:
    """The streams' settings; a second sensor that is much slower than the first leaves gaps, not frames out."""
    several = len(np.unique(displacement.source)) > 1
    return StreamSettings(longest_steps=LONGEST_IN_TURN if several else LONGEST_STEPS, edges=settings.kalman)


RUNNERS: dict[str, Runner] = {
    "smoother": Runner(_smoother, both_ways=True, has_state=True, response="smoother"),
    "kalman": Runner(_kalman, both_ways=False, has_state=True, response="kalman"),
    "lag": Runner(_lag, both_ways=False, has_state=True, response="lag"),
    "adaptive-kalman": Runner(_adaptive, both_ways=False, has_state=True, response="kalman"),
    "fir": Runner(_fir, both_ways=True, has_state=False, response="fir", one_series=True),
    "two-stage-fir": Runner(_two_stage, both_ways=True, has_state=False, response="two-stage-fir", one_series=True),
}


def run_method(
    name: str, acceleration: Acceleration, displacement: Displacement, settings: MethodSettings | None = None
) -> Smoothed:
    """Run the method `name` of `midspan methods` over a whole record.

    acceleration: block of n samples; displacement: block of m measurements on the same clock, in time order. Returns
    one row a sample with the innovations and events. Raises UsageError for an unknown name.
    """
    return RUNNERS[option("method", name, RUNNERS)].run(acceleration, displacement, settings or MethodSettings())
