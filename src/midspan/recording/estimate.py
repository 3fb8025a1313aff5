"""`estimate`: the main job, from a recording to displacement at the accelerometer's rate with its error band."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from midspan.checks import option
from midspan.errors import DataError, UsageError
from midspan.fusion.estimator import Estimator
from midspan.fusion.methods import LITERAL, METHODS, no_literal_form
from midspan.fusion.second_pass import smooth
from midspan.recording import estimate_whole
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.cameras.tracked import Side, open_eyes, side_of
from midspan.recording.point import measuring_point
from midspan.recording.result import Result
from midspan.recording.run import Outcome, run
from midspan.recording.second_axis import SecondAxis
from midspan.recording.stored.calibration import Calibration
from midspan.recording.stored.calibration_file import load_calibration
from midspan.recording.streams.progress import Progress, silent
from midspan.recording.streams.recording import Recording, naming, open_recording
from midspan.recording.streams.span import inside
from midspan.recording.tracking.tracking import CameraTracking
from midspan.recording.unsupported import unsupported_events
from midspan.records import Estimate, Innovation, joined, part

# Methods whose rows the engine gives.
ENGINE = ("kalman", "lag", "smoother")


def estimate(
    recording: Recording | str | Path,
    calibration: Calibration | str | Path | None = None,
    *,
    method: str | None = None,
    tracking: CameraTracking | None = None,
    progress: Progress = silent,
) -> Result:
    """Estimate the displacement of a recording, which may be given by its path.

    calibration: or its file; left out, it is made first (and the camera is tracked once for both). method: a name of
    `midspan methods`, over the recording's own. tracking: what `calibrate_and_track` left, to go on with. Returns one
    row for each accelerometer sample in the streams' common span.
    Raises UntrustedError when calibration is refused, DataError for unusable streams.
    """
    if isinstance(recording, str | Path):
        recording = open_recording(recording)
    if isinstance(calibration, str | Path):
        calibration = load_calibration(calibration)
    # The method is checked first: tracking may take long.
    method = option("method", method or recording.settings.fusion.method, METHODS)
    if method not in ENGINE or recording.has("radar"):
        return estimate_whole.estimate(recording, calibration, method=method, tracking=tracking, progress=progress)
    recording.require_one_of_a_kind()
    if recording.settings.fusion.literal and method not in LITERAL:
        raise UsageError(f"{recording.file}: fusion: {no_literal_form(method)}.")
    given = calibration is not None and tracking is None
    if calibration is None:
        calibration, tracking = calibrate_and_track(recording, progress)
    with naming(recording):
        return _estimate(recording, calibration, Asked(method, given), tracking, progress)


@dataclass(frozen=True, slots=True)
class Asked:
    """The method, and whether the calibration was given, not estimated on this recording just now."""

    method: str
    given: bool


def _estimate(
    recording: Recording, calibration: Calibration, asked: Asked, tracking: CameraTracking | None, progress: Progress
) -> Result:
    estimate_whole._require(recording, calibration)
    sides = [side_of(recording, calibration)]
    if recording.across is not None and calibration.across is not None:
        sides.append(side_of(recording.across, calibration.across))
    eyes = open_eyes(sides, tracking, progress)
    point = measuring_point(sides, eyes, lag_s=recording.settings.fusion.lag_s if asked.method == "lag" else None)
    outcome = run(point, sides, eyes)
    progress(0, 1, "fusing")
    settings = point.estimator.settings
    if asked.method == "smoother":
        assert isinstance(point.estimator, Estimator)
        if point.estimator.log is None:
            raise DataError("No sensor measured anything within the acceleration.")
        rows = smooth(point.estimator.log, settings)
    else:
        rows = tuple(outcome.estimate(axis) for axis in range(len(sides)))
    used = span_of(outcome, rows[0])
    rows = tuple(part(one, used) for one in rows)
    innovations = [
        joined([outcome.innovation(k) for k, channel in enumerate(settings.channels) if channel.axis == axis])
        for axis in range(len(sides))
    ]
    main = in_time(innovations[0])
    estimate_whole._refuse_rejections(recording, main)
    alone = unsupported_events(rows[0], outcome.events)
    progress(1, 1, "fusing")
    return Result(
        estimate=rows[0],
        calibration=calibration,
        settings=recording.settings,
        method=asked.method,
        innovation=main,
        events=tuple(sorted((*outcome.events, *alone), key=lambda event: event.time_ns)),
        warnings=(
            *estimate_whole._channel_warnings(recording, calibration),
            *(line for eye in eyes for line in eye.tracking.warnings()),
            *estimate_whole._told(tuple(outcome.events)),
            *estimate_whole._shares(main, rows[0]),
        ),
        track=eyes[0].track if eyes else None,
        tracking=eyes[0].tracking if eyes else None,
        recording=recording,
        across=None if len(sides) < 2 else second_axis(sides[1], asked.method, rows[1], in_time(innovations[1])),
        zero_std_m=float(np.sqrt(outcome.zero_variance_m2[0])),
        eyes=eyes,
    )


def second_axis(side: Side, method: str, rows: Estimate, innovation: Innovation) -> SecondAxis:
    """The second image axis at the rows of the first."""
    camera = side.calibration.first_camera
    assert camera is not None
    return SecondAxis(camera.direction, camera.fused, method, rows, innovation)


def in_time(innovation: Innovation) -> Innovation:
    """Innovations of several channels in the order of time."""
    return part(innovation, np.argsort(innovation.time_ns, kind="stable"))


def span_of(outcome: Outcome, rows: Estimate) -> slice:
    """The rows in the streams' common span: up to the last measurement."""
    times = [block.time_ns[np.isfinite(block.value)] for blocks in outcome.measured.values() for block in blocks]
    last = max((int(stamps[-1]) for stamps in times if len(stamps)), default=0)
    return inside(rows.time_ns, int(rows.time_ns[0]), last)
