"""The radar's stage and the estimator as a closed loop, frame by frame, on simulated range profiles."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.engine.channels import OTHER_ZERO_STD_M, first_zero_std_m
from midspan.engine.radar import RadarChain
from midspan.engine.radar_target import FollowedTarget
from midspan.fusion.estimator import Estimator
from midspan.fusion.model import EstimatorSettings, Parameter, ParameterKind
from midspan.records import (
    Channel,
    Event,
    Floats,
    Measured,
    RangeFrame,
    SampleKind,
    Samples,
    Source,
    Status,
    nanoseconds,
)


@dataclass(frozen=True)
class Run:
    """Rows (s,) in s, m and m (displacement since the first frame used and its standard deviation).

    phase_rad, reference_rad2, status (frames, targets): of the chain; events: of both.
    """

    time_s: Floats
    value_m: Floats
    std_m: Floats
    phase_rad: Floats
    reference_rad2: Floats
    status: NDArray[np.uint8]
    events: tuple[Event, ...]


def estimator_for(targets: list[FollowedTarget], bias_m_s2: float, clock_std_s: float, zero_ns: int) -> Estimator:
    """One channel a target, a scale error of each, a clock offset of all; rows count from an instant."""
    channels = tuple(
        Channel(
            "radar",
            Source.RADAR,
            item.phase_per_m / item.target.conversion_factor,
            str(k + 1),
            zero_std_m=OTHER_ZERO_STD_M if k else first_zero_std_m(item),
        )
        for k, item in enumerate(targets)
    )
    scales = [Parameter(ParameterKind.SCALE_ERROR, (k,), item.target.relative_std) for k, item in enumerate(targets)]
    clock = Parameter(ParameterKind.CLOCK_OFFSET, tuple(range(len(targets))), clock_std_s)
    parameters = (*scales, clock)
    return Estimator(EstimatorSettings(channels, parameters=parameters, bias_m_s2=(bias_m_s2,), zero_ns=zero_ns))


def first_used(chain: RadarChain, frames: list[RangeFrame]) -> int:
    """Instant of the first frame that a target is used in."""
    for frame in frames:
        if any(one.status == Status.TRACKING for one in chain.push(frame)):
            return frame.time_ns
    raise AssertionError("no target is seen")


def run(
    targets: list[FollowedTarget],
    frames: tuple[Floats, NDArray[np.complex64], NDArray[np.bool_]],
    samples: Floats,
    density: float,
    *,
    give: bool = True,
    clock_std_s: float = 1e-5,
) -> Run:
    """A record through chain and estimator.

    frames: instants (n,) on the accelerometer's clock, s, profiles (n, channels, bins), valid (n, channels); samples
    (m, 2); density of the acceleration's noise; give: whether the chain gets the estimator's predictions.
    """
    chain = RadarChain(targets)
    at, profiles, valid = frames
    seen = profiles[:, :, chain.bins.astype(int)] if profiles.shape[2] != len(chain.bins) else profiles
    stamps, times = nanoseconds(at), nanoseconds(samples[:, 0])
    zero_ns = first_used(
        RadarChain(targets), [RangeFrame(int(t), *one) for t, *one in zip(stamps, seen, valid, strict=True)]
    )
    estimator = estimator_for(targets, float(np.mean(samples[:200, 1])), clock_std_s, zero_ns)
    rows, met, events, f = [], [], [], 0
    for k, time_ns in enumerate(times):
        while f < len(stamps) and stamps[f] <= time_ns:
            given = [estimator.predict(c, int(stamps[f])) if give else None for c in range(len(targets))]
            found = chain.push(RangeFrame(int(stamps[f]), seen[f], valid[f]), given)
            met.append(found)
            events += [event for one in found for event in one.events]
            estimator.push(
                Measured(
                    np.full(len(found), stamps[f]),
                    np.arange(len(found)),
                    np.array([one.phase_rad for one in found]),
                    np.array([one.variance_rad2 for one in found]),
                    np.array([one.reference_variance_rad2 for one in found]),
                )
            )
            f += 1
        one = slice(k, k + 1)
        sample = Samples(
            times[one], samples[one, 1:], np.full((1, 1), density), np.full(1, SampleKind.MEASURED, dtype=np.uint8)
        )
        for out in estimator.push(sample):
            rows += out.estimates
            events += out.events
    time_s = np.concatenate([row.time_ns for row in rows]) / 1e9
    value, variance = (np.concatenate([getattr(row, n) for row in rows]) for n in ("displacement_m", "variance_m2"))
    phase, reference = (
        np.array([[getattr(one, name) for one in found] for found in met])
        for name in ("phase_rad", "reference_variance_rad2")
    )
    status = np.array([[one.status for one in found] for found in met], dtype=np.uint8)
    assert Status.TRACKING in status
    return Run(time_s, value, np.sqrt(variance), phase, reference, status, tuple(events))
