"""What the estimator is given of its channels and parameters; the core (`core/src/estimator`) reads each field."""

from dataclasses import dataclass, field
from enum import IntEnum

from midspan.records import Channel

# The state starts this long before the first sample (s); the same however the record is cut.
START_S = 0.01


class ParameterKind(IntEnum):
    """What a parameter is: the relative error of a scale, a clock's offset in s (measured late by so much), or the
    relative error of the accelerometer's gain (it measures too much by so much), also in scales estimated from it.
    """

    SCALE_ERROR = 1
    CLOCK_OFFSET = 2
    GAIN_ERROR = -1


@dataclass(frozen=True, slots=True)
class Parameter:
    """What is unknown of a group of channels (their numbers): see `ParameterKind`.

    channels: of a gain, those whose scale was estimated from the accelerometer. std: standard deviation of what it is
    before, 0. Only the band holds it, unless it is estimated from an instant on. walk: density of its random walk,
    unit²/s: how it drifts. clear: a measurement tells it only where the square of the sensitivity is this many times
    the variance of the prediction, see `engine.channels`. axis: of a gain error whose accelerometer it is.
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

    outlier: least share of measurements that are wrong by any amount; more is estimated. stays: of those whose next one
    is wrong too, of errors of the acceleration that last from one measurement to the next, and of a sensor's targets
    that shift with one.
    shift, wrong, lost, noise, clock: a second, see `hypotheses`; once an hour each. revert: of those shifts that may
    revert (`Channel.reverting_s`) the share that does: a solution that has to converge is met more often than a gauge
    that was pushed, and what stays shows so itself in time. back: of a shifted zero, a second.
    odds: logarithm by which a hypothesis falls behind the best before it is dropped: at 12 it is 160 000 times less
    likely.
    """

    outlier: float = 0.01
    stays: float = 0.6
    shift: float = 1.0 / 3600.0
    revert: float = 0.9
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
