"""What the estimator is told of its channels and parameters, and the filter's arrays made from it."""

from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from midspan.fusion.filtering import FOUND_COLUMNS, MET_COLUMNS, OPEN, RECORD, run_block
from midspan.fusion.forward import (
    CHANNEL_COLUMNS,
    CLOCK,
    COUNT,
    GAIN,
    INPUT,
    JUDGED,
    MOTION_COLUMNS,
    PARAMETER_COLUMNS,
    SCALE,
    STEP,
    TIME,
)
from midspan.fusion.hypothesis import (
    ACCEPTED_AT,
    BEGAN_AT,
    FACTOR,
    KINDS,
    LAST_AT,
    MARK_COLUMNS,
    MEMORY_COLUMNS,
    MET_AT,
    MOST,
    OUTLIER_AT,
    RECENT,
    RESTS_ON,
    SHIFT_AT,
)
from midspan.fusion.steps import CAUSES, INSTANTS, SUMS
from midspan.records import NANOSECONDS, Channel, Floats

# The state starts this long before the first sample; the same however the record is cut.
START_S = 0.01
# States of each channel's zero: as calibrated, its shift since, the reference's error.
ZERO_STATES = 3


class ParameterKind(IntEnum):
    """What a parameter is: the relative error of a scale, a clock's offset in s (measured late by so much), or the
    relative error of the accelerometer's gain (it measures too much by so much), also in scales learnt from it.
    """

    SCALE_ERROR = SCALE
    CLOCK_OFFSET = CLOCK
    GAIN_ERROR = GAIN


@dataclass(frozen=True, slots=True)
class Parameter:
    """What is unknown of a group of channels (their numbers): see `ParameterKind`.

    channels: of a gain, those whose scale was learnt from the accelerometer. std: standard deviation of what it is
    before, 0. Only the band holds it, unless it is estimated from an instant on. walk: density of its random walk,
    unit²/s: how it drifts. clear: a measurement tells it only where the square of the sensitivity is so many times the
    variance of the prediction, see `engine.channels`. axis: of a gain error whose accelerometer it is.
    """

    kind: ParameterKind
    channels: tuple[int, ...]
    std: float
    estimated_from_ns: int | None = None
    walk: float = 0.0
    clear: float = 0.0
    axis: int = 0


@dataclass(frozen=True, slots=True)
class Rates:
    """How often each is met, and what decides.

    outlier: least share of measurements that are wrong by any amount; more is learnt. stays: of those whose next one
    is wrong too, of errors of the acceleration that last from one measurement to the next, and of a sensor's targets
    that shift with one.
    shift, wrong, lost, noise, clock: a second, see `hypotheses`; once an hour each. back: of a shifted zero, a second.
    odds: logarithm by which a hypothesis falls behind the best before it is dropped: at 12 it is 160 000 times less
    likely.
    """

    outlier: float = 0.01
    stays: float = 0.6
    shift: float = 1.0 / 3600.0
    back: float = 0.1
    wrong: float = 1.0 / 3600.0
    noise: float = 1.0 / 3600.0
    lost: float = 1.0 / 3600.0
    clock: float = 1.0 / 3600.0
    odds: float = 12.0


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """The estimator's table of channels, and what is known before the first measurement.

    channels: each is named by its number here. axes: 1 or 2. parameters: see `Parameter`. bias_m_s2, bias_std_m_s2
    (one an axis): expected bias of the acceleration. bias_walk: density of its random walk, (m/s²)²/s.
    velocity_std_m_s, displacement_std_m: how fast the structure may be, and how far from the first measurement; None to
    take it from the first measurements. noise_memory: measurements over which a channel's noise is followed; fewer
    follow it faster, and it then scatters by sqrt(2/noise_memory). noise_weight: how many measurements the
    channels' variance factors rest on. motion (one an axis): standard deviation (m) of displacement and middle
    angular frequency (1/s): what a sensor measures whose clock has stepped; 0: clocks do not step. zero_ns: instant
    that rows count from; None: from the sensors' own zero. misfit (one an axis): factor on the variance of the states
    in rows, as innovations that are not white show. unseen_std_m (one an axis): standard deviation of an error that
    nothing measured tells, as of a camera's tilt: in each row, and as large and independent of it in the zero.
    unseen_zero_std_m (one an axis): the same of the zero alone, which all rows have in common. lean (one an axis):
    acceleration that leaning takes per metre of displacement, 1/s².
    """

    channels: tuple[Channel, ...]
    axes: int = 1
    parameters: tuple[Parameter, ...] = ()
    bias_m_s2: tuple[float, ...] = (0.0, 0.0)
    bias_std_m_s2: tuple[float, ...] = (0.3, 0.3)
    bias_walk: float = 1e-8
    velocity_std_m_s: tuple[float, ...] | None = None
    displacement_std_m: float | None = None
    rates: Rates = field(default_factory=Rates)
    noise_memory: float = 100.0
    noise_weight: float = 20.0
    motion: tuple[tuple[float, float], ...] = ((0.0, 0.0), (0.0, 0.0))
    zero_ns: int | None = None
    unseen_std_m: tuple[float, ...] = (0.0, 0.0)
    unseen_zero_std_m: tuple[float, ...] = (0.0, 0.0)
    misfit: tuple[float, ...] = (1.0, 1.0)
    lean: tuple[float, ...] = (0.0, 0.0)

    def unseen_variance_m2(self, axis: int) -> float:
        """What nothing measured tells of a row, m²: of its own and of its zero."""
        return 2.0 * self.unseen_std_m[axis] ** 2 + self.unseen_zero_std_m[axis] ** 2

    def unseen_common_m2(self, axis: int) -> float:
        """The part of it that all rows have in common, m²: a sensor's own zero has none of the first kind."""
        own = 0.0 if self.zero_ns is None else self.unseen_std_m[axis] ** 2
        return own + self.unseen_zero_std_m[axis] ** 2

    @property
    def first_zero(self) -> int:
        """The first state of the channels' zeros."""
        return (3 if self.zero_ns is None else 4) * self.axes

    @property
    def size(self) -> int:
        """How many states there are."""
        return self.first_zero + ZERO_STATES * len(self.channels)


Hyps = tuple[Floats, Floats, Floats, Floats, Floats, Floats, Floats]
Tables = tuple[Floats, Floats, NDArray[np.int64], int, Floats, Floats, Floats]


def tables_of(settings: EstimatorSettings, origin_ns: int = 0) -> Tables:
    """Walks (n,), channels (c, 13), kinds (c, k), the first state of the datums, and the table of the parameters
    (k, 4), misfit and lean (axes,), as `run_block` takes them; origin_ns: what times in s count from.
    """
    walks = np.zeros(settings.size)
    walks[2 : 3 * settings.axes : 3] = settings.bias_walk
    walks[settings.first_zero + 1 :: ZERO_STATES] = [channel.zero_walk_m2_s for channel in settings.channels]
    channels = np.zeros((len(settings.channels), CHANNEL_COLUMNS))
    sensors = sorted({channel.sensor for channel in settings.channels})
    for i, channel in enumerate(settings.channels):
        channels[i] = (
            channel.units_per_m,
            channel.exposure_s**2 / 24.0,
            channel.axis,
            settings.first_zero + ZERO_STATES * i,
            sensors.index(channel.sensor),
            channel.zero_std_m**2,
            channel.source,
            channel.coasting_s,
            channel.lost_s,
            *apart(settings, channel),
            channel.slow_std_m**2,
            1.0 / channel.slow_time_s,
        )
    kinds = np.zeros((len(settings.channels), len(settings.parameters)), dtype=np.int64)
    for q, parameter in enumerate(settings.parameters):
        kinds[list(parameter.channels), q] = parameter.kind
    learning = np.zeros((len(settings.parameters), PARAMETER_COLUMNS))
    for q, parameter in enumerate(settings.parameters):
        begin = parameter.estimated_from_ns
        from_s = np.inf if begin is None else (begin - origin_ns) / NANOSECONDS
        gain_of = parameter.axis if parameter.kind is ParameterKind.GAIN_ERROR else -1
        learning[q] = (from_s, parameter.walk, parameter.clear, gain_of)
    datum = -1 if settings.zero_ns is None else 3 * settings.axes
    misfit, lean = (np.array(one[: settings.axes]) for one in (settings.misfit, settings.lean))
    return walks, channels, kinds, datum, learning, misfit, lean


def apart(settings: EstimatorSettings, channel: Channel) -> tuple[float, float]:
    """Variance (m²) of what a clock's step makes of a channel's measurements, and the rate (1/s) at which it changes.

    Two instants far apart differ by twice the motion's variance. The targets of a sensor differ by the same, which is
    told of each of them as if it were its own: their mean must not be more certain than one.
    """
    std_m, rate_s = settings.motion[channel.axis]
    targets = sum((one.sensor, one.axis) == (channel.sensor, channel.axis) for one in settings.channels)
    return 2.0 * std_m**2 * targets, rate_s


def options_of(settings: EstimatorSettings) -> Floats:
    """Rates and the noise's memory as `hypotheses` takes them."""
    rates = settings.rates
    return np.array(
        [
            *(rates.outlier, rates.stays, rates.shift, rates.back, rates.wrong, rates.noise, rates.lost),
            *(rates.clock, rates.odds),
            settings.noise_memory,
        ]
    )


@dataclass(frozen=True, slots=True)
class Beginning:
    """The state before the first sample: its time (s), acceleration, displacement, and the deviations of displacement
    and velocity (axes,).
    """

    time_s: float
    acceleration: Floats
    displacement_m: Floats
    displacement_std_m: Floats
    velocity_std_m_s: Floats
    judged: int


def hypotheses_at(
    begin: Beginning, settings: EstimatorSettings, count: int = 2 * MOST + 1
) -> tuple[Hyps, Floats, Floats]:
    """At the beginning: arrays of so many hypotheses, the first one in use, motion (axes, 3) and clock (4,)."""
    n, c, k = settings.size, len(settings.channels), len(settings.parameters)
    xs, ps = np.zeros((count, n, 1 + k)), np.zeros((count, n, n))
    marks, memory = np.zeros((count, c, MARK_COLUMNS)), np.zeros((count, MEMORY_COLUMNS))
    for a in range(settings.axes):
        i = 3 * a
        xs[0, i, 0], xs[0, i + 2, 0] = begin.displacement_m[a], settings.bias_m_s2[a]
        stds = (begin.displacement_std_m[a], begin.velocity_std_m_s[a], settings.bias_std_m_s2[a])
        ps[0, range(i, i + 3), range(i, i + 3)] = np.square(stds)
    slow = settings.first_zero + 2 + ZERO_STATES * np.arange(c)
    ps[0, slow, slow] = [channel.slow_std_m**2 for channel in settings.channels]
    for q, parameter in enumerate(settings.parameters):
        if parameter.kind is ParameterKind.GAIN_ERROR:
            # The accelerometer measures too much of what its bias is known by, too.
            xs[0, 3 * parameter.axis + 2, 1 + q] = -settings.bias_m_s2[parameter.axis]
    marks[0, :, FACTOR] = [channel.variance_factor for channel in settings.channels]
    marks[0, :, RESTS_ON], marks[0, :, ACCEPTED_AT] = settings.noise_weight, -np.inf
    marks[0, :, MET_AT], marks[0, :, RECENT] = begin.time_s - START_S, 1.0
    memory[0, [SHIFT_AT, OUTLIER_AT]], memory[0, [LAST_AT, BEGAN_AT]] = -np.inf, begin.time_s
    spreads = np.zeros((count, k, k))
    spreads[0] = np.diag([p.std**2 for p in settings.parameters])
    motion, clock = np.zeros((settings.axes, MOTION_COLUMNS)), np.zeros(4)
    motion[:, INPUT] = begin.acceleration
    clock[[TIME, STEP, COUNT, JUDGED]] = (begin.time_s - START_S, np.inf, 1, begin.judged)
    groups = len({channel.sensor for channel in settings.channels}) * settings.axes
    tests = np.zeros((count, groups, INSTANTS + 1, SUMS + CAUSES * (2 + k + n)))
    return (xs, ps, marks, memory, np.zeros((count, k)), spreads, tests), motion, clock


@dataclass(frozen=True, slots=True)
class Left:
    """What a run over s samples and m measurements left, see `filtering.run_block`; uncertain (n,): above 0 for states
    that were so in any part of it.
    """

    found: Floats
    met: Floats
    survivors: NDArray[np.int16]
    errors: Floats
    nodes: Floats
    record: Floats
    uncertain: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Filter:
    """The estimator's hypotheses, motion and clock as arrays that a run changes in place."""

    hyps: Hyps
    motion: Floats
    clock: Floats

    @classmethod
    def begun(cls, begin: Beginning, settings: EstimatorSettings, most: int = 2 * MOST + 1) -> "Filter":
        """The filter before its first sample with room for so many hypotheses, see `resumed`."""
        return cls(*hypotheses_at(begin, settings, most))

    @property
    def count(self) -> int:
        """How many hypotheses there are."""
        return int(self.clock[COUNT])

    def saved(self) -> "Filter":
        """A copy of the hypotheses that are in use."""
        hyps = [array[: self.count].copy() for array in self.hyps]
        return Filter(tuple(hyps), self.motion.copy(), self.clock.copy())  # type: ignore[arg-type]

    def resumed(self, most: int = 2 * MOST + 1) -> "Filter":
        """A copy of a saved filter with room for so many hypotheses: 1 is enough for measurements that are decided."""
        hyps = []
        for array in self.hyps:
            whole = np.zeros((most, *array.shape[1:]))
            whole[: min(most, self.count)] = array[:most]
            hyps.append(whole)
        clock = self.clock.copy()
        clock[COUNT] = min(most, self.count)
        return Filter(tuple(hyps), self.motion.copy(), clock)  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class Block:
    """Samples (s, 1 + 2 axes) and the measurements (m, 5) within them, decided (m,) or open."""

    samples: Floats
    rows: Floats
    decided: NDArray[np.int64]

    @classmethod
    def open(cls, samples: Floats, rows: Floats) -> "Block":
        """Measurements of which nothing is decided."""
        return cls(samples, rows, np.full(len(rows), OPEN))

    def taken_as(self, codes: NDArray[np.int64]) -> "Block":
        """The same with what was decided."""
        return replace(self, decided=codes)


def run(
    state: Filter, block: Block, tables: Tables, options: Floats, *, back: bool = False, nodes: Floats | None = None
) -> Left:
    """Run over a block; back: also leave what the pass back needs, in `nodes` (s or more, ...) of an earlier block that
    is done with.
    """
    axes, s, m = len(state.motion), len(block.samples), len(block.rows)
    room, n, columns = state.hyps[0].shape
    most, kept = min(room, MOST), s if back else 0
    if nodes is None or len(nodes) < kept:
        nodes = np.empty((kept, axes, 2 * columns + 2 * n))
    found, met, nodes = np.empty((s, axes, FOUND_COLUMNS)), np.zeros((m, MET_COLUMNS)), nodes[:kept]
    survivors, errors = np.empty((most, m), dtype=np.int16), np.empty((most, m, 3))
    record, uncertain = np.zeros((m, RECORD + columns + n)), np.zeros(n, dtype=np.int64)
    scratch = np.zeros(n), np.zeros(columns), np.zeros(axes), np.zeros((most, KINDS))
    numbers = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    samples, moving = block.samples.copy() if tables[6].any() else block.samples, (state.motion, state.clock)
    out = (found, met, survivors, errors, nodes, record, uncertain)
    widest = run_block(samples, block.rows, block.decided, moving, state.hyps, tables, options, scratch, numbers, out)
    # Memory that no hypothesis has written to is never touched.
    of_each = np.ascontiguousarray(survivors[:widest].T), np.ascontiguousarray(errors[:widest].transpose(1, 0, 2))
    return Left(found, met, *of_each, nodes, record, uncertain)
