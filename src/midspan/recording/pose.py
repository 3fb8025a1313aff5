"""Translation and rotation of a camera as columns of the result, where its targets show all six degrees of freedom.

Frame by frame the targets give the camera's pose (`vision/pose.py`). Each degree is then smoothed to the rows' times as
a motion of constant velocity whose changes are as large as the frames show; that along the accelerometer's axis with
the acceleration.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.camera.geometry import Surroundings, contradicted
from midspan.calibration.camera.view import View, camera_pair, filter_settings, scale_of
from midspan.calibration.scale import ScaleCalibration
from midspan.engine.sensor_series import CameraResult
from midspan.errors import UntrustedError
from midspan.fusion.path import at
from midspan.fusion.streams import smooth
from midspan.notices import Notice
from midspan.recording.cameras import view_of
from midspan.recording.depth import AlongView, along_view
from midspan.recording.tracked import Side, TrackedCamera
from midspan.recording.tracking.posed import AXES, PosedTracking, is_steady, known_surroundings, seen_frames
from midspan.recording.unfelt import MIN_FRAMES, block_of, smoothed
from midspan.records import NANOSECONDS, Acceleration, Displacement, Estimate, Floats
from midspan.signals.averaging import at_instants
from midspan.vision.pose import Poses, by_geometry

UNITS = (1e3, 1e3, 1e3, *[1e3 * float(np.degrees(1.0))] * 3)


@dataclass(frozen=True, slots=True, eq=False)
class CameraPose:
    """Where a camera is: value (n, 6), translation (m) and rotation vector (rad) about its own axes x (right), y (down)
    and z (along the view) since the first frame used, with standard deviations; zero_std (6,): the part of these that
    the zero makes, common to all rows. What is not observed is NaN.
    """

    value: Floats
    std: Floats
    zero_std: Floats

    def columns(self) -> dict[str, Floats]:
        """The columns of the result, mm and mdeg."""
        found = dict[str, Floats]()
        for k, axis in enumerate("xyz" * 2):
            if np.isnan(self.zero_std[k]):
                continue
            name, unit = ("translation", "mm") if k < 3 else ("rotation", "mdeg")
            found[f"{name}_{axis}_{unit}"] = UNITS[k] * self.value[:, k]
            found[f"{name}_{axis}_std_{unit}"] = UNITS[k] * self.std[:, k]
        return found

    def metadata(self) -> dict[str, list[float | None]]:
        """The zero's part, three values each; none of what is not observed."""
        zero = [None if np.isnan(one) else float(one) for one in self.zero_std * UNITS]
        return {"translation_zero_std_mm": zero[:3], "rotation_zero_std_mdeg": zero[3:]}


@dataclass(frozen=True, slots=True)
class Rows:
    """Displacement along each axis, the main one first, with the variances of its zero."""

    estimates: Sequence[Estimate]
    zero_variance_m2: Sequence[float]


def camera_pose(
    seen: Sequence[tuple[CameraResult, TrackedCamera]], sides: Sequence[Side], rows: Rows
) -> tuple[CameraPose | None, tuple[Notice, ...]]:
    """The pose of the first camera whose targets show it; else why that of the first one is not seen, in a note.

    seen: the cameras with their tracking; rows: those of the result.
    """
    notices: tuple[Notice, ...] = ()
    for camera, tracked in seen:
        found, own = _Camera(camera, tracked, sides).pose(rows)
        if found is not None:
            return found, own
        notices = notices or own
    for camera, tracked in seen:
        alone = along_view(camera, tracked, rows.estimates[0].time_ns)
        if alone is not None:
            return _only_along_view(alone), (*notices, alone.notice)
    return None, notices


def _only_along_view(found: AlongView) -> CameraPose:
    unseen = np.full(6, np.nan)
    pose = CameraPose(np.tile(unseen, (len(found.value_m), 1)), np.tile(unseen, (len(found.value_m), 1)), unseen)
    pose.value[:, 2], pose.std[:, 2], pose.zero_std[2] = found.value_m, found.std_m, found.zero_std_m
    return pose


@dataclass(frozen=True, slots=True)
class Along:
    """The motion along an axis compared with the acceleration: by what it is larger than the geometry says, with its
    standard deviation; sign: 1 where the accelerometer reads more as the camera goes along the axis; variance_factor:
    what the frames scatter by, over what the tracker says; offset_ns: of the camera's clock; fit: where it was not part
    of the calibration.
    """

    gain: float
    std: float
    sign: float
    variance_factor: float
    offset_ns: int
    fit: ScaleCalibration | None = None


class _Camera:
    """One camera: what its targets show in each frame, on the accelerometer's clock."""

    def __init__(self, camera: CameraResult, tracked: TrackedCamera, sides: Sequence[Side]) -> None:
        self._camera, self._tracked, self._sides = camera, tracked, sides
        own = sides[0].recording.settings.accelerometer
        self._lever_m = np.array((0.0, 0.0, 0.0) if own is None else own.camera_offset_m)
        self._scale_std = 0.0 if own is None else own.scale_std
        self._posed = tracked.tracking if isinstance(tracked.tracking, PosedTracking) else None
        self._seen = seen_frames(camera.targets) if self._posed is None else self._posed.frames

    def pose(self, rows: Rows) -> tuple[CameraPose | None, tuple[Notice, ...]]:
        """The pose at the rows, and what is worth reporting."""
        known, why = self._surroundings()
        if known is None:
            return None, (Notice("pose-unseen", f"{PREFIX}{why}"),) if why else ()
        frames, found = self._seen.poses(known), dict[int, Along]()
        if np.count_nonzero(np.isfinite(frames.value[:, 0])) < MIN_FRAMES:
            return None, (Notice("pose-unseen", f"{PREFIX}fewer than {MIN_FRAMES} frames show three targets."),)
        if not is_steady(frames):
            why = "the targets do not keep their places: one moves on its own, or a distance is wrong."
            return None, (Notice("pose-unseen", f"{PREFIX}{why}"),)
        # The accelerometer tells how large the motion along its axis is.
        for number, view in enumerate(self._views()):
            axis = AXES.index(view.axis)
            try:
                along = (
                    self._fit(view, frames, known, self._sides[number]) if self._posed is None else self._own(number)
                )
            except UntrustedError:
                continue
            sharper = known.with_gain(along.gain, along.std**2, self._seen.slopes(known, frames, axis)[0])
            if sharper is None:
                return None, (contradicted(known.names, view.axis, along.gain),)
            known, found[axis] = sharper, along
            frames = self._seen.poses(known)
        if why := known.unseen(self._seen.usual_px2):
            return None, (Notice("pose-unseen", f"{PREFIX}{why}"),)
        alone = "camera: three targets give its pose exactly; one that moves on its own would not show. Add a fourth."
        exact = (Notice("pose-unchecked", alone),) if len(known.geometry) == 3 else ()
        return self._at_rows(known, frames, found, rows), exact

    def _surroundings(self) -> tuple[Surroundings | None, str]:
        if self._posed is not None:
            return self._posed.known, ""
        scales = {one.name: one.scale for one in self._camera.calibrations[0].used}
        moved = {name: 1.0 / scale.value_m_per_px for name, scale in scales.items() if scale is not None}
        return known_surroundings(self._tracked.view.settings.first_camera, self._tracked.tracking, self._seen, moved)

    def _views(self) -> list[View]:
        """The axes with an acceleration of their own."""
        view = self._tracked.view
        fused = [one for one in (view, view.across)[: len(self._sides)] if one is not None and one.fused]
        return [replace(view_of(one), scale=None, printed=None) for one in fused]

    def _at_accelerometer(self, pose: Floats) -> Floats:
        """Translations (n, 3) of the accelerometer's place."""
        return np.asarray(pose[:, :3] - np.cross(pose[:, 3:], self._lever_m))

    def _own(self, number: int) -> Along:
        """By the calibration of the poses' own translation."""
        assert self._posed is not None
        own = self._tracked.calibrations[number]
        sign, offset_ns = -float(np.sign(own.scale.value_m_per_px)), round(NANOSECONDS * own.offset.value_s)
        return Along(*self._posed.gain(own), sign, own.variance_factor, offset_ns)

    def _fit(self, view: View, frames: Poses, known: Surroundings, side: Side) -> Along:
        """By the acceleration, in pixels of the nearest target."""
        axis = AXES.index(view.axis)
        px_per_m = float(np.mean(known.geometry.focal_px) * np.max(known.geometry.inverse_distance))
        variance = px_per_m**2 * frames.covariance[:, axis, axis]
        moved = px_per_m * self._at_accelerometer(frames.value)[:, axis]
        if axis == 0:
            track = replace(self._seen.track, x_px=moved, variance_x_px2=variance)
        else:
            track = replace(self._seen.track, y_px=moved, variance_y_px2=variance)
        fit = scale_of(view, camera_pair(view, track, self._blur_s()))
        scale, own = fit.scale, side.calibration
        gain = abs(scale.value_m_per_px) * px_per_m / own.accelerometer_scale
        relative = np.sqrt(scale.variance) / abs(scale.value_m_per_px)
        std = float(np.linalg.norm((relative, max(own.accelerometer_scale_std, self._scale_std)))) * gain
        offset_ns = round(NANOSECONDS * view.offset(fit.search.offset).value_s)
        return Along(gain, std, float(np.sign(scale.value_m_per_px)), fit.variance_factor, offset_ns, fit)

    def _blur_s(self) -> float:
        return self._tracked.view.exposure_s or self._camera.calibrations[0].exposure_s

    def _at_rows(self, known: Surroundings, frames: Poses, found: dict[int, Along], rows: Rows) -> CameraPose:
        calibrated = self._camera.calibrations[0]
        factors = [one.variance_factor for one in found.values()] or [calibrated.variance_factor]
        frames = replace(frames, covariance=float(np.mean(factors)) * frames.covariance)
        offsets = [one.offset_ns for one in found.values()] or [round(NANOSECONDS * calibrated.offset.value_s)]
        stamps_ns = self._seen.track.time_ns + offsets[0]
        # The zero is the first frame's place, as all frames show it: what that frame itself errs by is in all others.
        time_ns = np.concatenate((stamps_ns[:1], rows.estimates[0].time_ns))
        value, own = np.empty((len(time_ns), 6)), np.empty((len(time_ns), 6))
        for axis in (3, 4, 5, 0, 1, 2):
            if axis not in found:
                block = block_of(stamps_ns, frames.value[:, axis], frames.covariance[:, axis, axis])
                value[:, axis], own[:, axis] = smoothed(block, time_ns)
                continue
            number, along = list(found).index(axis), found[axis]
            if self._posed is None:
                moved = along.sign * self._at_accelerometer(frames.value)[:, axis]
                block = block_of(stamps_ns, moved, frames.covariance[:, axis, axis])
                moved, own[:, axis] = at(self._with_acceleration(number, along, block), time_ns)
            else:
                # What is measured is the displacement itself.
                zero, estimate = rows.zero_variance_m2[number], rows.estimates[number]
                moved = np.concatenate(([0.0], estimate.displacement_m))
                own[:, axis] = np.concatenate(([zero], estimate.variance_m2 - zero))
            value[:, axis] = along.sign * moved + np.cross(value[:, 3:], self._lever_m)[:, axis]
        value, zeros, own = value[1:] - value[0], own[0], np.maximum(own[1:], 0.0)
        slopes = by_geometry(known.geometry, value, self._seen.usual_px2)
        shape = np.einsum("npk,kl,npl->np", slopes, known.covariance, slopes, optimize=True)
        if self._posed is not None:
            # The displacement's band has it already.
            shape[:, list(found)] = 0.0
        return CameraPose(value, np.sqrt(own + shape + zeros), np.sqrt(zeros))

    def _with_acceleration(self, number: int, along: Along, block: Displacement) -> Estimate:
        view, gain = self._views()[number], self._sides[number].calibration.accelerometer_scale
        assert along.fit is not None
        noise = along.fit.input_noise
        felt = view.prepared.with_noise(noise.density, noise.motion_s)
        felt = Acceleration(felt.time_ns, felt.value_m_s2 / gain, felt.noise_density / gain**2)
        block = at_instants(block, self._blur_s(), felt)
        return smooth(
            felt, block, filter_settings(view.prepared, noise.density, lean=along.fit.search.pair.lean)
        ).estimate


PREFIX = "camera: the result has no columns of its translation and rotation: "
