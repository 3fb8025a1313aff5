"""The temperatures that a thermal camera's trackers see: as they are, or a range of them in grey levels."""

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.engine.thermal_target import ThermalTarget
from midspan.engine.tracking import CameraTracking
from midspan.errors import UsageError
from midspan.recording.streams.recording import Recording
from midspan.settings.camera import InfraredSettings
from midspan.thermal.limits import Limits

# Trackers that were made for pictures of 256 grey levels: their thresholds are in them.
IN_GREY = ("features",)


def levels_of(view: Recording, known: CameraCalibration | None) -> Limits | None:
    """The range that is shown in grey levels; None where trackers see temperatures as they are.

    known: the calibration, whose range is taken where none is given and the tracker needs one. Raises UsageError for a
    range of pictures that hold no temperatures.
    """
    camera = view.settings.camera
    if not isinstance(camera, InfraredSettings):
        return None
    if camera.temperature_range_c is None:
        if known is None or known.temperature_range_c is None or camera.tracker not in IN_GREY:
            return None
        return Limits(*known.temperature_range_c)
    if is_grey(view):
        raise UsageError(
            f"{view.file}: infrared.temperature_range_c: must be left out for {camera.file}, which holds grey levels "
            "of 8 bits and no temperatures."
        )
    return Limits(*camera.temperature_range_c)


def is_grey(view: Recording) -> bool:
    """Whether a thermal camera's frames are grey levels of 8 bits instead of temperatures."""
    return not view.frames.info.radiometric


def range_seen(tracking: CameraTracking, place: int) -> tuple[float, float] | None:
    """Temperatures (°C) that the tracker of the target with this number sees; None where it gets pictures."""
    tracker = tracking.targets[place].tracker
    return (tracker.limits.low_c, tracker.limits.high_c) if isinstance(tracker, ThermalTarget) else None
