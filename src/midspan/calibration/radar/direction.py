"""A radar's calibration along its own axis, where the accelerometer's other axes were recorded."""

from dataclasses import replace

import numpy as np

from midspan.calibration.direction import turned
from midspan.calibration.radar.calibrate import RadarFit, fit_radar, radar_pair, series_of
from midspan.calibration.radar.clear_part import found_targets
from midspan.calibration.radar.window import OpenedWindow
from midspan.radar.frames import samples_of, without_holes
from midspan.radar.info import RadarInfo
from midspan.records import NANOSECONDS, TimeOffset
from midspan.signals.acceleration import PreparedAcceleration


def fit_radar_along(
    window: OpenedWindow,
    prepared: PreparedAcceleration,
    info: RadarInfo,
    *,
    most_targets: int,
    target_range_m: float | None = None,
) -> RadarFit:
    """The same as `fit_radar`, with the acceleration along the direction that the clearest target shows."""
    if prepared.cross_m_s2 is None:
        return fit_radar(window, prepared, info, most_targets=most_targets, target_range_m=target_range_m)
    (origin, max_offset), samples = window.clock, window.samples
    found = found_targets(window.frames, samples, info, max_offset)
    best = min(found, key=lambda one: (bool(one.objection), one.noise_m))
    series = series_of(window.frames, best, info, samples)
    axis = turned(radar_pair(prepared, without_holes(window.frames), series, window.clock), max_offset)
    assert axis.direction is not None
    prepared = prepared.along(axis.direction.components)
    first_ns, last_ns = (origin + int(np.rint(NANOSECONDS * time_s)) for time_s in samples[[0, -1], 0])
    window = replace(window, samples=samples_of(prepared, origin, (first_ns, last_ns)))
    fit = fit_radar(window, prepared, info, most_targets=most_targets, target_range_m=target_range_m)
    offset = fit.calibration.offset
    wider = replace(fit.calibration, offset=TimeOffset(offset.value_s, offset.variance + axis.offset_variance))
    return replace(fit, calibration=wider.without_gain(1.0, axis.relative_std), direction=axis.direction)
