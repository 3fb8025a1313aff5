"""`calibrate`: from an opened recording to scale factor, clock offset and noise levels."""

from dataclasses import replace

import numpy as np

from midspan.calibration.fit import Pair
from midspan.calibration.noise import NoiseCalibration, calibrate_noise
from midspan.calibration.scale import ScaleCalibration
from midspan.errors import DataError, UntrustedError, UsageError
from midspan.recording.calibrate_camera import (
    LEAST_MEASUREMENTS,
    CameraFit,
    calibrate_camera,
    calibration_window,
    judged_by,
    measured_rows,
    window_ends,
)
from midspan.recording.calibration import Calibration, CameraCalibration, DisplacementCalibration
from midspan.recording.lens import check_same_lens, lens_of
from midspan.recording.progress import Progress, silent
from midspan.recording.recording import Recording, naming
from midspan.recording.span import inside, require_overlap
from midspan.recording.tracking import CameraTracking, Target, TrackingSettings
from midspan.records import NANOSECONDS, Nanoseconds, Region, TimeOffset, TimeSeries
from midspan.settings.camera import CameraSettings
from midspan.signals.health import dominant_frequency
from midspan.vision.tracker import tracker_settings

# Noise levels of a displacement sensor are learnt from this much at most, in one piece, for speed.
NOISE_WINDOW_S = 1800.0
# A clock offset that was not asked for is refused when it moves the displacement by more than this many times its
# noise.
MOST_LATE = 2.0
# A displacement that is so much more likely (logarithm of the likelihood) with the opposite sign has it.
CLEARLY_REVERSED = 20.0
# A given noise of a displacement sensor is taken unless the sensors differ as if it were so many times larger.
MOST_OPTIMISTIC = 1.5


def calibrate(recording: Recording, progress: Progress = silent) -> Calibration:
    """Learn scale factor, clock offset and noise levels of a recording.

    The camera is calibrated against the accelerometer in calibration.window_s (the first minute when left out); a
    [displacement] sensor's noise and clock offset are learnt beside it. Raises UntrustedError, with the reason, when
    the result could not be trusted, DataError for unusable streams.
    """
    calibration, tracking = calibrate_and_track(recording, progress)
    if tracking is not None:
        tracking.close()
    return calibration


def calibrate_and_track(recording: Recording, progress: Progress = silent) -> tuple[Calibration, CameraTracking | None]:
    """The calibration, and the camera's tracking as far as it had to go, to be continued."""
    with naming(recording):
        return _calibrate_and_track(recording, progress)


def _calibrate_and_track(recording: Recording, progress: Progress) -> tuple[Calibration, CameraTracking | None]:
    prepared, settings = recording.prepared, recording.settings
    parts: tuple[CameraFit, ...] = ()
    displacement_part: DisplacementCalibration | None = None
    tracking: CameraTracking | None = None
    warnings = list(prepared.warnings)
    densities: list[float] = []
    diagnostics: ScaleCalibration | NoiseCalibration | None = None
    if settings.camera is not None:
        tracking = open_tracking(recording, None, progress)
        parts = calibrate_camera(recording, tracking)
        diagnostics = parts[0].diagnostics
        warnings += [*_codec_warnings(recording), *(line for part in parts for line in part.warnings)]
        densities.append(parts[0].input_density)
    if settings.displacement is not None:
        learnt = _calibrate_displacement(recording)
        displacement_part = _displacement_part(recording, learnt)
        warnings += _displacement_warnings(learnt)
        densities.append(learnt.input_noise_density)
        diagnostics = diagnostics or learnt
    window = calibration_window(recording)
    across = _across(recording, parts[1], warnings) if len(parts) > 1 else None
    calibration = Calibration(
        noise_std_m_s2=_acceleration_noise(recording, densities, warnings),
        bias_m_s2=float(np.mean(prepared.value_m_s2[window])),
        camera=parts[0].calibration if parts else None,
        displacement=displacement_part,
        warnings=tuple(warnings),
        across=across,
        left_out=recording.across.axis if recording.across is not None and across is None else "",
        diagnostics=diagnostics,
    )
    return calibration, tracking


def _across(recording: Recording, part: CameraFit, warnings: list[str]) -> Calibration:
    """The calibration along the second image axis; without an accelerometer there, the motion itself is its noise."""
    view = recording.across
    assert view is not None
    if not part.calibration.fused:
        return Calibration(
            noise_std_m_s2=float(np.sqrt(part.input_density * recording.prepared.rate_hz)),
            bias_m_s2=0.0,
            camera=part.calibration,
        )
    warnings += view.prepared.warnings
    return Calibration(
        noise_std_m_s2=_acceleration_noise(view, [part.input_density], warnings),
        bias_m_s2=float(np.mean(view.prepared.value_m_s2[calibration_window(view)])),
        camera=part.calibration,
        diagnostics=part.diagnostics,
    )


def open_tracking(recording: Recording, calibration: Calibration | None, progress: Progress) -> CameraTracking:
    """The camera's tracking from the first frame used; with a calibration its targets are taken over.

    Where no target is given, the accelerometer helps to choose. Raises UsageError for a target that the calibration
    does not know.
    """
    camera = recording.settings.camera
    if camera is None:
        raise DataError(f"{recording.file}: has no [camera] section.")
    times = recording.frames.times_ns()
    if not len(times):
        raise DataError(f"{camera.file}: holds no frames.")
    acceleration_ns = recording.prepared.time_ns
    require_overlap(acceleration_ns, times, "camera")
    margin = round(recording.settings.calibration.max_offset_s * NANOSECONDS)
    used = frames_used(times, acceleration_ns, margin)
    known = None if calibration is None else calibration.camera
    settings = TrackingSettings(
        tracker=camera.tracker,
        direction=recording.axis,
        targets=calibrated_targets(given_targets(camera), known),
        automatic_targets=camera.automatic_targets,
        first=used.start,
        last=used.stop,
        readout_s=camera.readout_s,
        trial_from_ns=window_ends(recording)[0],
        tracker_settings=tracker_settings(camera.tracker, **camera.tracker_settings),
        lens=lens_of(recording),
    )
    if known is not None:
        check_same_lens(settings.lens, known.lens)
    return CameraTracking(recording.frames, settings, progress, lambda track: judged_by(recording, track))


def given_targets(camera: CameraSettings) -> tuple[Target, ...]:
    """The targets that a recording names; none where they are to be chosen."""
    if camera.roi is not None:
        return (Target(Region(*camera.roi)),)
    return tuple(Target(Region(*t.roi), name) for t, name in zip(camera.target, camera.target_names, strict=True))


def calibrated_targets(given: tuple[Target, ...], known: CameraCalibration | None) -> tuple[Target, ...]:
    """The targets to track beside a calibration: its own in use, or those of them that the recording names."""
    if known is None:
        return given
    if not given:
        return tuple(Target(target.region, target.name) for target in known.used)
    if len(given) == 1 and len(known.targets) <= 1:
        # One target's scale factor is taken for the same target that moved a little in the picture.
        return given
    regions = {target.region: target for target in known.targets}
    missing = [target.name for target in given if target.region not in regions]
    if missing or len(given) < len(known.used):
        raise UsageError(
            f"camera.target: the calibration was made for {len(known.targets)} targets, and not for the same: "
            f"{'not ' + ', '.join(missing) if missing else 'some are missing in the recording'}. Calibrate again."
        )
    return tuple(Target(target.region, target.name) for target in known.used)


def frames_used(times_ns: Nanoseconds, acceleration_ns: Nanoseconds, margin_ns: int) -> slice:
    """Frames from the first one used: the file's first where the streams start together, else the first in both."""
    overlapping = inside(times_ns, int(acceleration_ns[0]), int(acceleration_ns[-1]) + margin_ns)
    if times_ns[0] >= acceleration_ns[0] - margin_ns:
        return slice(0, overlapping.stop)
    return overlapping


def _codec_warnings(recording: Recording) -> list[str]:
    info = recording.frames.info
    if info.lossless is not False:
        return []
    return [
        f"camera: the video is compressed ({info.codec}). Compression freezes parts of the picture: motion of "
        "a few hundredths of a pixel can be lost and the scale factor can be off by 1 % or more. "
        "Record raw or lossless where you can."
    ]


def _calibrate_displacement(recording: Recording) -> NoiseCalibration:
    prepared, series = recording.prepared, recording.displacement
    require_overlap(prepared.time_ns, series.time_ns, "displacement")
    used = inside(series.time_ns, int(prepared.time_ns[0]), int(prepared.time_ns[-1]))
    first = int(series.time_ns[used.start])
    last = min(int(series.time_ns[used.stop - 1]), first + round(NOISE_WINDOW_S * NANOSECONDS))
    max_offset = min(recording.settings.calibration.max_offset_s, 0.1 * (last - first) / NANOSECONDS)
    margin = round(max_offset * NANOSECONDS)
    used = inside(series.time_ns, first + margin, last - margin)
    _refuse_poor_displacement(series, used)
    window = inside(prepared.time_ns, first - NANOSECONDS, last + NANOSECONDS)
    rows = measured_rows(series.time_ns[used], series.value[used], np.ones(used.stop - used.start), first)
    pair = Pair(prepared.rows(first, window), rows, 1.0)
    searched = calibrate_noise(pair, max_offset)
    if searched.reversed_gain > CLEARLY_REVERSED:
        raise UntrustedError(
            "displacement: its sign is reversed: turned round it fits the accelerometer far better. Its second "
            "derivative must be positive where the structure accelerates along the sensor's positive axis. Turn the "
            "sign of the column, or of the accelerometer's."
        )
    section = recording.settings.displacement
    if section is not None and section.estimate_offset:
        return searched
    # One clock is taken for granted; an offset that shows all the same is told and put into the error band.
    off = searched.offset.value_s
    still = calibrate_noise(pair, 0.0)
    value = pair.samples[:, 1]
    shaken = float(np.std(value)) / (2.0 * np.pi * max(dominant_frequency(value, prepared.rate_hz), 0.2))
    speed = max(shaken, float(np.sqrt(np.mean((np.diff(rows[:, 1]) / np.diff(rows[:, 0])) ** 2))))
    if abs(off) * speed > MOST_LATE * np.sqrt(searched.variance_factor):
        raise UntrustedError(
            f"displacement: its clock differs from the accelerometer's by {off:+.4f} s, which moves it by "
            f"{1e3 * abs(off) * speed:.3g} mm rms. Set displacement.estimate_offset = true to have the offset "
            "learnt and "
            "applied, or correct its time column."
        )
    return replace(still, offset=TimeOffset(0.0, off * off), scale=searched.scale, scale_std=searched.scale_std)


def _refuse_poor_displacement(series: TimeSeries, used: slice) -> None:
    value = series.value[used]
    known = value[np.isfinite(value)]
    if len(known) < LEAST_MEASUREMENTS:
        raise DataError(
            f"displacement: {len(known)} measurements overlap the accelerometer; at least {LEAST_MEASUREMENTS} "
            "are needed "
            "to learn its noise. Check its time column, gaps and unit."
        )
    if np.ptp(known) == 0.0:
        raise DataError(
            f"displacement ({series.name}): stands at one value, {1e3 * known[0]:g} mm, all the time. Check the "
            "sensor, or "
            "choose another column with displacement.value."
        )


def _displacement_part(recording: Recording, learnt: NoiseCalibration) -> DisplacementCalibration:
    given = recording.settings.displacement.noise_std if recording.settings.displacement else None
    std = float(np.sqrt(learnt.variance_factor))
    if given is not None:
        own = given * unit_in_metres(recording)
        # A given noise far below what the sensors differ by would only make the gate reject right measurements.
        std = own if std < MOST_OPTIMISTIC * own else std
    return DisplacementCalibration(std, learnt.offset)


def unit_in_metres(recording: Recording) -> float:
    """Metres in one unit of the [displacement] channel."""
    from midspan.sources.accelerometer.units import si_factor

    section = recording.settings.displacement
    unit = (section.unit if section else None) or recording.displacement.unit
    return si_factor(unit, "displacement", None)


def _displacement_warnings(learnt: NoiseCalibration) -> list[str]:
    """A doubt about the displacement's unit or sign in words; UntrustedError where it is beyond doubt."""
    found = []
    if learnt.offset.value_s == 0.0 and 0.0 < learnt.offset.variance < np.inf:
        found.append(
            "displacement: its clock seems to differ from the accelerometer's by "
            f"{1e3 * np.sqrt(learnt.offset.variance):.3g} "
            "ms. Set displacement.estimate_offset = true to have the offset learnt and applied."
        )
    off = abs(learnt.scale - 1.0)
    text = (
        f"displacement: follows the accelerometer with a factor of {learnt.scale:.3g} ± {learnt.scale_std:.2g} "
        "where 1 is "
        "expected. Check displacement.unit, its sign, accelerometer.unit and that both sensors measure the same axis."
    )
    if off > max(0.5, 5.0 * learnt.scale_std):
        raise UntrustedError(text)
    return [*found, text] if off > max(0.1, 5.0 * learnt.scale_std) else found


def _acceleration_noise(recording: Recording, densities: list[float], warnings: list[str]) -> float:
    """Noise per sample of the acceleration: as given, else as learnt (the larger of two)."""
    learnt = float(np.sqrt(max(densities) * recording.prepared.rate_hz))
    given = recording.settings.accelerometer.noise_std
    if given is None:
        return learnt
    if learnt > 2.0 * given:
        warnings.append(
            f"accelerometer.noise_std = {given:g} m/s² is given, but the two sensors differ as if it were "
            f"{learnt:.2g} m/s²; the larger one is used. Check the region, the mounting and the axes."
        )
        return learnt
    return given
