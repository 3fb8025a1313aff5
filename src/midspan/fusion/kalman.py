"""`kalman`: displacement, velocity and accelerometer bias from acceleration and asynchronous displacement, causal."""

from dataclasses import dataclass, field

import numpy as np

from midspan.fusion.events import GateEvents
from midspan.fusion.gate import NO_GATE, GateSettings
from midspan.fusion.noise_online import learning_off, nothing_learnt
from midspan.fusion.recursion import (
    ACCEPTED_AT,
    ACCEPTED_SOURCE,
    INNOVATION,
    INNOVATION_VARIANCE,
    NODE_COLUMNS,
    NOISE,
    RECORD_COLUMNS,
    TIME_OF_NODE,
    UNUSED,
    VELOCITY,
    VERDICT,
    learning_block,
)
from midspan.fusion.state_space import (
    INPUT,
    LEAD,
    P00,
    SLOPE,
    TIME,
    V,
    X,
    advance_covariance,
    advance_mean,
    initial_state,
)
from midspan.fusion.waiting import Waiting
from midspan.records import (
    Acceleration,
    Displacement,
    Estimate,
    Event,
    Floats,
    Innovation,
    Nanoseconds,
    Source,
    Status,
    joined,
    nanoseconds,
    part,
    seconds,
)

BLOCK = 32768
# The state starts this long before the first sample; the same however the record is cut.
START_S = 0.01
Output = Estimate | Innovation | Event


@dataclass(frozen=True, slots=True)
class KalmanSettings:
    """How the filter behaves besides the noise levels, which come with the measurements.

    bias_walk: density of the accelerometer bias's random walk, (m/s²)²/s; higher follows faster drift. The default lets
    the bias wander by about 0.8 mm/s² in a minute and costs below 1 % where it is constant.
    displacement_std, velocity_std, bias_std: uncertainty before the first measurement, m, m/s, m/s².
    bias: expected bias before the first measurement, m/s² (the mean of the first samples is good).
    coasting_s: age of the last accepted measurement beyond which a row is `coasting`; lost_s: beyond which it is
    `lost`.
    learn_noise: whether `kalman` and `lag` follow each source's noise where it is other than declared (not without a
    gate: outliers would teach). `smoother` looks at the whole record instead.
    """

    bias_walk: float = 1e-8
    displacement_std: float = 1.0
    velocity_std: float = 1.0
    bias_std: float = 0.3
    bias: float = 0.0
    coasting_s: float = 0.5
    lost_s: float = 10.0
    gate: GateSettings = field(default_factory=GateSettings)
    learn_noise: bool = True

    @property
    def limits(self) -> tuple[float, float]:
        """The gate's numbers as the recursion takes them."""
        return self.gate.limit, self.gate.reacquire_s

    def noise_before(self) -> Floats:
        """What is known of the sources' noise before the first measurement, as the recursion takes it."""
        return nothing_learnt() if self.learn_noise and self.gate.limit < NO_GATE.limit else learning_off()

    def state_before(self, samples: Floats) -> Floats:
        """The state vector shortly before the first of `samples` (n, 3)."""
        variance = (self.displacement_std**2, self.velocity_std**2, self.bias_std**2)
        state = initial_state(samples[0, 0] - START_S, (0.0, 0.0, self.bias), variance)
        state[INPUT] = samples[0, 1]
        return state


class KalmanFilter:
    """The causal filter as a stream: push blocks of displacement and acceleration in time order, take estimates.

    Displacement pushed before the acceleration that covers its time waits for it; any cutting of the input into blocks
    gives the same output. Each estimate uses the measurements up to its own sample.
    """

    def __init__(self, settings: KalmanSettings | None = None) -> None:
        self.settings = settings or KalmanSettings()
        self.state: Floats | None = None
        self._learnt = self.settings.noise_before()
        self._origin_ns = 0
        self._waiting = Waiting()
        self._events = GateEvents()

    def push(self, record: Acceleration | Displacement) -> list[Output]:
        """Take one block; returns for acceleration its Estimate, and Innovation and Event blocks where there are any.

        Times within a block and from block to block must increase; a displacement older than the last acceleration
        already pushed is ignored.
        """
        if isinstance(record, Displacement):
            self._waiting.push(record)
            return []
        if not len(record.time_ns):
            return []
        estimate, innovation, _ = self.run(record)
        met = [innovation] if len(innovation.time_ns) else []
        return [estimate, *met, *self._events.push(innovation)]

    def run(self, record: Acceleration) -> tuple[Estimate, Innovation, Floats]:
        """Estimate (n), innovations (m) and the noise variance (m,) in m² that each measurement was taken with."""
        if self.state is None:
            self._origin_ns = int(record.time_ns[0])
            self.state = self.settings.state_before(sample_rows(part(record, slice(2)), self._origin_ns))
        starts = range(0, len(record.time_ns), BLOCK)
        found = [self._run(part(record, slice(start, start + BLOCK)), self.state) for start in starts]
        estimates, innovations, noise = zip(*found, strict=True)
        return joined(estimates), joined(innovations), np.concatenate(noise)

    def finish(self) -> list[Output]:
        """What is left to tell at the end of the record: a run of rejections that it cut off."""
        return list(self._events.finish())

    def predict(self, time_ns: int) -> tuple[float, float]:
        """Displacement (m) and variance (m²) at `time_ns`, the last acceleration held; the state stays as it is."""
        if self.state is None:
            return 0.0, np.inf
        ahead = self.state.copy()
        dt = max(0.0, float(seconds(np.array([time_ns]), self._origin_ns)[0]) - ahead[TIME])
        ahead[V] -= ahead[LEAD] * ahead[SLOPE]
        held = ahead[INPUT]
        advance_mean(ahead, dt, (0.0, 0.0), (0.5 * held * dt * dt, held * dt))
        advance_covariance(ahead, dt, 0.0, 0.0)
        return float(ahead[X]), float(ahead[P00])

    def _run(self, block: Acceleration, state: Floats) -> tuple[Estimate, Innovation, Floats]:
        samples = sample_rows(block, self._origin_ns)
        rows = due_rows(self._waiting, int(block.time_ns[-1]), self._origin_ns)
        nodes, outcome = np.empty((len(samples), NODE_COLUMNS)), np.zeros((len(rows), RECORD_COLUMNS))
        options = (self.settings.bias_walk, self.settings.limits)
        learning_block(samples, rows, state, options, self._learnt, nodes, outcome)
        met = outcome[:, VERDICT] != UNUSED
        innovation = innovation_rows(rows[met], outcome[met], self._origin_ns)
        return estimate_rows(block.time_ns, nodes, self.settings), innovation, outcome[met, NOISE]


def sample_rows(acceleration: Acceleration, origin_ns: int) -> Floats:
    """Rows (n, 3) of time in s, acceleration and noise density as the recursion takes them."""
    time_s = seconds(acceleration.time_ns, origin_ns)
    return np.column_stack((time_s, acceleration.value_m_s2, acceleration.noise_density))


def due_rows(waiting: Waiting, until_ns: int, origin_ns: int) -> Floats:
    """Rows (m, 4) as of `measurement_rows` of the waiting measurements up to `until_ns`."""
    due = waiting.take(until_ns)
    return np.empty((0, 4)) if due is None else measurement_rows(due, origin_ns)


def measurement_rows(displacement: Displacement, origin_ns: int) -> Floats:
    """Rows (m, 4) of time in s, displacement, variance (infinite where unusable) and source code."""
    usable = np.isfinite(displacement.value_m) & np.isfinite(displacement.variance_m2)
    return np.column_stack(
        (
            seconds(displacement.time_ns, origin_ns),
            np.where(usable, displacement.value_m, 0.0),
            np.where(usable, displacement.variance_m2, np.inf),
            displacement.source.astype(np.float64),
        )
    )


def estimate_rows(time_ns: Nanoseconds, nodes: Floats, settings: KalmanSettings) -> Estimate:
    """The result of a block from its nodes: a row is `coasting` or `lost` by the age of its last measurement."""
    age_s = nodes[:, TIME_OF_NODE] - nodes[:, ACCEPTED_AT]
    status = np.where(age_s <= settings.coasting_s, np.uint8(Status.TRACKING), np.uint8(Status.COASTING))
    status = np.where(age_s <= settings.lost_s, status, np.uint8(Status.LOST))
    source = np.where(status == Status.TRACKING, nodes[:, ACCEPTED_SOURCE], Source.PREDICTION)
    return Estimate(
        time_ns=time_ns,
        displacement_m=nodes[:, X].copy(),
        variance_m2=nodes[:, P00].copy(),
        velocity_m_s=nodes[:, VELOCITY].copy(),
        source=source.astype(np.uint8),
        status=status,
    )


def innovation_rows(rows: Floats, outcome: Floats, origin_ns: int) -> Innovation:
    """Innovations of the measurements `rows` (m, 4) that were met with `outcome` (m, 9)."""
    return Innovation(
        time_ns=nanoseconds(rows[:, 0], origin_ns),
        value_m=outcome[:, INNOVATION].copy(),
        variance_m2=outcome[:, INNOVATION_VARIANCE].copy(),
        verdict=outcome[:, VERDICT].astype(np.int8),
    )
