"""The cameras of a calibrated recording: tracked to their end with one filter's predictions, each as a displacement."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from midspan.calibration.camera.view import filter_settings
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.engine.tracking import CameraTracking
from midspan.fusion.streams import KalmanSettings
from midspan.progress import Progress
from midspan.recording.streams.recording import Recording
from midspan.recording.tracking.opening import open_tracking, where_it_sees
from midspan.recording.tracking.posed import PosedTracking, posed
from midspan.records import Acceleration, TimeOffset
from midspan.settings.kinds import CAMERAS
from midspan.settings.messages import in_words_of
from midspan.settings.stored.calibration import Calibration
from midspan.signals.acceleration import GRAVITY_M_S2, PreparedAcceleration, still


@dataclass(frozen=True, slots=True)
class Side:
    """One image axis of a recording, or all of one without a camera: its acceleration and the filter's settings."""

    recording: Recording
    calibration: Calibration
    prepared: PreparedAcceleration
    acceleration: Acceleration
    kalman: KalmanSettings


@dataclass(frozen=True, slots=True)
class TrackedCamera:
    """One camera of a recording, its tracking, and what was estimated of it along each axis, the main one first."""

    view: Recording
    tracking: CameraTracking
    calibrations: tuple[CameraCalibration, ...]

    @property
    def sensor(self) -> str:
        """The camera's name."""
        return self.view.sensor

    @property
    def zero_ns(self) -> int:
        """The instant (ns on its own clock) at which the rows of its best target were exposed in the first frame."""
        best = self.calibrations[0].best_used
        return int(self.tracking.time_ns[0]) + self.tracking.targets[best].chain.first_late_ns

    @property
    def begins_dark(self) -> bool:
        """Whether frames before the first one used were dark or not usable."""
        began_ns = self.view.sees_from_ns
        return self.tracking.skipped > 0 or (began_ns is not None and began_ns > self.view.frames.times_ns()[0])


def known_sensors(main: Side) -> list[tuple[Recording, Any]]:
    """The calibrated sensors of a recording that are no cameras: the view of each, and what was estimated of it."""
    views = [view for view in main.recording.views if view.kind not in CAMERAS]
    known = [(view, main.calibration.of_sensor(view.own, view.companions)) for view in views]
    return [one for one in known if one[1] is not None]


def offsets_of(main: Side, tracked_cameras: Sequence[TrackedCamera]) -> dict[str, TimeOffset]:
    """The calibrated clock offset of each sensor, by its name."""
    found = {tracked_camera.sensor: tracked_camera.calibrations[0].offset for tracked_camera in tracked_cameras}
    found |= {view.sensor: known.offset for view, known in known_sensors(main)}
    return found | {one.kind: one.offset for one in main.calibration.auxiliary}


def clocks_shared(main: Side) -> set[str]:
    """Names of the displacement sensors whose clock is the accelerometer's, as is said or as the calibration says."""
    found = set()
    for view, known in known_sensors(main):
        if (section := view.settings.displacement) is not None:
            one = known.offset.value_s == 0.0 and known.clock_rate == 0.0
            if section.estimate_offset is False or (section.estimate_offset is None and one):
                found.add(view.sensor)
    return found


def side_of(recording: Recording, calibration: Calibration) -> Side:
    """A recording's axis with its calibration; without an accelerometer there its acceleration is zero.

    What the calibration leaves open of the sensors' axis makes noise of the cross motion.
    """
    if (axis := calibration.sensor_axis) is not None:
        cross = np.sqrt(axis.noise_density(recording.prepared) * recording.prepared.rate_hz)
        calibration = replace(calibration, noise_std_m_s2=float(np.hypot(calibration.noise_std_m_s2, cross)))
    if calibration.lines != recording.lines:
        # What is not taken out is noise.
        more = sum(line.density for line in calibration.lines if line.taken_out)
        more = np.sqrt(more * recording.prepared.rate_hz)
        calibration = replace(calibration, noise_std_m_s2=float(np.hypot(calibration.noise_std_m_s2, more)))
    recording = recording.along(axis)
    camera = calibration.first_camera
    prepared = recording.prepared if camera is None or camera.fused else still(recording.prepared)
    density = calibration.noise_density(prepared.rate_hz)
    gain = calibration.accelerometer_scale
    kalman = filter_settings(prepared, density, calibration.bias_m_s2 / gain, GRAVITY_M_S2 * calibration.slope)
    own = prepared.with_noise(density, calibration.motion_noise_s)
    acceleration = Acceleration(own.time_ns, own.value_m_s2 / gain, own.noise_density / gain**2)
    return Side(recording, calibration, prepared, acceleration, kalman)


def open_tracked_cameras(
    sides: Sequence[Side], tracking: CameraTracking | None, progress: Progress
) -> tuple[TrackedCamera, ...]:
    """The calibrated cameras of a recording, the one whose zero counts first.

    tracking: what calibrating left, with those of further cameras with it; None: each is opened.
    """
    opened = {} if tracking is None else {one.settings.sensor: one for one in (tracking, *tracking.companions)}
    tracked_cameras = []
    for view in sides[0].recording.cameras:
        parts = (side.calibration.of_sensor(view.own, view.companions) for side in sides)
        if known := tuple(part for part in parts if part is not None):
            view, _ = where_it_sees(view.later(known[0].offset.value_s))
            with in_words_of(view.sensor):
                own = opened.get(view.sensor) or open_tracking(view, known[0], progress)
            if view.posed and view.sensor not in opened:
                own = posed(view.settings.first_camera, own, view.accelerometer.camera_offset_m)
            if isinstance(own, PosedTracking) and own is not opened.get(view.sensor):
                known = tuple(own.as_declared(one) for one in known)
            tracked_cameras.append(TrackedCamera(view, own, known))
    return tuple(tracked_cameras)
