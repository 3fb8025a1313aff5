"""Steps of a radar's clock, from its file."""

import numpy as np

from midspan.calibration.radar.clock_steps import MAX_SIDE_S, ClockStep, Phase, clock_steps, irregular
from midspan.calibration.radar.window import strongest_place
from midspan.progress import silent
from midspan.radar.following import at_place
from midspan.radar.frames import collected
from midspan.records import NANOSECONDS
from midspan.signals.acceleration import PreparedAcceleration
from midspan.signals.stamps import inside
from midspan.sources.radar.radar_source import RadarSource


def steps_of(
    source: RadarSource, prepared: PreparedAcceleration, range_m: float | None, max_offset_s: float
) -> tuple[ClockStep, ...]:
    """Steps of the clock of a radar's file; range_m: of its target where that is given; max_offset_s: largest offset.

    Nothing is read but the stamps where all intervals are alike.
    """
    time_ns, info = source.times_ns(), source.info
    if not (edges := irregular(time_ns)):
        return ()
    reach_ns = round(MAX_SIDE_S * NANOSECONDS)
    near = inside(time_ns, int(time_ns[edges[0]]) - reach_ns, int(time_ns[edges[-1]]) + reach_ns)
    few = min(source.at_a_time, near.stop - near.start)
    frames = collected(source.profiles(near.start, near.start + few), few, silent, "")
    if (place := strongest_place(frames, info, range_m)) is None:
        return ()
    count = near.stop - near.start
    whole = collected(source.slow_time(np.array([place]), near.start, near.stop), count, silent, "")
    # The receiver that sees it best.
    best = int(np.argmax(np.mean(np.abs(at_place(frames.phasors, place)), axis=0)))
    z = np.where(whole.valid[:, best], whole.phasors[:, best, 0], np.nan)
    phase = Phase(whole.time_ns, np.angle(z).astype(np.float64), info.axis.phase_per_m(info.axis.range_at(place)))
    samples = prepared.rows(int(whole.time_ns[0]), slice(None))[:, :2]
    steps = clock_steps(phase, samples, max_offset_s)
    return tuple(ClockStep(step.frame + near.start, step.late_s) for step in steps)
