"""What the figures and tables of a report draw on, prepared once."""

from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from midspan.calibration.camera.view import camera_pair, scale_of
from midspan.calibration.scale import ScaleCalibration
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.engine.sensor_series import CameraResult, SensorSeries
from midspan.errors import DataError, MidspanError
from midspan.evaluate.metrics import Band, Comparison, compare, step_of
from midspan.recording.cameras import view_of
from midspan.recording.result import Result
from midspan.records import NANOSECONDS, Floats, Nanoseconds, TimeSeries, seconds
from midspan.settings.camera import CameraSettings
from midspan.signals.stamps import EPOCH_FROM_NS, inside

# Standard deviations on each side of a band that holds 95 % of the truth.
BAND = 1.96
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
    acceleration: of the accelerometer within that span, m/s²; None where its file is not at hand.
    """

    result: Result
    clock: Clock
    measured: tuple[Measured, ...]
    reference: TimeSeries | None = None
    comparison: Comparison | None = None
    reference_moved_mm: float = 0.0
    problem: str | None = None
    second: "Material | None" = None
    acceleration: TimeSeries | None = None

    @property
    def t(self) -> Floats:
        """Times (n,) of the rows on the axis."""
        return self.clock.at(self.result.estimate.time_ns)

    def section_of(self, camera: CameraResult) -> CameraSettings:
        """The section of a camera in the settings."""
        listed = [(one.name, one.settings) for one in self.result.settings.sensors]
        return next(own for name, own in listed if name == camera.sensor and isinstance(own, CameraSettings))

    @property
    def name(self) -> str:
        """The recording's name."""
        return self.result.name or self.result.settings.name or "recording"


def gather(result: Result, reference: TimeSeries | None, across: TimeSeries | None = None) -> Material:
    """The material of a result and its references along the main and the second axis (m); None: without one."""
    second = None if result.across is None else gather(result.across, across)
    measured = tuple(_aligned(result, series) for series in result.measured)
    clock, felt = clock_of(int(result.estimate.time_ns[0])), _acceleration(result)
    material = Material(result, clock, measured, second=second, acceleration=felt)
    if reference is None:
        return material
    own = TimeSeries(result.estimate.time_ns, result.estimate.displacement_m)
    try:
        band = Band(np.sqrt(result.estimate.variance_m2), result.zero_std_m)
        found = compare(own, reference, band=band)
    except DataError as error:
        return replace(material, problem=str(error))
    which = inside(reference.time_ns, int(own.time_ns[0]), int(own.time_ns[-1]))
    cut = TimeSeries(reference.time_ns[which], 1e3 * reference.value[which])
    moved = found.bias_mm if abs(found.bias_mm) > MOVED_SHARE * found.reference_peak_to_peak_mm else 0.0
    return replace(material, reference=cut, comparison=found, reference_moved_mm=moved)


def _acceleration(result: Result) -> TimeSeries | None:
    """The acceleration along the result's axis; None where the recording's files cannot be read again."""
    recording = result.recording
    if recording is None or not result.fused:
        return None
    try:
        own = recording if recording.axis == result.axis else recording.across
        if own is None:
            return None
        found = own.along(result.calibration.sensor_axis).acceleration
    except MidspanError:
        return None
    which = inside(found.time_ns, int(result.estimate.time_ns[0]), int(result.estimate.time_ns[-1]))
    return TimeSeries(found.time_ns[which], found.value[which])


def shown_here(result: Result, sensor: str) -> ScaleCalibration | None:
    """What a recording shows of the scale of a camera whose calibration came from a file, along the main axis; None
    where it cannot: its files are gone, or it is too quiet.
    """
    recording, seen = result.recording, next((one for one in result.cameras if one.sensor == sensor), None)
    if recording is None or seen is None:
        return None
    try:
        views = recording.along(result.calibration.sensor_axis).views
        own, known = next(one for one in views if one.sensor == sensor), result.calibration.of(sensor)
        view = view_of(own.later(known.offset.value_s) if isinstance(known, CameraCalibration) else own)
        found = scale_of(view, camera_pair(view, seen.track, view.exposure_s or 0.0))
        return replace(found, search=found.search.on_clock(view.late_ns / NANOSECONDS))
    except MidspanError:
        return None


def clock_of(first_ns: int) -> Clock:
    """The time axis of a record that starts at `first_ns`: its own seconds, or seconds after a date."""
    if first_ns < EPOCH_FROM_NS:
        return Clock(0, "time (s)")
    start = datetime.fromtimestamp(first_ns // 1_000_000_000, UTC)
    return Clock(int(start.timestamp()) * 1_000_000_000, f"time after {start:%Y-%m-%d %H:%M:%S} UTC (s)")


def _aligned(result: Result, series: SensorSeries) -> Measured:
    """Measurements inside the result's span, moved by the median of their difference: the result has its own zero."""
    rows = result.estimate
    which = inside(series.time_ns, int(rows.time_ns[0]), int(rows.time_ns[-1]))
    time_ns, value = series.time_ns[which], 1e3 * series.value_m[which]
    fused = np.interp(
        seconds(time_ns, int(rows.time_ns[0])), seconds(rows.time_ns, int(rows.time_ns[0])), rows.displacement_m
    )
    difference = value - 1e3 * fused
    known = np.isfinite(difference)
    moved = float(np.median(difference[known])) if known.any() else 0.0
    # "displacement" alone could be the result's.
    name = "displacement sensor" if series.sensor == "displacement" else series.sensor
    return Measured(name, time_ns, value - moved, 1e3 * series.std_m[which])
