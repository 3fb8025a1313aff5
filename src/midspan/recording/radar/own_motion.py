"""Targets of a radar that move by themselves: found, left out or put into the error band, and told."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from midspan.radar.departures import LAGS_S
from midspan.radar.own_motion import OwnMotions, near
from midspan.radar.target import Target
from midspan.recording.streams.acceleration import PreparedAcceleration
from midspan.records import Floats, seconds

# Motions that are told: from this on, and from this share of one frame's noise on.
TOLD_M, TOLD_SHARE = 1e-5, 0.3


def without_acceleration(prepared: PreparedAcceleration, origin_ns: int, frame_s: Floats) -> NDArray[np.bool_]:
    """Frames (n,), at `frame_s` after the origin, in which no acceleration was measured or the step from one is not."""
    out = np.zeros(len(frame_s), dtype=np.bool_)
    for first, last in prepared.unmeasured_ns:
        begin, end = seconds(np.array([first, last]), origin_ns)
        out[max(int(np.searchsorted(frame_s, begin)) - 1, 0) : int(np.searchsorted(frame_s, end, side="right")) + 1] = (
            True
        )
    return out


def comparable(value_m: Floats, frame_s: Floats, blind: NDArray[np.bool_]) -> Floats:
    """Values (targets, n) without those that a comparison with the accelerometer would take over a blind stretch."""
    if not blind.any():
        return value_m
    reach = int(np.ceil(LAGS_S[0] / float(np.median(np.diff(frame_s)))))
    return np.where(near(blind, reach), np.nan, value_m)


def told(own: OwnMotions, targets: Sequence[Target]) -> list[str]:
    """A sentence on each target that moves by itself."""
    if own.undecided.any() and len(targets) == 2 and not own.left_out.any():
        power = np.where(own.undecided, own.power_m2[0], 0.0)
        if _worth(float(power.sum()), min(targets, key=lambda target: target.noise_m)):
            at_hz = float(own.frequency_hz[np.argmax(power)])
            return [
                f"radar: the targets at {targets[0].range_m:.2f} and {targets[1].range_m:.2f} m differ by about "
                f"{1e3 * np.sqrt(power.sum()):.2g} mm (rms, at {at_hz:.2g} Hz): one of them moves by itself, and the "
                "accelerometer cannot tell which. The error band holds it."
            ]
    found = []
    for k, target in enumerate(targets):
        if not _worth(own.std_m(k) ** 2, target):
            continue
        end = (
            "it was left out"
            if own.left_out[k]
            else "the error band holds it, as it would an error of the accelerometer"
            if len(targets) == 1
            else "the error band holds it"
        )
        found.append(
            f"radar: the target at {target.range_m:.2f} m moves by about {1e3 * own.std_m(k):.2g} mm by itself (rms, "
            f"at {own.main_hz(k):.2g} Hz): {end}."
        )
    return found


def _worth(power_m2: float, target: Target) -> bool:
    return power_m2 > max(TOLD_M, TOLD_SHARE * target.noise_m) ** 2
