"""A radar's displacement as printed (Ma et al., doi:10.1016/j.ymssp.2022.109582), over a whole record."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.sensors.radar import RadarCalibration
from midspan.engine.radar_target import FollowedTarget
from midspan.engine.radar_trace import RadarLog
from midspan.papers.printed.radar_phase import acceleration_at, printed_phase_per_m, printed_series, ran_away
from midspan.radar.chirp import RadarInfo
from midspan.radar.frames import even_places, samples_of
from midspan.records import NANOSECONDS, Displacement, Nanoseconds, PhaseMeasurement, Source, Status, seconds
from midspan.signals.acceleration import PreparedAcceleration


@dataclass(frozen=True, slots=True)
class Printed:
    """The displacement as printed, a row a frame on the accelerometer's clock; whether it ran away; the frames' log."""

    measured: Displacement
    ran_away: bool
    log: RadarLog


def printed_displacement(
    frames: tuple[Nanoseconds, NDArray[np.complex64]],
    prepared: PreparedAcceleration,
    calibration: RadarCalibration,
    info: RadarInfo,
) -> Printed:
    """Displacement at the chosen target through a record, by equations 10 and 12 to 16.

    frames: stamps (n,) and phasors (n,) of the target. A frame that never arrived takes the predicted phase and is no
    measurement.
    """
    (time_ns, phasors), best = frames, calibration.best
    places, origin = even_places(time_ns), int(time_ns[0])
    z = np.full(int(places[-1]) + 1, np.nan, dtype=np.complex64)
    z[places] = phasors
    frame_s = np.interp(np.arange(len(z)), places, seconds(time_ns, origin))
    level = acceleration_at(samples_of(prepared, origin), frame_s + calibration.offset.value_s)
    unit = printed_phase_per_m(info)
    series = printed_series(z, frame_s, level, (best, unit))
    measured = Displacement(
        time_ns=time_ns + round(calibration.offset.value_s * NANOSECONDS),
        value_m=series.value_m[places],
        variance_m2=series.variance_m2[places],
        source=np.full(len(places), Source.RADAR, dtype=np.uint8),
    )
    period_s = 1.0 / info.frame_rate_hz
    log = RadarLog([FollowedTarget(best, unit, np.array([best.place_bin]), np.nan, period_s)])
    for k, strength in enumerate(np.abs(np.nan_to_num(phasors)) / best.amplitude):
        phase = unit * series.range_change_m[places[k]]
        status = Status.TRACKING if np.isfinite(phase) else Status.COASTING
        one = PhaseMeasurement(int(measured.time_ns[k]), float(phase), 0.0, 0.0, status, float(strength))
        log.push([one])
    gone = ran_away(series.range_change_m, period_s=period_s, phase_per_m=unit)
    return Printed(measured, gone, log)
