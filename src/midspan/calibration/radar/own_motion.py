"""Which of the chosen targets move on their own, as the calibration window shows it, and what is made of it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from midspan.calibration.sensors.radar import RadarTarget
from midspan.notices import Notice, rounded
from midspan.radar.measurement import TargetSeries
from midspan.radar.own_motion import OwnMotions, Shown, own_motions
from midspan.radar.target import Target
from midspan.records import Floats
from midspan.signals.lines import Line

# Motions that are reported: from this on, m, and from this share of one frame's noise on.
REPORTED_M, REPORTED_SHARE = 1e-5, 0.3


def judged(
    targets: tuple[RadarTarget, ...],
    series: Sequence[TargetSeries],
    frame_s: Floats,
    samples: Floats,
    lines: Sequence[Line] = (),
) -> tuple[tuple[RadarTarget, ...], list[Notice]]:
    """The targets with their own motions, those left out whose motion others do without, and a sentence on each.

    series: of each target in use, on even frames at frame_s (n,) on the accelerometer's clock, s; samples (m, 2): its
    times (s) and accelerations (m/s²); lines: of these that are no motion.
    """
    used = [item.target for item in targets if item.used]
    steps = np.zeros((len(used), len(frame_s)), dtype=np.bool_)
    for row, one in zip(steps, series, strict=True):
        row[list(one.restarts)] = True
    own = own_motions(
        Shown(
            frame_s,
            np.stack([one.value_m for one in series]),
            np.stack([one.variance_m2 for one in series]),
            steps,
            np.array([target.relative_std for target in used]),
            np.array([target.bent_m for target in used]),
            tuple(lines),
        ),
        samples,
    )
    found: list[RadarTarget] = []
    for k, target in enumerate(used):
        moving = replace(target, own_m=own.std_m(k), own_hz=own.main_hz(k))
        reason = f"it moves by about {1e3 * own.std_m(k):.2g} mm on its own" if own.left_out[k] else ""
        found.append(RadarTarget(moving, not reason, reason))
    rest = [item for item in targets if not item.used]
    return (*sorted(found, key=lambda item: not item.used), *rest), list(_reported(own, used))


def _reported(own: OwnMotions, targets: Sequence[Target]) -> Iterator[Notice]:
    if own.undecided.any() and len(targets) == 2 and not own.left_out.any():
        power = np.where(own.undecided, own.power_m2[0], 0.0)
        if _matters(float(power.sum()), min(targets, key=lambda target: target.noise_m)):
            at_hz = float(own.frequency_hz[np.argmax(power)])
            yield Notice(
                "radar-target",
                f"radar: the targets {targets[0].place} and {targets[1].place} differ by about "
                f"{rounded(1e3 * np.sqrt(power.sum()))} mm (rms, at {at_hz:.2g} Hz): one of them moves on its own, "
                "and the accelerometer cannot show which. The error band includes it. Aim at fixed targets.",
            )
            return
    held = "the error band includes it (an error of the accelerometer would look the same)"
    for k, target in enumerate(targets):
        if _matters(own.std_m(k) ** 2, target):
            end = "it was left out" if own.left_out[k] else held if len(targets) == 1 else "the error band includes it"
            yield Notice(
                "radar-target",
                f"radar: the target {target.place} moves by about {rounded(1e3 * own.std_m(k))} mm on its own "
                f"(rms, at {own.main_hz(k):.2g} Hz): {end}.",
            )


def _matters(power_m2: float, target: Target) -> bool:
    return power_m2 > max(REPORTED_M, REPORTED_SHARE * target.noise_m) ** 2
