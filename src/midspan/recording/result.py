"""The result of an estimate: rows, figures, and ways to look at them and keep them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from midspan._version import __version__
from midspan.engine.radar_trace import RadarTrace
from midspan.engine.sensor_series import CameraResult, SensorSeries
from midspan.fusion.methods import named
from midspan.notices import Notice, notice_trees
from midspan.recording.not_in_band import not_in_band
from midspan.recording.pose import CameraPose
from midspan.recording.streams.recording import Recording
from midspan.recording.verdict import Motion, verdict
from midspan.records import Estimate, Event, Floats, Innovation, PixelTrack, Source, Status, TimeSeries, seconds
from midspan.settings.recording import RecordingSettings
from midspan.settings.stored.calibration import Calibration
from midspan.sinks.table import ResultTable
from midspan.sinks.write import write_result

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# What stands in `report`, above this room.
PLOT, NOTEBOOK = "midspan.report.plot:plot", "midspan.report.plot:notebook_html"
REPORT = "midspan.report.report:write_report"


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """Displacement at the accelerometer's rate with its error band, and everything it rests on: plain data.

    estimate: the rows in SI; calibration, settings, method: how they came about; innovation: measured minus predicted
    displacement; events, warnings: what is worth reporting; cameras: each camera's targets, frame by frame; measured:
    what each sensor measured, in metres; radars: what the targets of each showed, by its name; across: the same along
    the second image axis, with camera.direction = "xy". pose: the camera's translation and rotation, where its targets
    show them. zero_std_m: the part of every row's standard deviation that is the zero's, common to the whole record.
    used: segments (first and last stamp, ns) in which measurements of each sensor, by its name, were used. delay_s: how
    much of the record after it a row needs, infinite: all. file: the recording's settings file; name: the recording's
    name.
    """

    estimate: Estimate
    calibration: Calibration
    settings: RecordingSettings
    method: str
    innovation: Innovation
    events: tuple[Event, ...]
    warnings: tuple[Notice, ...]
    cameras: tuple[CameraResult, ...] = field(default=(), repr=False)
    measured: tuple[SensorSeries, ...] = field(default=(), repr=False)
    radars: Mapping[str, RadarTrace] = field(default_factory=dict, repr=False)
    across: "Result | None" = field(default=None, repr=False)
    pose: CameraPose | None = field(default=None, repr=False)
    zero_std_m: float = 0.0
    used: Mapping[str, Sequence[tuple[int, int]]] = field(default_factory=dict, repr=False)
    delay_s: float = 0.0
    file: Path | None = None
    name: str = ""

    @property
    def recording(self) -> Recording | None:
        """The recording that the result was made of, opened anew with the same settings; None where it has no file."""
        return None if self.file is None else Recording(self.file, self.settings)

    @property
    def track(self) -> PixelTrack | None:
        """The track of the first camera's best target, on that camera's own clock; None without a camera."""
        return self.cameras[0].track if self.cameras else None

    @property
    def radar(self) -> RadarTrace | None:
        """What the targets of the first radar showed; None without one."""
        return next(iter(self.radars.values()), None)

    @property
    def not_in_band(self) -> tuple[str, ...]:
        """What the standard deviations cannot contain, with its size where this recording tells one, in sentences."""
        return not_in_band(self.settings, self.calibration, self.estimate)

    @property
    def verdict(self) -> str:
        """The result in one sentence: how far the structure moved, how surely, and what to look at first."""
        motions = [Motion(self.estimate, self.zero_std_m)]
        if self.across is not None:
            motions = [Motion(one.estimate, one.zero_std_m, one.axis) for one in (self, self.across)]
        usual = self.calibration.usual
        return verdict(motions, self.warnings, np.nan if usual is None else usual.peak_m_s2)

    @property
    def axis(self) -> str:
        """The image axis "x" or "y" that the main columns belong to; empty without a camera."""
        camera = self.calibration.first_camera
        return camera.direction if camera else ""

    @property
    def fused(self) -> bool:
        """Whether an accelerometer measures along this axis too."""
        camera = self.calibration.first_camera
        return camera is None or camera.fused

    @property
    def time_s(self) -> Floats:
        """Time of each row on the accelerometer's clock, s."""
        return seconds(self.estimate.time_ns, 0)

    @property
    def displacement_mm(self) -> Floats:
        """Displacement of each row, mm."""
        return 1e3 * self.estimate.displacement_m

    @property
    def displacement_std_mm(self) -> Floats:
        """Standard deviation of each row's displacement, mm."""
        return 1e3 * np.sqrt(self.estimate.variance_m2)

    @property
    def velocity_mm_s(self) -> Floats:
        """Velocity of each row, mm/s."""
        return 1e3 * self.estimate.velocity_m_s

    def __repr__(self) -> str:
        return f"Result({self.name!r}: {self.summary()})"

    def summary(self) -> str:
        """Method, span, range and typical standard deviation of the displacement in a line."""
        f = self.figures()
        return (
            f"{f['smallest_mm']:.4g} … {f['largest_mm']:.4g} mm ± {f['median_std_mm']:.2g} mm, {f['rows']} rows from "
            f"{f['start_s']:.2f} to {f['end_s']:.2f} s, {self.method}"
        )

    def table(self) -> ResultTable:
        """The columns of the result files with their metadata."""
        columns: dict[str, Any] = {
            "time_s": self.time_s,
            "displacement_mm": self.displacement_mm,
            "displacement_std_mm": self.displacement_std_mm,
            "velocity_mm_s": self.velocity_mm_s,
            "source": self.estimate.source,
            "status": self.estimate.status,
        }
        if self.across is not None:
            axis = self.across.axis
            columns |= {
                f"displacement_{axis}_mm": self.across.displacement_mm,
                f"displacement_std_{axis}_mm": self.across.displacement_std_mm,
                f"velocity_{axis}_mm_s": self.across.velocity_mm_s,
                f"status_{axis}": self.across.estimate.status,
            }
        if self.pose is not None:
            columns |= self.pose.columns()
        return ResultTable(columns=columns, time_ns=self.estimate.time_ns, metadata=self.metadata())

    def metadata(self) -> dict[str, Any]:
        """Settings, calibration, version, events and warnings, as plain values."""
        return {
            "midspan": __version__,
            "method": self.method,
            # Where it is the whole record JSON has no number for it.
            "delay_s": self.delay_s if np.isfinite(self.delay_s) else None,
            "zero_std_mm": 1e3 * self.zero_std_m,
            **({} if self.pose is None else self.pose.metadata()),
            "verdict": self.verdict,
            "not_in_band": list(self.not_in_band),
            **self._axes(),
            **self._sensors(),
            "settings": self.settings.model_dump(mode="json", exclude_none=True),
            "calibration": self.calibration.to_dict(),
            "warnings": list(self.warnings),
            "notices": notice_trees(self.warnings),
            "events": _events(self.events),
        }

    def _sensors(self) -> dict[str, Any]:
        """Which sensor stands behind `source` when; nothing where there is one of each kind."""
        sensors = self.settings.sensors
        if len({sensor.kind for sensor in sensors}) == len(sensors):
            return {}
        return {
            "sensors": [
                {
                    "name": sensor.name,
                    "source": sensor.kind,
                    "used_s": [[first / 1e9, last / 1e9] for first, last in self.used.get(sensor.name, ())],
                }
                for sensor in sensors
            ]
        }

    def _axes(self) -> dict[str, Any]:
        """Which columns belong to which image axis, and how each came about; nothing where there is one axis only."""
        if self.across is None:
            return {}
        second = self.across
        return {
            "axes": {
                self.axis: {"column": "displacement_mm", "fused": True, "method": self.method},
                second.axis: {
                    "column": f"displacement_{second.axis}_mm",
                    "fused": second.fused,
                    "method": second.method,
                    "zero_std_mm": 1e3 * second.zero_std_m,
                    "events": _events(second.events),
                },
            }
        }

    def figures(self) -> dict[str, Any]:
        """The figures a person asks for first: span, peaks, typical standard deviation with its part that is the zero's
        and common to all rows, and that of a row's own, shares of each status.
        """
        d, rows, second = self.displacement_mm, self.estimate, dict[str, Any]()
        if self.across is not None:
            found, names = self.across.figures(), ("largest", "smallest", "rms", "median_std")
            second = {f"{name}_{self.across.axis}_mm": found[f"{name}_mm"] for name in names}
        return {
            "rows": len(d),
            "start_s": float(self.time_s[0]),
            "end_s": float(self.time_s[-1]),
            "largest_mm": float(d.max()),
            "smallest_mm": float(d.min()),
            "rms_mm": float(np.sqrt(np.mean((d - d.mean()) ** 2))),
            "median_std_mm": float(np.median(self.displacement_std_mm)),
            "zero_std_mm": 1e3 * self.zero_std_m,
            "delay_s": self.delay_s if np.isfinite(self.delay_s) else None,
            "median_own_std_mm": 1e3 * float(np.sqrt(max(np.median(rows.variance_m2) - self.zero_std_m**2, 0.0))),
            "status": {s.word: float(np.mean(rows.status == s)) for s in Status},
            "source": {s.word: float(np.mean(rows.source == s)) for s in Source if np.any(rows.source == s)},
            **second,
        }

    def to_pandas(self) -> "pd.DataFrame":
        """The rows as a data frame indexed by time_s, with words for source and status."""
        return self.table().to_pandas()

    def save(self, path: str | Path) -> Path:
        """Write the result; the suffix chooses the format (.csv, .parquet, .h5, .mat, .xlsx, .tdms, .mseed, .uff)."""
        return write_result(path, self.table())

    def plot(self, axes: "Axes | None" = None) -> "Figure":
        """Draw the time history with its ±1.96 standard deviations; returns the figure.

        axes: where to draw; left out: in a new figure of pyplot, which `matplotlib.pyplot.show()` shows in a script.
        """
        figure: Figure = named(PLOT)(self, axes)
        return figure

    def report(self, path: str | Path) -> Path:
        """Write a self-contained HTML report, compared with the recording's [reference] where it has one.

        Returns `path`. Raises UsageError where the file cannot be written, DataError where the reference cannot be
        read.
        """
        written: Path = named(REPORT)(self, path, *self.references())
        return written

    def references(self) -> tuple[TimeSeries | None, TimeSeries | None]:
        """The recording's [reference] along the main axis and along the second one, m; read from its file."""
        recording = self.recording
        if recording is None or not recording.has("reference"):
            return None, None
        return recording.reference, recording.reference_across

    def _repr_html_(self) -> str:
        """What a notebook shows: the picture and the first figures."""
        html: str = named(NOTEBOOK)(self)
        return html


def _events(events: tuple[Event, ...]) -> list[dict[str, Any]]:
    """Events as plain values."""
    return [{"time_s": event.time_ns / 1e9, "kind": event.kind, "text": event.text} for event in events]
