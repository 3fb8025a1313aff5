"""`estimate` with a radar as printed (Ma et al., doi:10.1016/j.ymssp.2022.109582): its displacement is one series.

The series goes to a method that is run as printed as well. Nothing is judged and nothing is left out; no other sensor
takes part.
"""

import numpy as np

from midspan.calibration.sensors.radar import require_same_way
from midspan.engine.channels import clock_std_s, without_gain
from midspan.engine.point import Support
from midspan.engine.row_messages import event_warnings, radar_warnings, shares
from midspan.engine.sensor_series import series_of
from midspan.errors import UsageError
from midspan.fusion.blocks import Rows
from midspan.fusion.methods import METHODS, no_literal_form
from midspan.notices import Notice, once
from midspan.papers.printed.one_series import literal_warnings, run_on_series, with_uncertain
from midspan.papers.printed.radar_series import Printed, printed_displacement
from midspan.progress import Progress
from midspan.radar.frames import collected, together
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.kinds import radar_part
from midspan.recording.result import Result
from midspan.recording.streams.recording import Recording, naming
from midspan.recording.tracked import side_of
from midspan.records import NANOSECONDS, Displacement, Estimate, Source, part
from midspan.settings.stored.calibration import Calibration
from midspan.signals.stamps import frames_used, inside

RAN_AWAY = Notice(
    "literal",
    "radar: the printed unwrapping (fusion.literal) lost cycles and ran away (equations 12 to 15 do not return): the "
    "displacement is wrong from there on. Leave fusion.literal out.",
)


def estimate_printed(recording: Recording, calibration: Calibration | None, method: str, progress: Progress) -> Result:
    """The displacement of a recording whose radar, method and calibration are as printed."""
    if not METHODS[method].literal:
        raise UsageError(f"{recording.file}: fusion: {no_literal_form(method)}.")
    if len(recording.sensors) > 1:
        raise UsageError(
            f"{recording.file}: fusion.literal = true with [radar]: the printed radar takes no other sensor. Leave "
            "[camera], [infrared] and [displacement] out, or leave fusion.literal out."
        )
    if calibration is None:
        calibration, _ = calibrate_and_track(recording, progress)
    with naming(recording):
        known = radar_part(recording, calibration)
        require_same_way(known, literal=True)
        source = recording.radar
        margin_ns = round(recording.max_offset_s * NANOSECONDS)
        used = frames_used(source.times_ns(), recording.prepared.time_ns, margin_ns)
        blocks = source.slow_time(np.array([known.best.place_bin]), used.start, used.stop)
        frames = collected(blocks, used.stop - used.start, progress, "reading the radar")
        own = frames.time_ns, together(frames.phasors, known.best, frames.valid)[:, 0]
        printed = printed_displacement(own, recording.prepared, known, source.info)
        return _fused(recording, calibration, printed, method)


def _fused(recording: Recording, calibration: Calibration, printed: Printed, method: str) -> Result:
    """The printed displacement fused by a method."""
    side, known = side_of(recording, calibration), calibration.radar
    assert known is not None
    settings = recording.settings.fusion.of_method(side.kalman)
    done = run_on_series(side.acceleration, printed.measured, method, settings, rate_hz=side.prepared.rate_hz)
    # What ran away is as uncertain as it is large.
    scale_std = without_gain(known.relative_std, calibration.accelerometer_scale_std)
    gain = calibration.gain_std(recording.accelerometer.scale_std, given=True)
    relative = float(np.linalg.norm((scale_std, gain, 1.0 if printed.ran_away else 0.0)))
    zero_m2 = known.best.noise_m**2
    rows = with_uncertain(done.estimate, zero_m2, relative, clock_std_s(known.offset))
    rows = _measured_rows(rows, printed.measured)
    alone = Support().after([Rows((rows,), (), ())])[1][0].events
    warnings = (
        *recording.channel_warnings,
        *event_warnings((*done.events, *alone)),
        *radar_warnings(printed.log, recording.radar.info.warnings),
        *([RAN_AWAY] if printed.ran_away else []),
        *shares(done.innovation, rows),
        *literal_warnings(printed.measured, done),
    )
    return Result(
        estimate=rows,
        calibration=calibration,
        settings=recording.settings,
        method=method,
        innovation=done.innovation,
        events=tuple(sorted((*recording.prepared.events, *done.events, *alone), key=lambda event: event.time_ns)),
        warnings=once(warnings, calibration.warnings),
        measured=(series_of("radar", Source.RADAR, printed.measured),),
        radars={"radar": printed.log.trace(recording.radar.info.limit_speed_m_s)},
        zero_std_m=float(np.sqrt(zero_m2)),
        delay_s=done.delay_s,
        file=recording.file,
        name=recording.name,
    )


def _measured_rows(rows: Estimate, measured: Displacement) -> Estimate:
    """The rows from the first measurement to the last."""
    stamps = measured.time_ns[np.isfinite(measured.value_m)]
    return part(rows, inside(rows.time_ns, int(stamps[0]), int(stamps[-1])))
