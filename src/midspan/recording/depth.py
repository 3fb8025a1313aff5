"""Motion of a camera along its view, by how much the picture of a target at a known distance grows.

A camera that comes nearer by t to a target at the distance d sees it grow by a share z = t / (d − t). The
`registration` tracker measures z frame by frame. A focus that moves looks the same: the notice says so.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan.engine.sensor_series import CameraResult, TargetResult
from midspan.notices import Notice, rounded
from midspan.recording.tracked import TrackedCamera
from midspan.recording.unfelt import MIN_FRAMES, block_of, smoothed
from midspan.records import NANOSECONDS, Floats, Nanoseconds
from midspan.signals.medians import white_noise

# Tilt of a camera of which nothing is known, rad: 5 mdeg, of a box on a footbridge.
USUAL_TILT = float(np.radians(5e-3))


@dataclass(frozen=True, slots=True, eq=False)
class AlongView:
    """Translation (n,) along the view since the first frame, its standard deviation (n,), of these that of the zero, m,
    and what is worth reporting.
    """

    value_m: Floats
    std_m: Floats
    zero_std_m: float
    notice: Notice


def along_view(camera: CameraResult, tracked: TrackedCamera, time_ns: Nanoseconds) -> AlongView | None:
    """The motion along the view at stamps (n,); None where no target at a declared distance shows it."""
    settings = tracked.view.settings.first_camera
    declared = {} if settings is None else dict(zip(settings.target_names, settings.target, strict=True))
    seen = list[tuple[float, TargetResult, tuple[float, float]]]()
    for target in camera.targets:
        known = declared[target.name].inverse_distance if target.name in declared else None
        if known is not None and known[0] > 0.0 and np.count_nonzero(_usable(target)) >= MIN_FRAMES:
            noise = float(np.sqrt(np.median(target.track.variance_zoom[_usable(target)]))) / known[0]
            seen.append((noise, target, known))
    if not seen:
        return None
    _, target, (inverse, inverse_std) = min(seen, key=lambda one: one[0])
    track, usable = target.track, _usable(target)
    zoom, variance = track.zoom[usable], track.variance_zoom[usable]
    # What the tracker says goes with where the target is between pixels, too: smoothing does not take it.
    between = float(np.median(variance)) / inverse**2
    variance = variance * max(white_noise(zoom) ** 2 / float(np.median(variance)), 1.0)
    calibrated = camera.calibrations[0]
    stamps = track.time_ns[usable] + round(NANOSECONDS * calibrated.offset.value_s)
    moved, growth = zoom / (1.0 + zoom) / inverse, (1.0 + zoom) ** -2 / inverse
    block = block_of(stamps, moved, growth**2 * variance)
    value, own = smoothed(block, np.concatenate((stamps[:1], time_ns)))
    value, zero, own = value[1:] - value[0], own[0], own[1:]
    # A target's picture grows with its place by the lens' distortion, and with the tilt off the optical axis.
    place = np.column_stack((track.x_px, track.y_px))[usable]
    with_place = _explained(zoom, place) / inverse
    tilted = 2.0 * _off_axis(camera, target, tracked) * USUAL_TILT / inverse
    systematic = between + with_place**2 + tilted**2 + (inverse_std / inverse * value) ** 2
    std = np.sqrt(own + zero + systematic)
    text = (
        f"camera: translation_z_mm comes from the size of target {target.name} in the image (± "
        f"{rounded(1e3 * float(np.median(std)))} mm). A focus that moves looks the same: lock it."
    )
    return AlongView(value, std, float(np.sqrt(zero)), Notice("depth-by-size", text))


def _usable(target: TargetResult) -> NDArray[np.bool_]:
    track = target.track
    found: NDArray[np.bool_] = np.isfinite(track.zoom + track.variance_zoom + track.x_px + track.y_px)
    return found


def _explained(zoom: Floats, place: Floats) -> float:
    """What of a zoom (n,) goes with the place (n, 2) in the picture, rms."""
    centred, own = place - np.mean(place, axis=0), zoom - np.mean(zoom)
    with_place = centred @ np.linalg.lstsq(centred, own, rcond=None)[0]
    return float(np.sqrt(np.mean(with_place**2)))


def _off_axis(camera: CameraResult, target: TargetResult, tracked: TrackedCamera) -> float:
    """Tangent of how far off the optical axis a target is; without a lens that of a wide one."""
    lens, region, (rows, columns) = tracked.tracking.settings.lens, target.region, camera.reference.shape[:2]
    middle = np.array([region.x + 0.5 * (region.width - 1), region.y + 0.5 * (region.height - 1)])
    if lens is None:
        return float(np.linalg.norm(middle - 0.5 * np.array([columns - 1, rows - 1])) / max(rows, columns))
    tangent: Floats = (middle - np.array(lens.matrix[2:4])) / np.array(lens.matrix[:2])
    return float(np.linalg.norm(tangent))
