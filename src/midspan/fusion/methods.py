"""The table of fusion methods: name → when to use it."""

METHODS: dict[str, str] = {
    "smoother": "offline default: uses measurements before and after each sample; half the error of `kalman`",
    "kalman": "causal: uses only what came before each sample; for real time and for control",
}
DEFAULT_METHOD = "smoother"
