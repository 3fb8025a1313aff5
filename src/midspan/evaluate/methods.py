"""All fusion methods on one recording that is calibrated and tracked once: how they compare."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from midspan.errors import MidspanError
from midspan.evaluate import metrics
from midspan.evaluate.metrics import Comparison
from midspan.evaluate.result_file import of_result, read_reference
from midspan.fusion.methods import METHODS
from midspan.progress import Progress, silent
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.estimate import estimate
from midspan.recording.kinds import has_printed
from midspan.recording.result import Result
from midspan.recording.streams.recording import Recording
from midspan.recording.tracked import open_tracked_cameras, side_of
from midspan.records import TimeSeries
from midspan.settings.load import validate
from midspan.settings.stored.calibration import Calibration


@dataclass(frozen=True, slots=True)
class MethodRun:
    """One method on the recording; literal: as printed in its paper. result: None where it was refused, for the
    reason `refused`; comparison: with the reference, None without one; took_s: what it takes beyond the tracking.
    """

    method: str
    literal: bool = False
    result: Result | None = None
    refused: str = ""
    comparison: Comparison | None = None
    took_s: float = 0.0

    @property
    def name(self) -> str:
        """The method, and whether it ran as printed."""
        return f"{self.method}, literal" if self.literal else self.method

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values."""
        found = self.result
        if found is None:
            return {"method": self.method, "literal": self.literal, "refused": self.refused}
        return {
            "method": self.method,
            "literal": self.literal,
            "median_std_mm": found.figures()["median_std_mm"],
            "delay_s": found.delay_s,
            "took_s": self.took_s,
            "warnings": list(found.warnings),
            **({} if self.comparison is None else {"comparison": self.comparison.to_dict()}),
        }


def reference_of(recording: Recording, path: Path | None, unit: str | None) -> TimeSeries | None:
    """The displacement that the methods are compared with, m: of a file, else the recording's own, else None."""
    if path is not None:
        return read_reference(path, unit)
    return recording.reference if recording.has("reference") else None


def run_all(
    recording: Recording,
    calibration: Calibration | None = None,
    *,
    reference: TimeSeries | None = None,
    progress: Progress = silent,
) -> Iterator[MethodRun]:
    """Each method of `midspan methods` in turn, on one calibration and one tracking of the cameras; then the papers' as
    printed, except with a radar, whose calibration is printed too.

    calibration: left out, it is made; reference: displacement in m on the accelerometer's clock. The cameras are
    tracked with the predictions of the recording's own method. Raises what `estimate` raises for that method; others
    that are refused are in their rows.
    """
    given = calibration is not None
    if calibration is None:
        calibration, tracking = calibrate_and_track(recording.by_pose(), progress)
    else:
        tracked_cameras = open_tracked_cameras((side_of(recording, calibration),), None, progress)
        tracking = tracked_cameras[0].tracking if tracked_cameras else None
        if tracking is not None:
            tracking.companions = tuple(tracked_camera.tracking for tracked_camera in tracked_cameras[1:])
    # The frames are tracked in the first run; what the methods take is measured without it.
    estimate(recording, calibration, tracking=tracking, given=given, progress=progress)
    forms = [(method, False) for method in METHODS]
    forms += [(method, True) for method, row in METHODS.items() if row.guarded and not has_printed(recording)]
    for method, literal in forms:
        begun_s = time.perf_counter()
        try:
            tree = recording.settings.model_dump(exclude_none=True)
            tree["fusion"] |= {"method": method, "literal": literal}
            view = Recording(recording.file, validate(tree, str(recording.file)))
            found = estimate(view, calibration, tracking=tracking, given=given, progress=progress)
        except MidspanError as error:
            yield MethodRun(method, literal, refused=str(error))
            continue
        took_s = time.perf_counter() - begun_s
        own = of_result(found)
        compared = None if reference is None else metrics.compare(own.series, reference, band=own.band)
        yield MethodRun(method, literal, found, comparison=compared, took_s=took_s)
