"""What the figures and tables of a report draw on, prepared once."""

from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from midspan.errors import DataError
from midspan.evaluate.interpolation import step_of
from midspan.evaluate.metrics import Comparison, compare
from midspan.recording.displacement.sensor import read_with
from midspan.recording.result import Result
from midspan.recording.streams.span import EPOCH_FROM_NS, inside
from midspan.records import Displacement, Floats, Nanoseconds, Source, TimeSeries, part, seconds

# A reference whose zero is off by more than this share of its motion is drawn moved, and the caption says so.
MOVED_SHARE = 0.2


@dataclass(frozen=True, slots=True)
class Clock:
    """Seconds on the time axis count from `origin_ns`; `label` says so."""

    origin_ns: int
    label: str

    def at(self, time_ns: Nanoseconds) -> Floats:
        """Stamps (n,) as seconds on the axis."""
        return seconds(time_ns, self.origin_ns)


@dataclass(frozen=True, slots=True)
class Measured:
    """What a displacement sensor said: value_mm (n,) at time_ns (n,) on the accelerometer's clock, brought to the

    result's zero; std_mm (n,); NaN where it was lost. rate_hz: its mean rate.
    """

    name: str
    time_ns: Nanoseconds
    value_mm: Floats
    std_mm: Floats

    @property
    def rate_hz(self) -> float:
        """Its usual rate, Hz."""
        return 1.0 / step_of(self.time_ns)


@dataclass(frozen=True, slots=True)
class Material:
    """A result with its reference and what follows from both.

    reference: cut to the result's span, mm; comparison: None without one; problem: why it could not be compared.
    reference_moved_mm: what was added to the drawn reference. second: the same along the second image axis.
    """

    result: Result
    clock: Clock
    measured: tuple[Measured, ...]
    reference: TimeSeries | None = None
    comparison: Comparison | None = None
    reference_moved_mm: float = 0.0
    problem: str | None = None
    second: "Material | None" = None

    @property
    def t(self) -> Floats:
        """Times (n,) of the rows on the axis."""
        return self.clock.at(self.result.estimate.time_ns)

    @property
    def name(self) -> str:
        """The recording's name."""
        recording = self.result.recording
        return recording.name if recording is not None else self.result.settings.name or "recording"


def gather(result: Result, reference: TimeSeries | None) -> Material:
    """The material of a result and a reference (m, on the accelerometer's clock); None: without one."""
    second = None
    if result.second is not None:
        known = None if reference is None or result.recording is None else result.recording.reference_across
        second = gather(result.second, known)
    measured = tuple(_measured(result))
    material = Material(result, clock_of(int(result.estimate.time_ns[0])), measured, second=second)
    if reference is None:
        return material
    own = TimeSeries(result.estimate.time_ns, result.estimate.displacement_m)
    try:
        found = compare(own, reference, std_m=np.sqrt(result.estimate.variance_m2))
    except DataError as error:
        return replace(material, problem=str(error))
    which = inside(reference.time_ns, int(own.time_ns[0]), int(own.time_ns[-1]))
    cut = TimeSeries(reference.time_ns[which], 1e3 * reference.value[which])
    moved = found.bias_mm if abs(found.bias_mm) > MOVED_SHARE * found.reference_peak_to_peak_mm else 0.0
    return replace(material, reference=cut, comparison=found, reference_moved_mm=moved)


def clock_of(first_ns: int) -> Clock:
    """The time axis of a record that starts at `first_ns`: its own seconds, or seconds after a date."""
    if first_ns < EPOCH_FROM_NS:
        return Clock(0, "time (s)")
    start = datetime.fromtimestamp(first_ns // 1_000_000_000, UTC)
    return Clock(int(start.timestamp()) * 1_000_000_000, f"time after {start:%Y-%m-%d %H:%M:%S} UTC (s)")


def _measured(result: Result) -> list[Measured]:
    found = []
    camera = result.calibration.first_camera
    if result.belief is not None:
        found += _of_cameras(result, result.belief.measured)
    elif camera is not None and result.track is not None:
        block = camera.mapping().displacement(result.track)
        std = np.sqrt(block.variance_m2)
        name = camera.source.word
        found.append(_aligned(result, Measured(name, block.time_ns, 1e3 * block.value_m, 1e3 * std)))
    if result.radar is not None:
        block = result.radar.measured
        # Blocked frames are NaN and of infinite variance.
        std = np.where(np.isfinite(block.value_m), np.sqrt(block.variance_m2), np.nan)
        found.append(_aligned(result, Measured("radar", block.time_ns, 1e3 * block.value_m, 1e3 * std)))
    learnt = result.calibration.displacement
    # A second axis has none of its own.
    if learnt is not None and result.recording is not None and result.recording.has("displacement"):
        series = read_with(result.recording.displacement, learnt)
        std = np.full(len(series.time_ns), 1e3 * learnt.noise_std_m)
        found.append(_aligned(result, Measured("displacement sensor", series.time_ns, 1e3 * series.value, std)))
    return found


def _of_cameras(result: Result, both: Displacement) -> list[Measured]:
    """What each of two cameras said, the second on the zero of the first."""
    found = []
    for code in np.unique(both.source):
        block = part(both, both.source == code)
        std = np.where(np.isfinite(block.value_m), np.sqrt(block.variance_m2), np.nan)
        name = Source(int(code)).word
        found.append(_aligned(result, Measured(name, block.time_ns, 1e3 * block.value_m, 1e3 * std)))
    return found


def _aligned(result: Result, measured: Measured) -> Measured:
    """Measurements inside the result's span, moved by the median of their difference: the result has its own zero."""
    rows = result.estimate
    which = inside(measured.time_ns, int(rows.time_ns[0]), int(rows.time_ns[-1]))
    time_ns, value = measured.time_ns[which], measured.value_mm[which]
    fused = np.interp(
        seconds(time_ns, int(rows.time_ns[0])), seconds(rows.time_ns, int(rows.time_ns[0])), rows.displacement_m
    )
    difference = value - 1e3 * fused
    known = np.isfinite(difference)
    moved = float(np.median(difference[known])) if known.any() else 0.0
    return Measured(measured.name, time_ns, value - moved, measured.std_mm[which])
