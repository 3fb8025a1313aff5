"""How each fusion method is run over a whole record of plain arrays: one table, so that a new method is one entry."""

from collections.abc import Callable
from dataclasses import dataclass, field

from midspan.checks import option
from midspan.fusion.adaptive import AdaptiveSettings, adapt
from midspan.fusion.complementary import smoothed_record
from midspan.fusion.fir import FirSettings, run_fir
from midspan.fusion.streams import KalmanSettings, Smoothed, filtered, smooth
from midspan.fusion.two_stage import TwoStageSettings, run_two_stage
from midspan.records import Acceleration, Displacement


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


Run = Callable[[Acceleration, Displacement, MethodSettings], Smoothed]


def _smoother(acceleration: Acceleration, displacement: Displacement, settings: MethodSettings) -> Smoothed:
    return smooth(acceleration, displacement, settings.kalman)


def _kalman(acceleration: Acceleration, displacement: Displacement, settings: MethodSettings) -> Smoothed:
    return filtered(acceleration, displacement, settings.kalman)


def _lag(acceleration: Acceleration, displacement: Displacement, settings: MethodSettings) -> Smoothed:
    return filtered(acceleration, displacement, settings.kalman, lag_s=settings.lag_s)


def _adaptive(acceleration: Acceleration, displacement: Displacement, settings: MethodSettings) -> Smoothed:
    adaptive = AdaptiveSettings(literal=settings.literal, forgetting=settings.forgetting, kalman=settings.kalman)
    return adapt(acceleration, displacement, adaptive)


def _fir(acceleration: Acceleration, displacement: Displacement, settings: MethodSettings) -> Smoothed:
    smoothed = smoothed_record(acceleration, displacement, settings.kalman)
    return run_fir(acceleration, displacement, FirSettings(literal=settings.literal), smoothed)


def _two_stage(acceleration: Acceleration, displacement: Displacement, settings: MethodSettings) -> Smoothed:
    smoothed = smoothed_record(acceleration, displacement, settings.kalman)
    return run_two_stage(acceleration, displacement, TwoStageSettings(literal=settings.literal), smoothed)


RUNNERS: dict[str, Run] = {
    "smoother": _smoother,
    "kalman": _kalman,
    "lag": _lag,
    "adaptive-kalman": _adaptive,
    "fir": _fir,
    "two-stage-fir": _two_stage,
}


def run_method(
    name: str, acceleration: Acceleration, displacement: Displacement, settings: MethodSettings | None = None
) -> Smoothed:
    """Run the method `name` of `midspan methods` over a whole record.

    acceleration: block of n samples; displacement: block of m measurements on the same clock, in time order. Returns
    one row a sample, from the first measurement on, with the innovations and events. Raises UsageError for an unknown
    name.
    """
    return RUNNERS[option("method", name, RUNNERS)](acceleration, displacement, settings or MethodSettings())
