"""What is said where a displacement sensor and the accelerometer do not agree: what was measured, and its cause.

A cause is named only where its model explains the readings clearly better than those of all others (`causes`).
"""

from midspan.calibration.causes import Cause, likeliest_cause, listed
from midspan.calibration.fit import Pair

REMEDIES = {
    Cause.UNIT: "Check displacement.unit, accelerometer.unit and that both sensors measure the same axis, or have it "
    "learnt: displacement.estimate_scale = true.",
    Cause.CLOCK: "Correct its time column or displacement.start_s, or set displacement.estimate_offset = true.",
    Cause.STEP: "Cut the recording where the clock steps, or correct the time column.",
    Cause.LOW_PASS: "Use a logger whose low-pass lies far above the motion.",
    Cause.SLOW_SENSOR: "Use a sensor that follows the motion, or declare what it averages over: exposure_s.",
    Cause.PLAY: "Tighten the sensor's rod, wire or joint.",
    Cause.TONE: "Use a logger with an anti-alias filter, or mount the accelerometer away from the machine.",
}


def disagreement(pair: Pair, offset_s: float, measured: str) -> str:
    """The sentence on sensors that differ: what was measured, and the cause that explains it or all that may."""
    found = likeliest_cause(pair, offset_s)
    if found is not None and found.named:
        if found.cause is Cause.UNIT:
            return f"{measured}. {REMEDIES[Cause.UNIT]}"
        return (
            f"{measured}; but of the causes compared {found.cause.value} explains the readings best, and leaves "
            f"{100 * found.left:.2g} % of the difference. {REMEDIES[found.cause]}"
        )
    return f"{measured}. None of the causes compared stands out: {listed()}. Check both sensors for these."


def lateness(pair: Pair, offset_s: float) -> str:
    """What may make readings come late or early by an offset, as a sentence; empty where it is the clock."""
    found = likeliest_cause(pair)
    if found is None or not found.named:
        others = (Cause.SLOW_SENSOR, Cause.PLAY) if offset_s > 0.0 else (Cause.LOW_PASS,)
        return f"Its readings do not tell a clock from {listed(Cause.CLOCK, Cause.UNIT, Cause.TONE, *others)}. "
    if found.cause is Cause.CLOCK:
        return ""
    return (
        f"Of the causes compared {found.cause.value} explains the readings best, not a constant offset. "
        f"{REMEDIES[found.cause]} "
    )
