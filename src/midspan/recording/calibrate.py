"""`calibrate`: from an opened recording to scale factor, clock offset and noise levels."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from midspan.calibration.lines import LinesFound, lines_text
from midspan.calibration.scale import uncertain_scale
from midspan.calibration.sensors.fit import Bias, SensorFit
from midspan.engine.axis import AxisFigures, usual_figures
from midspan.engine.tracking import CameraTracking
from midspan.errors import MidspanError, UntrustedError
from midspan.notices import Notice
from midspan.progress import Progress, silent
from midspan.recording.auxiliary import calibrate_auxiliary, require_focal_length, tilting
from midspan.recording.box import calibrate_cameras, together, with_radar
from midspan.recording.kinds import ROWS
from midspan.recording.other_channels import other_channels
from midspan.recording.streams.recording import Recording, naming, opened
from midspan.recording.streams.window import calibration_window, liveliest_minute
from midspan.settings.messages import in_words_of, renamed
from midspan.settings.plausible import implausible
from midspan.settings.stored.calibration import Calibration, placed


def calibrate(recording: Recording | str | Path, progress: Progress = silent) -> Calibration:
    """Learn scale factor, clock offset and noise levels of a recording, which may be given by its path.

    The camera is calibrated against the accelerometer in calibration.window_s (the first minute when left out); a
    [displacement] sensor's noise and clock offset are estimated relative to it. Raises UntrustedError, with the reason,
    when the result could not be trusted, DataError for unusable streams.
    """
    recording = opened(recording)
    calibration, tracking = calibrate_and_track(recording, progress)
    if tracking is not None:
        tracking.close()
    return calibration


def calibrate_and_track(recording: Recording, progress: Progress = silent) -> tuple[Calibration, CameraTracking | None]:
    """The calibration, and the camera's tracking as far as it had to go, to be continued."""
    with naming(recording):
        try:
            return _calibrate_and_track(recording, progress)
        except UntrustedError:
            if (found := _in_liveliest_minute(recording, progress)) is None:
                raise
            return found


def _in_liveliest_minute(recording: Recording, progress: Progress) -> tuple[Calibration, CameraTracking | None] | None:
    """The calibration of the liveliest minute in place of the first; None where there is none, or it is no better."""
    if (span := liveliest_minute(recording)) is None:
        return None
    window = recording.settings.calibration.model_copy(update={"window_s": span})
    livelier = recording.settings.model_copy(update={"calibration": window})
    try:
        again = Recording(recording.file, livelier)
        found, tracking = _calibrate_and_track(again.by_pose() if recording.posed else again, progress)
    except MidspanError:
        return None
    text = (
        f"The first minute did not determine the calibration; the liveliest minute, {span[0]:.6g} to {span[1]:.6g} s, "
        "was used. Set calibration.window_s for another."
    )
    return replace(found, warnings=(*found.warnings, Notice("window-moved", text))), tracking


def _calibrate_and_track(recording: Recording, progress: Progress) -> tuple[Calibration, CameraTracking | None]:
    """The calibration and the tracking, without lines of the acceleration that a sensor does not show."""
    try:
        return _calibrated(recording, progress)
    except LinesFound as error:
        if recording.lines:
            raise
        lines, sensor = error.lines, error.sensor
    try:
        found, tracking = _calibrated(recording.without_lines(lines), progress)
    except UntrustedError:
        # Where the sensors do not agree with a line, what moves at its frequency is given up.
        if all(line.taken_out for line in lines):
            raise
        lines = tuple(replace(line, taken_out=True) for line in lines)
        found, tracking = _calibrated(recording.without_lines(lines), progress)
    return replace(found, lines=lines, warnings=(lines_text(lines, sensor), *found.warnings)), tracking


def _calibrated(recording: Recording, progress: Progress) -> tuple[Calibration, CameraTracking | None]:
    require_focal_length(recording)
    seen = calibrate_cameras(recording, progress) if recording.cameras else ()
    others = [_fitted(view, progress) for view in recording.views if view.kind in ROWS]
    seen = with_radar(recording, seen, others)
    auxiliary, left_out = calibrate_auxiliary(recording, seen[0].parts[0] if seen else None)
    if seen:
        main_axis, *second = seen[0].parts
        seen = (replace(seen[0], parts=(tilting(recording, main_axis, auxiliary), *second)), *seen[1:])
    fits = [one.parts[0] for one in seen] + others
    warnings = [*recording.channel_warnings, *(line for one in seen for line in one.warnings)]
    warnings += [line for fit in fits[len(seen) :] for line in fit.warnings]
    gains = [(fit.gain_std, fit.gain) for fit in fits if fit.gain_std > 0.0]
    # What the accelerometer's sensitivity may be off by is in all that was compared with it.
    tolerance = recording.accelerometer.scale_std
    gain_std, gain = min(gains, default=(tolerance, 1.0))
    # All compare with one accelerometer; the surest direction is taken.
    fits = sorted(fits, key=lambda fit: np.inf if fit.direction is None else fit.direction.variance)
    axis = fits[0].direction
    main = _of_axis(recording.along(axis), fits, (gain, gain_std), warnings)
    view, across = recording.across, None
    if view is not None and seen and len(seen[0].parts) > 1:
        part = seen[0].parts[1]
        # Its own accelerometer is as good as its tolerance; without one its scale is the main axis's.
        own_gain = (1.0, tolerance) if part.calibration.fused else (gain, gain_std)
        across = _of_axis(view, [part], own_gain, warnings)
    for one in seen:
        for part in (part for part in one.parts if part.parts):
            total = float(np.hypot(part.calibration.relative_std, gain_std))
            warnings += uncertain_scale(one.tracking.settings.sensor, total, {**part.parts, "gain": gain_std})
    calibration = replace(
        main,
        auxiliary=auxiliary,
        accelerometer_scale=gain,
        sensor_axis=axis,
        warnings=(*warnings, *left_out, *_doubts(recording, main)),
        across=across,
        left_out=view.axis if view is not None and across is None else "",
    )
    return calibration, together(seen)


def _doubts(recording: Recording, found: Calibration) -> tuple[Notice, ...]:
    """What gravity, optics and the accelerometer's other channels say against the calibration."""
    if recording.settings.accelerometer is None:
        return implausible(recording.settings, found)
    return (*implausible(recording.settings, found, recording.acceleration.unit), *other_channels(recording))


def _fitted(view: Recording, progress: Progress) -> SensorFit[Any, Any]:
    """What is estimated of a sensor that is no camera, in words with its name."""
    with in_words_of(view.sensor):
        fit = ROWS[view.kind].calibrate(view, progress)
    own = replace(fit.calibration, name=view.own.settings.name)
    return replace(fit, calibration=own, warnings=tuple(renamed(line, view.sensor) for line in fit.warnings))


def _of_axis(view: Recording, fits: Sequence[Any], gain: tuple[float, float], warnings: list[Notice]) -> Calibration:
    """The calibration along one axis; without an accelerometer there, the motion itself is its noise.

    gain: of the accelerometer that the sensors were compared with, and its relative standard deviation.
    """
    biases = [fit.bias for fit in fits if fit.bias is not None]
    if biases:
        warnings += [line for line in view.prepared.warnings if line not in warnings]
    # The accelerometer's noise is in each of them: they are no independent draws, and the surest one is taken.
    # With several axes it is that along the axis taken.
    bias = min(biases[: 1 if fits[0].direction else None], key=lambda one: one.std_m_s2, default=Bias(0.0, 0.0))
    density = max(fit.input_noise.density for fit in fits)
    return Calibration(
        accelerometer_scale_std=gain[1],
        noise_std_m_s2=_white_noise(
            view if biases else None, float(np.sqrt(density * view.prepared.rate_hz)), warnings
        ),
        motion_noise_s=max(fit.input_noise.motion_s for fit in fits),
        misfit=max(fit.misfit.factor for fit in fits),
        slope=max(fit.slope for fit in fits),
        bias_m_s2=bias.value_m_s2,
        bias_std_m_s2=bias.std_m_s2,
        bias_drift_m_s3=bias.drift_m_s3,
        **placed([fit.calibration.without_gain(*gain) for fit in fits]),
        usual=usual_in_window(view) if biases else None,
        diagnostics=next((fit.diagnostics for fit in fits if fit.diagnostics is not None), None),
    )


def usual_in_window(recording: Recording) -> AxisFigures:
    """What is usual of the acceleration in the calibration window."""
    return usual_figures(recording.acceleration.value[calibration_window(recording)], recording.prepared.rate_hz)


def _white_noise(recording: Recording | None, estimated: float, warnings: list[Notice]) -> float:
    """White noise per sample of the acceleration, m/s²: as estimated, or as its section says where that holds."""
    given = None if recording is None else recording.accelerometer.noise_std
    if given is None or estimated <= 2.0 * given:
        return estimated if given is None else given
    text = (
        f"accelerometer.noise_std = {given:g} m/s² is too small: the difference of the two sensors corresponds to "
        f"{estimated:.2g} m/s², which is used. Check region, mounting and axes."
    )
    warnings.append(Notice("accelerometer-noisy", text))
    return estimated
