"""The table of fusion methods: name → when to use it; which have a literal form.

How each is run stands in `runners.py`, so that this table costs no import.
"""

METHODS: dict[str, str] = {
    "smoother": "offline default: uses measurements before and after each sample; half the error of `kalman`",
    "kalman": "causal: uses only what came before each sample; for real time and for control",
    "lag": "live with a short delay (fusion.lag_s): nearly the smoother's error from half a second on",
    "adaptive-kalman": "causal, learns the displacement's noise as it goes: for light or weather that changes; "
    "with fusion.literal the adaptive multirate filter exactly as published",
    "fir": "two FIR branches with a delay of seconds: to compare with Lee's method, where nothing folds",
    "two-stage-fir": "the same with folded motion taken off first: to compare with the two-stage method",
}
DEFAULT_METHOD = "smoother"
# Methods of papers that can also be run exactly as printed.
LITERAL: frozenset[str] = frozenset({"adaptive-kalman", "fir", "two-stage-fir"})


def no_literal_form(method: str) -> str:
    """Why `literal` cannot be had with a method, and what to do."""
    return (
        f"literal = true needs the method of a paper, one of {', '.join(sorted(LITERAL))}; received method = "
        f"{method!r}. Leave literal out, or choose one of these"
    )
