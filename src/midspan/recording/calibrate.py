"""`calibrate`: from an opened recording to scale factor, clock offset and noise levels."""

from pathlib import Path

import numpy as np

from midspan.calibration.bias import Bias
from midspan.calibration.noise import NoiseCalibration
from midspan.calibration.scale import ScaleCalibration
from midspan.engine.axis import AxisFigures, usual_figures
from midspan.recording.camera_calibration.camera import CameraFit
from midspan.recording.camera_calibration.cameras import calibrate_cameras, together
from midspan.recording.displacement.sensor import (
    calibrate_displacement,
    displacement_bias,
    displacement_part,
    displacement_warnings,
)
from midspan.recording.radar.calibrate import calibrate_radar
from midspan.recording.radar.literal import calibrate_radar_literal
from midspan.recording.stored.calibration import Calibration
from midspan.recording.stored.displacement import DisplacementCalibration
from midspan.recording.streams.progress import Progress, silent
from midspan.recording.streams.recording import Recording, naming, open_recording
from midspan.recording.streams.window import calibration_window
from midspan.recording.tracking.tracking import CameraTracking


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
    recording.require_one_of_a_kind()
    with naming(recording):
        return _calibrate_and_track(recording, progress)


def _calibrate_and_track(recording: Recording, progress: Progress) -> tuple[Calibration, CameraTracking | None]:
    settings = recording.settings
    sensor: DisplacementCalibration | None = None
    warnings = list(recording.channel_warnings)
    densities: list[float] = []
    biases: list[Bias] = []
    diagnostics: ScaleCalibration | NoiseCalibration | None = None
    seen = calibrate_cameras(recording, progress) if settings.first_camera is not None else ()
    parts = seen[0].parts if seen else ()
    for one in seen:
        diagnostics = diagnostics or one.parts[0].diagnostics
        warnings += one.warnings
        densities.append(one.parts[0].input_density)
        biases += [] if one.parts[0].bias is None else [one.parts[0].bias]
    learnt_of = {one.view.sensor: one.parts[0].calibration for one in seen}
    learn = calibrate_radar_literal if settings.fusion.literal else calibrate_radar
    radar = None if settings.radar is None else learn(recording, progress)
    if radar is not None:
        warnings += radar.warnings
        densities.append(radar.input_density)
        biases.append(radar.bias)
    if settings.displacement is not None:
        learnt = calibrate_displacement(recording)
        sensor = displacement_part(recording, learnt)
        warnings += displacement_warnings(recording, learnt, sensor)
        densities.append(learnt.input_noise_density)
        biases.append(displacement_bias(learnt))
        diagnostics = diagnostics or learnt
    # The accelerometer's noise is in each of them: they are no independent draws, and the surest one is taken.
    bias = min(biases, key=lambda one: one.std_m_s2)
    across = _across(recording, parts[1], warnings) if len(parts) > 1 else None
    calibration = Calibration(
        noise_std_m_s2=_acceleration_noise(recording, densities, warnings),
        bias_m_s2=bias.value_m_s2,
        bias_std_m_s2=bias.std_m_s2,
        camera=learnt_of.get("camera"),
        infrared=learnt_of.get("infrared"),
        radar=None if radar is None else radar.calibration,
        displacement=sensor,
        warnings=tuple(warnings),
        across=across,
        usual=usual_in_window(recording),
        left_out=recording.across.axis if recording.across is not None and across is None else "",
        diagnostics=diagnostics,
    )
    return calibration, together(seen)


def _across(recording: Recording, part: CameraFit, warnings: list[str]) -> Calibration:
    """The calibration along the second image axis; without an accelerometer there, the motion itself is its noise."""
    view = recording.across
    assert view is not None
    thermal = part.calibration if recording.settings.camera is None else None
    own = None if thermal else part.calibration
    if part.bias is None:
        return Calibration(
            noise_std_m_s2=float(np.sqrt(part.input_density * recording.prepared.rate_hz)),
            bias_m_s2=0.0,
            bias_std_m_s2=0.0,
            camera=own,
            infrared=thermal,
        )
    warnings += [line for line in view.prepared.warnings if line not in warnings]
    return Calibration(
        noise_std_m_s2=_acceleration_noise(view, [part.input_density], warnings),
        bias_m_s2=part.bias.value_m_s2,
        bias_std_m_s2=part.bias.std_m_s2,
        camera=own,
        infrared=thermal,
        usual=usual_in_window(view),
        diagnostics=part.diagnostics,
    )


def usual_in_window(recording: Recording) -> AxisFigures:
    """What is usual of the acceleration in the calibration window."""
    return usual_figures(recording.acceleration.value[calibration_window(recording)], recording.prepared.rate_hz)


def _acceleration_noise(recording: Recording, densities: list[float], warnings: list[str]) -> float:
    """Noise per sample of the acceleration: as given, else as learnt (the larger of two)."""
    learnt = float(np.sqrt(max(densities) * recording.prepared.rate_hz))
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
