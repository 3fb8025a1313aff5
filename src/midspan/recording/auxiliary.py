"""The part of a calibration of the sensors that help others: a velocity, a gyroscope, an inclinometer."""

import numpy as np

from midspan.calibration.camera.gyroscope import GyroscopeFit
from midspan.calibration.sensors.auxiliary import AuxiliaryCalibration
from midspan.calibration.velocity import fit_velocity
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.window import within_window
from midspan.records import TimeOffset
from midspan.settings.sensors import VelocitySettings
from midspan.sources.accelerometer.units import si_factor


def calibrate_auxiliary(recording: Recording, gyroscope: GyroscopeFit | None) -> tuple[AuxiliaryCalibration, ...]:
    """What is estimated of each; UntrustedError, with the reason, where one contradicts the others.

    gyroscope: as found with the camera on its box.
    """
    found = []
    if gyroscope is not None:
        focal = {"focal_px": gyroscope.focal_px, "focal_std_px": gyroscope.focal_std_px}
        known_s = gyroscope.offset_std_s if np.isfinite(gyroscope.offset_std_s) else 0.0
        found.append(
            AuxiliaryCalibration(
                "gyroscope",
                gyroscope.noise_rad_s,
                TimeOffset(gyroscope.offset_s, known_s**2),
                gyroscope.bias_std_rad_s + abs(gyroscope.bias_rad_s),
                gyroscope.bias_walk,
                **focal,
            )
        )
    for kind, section in recording.settings.auxiliary.items():
        if isinstance(section, VelocitySettings):
            series, given = recording.auxiliary[kind], section.noise_std
            noise = None if given is None else given * si_factor(section.unit or series.unit, "velocity", None)
            reach_s = recording.max_offset_s
            series = within_window(recording, series)
            found.append(fit_velocity(recording.prepared, series, max_offset_s=reach_s, noise_std=noise))
    return tuple(found)
