"""The calibration of a recording as one record, and its JSON file."""

import json
import math
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from midspan._version import __version__
from midspan.calibration.noise import NoiseCalibration
from midspan.calibration.scale import ScaleCalibration
from midspan.recording.stored.camera import CameraCalibration
from midspan.recording.stored.displacement import DisplacementCalibration
from midspan.recording.stored.json_values import finite_or_none
from midspan.recording.stored.radar import RadarCalibration
from midspan.writing import write_whole

CALIBRATION_FILE = "calibration.json"


@dataclass(frozen=True, slots=True)
class Calibration:
    """Everything `calibrate` learns about a recording's sensors.

    noise_std_m_s2: white noise of the acceleration per sample; bias_m_s2, bias_std_m_s2: the accelerometer's bias at
    the end of the window and its standard deviation, infinite where that is not known. across: the same along the
    second image axis, with camera.direction = "xy"; where that has no accelerometer, the noise is the motion's own
    acceleration. left_out: the second axis "x" or "y" where nothing could be learnt of it, else empty. diagnostics:
    what the estimates rest on, for the report; not stored in the file.
    """

    noise_std_m_s2: float
    bias_m_s2: float
    bias_std_m_s2: float = math.inf
    camera: CameraCalibration | None = None
    infrared: CameraCalibration | None = None
    radar: RadarCalibration | None = None
    displacement: DisplacementCalibration | None = None
    warnings: tuple[str, ...] = ()
    across: "Calibration | None" = None
    left_out: str = ""
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    version: str = __version__
    diagnostics: "ScaleCalibration | NoiseCalibration | None" = field(default=None, compare=False, repr=False)

    @property
    def first_camera(self) -> CameraCalibration | None:
        """The camera whose zero counts and whose axes the columns belong to, of light or infrared."""
        return self.camera or self.infrared

    def of(self, sensor: str) -> CameraCalibration | None:
        """The part of the section "camera" or "infrared"."""
        return self.infrared if sensor == "infrared" else self.camera

    @property
    def direction(self) -> str:
        """The camera's direction, "x", "y" or "xy"; empty without one."""
        if self.first_camera is None:
            return ""
        return self.first_camera.direction if self.across is None and not self.left_out else "xy"

    def noise_density(self, rate_hz: float) -> float:
        """Two-sided density of the acceleration's noise, (m/s²)²/Hz, at the accelerometer's rate."""
        return self.noise_std_m_s2**2 / rate_hz

    def to_dict(self) -> dict[str, Any]:
        """The contents of `calibration.json`: mm, px, s and m/s²."""
        tree: dict[str, Any] = {
            "version": self.version,
            "created": self.created,
            "warnings": list(self.warnings),
            "accelerometer": {
                "noise_std_m_s2": self.noise_std_m_s2,
                "bias_m_s2": self.bias_m_s2,
                "bias_std_m_s2": finite_or_none(self.bias_std_m_s2),
            },
        }
        first = self.first_camera
        if first:
            own = first.to_dict() | ({"left_out": self.left_out} if self.left_out else {})
            if self.across is not None and self.across.first_camera is not None:
                sides = ((part.first_camera, part) for part in (self, self.across))
                both = {camera.direction: _axis_dict(part) for camera, part in sides if camera is not None}
                own |= {"direction": "xy", "axis": first.direction, "axes": both}
            tree["infrared" if self.camera is None else "camera"] = own
        if self.camera and self.infrared:
            tree["infrared"] = self.infrared.to_dict()
        if self.radar:
            tree["radar"] = self.radar.to_dict()
        if self.displacement:
            tree["displacement"] = self.displacement.to_dict()
        return tree

    def save(self, path: str | Path) -> Path:
        """Write `calibration.json`; a folder gets a file of that name."""
        path = Path(path)
        path = path / CALIBRATION_FILE if path.is_dir() else path
        write_whole(path, (json.dumps(self.to_dict(), indent=2) + "\n").encode())
        return path


def _axis_dict(part: Calibration) -> dict[str, Any]:
    """What belongs to one image axis where both are measured."""
    camera = part.first_camera
    assert camera is not None
    return {
        "fused": camera.fused,
        **camera.scale_dict(),
        "noise_std_px": camera.noise_std_px,
        "variance_factor": camera.variance_factor,
        "accelerometer_noise_std_m_s2": part.noise_std_m_s2,
        "accelerometer_bias_m_s2": part.bias_m_s2,
        "accelerometer_bias_std_m_s2": finite_or_none(part.bias_std_m_s2),
        "targets": [target.to_dict() for target in camera.targets],
    }
