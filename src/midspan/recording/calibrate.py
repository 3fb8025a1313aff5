"""`calibrate`: from an opened recording to scale factor, clock offset and noise levels."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from midspan.calibration.camera.calibrate import CameraFit
from midspan.calibration.displacement.sensor import DisplacementFit
from midspan.calibration.radar.calibrate import RadarFit
from midspan.engine.axis import AxisFigures, usual_figures
from midspan.engine.tracking import CameraTracking
from midspan.progress import Progress, silent
from midspan.recording.cameras import calibrate_cameras, together
from midspan.recording.kinds import ROWS
from midspan.recording.streams.recording import Recording, naming, open_recording
from midspan.recording.streams.window import calibration_window
from midspan.records import InputNoise
from midspan.settings.sensor_words import in_words_of, worded
from midspan.settings.stored.calibration import Calibration, placed


def calibrate(recording: Recording | str | Path, progress: Progress = silent) -> Calibration:
    """Learn scale factor, clock offset and noise levels of a recording, which may be given by its path.

    The camera is calibrated against the accelerometer in calibration.window_s (the first minute when left out); a
    [displacement] sensor's noise and clock offset are learnt beside it. Raises UntrustedError, with the reason, when
    the result could not be trusted, DataError for unusable streams.
    """
    if isinstance(recording, str | Path):
        recording = open_recording(recording)
    calibration, tracking = calibrate_and_track(recording, progress)
    if tracking is not None:
        tracking.close()
    return calibration


def calibrate_and_track(recording: Recording, progress: Progress = silent) -> tuple[Calibration, CameraTracking | None]:
    """The calibration, and the camera's tracking as far as it had to go, to be continued."""
    with naming(recording):
        return _calibrate_and_track(recording, progress)


def _calibrate_and_track(recording: Recording, progress: Progress) -> tuple[Calibration, CameraTracking | None]:
    if recording.settings.fusion.literal:
        recording.require_one_of_a_kind()
    seen = calibrate_cameras(recording, progress) if recording.cameras else ()
    fits = [one.parts[0] for one in seen] + [_fitted(view, progress) for view in recording.views if view.kind in ROWS]
    warnings = [*recording.channel_warnings, *(line for one in seen for line in one.warnings)]
    warnings += [line for fit in fits[len(seen) :] for line in fit.warnings]
    # The accelerometer's noise is in each of them: they are no independent draws, and the surest one is taken.
    bias = min((fit.bias for fit in fits if fit.bias is not None), key=lambda one: one.std_m_s2)
    parts = seen[0].parts if seen else ()
    across = _across(recording, parts[1], warnings) if len(parts) > 1 else None
    gains = [(fit.gain_std, fit.gain) for fit in fits if fit.gain_std > 0.0]
    # What the accelerometer's sensitivity may be off by is in all that was compared with it.
    gain_std, gain = min(gains, default=(recording.accelerometer.scale_std, 1.0))
    calibration = Calibration(
        accelerometer_scale=gain,
        accelerometer_scale_std=gain_std,
        noise_std_m_s2=_white_noise(recording, [fit.input_noise for fit in fits], warnings),
        motion_noise_s=max(fit.input_noise.motion_s for fit in fits),
        misfit=max(fit.misfit.factor for fit in fits),
        slope=max(fit.slope for fit in fits),
        bias_m_s2=bias.value_m_s2,
        bias_std_m_s2=bias.std_m_s2,
        **placed([fit.calibration.without_gain(gain, gain_std) for fit in fits]),
        warnings=tuple(warnings),
        across=across if across is None else _with_gain(across, recording, (gain, gain_std)),
        usual=usual_in_window(recording),
        left_out=recording.across.axis if recording.across is not None and across is None else "",
        diagnostics=next((fit.diagnostics for fit in fits if fit.diagnostics is not None), None),
    )
    return calibration, together(seen)


def _fitted(view: Recording, progress: Progress) -> CameraFit | RadarFit | DisplacementFit:
    """What is learnt of a sensor that is no camera, in words with its name."""
    with in_words_of(view.sensor):
        fit = ROWS[view.kind].calibrate(view, progress)
    own: Any = replace(fit.calibration, name=view.own.settings.name)
    return replace(fit, calibration=own, warnings=tuple(worded(line, view.sensor) for line in fit.warnings))


def _with_gain(across: Calibration, recording: Recording, main: tuple[float, float]) -> Calibration:
    """The second axis: its own accelerometer is as good as its tolerance; without one its scale is the main axis's."""
    camera = across.first_camera
    fused = camera is None or camera.fused
    gain, std = (1.0, recording.accelerometer.scale_std) if fused else main
    return replace(across.without_gain(gain, std), accelerometer_scale_std=std)


def _across(recording: Recording, part: CameraFit, warnings: list[str]) -> Calibration:
    """The calibration along the second image axis; without an accelerometer there, the motion itself is its noise."""
    view = recording.across
    assert view is not None
    if part.bias is None:
        return Calibration(
            noise_std_m_s2=float(np.sqrt(part.input_noise.density * recording.prepared.rate_hz)),
            bias_m_s2=0.0,
            bias_std_m_s2=0.0,
            **placed([part.calibration]),
        )
    warnings += [line for line in view.prepared.warnings if line not in warnings]
    return Calibration(
        noise_std_m_s2=_white_noise(view, [part.input_noise], warnings),
        motion_noise_s=part.input_noise.motion_s,
        misfit=part.misfit.factor,
        slope=part.slope,
        bias_m_s2=part.bias.value_m_s2,
        bias_std_m_s2=part.bias.std_m_s2,
        **placed([part.calibration]),
        usual=usual_in_window(view),
        diagnostics=part.diagnostics,
    )


def usual_in_window(recording: Recording) -> AxisFigures:
    """What is usual of the acceleration in the calibration window."""
    return usual_figures(recording.acceleration.value[calibration_window(recording)], recording.prepared.rate_hz)


def _white_noise(recording: Recording, found: list[InputNoise], warnings: list[str]) -> float:
    """White noise per sample of the acceleration: as given, else as estimated (the largest)."""
    learnt = float(np.sqrt(max(noise.density for noise in found) * recording.prepared.rate_hz))
    given = recording.accelerometer.noise_std
    if given is None:
        return learnt
    if learnt > 2.0 * given:
        warnings.append(
            f"accelerometer.noise_std = {given:g} m/s² is given, but the two sensors differ as if it were "
            f"{learnt:.2g} m/s²; the larger one is used. Check the region, the mounting and the axes."
        )
        return learnt
    return given
