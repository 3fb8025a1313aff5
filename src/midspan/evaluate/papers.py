"""The papers' experiments with camera and accelerometer, repeated on their simulated scenes.

Camera alone: a tracker learns from the calibration's frames where it can, its scale factor is fitted by least squares,
and then it gets the filter's prediction with every frame, as in the papers. Fused: calibration and estimation of the
recording as a user runs them. Errors are root mean squares of one excitation each, without its mean.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from midspan.calibration.sensors.camera_scale import CameraScale
from midspan.engine.sensors import ACROSS_STD_PX, MIN_STD_PX
from midspan.fusion.streams import KalmanFilter, KalmanSettings
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.estimate import estimate
from midspan.recording.streams.recording import open_recording
from midspan.records import Acceleration, Floats, Frame, PixelTrack, PixelTranslation, Prediction, part
from midspan.simulate.scenarios.papers import ACCELEROMETER, CALIBRATION, Film
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest
from midspan.vision.tracker import Tracker, open_tracker

# What the displacement that the scale factor is fitted to is off by, as a share of its size; as of an accelerometer.
REFERENCE_NOISE = 0.0015


@dataclass(frozen=True, slots=True)
class CameraAlone:
    """Error of each excitation in mm (NaN where the target was never seen), the scale factor in mm/px, frames lost."""

    rmse_mm: dict[str, float]
    scale_mm_per_px: float
    lost: int

    @property
    def mean_mm(self) -> float:
        """Mean over the excitations, mm."""
        return float(np.mean(list(self.rmse_mm.values())))


@dataclass(frozen=True, slots=True)
class Fused:
    """Error of each excitation in mm, and the root mean square over all of them with the error of the zero in it."""

    rmse_mm: dict[str, float]
    whole_mm: float

    @property
    def mean_mm(self) -> float:
        """Mean over the excitations, mm."""
        return float(np.mean(list(self.rmse_mm.values())))


def recorded_frames(folder: Path) -> list[Frame]:
    """The frames of a recording of `write_recording` as they come out of its video, with their stamps."""
    return list(open_frames(folder / "camera.mkv", FrameRequest(times=folder / "camera_times.csv")).frames())


def camera_alone(film: Film, frames: Sequence[Frame], *, tracker: str, settings: Any = None) -> CameraAlone:
    """Track the frames of a film (n,) with the tracker of that name; `settings`: its record, its defaults without one.

    The error is taken against the displacement averaged over each exposure: more a camera alone cannot tell.
    """
    count = int(np.searchsorted(film.stamps_s + film.time_offset_s, film.spans[CALIBRATION][1]))
    follower = open_tracker(tracker, frames[0], film.region, settings)
    if follower.frames_to_learn:
        follower.learn(frames[:count])
    begun = PixelTrack.stack([follower.push(frame) for frame in frames[:count]])
    scale = _fitted_scale(film, begun)
    found = _with_predictions(film, frames[count:], follower, (begun, scale))
    px = np.concatenate([begun.along(film.scene.direction)[0], found])
    error_mm = 1e3 * (scale * px - film.seen_m())
    rmse = by_excitation(film, film.stamps_s + film.time_offset_s, error_mm)
    return CameraAlone(rmse, 1e3 * scale, int(np.count_nonzero(~np.isfinite(px))))


def _fitted_scale(film: Film, track: PixelTrack) -> float:
    """Metres a pixel by least squares, from the calibration's frames."""
    px = track.along(film.scene.direction)[0]
    known = film.seen_m()[: len(px)]
    known = known + np.random.default_rng(5).normal(0.0, REFERENCE_NOISE * float(np.std(known)), len(px))
    usable = np.isfinite(px)
    px, known = px[usable] - np.mean(px[usable]), known[usable] - np.mean(known[usable])
    return float(px @ known / (px @ px))


def _with_predictions(film: Film, frames: Sequence[Frame], tracker: Tracker, begun: tuple[PixelTrack, float]) -> Floats:
    """Translation (n,) in px in frames that are looked for where the filter expects it; `begun`: track and scale."""
    track, scale_m_per_px = begun
    along = film.scene.direction
    scale = CameraScale(scale_m_per_px, along, round(1e9 * film.time_offset_s))
    series = film.acceleration
    density = ACCELEROMETER.noise_std_m_s2**2 / ACCELEROMETER.rate_hz
    acceleration = Acceleration(series.time_ns, series.value, np.full(len(series.time_ns), density))
    kalman = KalmanFilter(KalmanSettings(bias=float(np.mean(series.value))))
    kalman.push(scale.displacement(track))
    found: list[PixelTranslation] = []
    pushed, across_px = 0, 0.0
    for frame in frames:
        at_ns = frame.time_ns + scale.time_offset_ns
        due = int(np.searchsorted(series.time_ns, at_ns, side="right"))
        kalman.push(part(acceleration, slice(pushed, due)))
        pushed = due
        found.append(tracker.push(frame, _expected(kalman.predict(at_ns), scale, across_px)))
        kalman.push(scale.displacement(PixelTrack.stack(found[-1:])))
        across = found[-1].y_px if along == "x" else found[-1].x_px
        across_px = across if np.isfinite(across) else across_px
    return PixelTrack.stack(found).along(along)[0]


def _expected(predicted: tuple[float, float], scale: CameraScale, across_px: float) -> Prediction | None:
    """Where a displacement (m, with its variance) is in the picture; across its axis where it was last."""
    std = max(float(np.sqrt(predicted[1])) / abs(scale.scale_m_per_px), MIN_STD_PX)
    if not np.isfinite(std):
        return None
    value = predicted[0] / scale.scale_m_per_px
    if scale.direction == "x":
        return Prediction(value, across_px, std, ACROSS_STD_PX)
    return Prediction(across_px, value, ACROSS_STD_PX, std)


def by_excitation(film: Film, time_s: Floats, error_mm: Floats) -> dict[str, float]:
    """Standard deviation in mm of an error (n,) at true times (n,) in each excitation; what is NaN does not count."""
    found = {}
    for name, (start, stop) in film.spans.items():
        inside = (time_s >= start) & (time_s < stop) & np.isfinite(error_mm)
        if name != CALIBRATION:
            found[name] = float(np.std(error_mm[inside])) if inside.any() else float("nan")
    return found


def fused(film: Film, folder: Path, *, tracker: str, methods: Sequence[str]) -> dict[str, Fused]:
    """Calibrate and estimate the film's recording in `folder`; a method with " as printed" behind it is run literally.

    The frames are tracked once for all methods. The error is taken against the displacement of the moment.
    """
    recording = open_recording(folder, camera={"tracker": tracker})
    calibration, tracking = calibrate_and_track(recording)
    out = {}
    for method in methods:
        name, _, literal = method.partition(" as ")
        asked = open_recording(folder, camera={"tracker": tracker}, fusion={"method": name, "literal": bool(literal)})
        result = estimate(asked, calibration, method=name, tracking=tracking)
        time_s = result.estimate.time_ns / 1e9
        error_mm = 1e3 * (result.estimate.displacement_m - film.truth_m(time_s))
        after = time_s >= film.spans[CALIBRATION][1]
        whole = float(np.sqrt(np.mean(error_mm[after] ** 2)))
        out[method] = Fused(by_excitation(film, time_s, error_mm), whole)
    return out
