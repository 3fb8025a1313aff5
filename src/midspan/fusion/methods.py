"""The table of fusion methods: a new one is a file with a function of the form `runners.OnSeries`, and a row here.

The table costs no import: a method's module is imported when it is run. The papers' methods stand in `papers`, above
this room, and are known here by name alone.
"""

from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from typing import Any

from midspan.errors import UsageError

# What the FIR methods take: lengths of their equiripple filters, below which nothing is left to shape and beyond which
# the exchange algorithm fails to converge, half the least-squares window of as many, and knots on each side of an
# interval. A cubic spline forgets what is k knots away by 0.268 to the power k: 0.5 %.
MIN_TAPS, MAX_TAPS, MIN_HALF_WINDOW, SPLINE_FRAMES = 9, 1500, 8, 4


class Pass(Enum):
    """Which rows of the estimator a method gives: as they come, after fusion.lag_s, smoothed by the whole record."""

    CAUSAL = "causal"
    LAGGED = "lagged"
    SMOOTHED = "smoothed"


@dataclass(frozen=True, slots=True)
class Method:
    """One row of the table: the method's name in words, when to use it, and what makes its rows.

    rows: those of the estimator, which takes each sensor's measurements as they come. on_series: module and function
    that make a method of one series of displacements, a `MakeMethod` of `on_series`, whose rows replace these.
    literal: it is a paper's. guarded: its own rows come with fusion.literal only, without it they are the estimator's.
    follows_noise: the estimator follows the measurements' noise as fusion.forgetting says. predicts: as printed its own
    predictions move the trackers' regions.
    """

    use: str
    rows: Pass
    on_series: str = ""
    literal: bool = False
    guarded: bool = False
    follows_noise: bool = False
    predicts: bool = False
    title: str = ""

    def __post_init__(self) -> None:
        if self.literal and not self.on_series:
            raise UsageError("A method that can be run as printed must have on_series; received none. Name it.")

    def takes_series(self, *, literal: bool) -> bool:
        """Whether its rows are made from one series, run as printed or not."""
        return bool(self.on_series) and (literal or not self.guarded)


METHODS: dict[str, Method] = {
    "smoother": Method(
        "default for files: uses measurements before and after each sample; half the error of `kalman`",
        Pass.SMOOTHED,
        title="Kalman smoother over the whole record",
    ),
    "kalman": Method(
        "causal: uses only earlier measurements; for real time and control",
        Pass.CAUSAL,
        title="causal Kalman filter",
    ),
    "lag": Method(
        "live with a short delay (fusion.lag_s): nearly the smoother's error from 0.5 s on",
        Pass.LAGGED,
        title="Kalman smoother with a fixed lag",
    ),
    "adaptive-kalman": Method(
        "causal, adapts the displacement's noise: for changing light or weather; with fusion.literal the adaptive "
        "multi-rate Kalman filter (AMKF paper) as published",
        Pass.CAUSAL,
        "midspan.papers.printed.adaptive:AdaptiveRows",
        literal=True,
        guarded=True,
        follows_noise=True,
        predicts=True,
        title="adaptive multirate Kalman filter",
    ),
    "fir": Method(
        "two FIR branches with a delay of seconds (Lee and others 2010; radar paper), as published, for comparison; "
        "all motion must lie below the Nyquist frequency of the displacement",
        Pass.LAGGED,
        on_series="midspan.papers.printed.fir:fir",
        literal=True,
        title="regularised FIR filters of Lee",
    ),
    "two-stage-fir": Method(
        "`fir` after subtracting aliased motion (two-stage paper), as published, for comparison",
        Pass.LAGGED,
        on_series="midspan.papers.printed.two_stage:two_stage_fir",
        literal=True,
        title="two-stage FIR filters with aliased motion removed first",
    ),
}
DEFAULT_METHOD = "smoother"


def named(place: str) -> Any:
    """What stands at "module:name" in a room above, imported now."""
    module, name = place.split(":")
    return getattr(import_module(module), name)


def no_literal_form(method: str) -> str:
    """Why `literal` cannot be had with a method, and what to do."""
    literal = [name for name, row in METHODS.items() if row.literal]
    return (
        f"literal = true needs the method of a paper, one of {', '.join(literal)}; received method = "
        f"{method!r}. Leave literal out, or choose one of these"
    )
