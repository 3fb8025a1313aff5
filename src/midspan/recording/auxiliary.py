"""The sensors that help others: what is estimated of a velocity or a gyroscope, and what they measured."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from midspan.calibration.camera.calibrate import CameraFit
from midspan.calibration.camera.geometry import FOCAL_STD
from midspan.calibration.camera.gyroscope import GyroscopeFit
from midspan.calibration.camera.inclination import angle_share, is_shown
from midspan.calibration.camera.tilt import walk_of
from midspan.calibration.sensors.auxiliary import MIN_ANGLES, AuxiliaryCalibration, turns_image
from midspan.calibration.velocity import fit_velocity
from midspan.errors import DataError, UntrustedError, UsageError
from midspan.notices import Notice
from midspan.recording.streams.recording import Recording
from midspan.recording.streams.window import calibration_window, within_window
from midspan.records import NANOSECONDS, Quantity, TimeOffset, TimeSeries
from midspan.settings.sensors import VelocitySettings
from midspan.signals.acceleration import GRAVITY_M_S2, prepare_acceleration
from midspan.signals.attitude import Attitude, attitude
from midspan.signals.medians import MEDIAN_DEVIATION
from midspan.sources.accelerometer.units import si_factor
from midspan.vision.lens import Lens

# What gravity shows together with a gyroscope; no section of its own.
GRAVITY = "gravity"
# The zero of gravity's angle drifts by so much (rad) in so long (s): 10 µg of a quiet accelerometer whose temperature
# is compensated. By the data sheet 0.15 mg/K are usual, which a settled temperature leaves out.
GRAVITY_STD, GRAVITY_S = 1e-5, 60.0
# The same of an inclinometer: its data sheets give some mdeg per K.
INCLINOMETER_STD, INCLINOMETER_S = 2e-5, 600.0
# An angle is no sharper than this, rad.
MIN_ANGLE_STD = 1e-7
# What is right by this logarithm of likelihoods, 4 standard deviations, is certain.
AGREES = 8.0
UNVERIFIED = "inclinometer: the motion does not verify its sign and scale; they are taken as declared."
# The axis along the view shows the pitch where the measured one carries this share of gravity at least.
MIN_UPRIGHT = 0.5


def require_focal_length(recording: Recording) -> None:
    """UsageError where nothing tells what an inclinometer's angle moves the image by."""
    settings = recording.settings
    no_lens = settings.first_camera is None or settings.first_camera.lens is None
    if settings.inclinometer is not None and settings.gyroscope is None and no_lens:
        raise UsageError(
            "inclinometer: needs the focal length, by which a tilt moves the image. Add [camera.lens], or [gyroscope]."
        )


def calibrate_auxiliary(
    recording: Recording, camera: CameraFit | None
) -> tuple[tuple[AuxiliaryCalibration, ...], tuple[Notice, ...]]:
    """What is estimated of each, and notices; camera: what was estimated of the one on whose box they are.

    Raises UntrustedError, with the reason, where one contradicts the acceleration.
    """
    found, notices = list[AuxiliaryCalibration](), list[Notice]()
    section = recording.settings.velocity
    if isinstance(section, VelocitySettings):
        series, given = recording.auxiliary["velocity"], section.noise_std
        noise = None if given is None else given * si_factor(section.unit or series.unit, "velocity", None)
        reach_s = recording.max_offset_s
        series = within_window(recording, series)
        try:
            found.append(fit_velocity(recording.prepared, series, max_offset_s=reach_s, noise_std=noise))
        except DataError as error:
            notices.append(_left_out("velocity", str(error)))
    gyroscope = None if camera is None else camera.gyroscope
    if recording.settings.inclinometer is not None:
        known = _focal_length(recording, gyroscope, None if camera is None else camera.calibration.lens)
        if known is not None and np.count_nonzero(np.isfinite(recording.auxiliary["inclinometer"].value)) >= MIN_ANGLES:
            own = _of_inclinometer(recording, *known)
            found.append(replace(own, verified=_is_shown(recording, camera, own)))
        else:
            why = f"it has fewer than {MIN_ANGLES} values." if known is not None else "the focal length is unknown."
            notices.append(_left_out("inclinometer", why))
    if gyroscope is not None:
        drift_m_s3 = 0.0 if camera is None or camera.bias is None else camera.bias.drift_m_s3
        of_box, more = _of_gyroscope(recording, gyroscope, drift_m_s3)
        found, notices = [*found, *of_box], [*notices, *more]
    if any(one.kind == "inclinometer" and not one.verified for one in found):
        notices.append(Notice("tilt-unverified", UNVERIFIED))
    return tuple(found), tuple(notices)


def _is_shown(recording: Recording, camera: CameraFit | None, own: AuxiliaryCalibration) -> bool:
    """Whether the image shows an inclinometer's angle beyond what the acceleration tells.

    Raises UntrustedError where it shows another sign or size.
    """
    series, found = recording.auxiliary["inclinometer"], None if camera is None else camera.diagnostics
    usable = np.isfinite(series.value)
    if found is None or (camera is not None and camera.gyroscope is not None):
        # Without the rotation that the gyroscope measures, nothing of it is left in the image.
        return False
    begin_ns, fit = int(recording.prepared.time_ns[calibration_window(recording).start]), found.search.fit
    time_s = (series.time_ns[usable] - begin_ns) / NANOSECONDS - fit.offset_s
    focal_px = turns_image(recording.axis) * own.focal_px
    share = angle_share(found.search.pair, fit, time_s, focal_px * series.value[usable], own.focal_px * own.noise_std)
    return is_shown(share, f"value_{'yx'['xy'.index(recording.axis)]}")


def tilting(recording: Recording, camera: CameraFit, helping: Sequence[AuxiliaryCalibration]) -> CameraFit:
    """The camera with the size of a tilt that angles show, and how steeply it goes on, where targets do not."""
    known, measured = camera.calibration, auxiliary_series(recording, helping)
    if known.tilt_walk_px2_s > 0.0:
        return camera
    for own in (one for one in helping if one.measures is Quantity.TILT and one.kind in measured):
        series = measured[own.kind]
        usable = np.isfinite(series.value)
        tilt_px, step_s = own.focal_px * series.value, float(np.median(np.diff(series.time_ns))) / NANOSECONDS
        walk = walk_of(tilt_px, step_s, own.focal_px * own.noise_std)
        if known.tilt_std_px == 0.0:
            # Within a second it is independent of what it was before.
            size_px = max(float(np.std(np.diff(tilt_px[usable]))) / np.sqrt(2.0), known.noise_std_px)
            known = replace(known, tilt_std_px=size_px)
        known = replace(known, tilt_walk_px2_s=max(walk, known.tilt_walk_px2_s))
    return replace(camera, calibration=known)


def _left_out(kind: str, why: str) -> Notice:
    return Notice("part-left-out", f"[{kind}] is left out of the result: {why}")


def _of_gyroscope(
    recording: Recording, gyroscope: GyroscopeFit, drift_m_s3: float
) -> tuple[list[AuxiliaryCalibration], list[Notice]]:
    """What is estimated of a gyroscope, and of gravity with it; drift_m_s3: of the accelerometer's bias."""
    focal: dict[str, Any] = {"focal_px": gyroscope.focal_px, "focal_std_px": gyroscope.focal_std_px}
    known_s = gyroscope.offset_std_s if np.isfinite(gyroscope.offset_std_s) else 0.0
    offset, zero_std = TimeOffset(gyroscope.offset_s, known_s**2), gyroscope.bias_std_rad_s + abs(gyroscope.bias_rad_s)
    of_gyroscope = AuxiliaryCalibration(
        "gyroscope", gyroscope.noise_rad_s, offset, zero_std, gyroscope.bias_walk, **focal
    )
    if (leaning := _gravity(recording, of_gyroscope)) is None:
        return [of_gyroscope], []
    agreement = leaning.agreement(gyroscope.noise_rad_s)
    if agreement < -AGREES:
        text = (
            "gravity along the view is left out of the result: it turns against the gyroscope. Check the sign of "
            "accelerometer.value_z (along the view, specific force); or the structure sways slowly along the view."
        )
        return [of_gyroscope], [Notice("part-left-out", text)]
    noise, walk = leaning.noise_std(gyroscope.noise_rad_s), 2.0 * GRAVITY_STD**2 / GRAVITY_S
    # What warms one axis warms the other.
    walk = max(walk, GRAVITY_S * (drift_m_s3 / GRAVITY_M_S2) ** 2)
    zero = TimeOffset(0.0, 0.0)
    gravity = AuxiliaryCalibration(GRAVITY, noise, zero, np.inf, walk, **focal, verified=agreement > AGREES)
    return [of_gyroscope, gravity], []


def _focal_length(
    recording: Recording, gyroscope: GyroscopeFit | None, lens: Lens | None
) -> tuple[float, float] | None:
    """The focal length by which a tilt moves the image and its standard deviation, px; None where only a
    gyroscope that was left out would show it.
    """
    if gyroscope is not None:
        return gyroscope.focal_px, gyroscope.focal_std_px
    if lens is not None:
        focal_px = lens.focal_px(recording.axis)
        return focal_px, FOCAL_STD * focal_px
    return None


def _of_inclinometer(recording: Recording, focal_px: float, focal_std_px: float) -> AuxiliaryCalibration:
    section, series = recording.settings.inclinometer, recording.auxiliary["inclinometer"]
    assert section is not None
    given = section.noise_std
    if given is not None:
        noise = given * si_factor(section.unit or series.unit, "angle", None)
    else:
        steps = np.diff(series.value[np.isfinite(series.value)], 2)
        noise = max(float(np.median(np.abs(steps)) / MEDIAN_DEVIATION / np.sqrt(6.0)), MIN_ANGLE_STD)
    walk = 2.0 * INCLINOMETER_STD**2 / INCLINOMETER_S
    return AuxiliaryCalibration(
        "inclinometer", noise, TimeOffset(0.0, 0.0), np.inf, walk, focal_px=focal_px, focal_std_px=focal_std_px
    )


def auxiliary_series(recording: Recording, known: Sequence[AuxiliaryCalibration]) -> dict[str, TimeSeries]:
    """What each calibrated one measured, by its kind, as far as the recording has it."""
    found = {one.kind: recording.auxiliary[one.kind] for one in known if one.kind in recording.auxiliary}
    own = next((one for one in known if one.kind == "gyroscope"), None)
    if own is not None and any(one.kind == GRAVITY for one in known):
        leaning = _gravity(recording, own)
        if leaning is not None:
            found[GRAVITY] = TimeSeries(leaning.time_ns, leaning.value, GRAVITY, "rad")
    return found


def _gravity(recording: Recording, gyroscope: AuxiliaryCalibration) -> Attitude | None:
    """The camera's pitch by gravity along its view and by its gyroscope; None where nothing shows it."""
    named = recording.accelerometer.named_axes
    rate = recording.auxiliary.get("gyroscope")
    if rate is None or "z" not in named or recording.axis not in named:
        return None
    own = recording.accelerometer_axes
    # A rotation about the image's x axis adds to z what the y axis carries of gravity, less its sign; about y what the
    # x axis carries.
    upright = -turns_image(recording.axis) * float(np.nanmean(own[recording.axis].value))
    if abs(upright) < MIN_UPRIGHT * GRAVITY_M_S2:
        return None
    along = prepare_acceleration(own["z"], "accelerometer along the view")
    time_ns = rate.time_ns + round(NANOSECONDS * gyroscope.offset.value_s)
    finite = np.isfinite(rate.value)
    if not finite.any():
        return None
    if time_ns[finite][0] > along.time_ns[-1]:
        raise UntrustedError("gyroscope: none of its values lies within the accelerometer's record.")
    rates = np.interp(along.time_ns, time_ns[finite], rate.value[finite])
    return attitude(along.time_ns, along.value_m_s2, rates, upright)
