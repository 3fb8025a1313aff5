"""The kinds of sensors that are no cameras, one row each: how they are calibrated, checked, staged and drawn.

Each works on the view of one sensor of the recording. Cameras have targets, tracked ahead of the engine, and rooms of
their own.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from midspan.calibration.radar.calibrate import RadarFit
from midspan.engine.sensor_series import SensorSeries
from midspan.engine.sensors import PlainSensor, RadarSensor
from midspan.progress import Progress
from midspan.recording.displacement.sensor import (
    DisplacementFit,
    calibrate_displacement,
    displacement_series,
    plain_channel,
    require_known,
)
from midspan.recording.radar.calibrate import calibrate_radar
from midspan.recording.radar.chain import radar_channels, radar_part, radar_series
from midspan.recording.streams.recording import Recording
from midspan.settings.stored.calibration import Calibration


@dataclass(frozen=True, slots=True)
class Kind:
    """calibrate: what is learnt of the sensor; known: its part of a calibration, or a refusal; stage: its part of the

    engine, and its channels in the table; series: what it measured over the record.
    """

    calibrate: Callable[[Recording, Progress], RadarFit | DisplacementFit]
    known: Callable[[Recording, Calibration], Any]
    stage: Callable[..., PlainSensor | RadarSensor]
    series: Callable[..., SensorSeries]


ROWS = {
    "radar": Kind(calibrate_radar, radar_part, radar_channels, radar_series),
    "displacement": Kind(calibrate_displacement, require_known, plain_channel, displacement_series),
}
