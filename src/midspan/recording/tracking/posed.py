"""A camera whose targets show all six degrees of freedom, as one target that its rotation does not move.

Targets apart from each other in the picture move by a roll, and with the distance, too: as displacements they
contradict each other. The translations of the poses do not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from midspan.calibration.camera.geometry import Placed, Surroundings, surroundings
from midspan.calibration.sensors.camera import CameraCalibration
from midspan.engine.camera import Target
from midspan.engine.tracking import CameraTracking, StoredTarget, StoredTracking, TargetTracking
from midspan.errors import UntrustedError
from midspan.notices import Notice, rounded
from midspan.recording.streams.recording import Recording
from midspan.recording.tracking.opening import lens_of
from midspan.records import Floats, Nanoseconds, PixelTrack, Region, ScaleFactor, Status, seconds
from midspan.settings.camera import CameraSettings
from midspan.signals.health import runs
from midspan.vision.frame_source import StoredTrack
from midspan.vision.lens import Lens
from midspan.vision.pose import Poses, by_geometry, inflation, poses

AXES = ("x", "y")
# Where the translation is this many times as uncertain as with the rotation known, the displacement is left to the
# targets' difference.
MAX_INFLATION = 5.0
# Squared residuals over their variances, in blocks of this many frames: the targets do not keep their places where one
# block has this many times the quiet ones, or all have more than trackers' variances are wrong by.
BLOCK, LARGER, MOST = 100, 4.0, 25.0


@dataclass(frozen=True, slots=True, eq=False)
class SeenFrames:
    """What a camera's targets show: names, the middles of their regions in the frames, px; moved_px and variance_px2
    (n, k, 2); track: of the first of them, whose stamps are all frames'.
    """

    names: tuple[str, ...]
    middles_px: tuple[tuple[float, float], ...]
    moved_px: Floats
    variance_px2: Floats
    track: PixelTrack

    @property
    def usual_px2(self) -> Floats:
        """Variances (k, 2) of a frame that shows all targets; infinite where none does."""
        whole = np.isfinite(self.variance_px2).all(axis=(1, 2))
        found: Floats = np.median(self.variance_px2[whole], axis=0)
        return found if whole.any() else np.full(self.variance_px2.shape[1:], np.inf)

    def poses(self, known: Surroundings) -> Poses:
        """The pose in each frame; while a target is not seen, as uncertain as the others differ from all of them.

        That goes with the geometry's errors and lasts: its variance is for the mean over such a time.
        """
        found = poses(known.geometry, self.moved_px, self.variance_px2)
        seen = np.isfinite(np.sum(self.moved_px + self.variance_px2, axis=-1))
        whole = np.asarray(seen.all(axis=1))
        if np.count_nonzero(whole) < BLOCK:
            return found
        covariance = found.covariance.copy()
        for some in np.unique(seen[~whole & (seen.sum(axis=1) > 2)], axis=0):
            moved = np.where(some[:, None], self.moved_px[whole], np.nan)
            apart = poses(known.geometry, moved, self.variance_px2[whole]).value - found.value[whole]
            here = (seen == some).all(axis=1)
            for first, end in runs(here).tolist():
                covariance[first:end] += (end - first) * np.diag(np.mean(apart**2, axis=0))
        return replace(found, covariance=covariance)

    def slopes(self, known: Surroundings, frames: Poses, axis: int) -> tuple[Floats, Floats]:
        """By how much the parameters of the geometry change the motion along an axis, relative (1 + k,), and what each
        does besides in the frames that show it (n, 1 + k).
        """
        seen = np.isfinite(frames.value[:, axis])
        own = by_geometry(known.geometry, frames.value[seen], self.usual_px2)[:, axis]
        # Slow motions of the other degrees are no part of it.
        change, moves = np.diff(own, axis=0), np.diff(frames.value[seen, axis])
        relative = moves @ change / (moves @ moves)
        return relative, own - np.outer(frames.value[seen, axis], relative)


def seen_frames(targets: Sequence[Any]) -> SeenFrames:
    """What targets show, with the variances of single frames; each has a name, a region, a track and reference_px2."""
    first = targets[0].track
    moved, variance = zip(*(_at_once(one.track, first.time_ns) for one in targets), strict=True)
    reference = np.array([one.reference_px2 for one in targets])
    middles = [_middle(one.region) for one in targets]
    names = tuple(one.name for one in targets)
    shape = (1, 0, 2)
    single = np.transpose(np.array(variance) - reference, shape)
    return SeenFrames(names, tuple(middles), np.transpose(np.array(moved), shape), single, first)


def _middle(region: Region) -> tuple[float, float]:
    return region.x + 0.5 * (region.width - 1), region.y + 0.5 * (region.height - 1)


def _at_once(track: PixelTrack, time_ns: Nanoseconds) -> tuple[Floats, Floats]:
    """Translations and variances (n, 2) of a target at these stamps, near its own, which a rolling shutter makes."""
    place = np.column_stack((track.x_px, track.y_px))
    variance = np.column_stack((track.variance_x_px2, track.variance_y_px2))
    late_s = seconds(time_ns, 0) - seconds(track.time_ns, 0)
    if np.any(late_s) and len(place) > 2:
        place = place + late_s[:, None] * np.gradient(place, seconds(track.time_ns, int(track.time_ns[0])), axis=0)
    return place, variance


def known_surroundings(
    camera: CameraSettings | None, tracking: CameraTracking, seen: SeenFrames, px_per_m: dict[str, float]
) -> tuple[Surroundings | None, str]:
    """What a camera looks at; None where that is not known or does not show all six degrees, and why.

    px_per_m: by which targets move with the displacement, by name. No word where no distance is declared.
    """
    declared = {} if camera is None else dict(zip(camera.target_names, camera.target, strict=True))
    lens = tracking.settings.lens
    if not any(one.distance_m is not None for one in declared.values()):
        return None, ""
    if lens is None:
        return None, "they need the focal length, in a section camera.lens." if len(declared) > 2 else ""
    if why := unseen_as_declared(camera, lens):
        return None, why
    placed = [
        Placed(name, middle, declared[name].inverse_distance if name in declared else None, px_per_m.get(name))
        for name, middle in zip(seen.names, seen.middles_px, strict=True)
    ]
    if (known := surroundings(placed, lens)) is None:
        return None, "the distances of the targets do not follow from those declared. Add distance_m to each."
    usual = seen.usual_px2
    if not np.isfinite(usual).all():
        return None, "no frame shows all targets."
    why = known.unseen(usual)
    return (None, why) if why else (known, "")


def six_degrees(view: Recording) -> str:
    """Whether the targets of a camera's view show all six degrees of freedom as declared, in words; none where their
    distances or the lens are not.
    """
    camera, lens = view.settings.first_camera, lens_of(view)
    if camera is None or lens is None or not camera.target or any(one.distance_m is None for one in camera.target):
        return ""
    why = unseen_as_declared(camera, lens)
    return f"six degrees of freedom of the camera: {why or 'all are seen by its targets.'}"


def unseen_as_declared(camera: CameraSettings | None, lens: Lens) -> str:
    """Why the targets of the settings, all of them, do not show all six degrees; empty where they may."""
    if camera is None or any(one.distance_m is None for one in camera.target):
        return ""
    placed = [
        Placed(name, _middle(Region(*one.roi)), one.inverse_distance, None)
        for name, one in zip(camera.target_names, camera.target, strict=True)
    ]
    known = surroundings(placed, lens) if placed else None
    return "" if known is None else known.unseen(np.ones((len(placed), 2)))


def is_steady(frames: Poses) -> bool:
    """Whether targets beyond three keep their places in the frames; true where there is none to check."""
    spare = frames.spare > 0.0
    if np.count_nonzero(spare) < BLOCK:
        return True
    ratio = frames.misfit[spare] / frames.spare[spare]
    # A block's median is not moved by what covers a target for a while.
    level = [float(np.median(part)) for part in np.array_split(ratio, max(len(ratio) // BLOCK, 1))]
    usual = float(np.quantile(level, 0.25))
    return max(level) < LARGER * max(usual, 1.0) and usual < MOST


def _unsteady(frames: SeenFrames, known: Surroundings) -> str:
    """That targets do not keep their places, and without which one the others do."""
    names, others = frames.names, []
    for k in range(len(names) if len(names) > 4 else 0):
        rest = np.arange(len(names)) != k
        own = known.geometry
        geometry = replace(own, place_px=own.place_px[rest], inverse_distance=own.inverse_distance[rest])
        if is_steady(poses(geometry, frames.moved_px[:, rest], frames.variance_px2[:, rest])):
            others.append(names[k])
    remedy = f"Without {others[0]} the others agree: remove it" if len(others) == 1 else "A further target shows which"
    return (
        "camera: its targets do not keep their places relative to each other: one moves on its own, or a declared "
        f"distance_m is wrong. {remedy}."
    )


class PosedTracking(StoredTracking):
    """The tracking of one target at the distance of the nearest, as the translations of the poses move it.

    inner: the tracking of the targets, which is at its end; lever_m: from the accelerometer, whose translation it is,
    to the camera.
    """

    def __init__(
        self, inner: CameraTracking, known: Surroundings, frames: SeenFrames, lever_m: Sequence[float]
    ) -> None:
        self.inner, self.frames, self.known = inner, frames, known
        self.lever_m = np.array(lever_m)
        self.source, self.progress = inner.source, inner.progress
        self.px_per_m = float(np.mean(known.geometry.focal_px) * np.max(known.geometry.inverse_distance))
        nearest = inner.targets[int(np.argmax(known.geometry.inverse_distance))]
        self.settings = replace(inner.settings, targets=(Target(nearest.region),))
        self.time_ns, self.reference = inner.time_ns, inner.reference
        self.chain: Any = self
        track = StoredTrack("1", nearest.region, self._rows(), nearest.strengths, np.zeros((len(frames.moved_px), 2)))
        own: Any = StoredTarget(self.reference, track, self.settings.readout_s, 0)
        self.targets = (TargetTracking(own),)
        self.targets[0].add_stored(track, slice(None))
        self.chosen = self.settings.targets
        self.skipped, self.done = inner.skipped, inner.done
        self.choice, self.range_surface, self.companions = None, None, ()

    def _rows(self) -> PixelTrack:
        solved, track = self.frames.poses(self.known), self.frames.track
        moved = solved.value[:, :3] - np.cross(solved.value[:, 3:], self.lever_m)
        values = {axis: -self.px_per_m * moved[:, k] for k, axis in enumerate(AXES)}
        variances = {axis: self.px_per_m**2 * solved.covariance[:, k, k] for k, axis in enumerate(AXES)}
        measured = np.isfinite(values["x"])
        unknown = np.full(len(measured), np.nan)
        return replace(
            track,
            x_px=values["x"],
            y_px=values["y"],
            variance_x_px2=variances["x"],
            variance_y_px2=variances["y"],
            quality=np.where(measured, 1.0, 0.0),
            status=np.where(measured, Status.TRACKING, Status.LOST).astype(np.uint8),
            zoom=unknown,
            variance_zoom=unknown,
        )

    def shape_std_m(self, axis: str) -> float:
        """What errors of the geometry make of the displacement along an axis, rms, besides its size."""
        solved = self.frames.poses(self.known)
        _, left = self.frames.slopes(self.known, solved, AXES.index(axis))
        left = left - np.mean(left, axis=0)
        return float(np.sqrt(np.mean(np.einsum("nk,kl,nl->n", left, self.known.covariance, left))))

    def gain(self, calibration: CameraCalibration) -> tuple[float, float]:
        """By what the accelerometer shows the motion to be larger than the geometry says, and its deviation."""
        gain = abs(calibration.scale.value_m_per_px) * self.px_per_m
        return gain, calibration.relative_std * gain

    def as_declared(self, known: CameraCalibration) -> CameraCalibration:
        """A calibration of the targets as that of the poses: the scale factor is what distances and lens say."""
        axis, names = AXES.index(known.direction), self.frames.names
        moved = {one.name: 1.0 / one.scale.value_m_per_px for one in known.used if one.scale is not None}
        inverse = self.known.geometry.inverse_distance
        near, far = (moved.get(names[int(k)], 0.0) for k in (np.argmax(inverse), np.argmin(inverse)))
        slopes, _ = self.frames.slopes(self.known, self.frames.poses(self.known), axis)
        relative = float(slopes @ self.known.covariance @ slopes)
        value = float(np.sign(near - far or 1.0)) / self.px_per_m
        variance = self.targets[0].rows.along(known.direction)[1]
        # What the targets move against each other by, as displacements, is no noise of the poses.
        noise = {one.name: one.noise_std_px**2 for one in known.used}
        usual = dict(zip(names, self.frames.usual_px2[:, axis].tolist(), strict=True))
        factors = [noise[name] / usual[name] for name in names if name in noise]
        return replace(
            known,
            variance_factor=float(np.mean(factors)) if factors else known.variance_factor,
            scale=ScaleFactor(value, relative * value**2),
            region=self.targets[0].region,
            noise_std_px=float(np.sqrt(np.median(variance[np.isfinite(variance)]))),
            targets=(),
            relative_scale_std=None,
            apart_std_m=self.shape_std_m(known.direction),
            slow_std_m=0.0,
            tilt_std_px=0.0,
        )

    def agrees(self, calibration: CameraCalibration) -> bool:
        """Whether the accelerometer shows the geometry to be as declared."""
        gain, std = self.gain(calibration)
        slopes, _ = self.frames.slopes(self.known, self.frames.poses(self.known), AXES.index(calibration.direction))
        return self.known.with_gain(gain, std**2, slopes) is not None

    def warnings(self, axes: str | None = None) -> list[Notice]:
        """What of the targets' frames is worth reporting."""
        hidden = ~np.isfinite(np.sum(self.frames.moved_px, axis=-1))
        share = 100.0 * float(np.mean(np.any(hidden, axis=1)))
        if share == 0.0:
            return self.inner.warnings(axes)
        names = ", ".join(name for k, name in enumerate(self.frames.names) if np.any(hidden[:, k]))
        text = f"camera: {rounded(share)} % of the frames do not show {names}; the error band is wider there."
        return [*self.inner.warnings(axes), Notice("lost", text)]

    def close(self) -> None:
        """Let the file go."""
        self.inner.close()
        for one in self.companions:
            one.close()


def posed(camera: CameraSettings | None, tracking: CameraTracking, lever_m: Sequence[float]) -> CameraTracking:
    """The tracking by poses where all distances are declared and all six degrees show well; else as it is."""
    declared = () if camera is None else camera.target
    if len(declared) < 3 or any(one.distance_m is None for one in declared) or tracking.settings.lens is None:
        return tracking
    # Of a thermal camera the range is looked for target by target, and phases calibrate to a factor of their own.
    if tracking.settings.thermal or any(one.tracker.phase_gain_px_per_rad is not None for one in tracking.targets):
        return tracking
    tracking.until(int(tracking.time_ns[-1]))
    frames = seen_frames(tracking.targets)
    known, _ = known_surroundings(camera, tracking, frames, {})
    if known is None or np.max(inflation(known.geometry, frames.usual_px2)[:2]) > MAX_INFLATION:
        return tracking
    if not is_steady(frames.poses(known)):
        raise UntrustedError(_unsteady(frames, known))
    return PosedTracking(tracking, known, frames, lever_m)
