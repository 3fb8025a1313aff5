"""Translation and rotation of a camera as columns of the result, where its targets show all six degrees of freedom.

Frame by frame the targets give the camera's pose (`vision/pose.py`). Each degree is then smoothed to the rows' times as
a motion of constant velocity whose changes are as large as the frames show; that along the accelerometer's axis with
the acceleration.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.calibration.camera.geometry import Placed, Surroundings, contradicted, surroundings
from midspan.calibration.camera.view import View, camera_pair, filter_settings, scale_of
from midspan.calibration.minimum import global_minimum
from midspan.calibration.scale import ScaleCalibration
from midspan.engine.sensor_series import CameraResult
from midspan.errors import UntrustedError
from midspan.fusion.path import at
from midspan.fusion.streams import NO_ERRORS, KalmanSettings, filtered, smooth
from midspan.notices import Notice
from midspan.recording.cameras import view_of
from midspan.recording.tracked import Side, TrackedCamera
from midspan.records import (
    NANOSECONDS,
    Acceleration,
    Displacement,
    Estimate,
    Floats,
    Nanoseconds,
    PixelTrack,
    Source,
    seconds,
)
from midspan.signals.averaging import at_instants
from midspan.vision.lens import Lens
from midspan.vision.pose import Poses, by_geometry, poses

AXES = ("x", "y")
# Frames that the changes of a motion are estimated from.
LEARNED_FRAMES = 4000
# How far the density of the acceleration of such a motion may be from what its frames say at once, decades.
DECADES = 4.0
# An innovation beyond this many standard deviations counts as that many.
CAPPED = 4.0
UNITS = (1e3, 1e3, 1e3, *[1e3 * float(np.degrees(1.0))] * 3)


@dataclass(frozen=True, slots=True, eq=False)
class CameraPose:
    """Where a camera is: value (n, 6), translation (m) and rotation vector (rad) about its own axes x (right), y (down)
    and z (along the view) since the first frame used, with standard deviations; zero_std (6,): the part of these that
    the zero makes, common to all rows.
    """

    value: Floats
    std: Floats
    zero_std: Floats

    def columns(self) -> dict[str, Floats]:
        """The columns of the result, mm and mdeg."""
        found = dict[str, Floats]()
        for k, axis in enumerate("xyz" * 2):
            name, unit = ("translation", "mm") if k < 3 else ("rotation", "mdeg")
            found[f"{name}_{axis}_{unit}"] = UNITS[k] * self.value[:, k]
            found[f"{name}_{axis}_std_{unit}"] = UNITS[k] * self.std[:, k]
        return found

    def metadata(self) -> dict[str, list[float]]:
        """The zero's part, three values each."""
        zero = (self.zero_std * UNITS).tolist()
        return {"translation_zero_std_mm": zero[:3], "rotation_zero_std_mdeg": zero[3:]}


def camera_pose(
    seen: Sequence[tuple[CameraResult, TrackedCamera]], sides: Sequence[Side], rows: Estimate
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
    return None, notices


class _Camera:
    """One camera: what its targets show in each frame, on the accelerometer's clock."""

    def __init__(self, camera: CameraResult, tracked: TrackedCamera, sides: Sequence[Side]) -> None:
        self._camera, self._tracked, self._sides = camera, tracked, sides
        self._settings = tracked.view.settings.first_camera
        self._lens: Lens | None = camera.calibrations[0].lens
        own = sides[0].recording.settings.accelerometer
        self._lever_m = np.array((0.0, 0.0, 0.0) if own is None else own.camera_offset_m)
        self._scale_std = 0.0 if own is None else own.scale_std
        best = self._best = camera.targets[camera.best].track
        moved, variance = zip(*(_at_once(one.track, best.time_ns) for one in camera.targets), strict=True)
        reference = np.array([one.reference_px2 for one in camera.targets]).swapaxes(0, 1)
        self._moved_px = np.array(moved).swapaxes(0, 1)
        self._variance_px2 = np.array(variance).swapaxes(0, 1) - reference
        self._usual_px2 = np.median(self._variance_px2[np.isfinite(self._variance_px2).all(axis=(1, 2))], axis=0)

    def pose(self, rows: Estimate) -> tuple[CameraPose | None, tuple[Notice, ...]]:
        """The pose at the rows, and what is worth reporting."""
        known, why = self._surroundings()
        if known is None:
            return None, (Notice("pose-unseen", f"{PREFIX}{why}"),) if why else ()
        frames = self._solved(known)
        # The accelerometer tells how large the motion along its axis is.
        fits = dict[int, ScaleCalibration]()
        for view, side in zip(self._views(), self._sides, strict=False):
            axis = AXES.index(view.axis)
            try:
                fits[axis] = self._fit(view, frames, known)
            except UntrustedError:
                continue
            gain, std = self._gain(fits[axis], known, side)
            sharper = known.with_gain(gain, std**2, self._slopes(known, frames, axis))
            if sharper is None:
                return None, (contradicted(known.names, view.axis, gain),)
            known = sharper
            frames = self._solved(known)
        if why := known.unseen(self._usual_px2):
            return None, (Notice("pose-unseen", f"{PREFIX}{why}"),)
        return self._at_rows(known, frames, fits, rows), ()

    def _surroundings(self) -> tuple[Surroundings | None, str]:
        """What the camera looks at; None where that is not known or does not do, and why; no word where not asked."""
        camera, lens = self._settings, self._lens
        declared = {} if camera is None else dict(zip(camera.target_names, camera.target, strict=True))
        if not any(one.distance_m is not None for one in declared.values()):
            return None, ""
        if lens is None:
            three = len(self._camera.targets) > 2
            return None, "they need the focal length, in a section camera.lens." if three else ""
        scales = {one.name: one.scale for one in self._camera.calibrations[0].used}
        placed = []
        for one in self._camera.targets:
            middle = (one.region.x + 0.5 * (one.region.width - 1), one.region.y + 0.5 * (one.region.height - 1))
            scale = scales.get(one.name)
            inverse = declared[one.name].inverse_distance if one.name in declared else None
            placed.append(Placed(one.name, middle, inverse, None if scale is None else 1.0 / scale.value_m_per_px))
        if (known := surroundings(placed, lens)) is None:
            return None, "the distances of the targets do not follow from those declared. Add distance_m to each."
        why = known.unseen(self._usual_px2)
        return (None, why) if why else (known, "")

    def _views(self) -> list[View]:
        """The axes with an acceleration of their own."""
        view = self._tracked.view
        return [
            replace(view_of(one), scale=None, printed=None)
            for one in (view, view.across)
            if one is not None and one.fused
        ]

    def _solved(self, known: Surroundings) -> Poses:
        return poses(known.geometry, self._moved_px, self._variance_px2)

    def _px_per_m(self, known: Surroundings) -> float:
        """Of the nearest target."""
        return float(np.mean(known.geometry.focal_px) * np.max(known.geometry.inverse_distance))

    def _at_accelerometer(self, pose: Floats) -> Floats:
        """Translations (n, 3) of the accelerometer's place."""
        return np.asarray(pose[:, :3] - np.cross(pose[:, 3:], self._lever_m))

    def _fit(self, view: View, frames: Poses, known: Surroundings) -> ScaleCalibration:
        """The motion along an axis compared with the acceleration, in pixels of the nearest target."""
        axis, scale = AXES.index(view.axis), self._px_per_m(known)
        variance = scale**2 * frames.covariance[:, axis, axis]
        moved = scale * self._at_accelerometer(frames.value)[:, axis]
        if axis == 0:
            track = replace(self._best, x_px=moved, variance_x_px2=variance)
        else:
            track = replace(self._best, y_px=moved, variance_y_px2=variance)
        return scale_of(view, camera_pair(view, track, self._blur_s()))

    def _blur_s(self) -> float:
        return self._tracked.view.exposure_s or self._camera.calibrations[0].exposure_s

    def _gain(self, fit: ScaleCalibration, known: Surroundings, side: Side) -> tuple[float, float]:
        """By what the motion is larger than the geometry says, and its standard deviation."""
        scale, own = fit.scale, side.calibration
        gain = abs(scale.value_m_per_px) * self._px_per_m(known) / own.accelerometer_scale
        relative = np.sqrt(scale.variance) / abs(scale.value_m_per_px)
        return gain, float(np.linalg.norm((relative, max(own.accelerometer_scale_std, self._scale_std)))) * gain

    def _slopes(self, known: Surroundings, frames: Poses, axis: int) -> Floats:
        """By how much the parameters of the geometry change the motion along an axis, relative (1 + k,)."""
        seen = np.isfinite(frames.value[:, axis])
        own = by_geometry(known.geometry, frames.value[seen], self._usual_px2)[:, axis]
        # Slow motions of the others are no part of it.
        change, moves = np.diff(own, axis=0), np.diff(frames.value[seen, axis])
        return np.asarray(moves @ change / (moves @ moves))

    def _at_rows(
        self, known: Surroundings, frames: Poses, fits: dict[int, ScaleCalibration], rows: Estimate
    ) -> CameraPose:
        # What the frames scatter by, over what the tracker says.
        factors = [one.variance_factor for one in fits.values()] or [self._camera.calibrations[0].variance_factor]
        frames = replace(frames, covariance=float(np.mean(factors)) * frames.covariance)
        stamps_ns = self._stamps_ns(fits)
        # The zero is the first frame's place, as all frames show it: what that frame itself errs by is in all others.
        time_ns = np.concatenate((stamps_ns[:1], rows.time_ns))
        value, own = np.empty((len(time_ns), 6)), np.empty((len(time_ns), 6))
        views = {AXES.index(view.axis): (view, side) for view, side in zip(self._views(), self._sides, strict=False)}
        for axis in (3, 4, 5, 0, 1, 2):
            block = _block(stamps_ns, frames.value[:, axis], frames.covariance[:, axis, axis])
            if axis not in fits:
                value[:, axis], own[:, axis] = smoothed(block, time_ns)
                continue
            (view, side), fit = views[axis], fits[axis]
            sign = np.sign(fit.scale.value_m_per_px)
            moved = sign * self._at_accelerometer(frames.value)[:, axis]
            block = _block(stamps_ns, moved, block.variance_m2)
            moved, own[:, axis] = at(self._with_acceleration(view, side, fit, block), time_ns)
            value[:, axis] = sign * moved + np.cross(value[:, 3:], self._lever_m)[:, axis]
        value, zero, own = value[1:] - value[0], own[0], own[1:]
        slopes = by_geometry(known.geometry, value, self._usual_px2)
        shape = np.einsum("npk,kl,npl->np", slopes, known.covariance, slopes, optimize=True)
        return CameraPose(value, np.sqrt(own + shape + zero), np.sqrt(zero))

    def _stamps_ns(self, fits: dict[int, ScaleCalibration]) -> Nanoseconds:
        """The frames' stamps on the accelerometer's clock, by what the surest axis shows."""
        offset = self._tracked.calibrations[0].offset
        if fits:
            sharpest = min(fits.values(), key=lambda fit: fit.search.offset.variance)
            offset = self._views()[0].offset(sharpest.search.offset)
        return self._best.time_ns + round(NANOSECONDS * offset.value_s)

    def _with_acceleration(self, view: View, side: Side, fit: ScaleCalibration, block: Displacement) -> Estimate:
        noise, gain = fit.input_noise, side.calibration.accelerometer_scale
        felt = view.prepared.with_noise(noise.density, noise.motion_s)
        felt = Acceleration(felt.time_ns, felt.value_m_s2 / gain, felt.noise_density / gain**2)
        block = at_instants(block, self._blur_s(), felt)
        return smooth(felt, block, filter_settings(view.prepared, noise.density)).estimate


PREFIX = "camera: the result has no columns of its translation and rotation: "


def _at_once(track: PixelTrack, time_ns: Nanoseconds) -> tuple[Floats, Floats]:
    """Translations and variances (n, 2) of a target at these stamps, near its own, which a rolling shutter makes."""
    place = np.column_stack((track.x_px, track.y_px))
    variance = np.column_stack((track.variance_x_px2, track.variance_y_px2))
    late_s = seconds(time_ns, 0) - seconds(track.time_ns, 0)
    if np.any(late_s) and len(place) > 2:
        place = place + late_s[:, None] * np.gradient(place, seconds(track.time_ns, int(track.time_ns[0])), axis=0)
    return place, variance


def _block(time_ns: Nanoseconds, value: Floats, variance: Floats) -> Displacement:
    return Displacement(time_ns, value, variance, np.full(len(value), Source.CAMERA, dtype=np.uint8))


def smoothed(block: Displacement, time_ns: Nanoseconds) -> tuple[Floats, Floats]:
    """A motion of which nothing but measurements is known, and its variance, at stamps (n,).

    Between measurements its velocity changes by white noise, of a density that makes them likeliest.
    """
    seen = np.isfinite(block.value_m) & np.isfinite(block.variance_m2)
    block = Displacement(block.time_ns[seen], block.value_m[seen], block.variance_m2[seen], block.source[seen])
    density = _density(block)
    own = _unfelt(np.union1d(time_ns, block.time_ns[:1]), density)
    return at(smooth(own, block, _settings(block)).estimate, time_ns)


def _unfelt(time_ns: Nanoseconds, density: float) -> Acceleration:
    return Acceleration(time_ns, np.zeros(len(time_ns)), np.full(len(time_ns), density))


def _settings(block: Displacement) -> KalmanSettings:
    """Of a motion without an acceleration: no bias, and every measurement as good as its variance says."""
    # Larger than anything that the block holds.
    large = 10.0 * float(np.ptp(block.value_m)) + 100.0 * float(np.sqrt(np.max(block.variance_m2)))
    step_s = float(np.median(np.diff(block.time_ns))) / NANOSECONDS
    return KalmanSettings(
        bias_walk=0.0, displacement_std=large, velocity_std=large / step_s, bias_std=0.0, rates=NO_ERRORS,
        noise_memory=np.inf,
    )  # fmt: skip


def _density(block: Displacement) -> float:
    """Density of the acceleration, (m/s²)²/Hz, by the likelihood of the innovations."""
    used = slice(0, LEARNED_FRAMES)
    part = Displacement(*(getattr(block, name)[used] for name in Displacement.__slots__))
    settings, step_s = _settings(part), float(np.median(np.diff(part.time_ns))) / NANOSECONDS
    # What second differences are, less their noise; of white noise of the density q they are 2/3 q T³.
    bent = np.diff(part.value_m, 2)
    noise = 6.0 * float(np.median(part.variance_m2))
    first = max(float(np.mean(bent**2)) - noise, 1e-3 * noise) / (2.0 / 3.0 * step_s**3)

    def cost(decades: float) -> float:
        density = first * 10.0**decades
        found = filtered(_unfelt(part.time_ns, density), part, settings).innovation
        variance = found.variance_m2[2:]
        return float(np.sum(np.log(variance) + np.minimum(found.value_m[2:] ** 2 / variance, CAPPED**2)))

    return float(first * 10.0 ** global_minimum(cost, -DECADES, 1.0, tried=11, tolerance=0.03))
