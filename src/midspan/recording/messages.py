"""What an estimate refuses and what it warns of, in sentences."""

import numpy as np

from midspan.calibration.sensors.radar import require_same_way
from midspan.engine.row_messages import rejected_share
from midspan.engine.sensor_series import SensorSeries
from midspan.errors import UntrustedError, UsageError
from midspan.notices import Notice
from midspan.recording.kinds import ROWS
from midspan.recording.streams.recording import Recording
from midspan.records import Estimate, Innovation, Nanoseconds
from midspan.settings.kinds import KINDS
from midspan.settings.stored.calibration import Calibration
from midspan.signals.stamps import shown

# Where more than half of the measurements contradict the prediction, the prediction or the calibration is wrong.
MAX_REJECTED = 0.5


def uncalibrated(recording: Recording, calibration: Calibration) -> list[Notice]:
    """What to report of a sensor that the recording has, other ones can do without, and the given calibration lacks."""
    text = (
        "[{0}] is left out of the result: the given calibration has no {0} part. Run `midspan calibrate` on a "
        "recording with all sensors."
    )
    missing = [view.sensor for view in recording.cameras if calibration.of_sensor(view.own, view.companions) is None]
    missing += [kind for kind in recording.settings.auxiliary if calibration.helped_by(kind) is None]
    return [Notice("part-left-out", text.format(name)) for name in missing]


def left_out(across: Recording, error: UntrustedError) -> Notice:
    """Why the second axis is left out of the result."""
    return Notice("part-left-out", f"The second axis {across.axis} is left out of the result. {error}")


def require_same_sensors(recording: Recording, calibration: Calibration) -> None:
    """UsageError for a calibration of other sensors, of another axis, or of a radar in another way; DataError where the
    streams do not overlap.
    """
    for view in (view for view in recording.views if view.kind in ROWS):
        known = ROWS[view.kind].known(view, calibration)
        if ROWS[view.kind].printed:
            require_same_way(known, recording.settings.fusion.literal)
    views = recording.cameras
    if views and not any(calibration.of_sensor(view.own, view.companions) for view in views):
        raise UsageError(
            f"The calibration has no {views[0].sensor} part, but the recording has a camera. Run `midspan calibrate` "
            "on a recording of this camera."
        )
    for view in views:
        camera, known = view.settings.camera, calibration.of_sensor(view.own, view.companions)
        if camera is None or known is None:
            continue
        made_for = calibration.direction if len(views) == 1 else known.direction
        if camera.direction != made_for:
            raise UsageError(
                f"{recording.file}: {view.sensor}.direction = {camera.direction!r}: the calibration was made for "
                f"{made_for!r}. Calibrate again."
            )
        if view.axis != known.direction:
            raise UsageError(
                f"{recording.file}: the main axis must be {known.direction!r}, as in the calibration; received "
                f"{view.axis!r}. Calibrate again."
            )


def refuse_rejections(recording: Recording, innovation: Innovation) -> None:
    """UntrustedError when most measurements contradict the prediction."""
    share = rejected_share(innovation)
    if share <= MAX_REJECTED:
        return
    looked_at = dict.fromkeys(KINDS[view.kind].to_check.format(view.sensor) for view in recording.views)
    raise UntrustedError(
        f"{100 * share:.0f} % of the measurements contradict the acceleration (at most {100 * MAX_REJECTED:g} % "
        "allowed). The scale factor, clock offset or direction belongs to another recording, or the sensors measure "
        f"different motions. Calibrate this recording and check {' and '.join(looked_at)}."
    )


def refuse_run_away(rows: Estimate, series: SensorSeries) -> None:
    """UntrustedError where most rows lie farther from a displacement sensor's values than these span."""
    value = series.value_m[np.isfinite(series.value_m)]
    span_m = float(np.ptp(value)) if len(value) else np.inf
    if np.median(np.abs(rows.displacement_m - np.median(value if len(value) else 0.0))) > span_m:
        raise UntrustedError(
            f"{series.sensor}: its values span {1e3 * span_m:.3g} mm, but most rows lie outside this range: its "
            "values and the acceleration contradict each other from the start. Cut the recording to a part in which "
            "they agree."
        )


def no_overlap(recording: Recording, measured_ns: Nanoseconds) -> str:
    """Why there is no row."""
    sampled, measured = recording.acceleration.time_ns, "nothing"
    if len(measured_ns):
        measured = f"measurements run from {shown(int(measured_ns[0]))} to {shown(int(measured_ns[-1]))}"
    return (
        f"The streams do not overlap with the calibrated clock offset: {measured} on the accelerometer's clock, which "
        f"runs from {shown(int(sampled[0]))} to {shown(int(sampled[-1]))}. Check the calibration's time_offset_s and "
        "the start_s of both."
    )
