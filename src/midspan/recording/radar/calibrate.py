"""The radar of a recording calibrated: its window read, its targets chosen, as printed where that is asked for."""

from midspan.calibration.radar.calibrate import RadarFit, fit_radar
from midspan.calibration.radar.literal import fit_radar_literal
from midspan.progress import Progress
from midspan.recording.radar.window import opened_window
from midspan.recording.streams.recording import Recording


def calibrate_radar(recording: Recording, progress: Progress) -> RadarFit:
    """Fixed targets, their conversion factors and the clock offset in the calibration window.

    Raises UntrustedError, with the reason, where no target follows the accelerometer well enough, DataError where the
    window holds too few frames.
    """
    window = opened_window(recording, progress)
    section, info = recording.settings.radar, recording.radar.info
    assert section is not None
    if recording.settings.fusion.literal:
        return fit_radar_literal(window, recording.prepared, info, target_range_m=section.target_range_m)
    return fit_radar(
        window,
        recording.prepared,
        info,
        most_targets=section.targets,
        target_range_m=section.target_range_m,
    )
