"""The part of a calibration of the sensors that help others: a velocity, a gyroscope, an inclinometer."""

from midspan.calibration.sensors.auxiliary import AuxiliaryCalibration
from midspan.calibration.velocity import fit_velocity
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.window import within_window
from midspan.settings.sensors import VelocitySettings
from midspan.sources.accelerometer.units import si_factor


def calibrate_auxiliary(recording: Recording) -> tuple[AuxiliaryCalibration, ...]:
    """What is estimated of each; UntrustedError, with the reason, where one contradicts the others."""
    found = []
    for kind, section in recording.settings.auxiliary.items():
        if isinstance(section, VelocitySettings):
            series, given = recording.auxiliary[kind], section.noise_std
            noise = None if given is None else given * si_factor(section.unit or series.unit, "velocity", None)
            reach_s = recording.max_offset_s
            series = within_window(recording, series)
            found.append(fit_velocity(recording.prepared, series, max_offset_s=reach_s, noise_std=noise))
    return tuple(found)
