"""The estimator for plain arrays: one channel for each source of displacement, in metres, whose zero is known.

For displacement that comes ready made; everything else about the estimator is in `estimator`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from midspan.checks import option, positive, refuse
from midspan.fusion.blocks import Rows
from midspan.fusion.entry import require_record, sound_acceleration, sound_displacement
from midspan.fusion.estimator import Estimator, Lag, State, Stream
from midspan.fusion.methods import MAX_TAPS, MIN_HALF_WINDOW, MIN_TAPS, SPLINE_FRAMES
from midspan.fusion.model import EstimatorSettings, Rates
from midspan.records import (
    NANOSECONDS,
    Acceleration,
    Channel,
    Displacement,
    Estimate,
    Event,
    Innovation,
    Measured,
    SampleKind,
    Samples,
    Source,
    joined,
    part,
)

if TYPE_CHECKING:
    from midspan.fusion.on_series import OnSeries

Output = Estimate | Innovation | Event
# Every measurement is as good as its variance says: none is rejected.
NO_ERRORS = Rates(outlier=0.0, stays=0.0, shift=0.0, back=0.0, wrong=0.0, noise=0.0, lost=0.0, clock=0.0)
# Measurements that a channel's noise rests on where it is not to be followed: one more then is lost in rounding.
AS_DECLARED = 1e30
# A measurement this many times as uncertain as what is known without it adds a millionth.
VAGUE = 1e3


@dataclass(frozen=True, slots=True)
class KalmanSettings:
    """How the filter behaves besides the noise levels, which come with the measurements.

    bias_walk: density of the accelerometer bias's random walk, (m/s²)²/s; higher follows faster drift. The default lets
    the bias drift by about 0.8 mm/s² in a minute and costs below 1 % where it is constant.
    displacement_std, velocity_std, bias_std: uncertainty before the first measurement, m, m/s, m/s².
    bias: expected bias before the first measurement, m/s² (the mean of the first samples is good).
    coasting_s: age of the last accepted measurement beyond which a row is `coasting`; lost_s: beyond which it is
    `lost`. rates: how often measurements are wrong in which way. noise_memory: measurements over which each source's
    noise is followed where it is other than declared; infinite: it is taken as declared. lean: acceleration that
    leaning takes per metre of displacement, 1/s².
    """

    bias_walk: float = 1e-8
    displacement_std: float = 1.0
    velocity_std: float = 1.0
    bias_std: float = 0.3
    bias: float = 0.0
    coasting_s: float = 0.5
    lost_s: float = 10.0
    rates: Rates = field(default_factory=Rates)
    noise_memory: float = 100.0
    lean: float = 0.0

    def estimator(self, sources: Sequence[int]) -> EstimatorSettings:
        """The estimator's settings for measurements of these sources: their channels in this order.

        The channel of the prediction stands for what is known before anything is measured; no row rests on it.
        """
        ages = {Source.PREDICTION: (-1.0, -1.0)}
        own = ((code, ages.get(code, (self.coasting_s, self.lost_s))) for code in map(Source, sources))
        settings = EstimatorSettings(
            tuple(Channel(code.word, code, 1.0, coasting_s=age[0], lost_s=age[1]) for code, age in own),
            bias_m_s2=(self.bias,),
            bias_std_m_s2=(self.bias_std,),
            bias_walk=self.bias_walk,
            velocity_std_m_s=(self.velocity_std,),
            displacement_std_m=self.displacement_std,
            rates=self.rates,
            noise_memory=self.noise_memory,
            lean=(self.lean,),
        )
        return replace(settings, noise_weight=AS_DECLARED) if np.isinf(self.noise_memory) else settings


@dataclass(frozen=True, slots=True)
class MethodSettings:
    """What any method may need: the filter's settings, and the keys of [fusion] that single methods use.

    lag_s: delay of `lag`, s. literal: a paper's method exactly as printed. forgetting: factor beta of
    `adaptive-kalman`, above 0 and below 1; nearer to 1 is steadier and slower: at 10 Hz 0.95 remembers 2 s.
    What the papers leave open, see `papers/printed`: input_rule (held or mean), first_frames, input_noise_m_s2,
    start_noise_m, start_velocity_m_s of `adaptive-kalman` (`PrintedFilter`); half_window, cut_off_hz, accuracy of `fir`
    (half the window in samples; the frequency, Hz, from which on the acceleration gives this share of the amplitude);
    transition_hz (up to the first the displacement alone counts, from the second on the acceleration), taps,
    anti_alias_taps (lengths, odd; None: by a ripple of 0.001) of `two-stage-fir`; of both spline_frames, displacements
    after an interval that the spline looks at.
    """

    kalman: KalmanSettings = field(default_factory=KalmanSettings)
    lag_s: float = 0.5
    literal: bool = False
    forgetting: float = 0.95
    input_rule: str = "held"
    first_frames: int = 10
    input_noise_m_s2: float | None = None
    start_noise_m: float | None = None
    start_velocity_m_s: float | None = None
    half_window: int | None = None
    cut_off_hz: float | None = None
    accuracy: float = 0.97
    transition_hz: tuple[float, float] = (0.5, 1.0)
    taps: int | None = None
    anti_alias_taps: int | None = None
    spline_frames: int = SPLINE_FRAMES

    def __post_init__(self) -> None:
        if not 0.0 < self.forgetting < 1.0:
            raise refuse("forgetting", "above 0 and below 1", self.forgetting)
        option("input_rule", self.input_rule, ("held", "mean"))
        if self.first_frames < 1:
            raise refuse("first_frames", "1 or more", self.first_frames)
        if self.cut_off_hz is not None:
            positive("cut_off_hz", self.cut_off_hz, "Hz")
        if not 0.0 < self.accuracy < 1.0:
            raise refuse("accuracy", "between 0 and 1 (share of the amplitude)", self.accuracy)
        if self.half_window is not None and self.half_window < MIN_HALF_WINDOW:
            raise refuse("half_window", f"at least {MIN_HALF_WINDOW} samples", self.half_window)
        for name, value in (("taps", self.taps), ("anti_alias_taps", self.anti_alias_taps)):
            if value is not None and not (value % 2 and MIN_TAPS <= value <= MAX_TAPS):
                raise refuse(name, f"an odd number from {MIN_TAPS} to {MAX_TAPS}", value)
        if not 0 <= self.spline_frames <= SPLINE_FRAMES:
            raise refuse("spline_frames", f"from 0 to {SPLINE_FRAMES} displacements", self.spline_frames)

    @property
    def noise_memory(self) -> float:
        """Measurements over which a method follows their noise."""
        return 1.0 / (1.0 - self.forgetting)


@dataclass(frozen=True, slots=True)
class Smoothed:
    """What a method returns for a whole record: the estimate, the innovations of its forward pass, and events.

    innovation: of each measurement that was met, in time order. delay_s: by how much a row needs what comes later, of
    a method that needs no more than that.
    """

    estimate: Estimate
    innovation: Innovation
    events: tuple[Event, ...]
    delay_s: float = np.inf


class KalmanFilter:
    """The causal filter as a stream: push blocks of displacement and acceleration in time order, take estimates.

    Displacement pushed before the acceleration that covers its time waits for it; any cutting of the input into blocks
    gives the same rows. They begin with the first measurement, and are held back until the first few have come: the
    first is judged by those after it. lag_samples: each row comes this many samples, or up to a quarter more, later,
    smoothed by what was measured until then.
    """

    def __init__(self, settings: KalmanSettings | None = None, *, lag_samples: int = 0) -> None:
        if lag_samples < 0:
            raise refuse("lag_samples", "0 or more", lag_samples)
        self.settings = settings or KalmanSettings()
        known = self.settings.estimator(tuple(Source))
        self._estimator: Stream = Lag(known, lag_samples) if lag_samples else Estimator(known)

    def push(self, record: Acceleration | Displacement) -> list[Output]:
        """Take one block; returns for acceleration an Estimate, an Innovation and Events, each where there are any.

        Raises UsageError for values that cannot be (an acceleration that is not finite, stamps out of order).
        Times of the acceleration increase from block to block; a displacement that is not later than the last
        acceleration already pushed is left out, with an Event.
        """
        if isinstance(record, Displacement):
            self._estimator.push(measured(sound_displacement(record), tuple(Source)))
            return []
        return self._single(self._estimator.push(samples(sound_acceleration(record))))

    def finish(self) -> list[Output]:
        """What is left at the end of the record."""
        return self._single(self._estimator.finish())

    def _single(self, rows: Sequence[Rows]) -> list[Output]:
        estimate, innovation, events = gathered(rows)
        return [*(one for one in (estimate, innovation) if one is not None), *events]

    def predict(self, time_ns: int) -> tuple[float, float]:
        """Displacement (m) and variance (m²) at a time after the last sample, whose acceleration is held."""
        return self._estimator.predict(Source.PREDICTION, time_ns)

    @property
    def state(self) -> State:
        """All that the filter remembers."""
        return self._estimator.state

    def restore(self, state: State) -> None:
        """Go on from the state of a filter with the same settings."""
        self._estimator.restore(state)


def smooth(acceleration: Acceleration, displacement: Displacement, settings: KalmanSettings | None = None) -> Smoothed:
    """Smooth a whole record.

    acceleration: block of n samples; displacement: block of m measurements on the same clock, in time order. The
    estimate has one row a sample; its standard deviation is that of the smoother.
    """
    require_record(acceleration, displacement)
    settings, count = settings or KalmanSettings(), len(displacement.time_ns) + 1
    estimator = Estimator(settings.estimator(sources_of(displacement)), log=True, rows=False, max_waiting=count)
    _, innovation, events = gathered(whole(estimator, acceleration, displacement, settings))
    return Smoothed(estimator.smoothed()[0], innovation or no_innovation(), tuple(events))


def filtered(
    acceleration: Acceleration,
    displacement: Displacement,
    settings: KalmanSettings | None = None,
    *,
    lag_s: float = 0.0,
) -> Smoothed:
    """Filter a whole record, as `smooth`; each row rests on what came before it, and on what came `lag_s` after it."""
    require_record(acceleration, displacement)
    settings, count = settings or KalmanSettings(), len(displacement.time_ns) + 1
    known = settings.estimator(sources_of(displacement))
    step_s = float(np.median(np.diff(acceleration.time_ns))) / NANOSECONDS if lag_s else np.inf
    lag_samples = round(lag_s / step_s)
    estimator = Lag(known, lag_samples, max_waiting=count) if lag_samples else Estimator(known, max_waiting=count)
    return pushed(estimator, acceleration, displacement, settings, delay_s=lag_s)


def pushed(
    estimator: "Stream | OnSeries",
    acceleration: Acceleration,
    displacement: Displacement,
    settings: KalmanSettings,
    *,
    delay_s: float,
) -> Smoothed:
    """What a stream with one channel for each of `sources_of` gives for a whole record, in one piece."""
    estimate, innovation, events = gathered(whole(estimator, acceleration, displacement, settings))
    assert estimate is not None
    return Smoothed(estimate, innovation or no_innovation(), tuple(events), delay_s)


def whole(
    estimator: "Stream | OnSeries", acceleration: Acceleration, displacement: Displacement, settings: KalmanSettings
) -> list[Rows]:
    """All that a stream with one channel for each of `sources_of` gives for a whole record, in one piece.

    It lets all measurements, and one that is put before them, wait for their samples.
    """
    displacement = with_prior(displacement, acceleration, settings)
    estimator.push(measured(displacement, sources_of(displacement)))
    return [*estimator.push(samples(acceleration)), *estimator.finish()]


def with_prior(displacement: Displacement, acceleration: Acceleration, settings: KalmanSettings) -> Displacement:
    """In time order, and where it begins after the first sample with a measurement there that tells nothing."""
    displacement = part(displacement, np.argsort(displacement.time_ns, kind="stable"))
    usable = np.isfinite(displacement.value_m) & np.isfinite(displacement.variance_m2)
    first = int(np.argmax(usable)) if usable.any() else 0
    if usable.any() and displacement.time_ns[first] <= acceleration.time_ns[0]:
        return displacement
    known = Displacement(
        acceleration.time_ns[:1],
        displacement.value_m[first : first + 1] if usable.any() else np.zeros(1),
        np.array([(VAGUE * settings.displacement_std) ** 2]),
        np.array([Source.PREDICTION], dtype=np.uint8),
    )
    return joined([known, part(displacement, displacement.time_ns > acceleration.time_ns[0])])


def no_innovation() -> Innovation:
    """Of no measurement."""
    return Innovation(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0), np.empty(0, dtype=np.int8))


def gathered(rows: Sequence[Rows]) -> tuple[Estimate | None, Innovation | None, list[Event]]:
    """Rows, innovations in the order of time, and events; None where there are none."""
    estimates = [one.estimates[0] for one in rows if one.estimates and len(one.estimates[0].time_ns)]
    # The first channel's are not of anything measured.
    innovations = [block for one in rows for block in one.innovations[1:] if len(block.time_ns)]
    met = joined(innovations) if innovations else None
    return (
        joined(estimates) if estimates else None,
        None if met is None else part(met, np.argsort(met.time_ns, kind="stable")),
        [event for one in rows for event in one.events],
    )


def sources_of(displacement: Displacement) -> tuple[int, ...]:
    """The prediction and the sources that occur, in the order of their codes."""
    occurs = np.bincount(displacement.source, minlength=1) > 0
    occurs[Source.PREDICTION] = True
    return tuple(np.flatnonzero(occurs).tolist())


def measured(displacement: Displacement, sources: Sequence[int]) -> Measured:
    """Displacement as measurements of the channels of these sources, in the order of their codes."""
    channel = np.searchsorted(np.asarray(sources), displacement.source).astype(np.int64)
    nothing = np.zeros(len(channel))
    return Measured(displacement.time_ns, channel, displacement.value_m, displacement.variance_m2, nothing)


def samples(acceleration: Acceleration) -> Samples:
    """Acceleration as the samples of one axis, all of them measured."""
    return Samples(
        acceleration.time_ns,
        acceleration.value_m_s2[:, None],
        acceleration.noise_density[:, None],
        np.full(len(acceleration.time_ns), SampleKind.MEASURED, dtype=np.uint8),
    )
