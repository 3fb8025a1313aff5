"""`adaptive-kalman`: the noise of the displacement is learnt from measurement to measurement.

The literal form is the adaptive multirate filter of Ma, Choi and Sohn, Computer-Aided Civil and Infrastructure
Engineering 37 (2022) 688-703, doi 10.1111/mice.12767, equations 7 to 26: displacement and velocity, the acceleration
held over each sample, and the noise variance by equation 20, which can become negative and runs away under a bias
(docs/methods.md). The guarded form, the default, is the filter of `kalman` (Numerov input, bias, gate) with the
variance learnt in the residual form of Mohamed and Schwarz (1999, doi 10.1007/s001900050236) within limits that
successive differences of the innovations set.
"""

from dataclasses import dataclass, field

import numpy as np

from midspan.checks import refuse
from midspan.fusion.adaptive_printed import printed_block
from midspan.fusion.adaptive_recursion import (
    ADAPTIVE_SIZE,
    BEYOND,
    LAST,
    MEDIAN_STEP,
    MET_COLUMNS,
    MET_INNOVATION,
    MET_NOISE,
    MET_TOTAL,
    MET_VERDICT,
    NOISE,
    SPREAD,
    SQUARED,
    UNUSED,
    guarded_block,
)
from midspan.fusion.events import GateEvents, gate_events
from midspan.fusion.gate import NORMAL_MEDIAN
from midspan.fusion.kalman import KalmanSettings, Output, due_rows
from midspan.fusion.smoother import Smoothed, empty_estimate
from midspan.fusion.state_space import P11, TIME, B
from midspan.fusion.waiting import Waiting
from midspan.records import (
    Acceleration,
    Displacement,
    Estimate,
    Floats,
    Innovation,
    joined,
    nanoseconds,
    part,
)

BLOCK = 131072
# The frames' noise is first taken for half of this many times the declared one; it falls by a tenth a frame.
FIRST_STEP = 8.0


@dataclass(frozen=True, slots=True)
class AdaptiveSettings:
    """How the noise is learnt; the rest is the Kalman filter's.

    literal: equations 7 to 26 exactly as printed, without bias, gate and limits; only the expected bias is taken off
    the acceleration. The paper leaves the start open: here it is at zero, with the first declared variance for the
    position and as R, kept through ten frames, and velocity_std for the velocity. forgetting: the factor beta of
    equation 20, above 0 and below 1; nearer to 1 is steadier and slower: at 10 Hz 0.95 remembers 2 s. floor, ceiling:
    least and largest noise deviation over the declared one; not used by the literal form.
    """

    literal: bool = False
    forgetting: float = 0.95
    floor: float = 0.1
    ceiling: float = 30.0
    kalman: KalmanSettings = field(default_factory=KalmanSettings)

    def __post_init__(self) -> None:
        if not 0.0 < self.forgetting < 1.0:
            raise refuse("forgetting", "above 0 and below 1", self.forgetting)
        if not 0.0 < self.floor <= 1.0 <= self.ceiling < np.inf:
            raise refuse("floor and ceiling", "such that 0 < floor <= 1 <= ceiling", (self.floor, self.ceiling))

    @property
    def options(self) -> tuple[float, tuple[float, float], tuple[float, float, float]]:
        """What the guarded recursion takes: the bias's walk, the gate's numbers, and how the noise is learnt."""
        return self.kalman.bias_walk, self.kalman.limits, (self.forgetting, self.floor**2, self.ceiling**2)


class AdaptiveFilter:
    """The adaptive filter as a stream: push blocks of displacement and acceleration in time order, take estimates.

    As with `KalmanFilter`, displacement waits for the acceleration that covers its time, and any cutting of the input
    gives the same output.
    """

    def __init__(self, settings: AdaptiveSettings | None = None) -> None:
        self.settings = settings or AdaptiveSettings()
        self.state: Floats | None = None
        self._origin_ns = 0
        self._declared = np.nan
        self._waiting = Waiting()
        self._events = GateEvents()

    @property
    def noise_std_m(self) -> float:
        """The learnt standard deviation of a displacement, m; NaN before the first, or where eq. 20 went negative."""
        if self.state is None:
            return np.nan
        variance = float(self.state[NOISE]) * (1.0 if self.settings.literal else self._declared)
        return float(np.sqrt(variance)) if variance >= 0.0 else np.nan

    def push(self, record: Acceleration | Displacement) -> list[Output]:
        """Take one block; returns for acceleration its Estimate, and Innovation and Event records where there are any.

        Times within a block and from block to block must increase; a displacement older than the last acceleration
        already pushed, and in the literal form one before the first, is ignored.
        """
        if isinstance(record, Displacement):
            self._waiting.push(record)
            return []
        if not len(record.time_ns):
            return []
        estimate, innovation, _ = self.run(record)
        met = [innovation] if len(innovation.time_ns) else []
        return [estimate, *met, *self._events.push(innovation)]

    def finish(self) -> list[Output]:
        """What is left to tell at the end of the record: a run of rejections that it cut off."""
        return list(self._events.finish())

    def run(self, record: Acceleration) -> tuple[Estimate, Innovation, Floats]:
        """Estimate (n), innovations (m) and the noise variance (m,) in m² that each measurement was taken with."""
        if self.state is None:
            self._origin_ns = int(record.time_ns[0])
            self.state = state_before(record, self.settings)
        estimate = empty_estimate(record.time_ns)
        told, noise = [], []
        for start in range(0, len(record.time_ns), BLOCK):
            rows = slice(start, start + BLOCK)
            frames = due_rows(self._waiting, int(record.time_ns[rows][-1]), self._origin_ns)
            met = np.zeros((len(frames), MET_COLUMNS))
            self._recursion(part(record, rows), frames, self.state, part(estimate, rows), met)
            used = met[:, MET_VERDICT] != UNUSED
            if not np.all(used):
                frames, met = frames[used], met[used]
            told.append(_innovation(frames, met, self._origin_ns))
            noise.append(met[:, MET_NOISE])
            self._declared = float(frames[-1, 2]) if len(frames) else self._declared
        return estimate, joined(told), np.concatenate(noise)

    def _recursion(self, block: Acceleration, frames: Floats, state: Floats, into: Estimate, met: Floats) -> None:
        settings = self.settings
        samples = (block.time_ns, self._origin_ns, block.value_m_s2, block.noise_density)
        rows = (into.displacement_m, into.variance_m2, into.velocity_m_s)
        labels = (into.source, into.status, settings.kalman.coasting_s, settings.kalman.lost_s)
        if settings.literal:
            printed_block(samples, frames, state, settings.forgetting, rows, labels, met)
            return
        guarded_block(samples, frames, state, settings.options, rows, labels, met)


def adapt(acceleration: Acceleration, displacement: Displacement, settings: AdaptiveSettings | None = None) -> Smoothed:
    """Run the adaptive filter over a whole record.

    acceleration: block of n samples; displacement: block of m measurements on the same clock, in time order. The
    estimate has one row a sample and uses what came before it; `variance_m2` tells the noise each measurement was
    taken with.
    """
    stream = AdaptiveFilter(settings)
    stream.push(displacement)
    estimate, innovation, noise = stream.run(acceleration)
    return Smoothed(estimate, innovation, tuple(gate_events(innovation)), noise)


def state_before(first: Acceleration, settings: AdaptiveSettings) -> Floats:
    """The state vector before the first sample; the literal form starts at the first sample."""
    samples = np.array([[0.0, first.value_m_s2[0], first.noise_density[0]]])
    state = np.zeros(ADAPTIVE_SIZE)
    before = settings.kalman.state_before(samples)
    state[: len(before)] = before
    state[[NOISE, SQUARED, SPREAD, LAST]] = 1.0, 1.0, 1.0, np.nan
    # Wide: the first frames with the noise taken too large costs less than a gate that shuts the truth out.
    state[MEDIAN_STEP] = FIRST_STEP * NORMAL_MEDIAN * np.sqrt(2.0)
    if settings.literal:
        # The printed equations know no bias: what is known of it is taken off the acceleration, gravity above all.
        state[: TIME + 1] = 0.0
        state[B], state[NOISE] = settings.kalman.bias, np.nan
        state[P11] = settings.kalman.velocity_std**2
        # Until the first frame nothing is known of the position that the printed start puts to zero.
        state[BEYOND] = settings.kalman.displacement_std**2
    return state


def _innovation(frames: Floats, met: Floats, origin_ns: int) -> Innovation:
    return Innovation(
        time_ns=nanoseconds(frames[:, 0], origin_ns),
        value_m=met[:, MET_INNOVATION].copy(),
        variance_m2=met[:, MET_TOTAL].copy(),
        verdict=met[:, MET_VERDICT].astype(np.int8),
    )
