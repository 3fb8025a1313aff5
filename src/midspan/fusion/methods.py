"""The table of fusion methods: a new one is a file with a function of the form `runners.Run`, and a row here.

The table costs no import: a method's module is imported when it is run.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Method:
    """One row of the table: when to use the method, and where it is.

    run: module and function that run it over a whole record, a `Run` of `runners`. literal: it is a paper's and can
    also be run exactly as printed. on_series: it takes one series of displacements; the others take each sensor's
    measurements as they come.
    """

    use: str
    run: str
    literal: bool = False
    on_series: bool = False


METHODS: dict[str, Method] = {
    "smoother": Method(
        "offline default: uses measurements before and after each sample; half the error of `kalman`",
        "midspan.fusion.streams:run_smoother",
    ),
    "kalman": Method(
        "causal: uses only what came before each sample; for real time and for control",
        "midspan.fusion.streams:run_kalman",
    ),
    "lag": Method(
        "live with a short delay (fusion.lag_s): nearly the smoother's error from half a second on",
        "midspan.fusion.streams:run_lag",
    ),
    "adaptive-kalman": Method(
        "causal, learns the displacement's noise as it goes: for light or weather that changes; "
        "with fusion.literal the adaptive multirate filter exactly as published",
        "midspan.fusion.adaptive:run_adaptive",
        literal=True,
    ),
    "fir": Method(
        "two FIR branches with a delay of seconds: to compare with Lee's method, where nothing folds",
        "midspan.fusion.fir:run_fir",
        literal=True,
        on_series=True,
    ),
    "two-stage-fir": Method(
        "the same with folded motion taken off first: to compare with the two-stage method",
        "midspan.fusion.two_stage:run_two_stage",
        literal=True,
        on_series=True,
    ),
}
DEFAULT_METHOD = "smoother"


def no_literal_form(method: str) -> str:
    """Why `literal` cannot be had with a method, and what to do."""
    literal = [name for name, row in METHODS.items() if row.literal]
    return (
        f"literal = true needs the method of a paper, one of {', '.join(literal)}; received method = "
        f"{method!r}. Leave literal out, or choose one of these"
    )
