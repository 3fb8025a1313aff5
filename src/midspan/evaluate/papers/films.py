"""The papers on camera and accelerometer on their simulated scenes: a tracker alone, and fused.

Camera alone: a tracker learns from the calibration's frames where it can, and then it gets the filter's prediction with
every frame, as in the papers. The track is judged by the true scale factor; what a fitted or a known one is off by
stands apart. Fused: calibration and estimation of the recording as a user runs them. Errors are standard deviations
over one excitation each.
"""

from collections.abc import Mapping, Sequence
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
from midspan.records import (
    Acceleration,
    Floats,
    Frame,
    PixelTrack,
    PixelTranslation,
    Prediction,
    TimeSeries,
    part,
)
from midspan.simulate.scenarios.papers import ACCELEROMETER, CALIBRATION, FRAME_RATE, Film
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest
from midspan.vision.tracker import Tracker, open_tracker

# Of the papers' calibration, Hz: from 0.3 Hz to a tenth of the camera's 29.97 frames a second.
BAND_HZ = (0.3, 3.0)


@dataclass(frozen=True, slots=True)
class CameraAlone:
    """A track: error of each excitation in mm by the true scale factor (NaN where the target was never seen).

    found_mm_per_px: the scale factor that the papers' calibration gives for it; lost: frames; good (n,): matches or
    share of the phases that agree, NaN where it was lost.
    """

    rmse_mm: dict[str, float]
    found_mm_per_px: float
    lost: int
    px: Floats
    good: Floats

    @property
    def mean_mm(self) -> float:
        """Mean over the excitations, mm."""
        return float(np.mean(list(self.rmse_mm.values())))


@dataclass(frozen=True, slots=True)
class Fused:
    """Error of each excitation in mm, and the root mean square over all of them with the error of the zero in it.

    later_mm: the error against the truth half a sample earlier: a filter that holds the acceleration is late by that.
    """

    rmse_mm: dict[str, float]
    whole_mm: float
    later_mm: dict[str, float]
    scale_mm_per_px: float

    @property
    def mean_mm(self) -> float:
        """Mean over the excitations, mm."""
        return float(np.mean(list(self.rmse_mm.values())))


def recorded_frames(folder: Path) -> list[Frame]:
    """The frames of a recording of `write_recording` as they come out of its video, with their stamps."""
    return list(open_frames(folder / "camera.mkv", FrameRequest(times=folder / "camera_times.csv")).frames())


def frames_of(film: Film) -> list[Frame]:
    """The film's frames with their stamps, as a lossless video gives them."""
    return [
        Frame(round(1e9 * s), pixels, k) for k, (s, pixels) in enumerate(zip(film.stamps_s, film.frames, strict=True))
    ]


def camera_alone(
    film: Film, frames: Sequence[Frame], *, tracker: str, settings: Any = None, by_acceleration: bool = False
) -> CameraAlone:
    """Track the frames of a film (n,) with the tracker of that name; `settings`: its record, its defaults without one.

    by_acceleration: a tracker that learns gets the accelerometer's motion in the papers' band. The error is taken
    against the displacement averaged over each exposure: more a camera alone cannot tell.
    """
    count = calibration_frames(film)
    follower = open_tracker(tracker, frames[0], film.region, settings)
    if follower.frames_to_learn:
        teach: Any = follower.learn
        shaken = {"translation_px": shaken_m(film)[:count] / film.scale_m_per_px, "direction": film.scene.direction}
        teach(frames[:count], **(shaken if by_acceleration else {}))
    begun = [follower.push(frame) for frame in frames[:count]]
    track = begun + _with_predictions(film, frames[count:], follower, PixelTrack.stack(begun))
    px = PixelTrack.stack(track).along(film.scene.direction)[0]
    found = 1e3 * printed_scale(film, px[:count])
    good = np.array([one.strength if np.isfinite(one.x_px) else np.nan for one in track])
    return CameraAlone(
        errors_mm(film, px, film.scale_m_per_px), found, int(np.count_nonzero(~np.isfinite(px))), px, good
    )


def calibration_frames(film: Film) -> int:
    """How many frames belong to the calibration."""
    return int(np.searchsorted(film.stamps_s + film.time_offset_s, film.spans[CALIBRATION][1]))


def errors_mm(film: Film, px: Floats, scale_m_per_px: float) -> dict[str, float]:
    """Error in mm of each excitation of a track (n,) in px by a scale factor."""
    error = 1e3 * (scale_m_per_px * px - film.seen_m())
    return by_excitation(film, film.stamps_s + film.time_offset_s, error)


def shaken_m(film: Film) -> Floats:
    """Displacement (n,) in m at the frames that the accelerometer gives in the papers' band: integrated twice."""
    series = film.acceleration
    rate_hz = 1e9 / float(np.median(np.diff(series.time_ns)))
    speed = np.cumsum(series.value - np.mean(series.value)) / rate_hz
    moved = np.cumsum(speed - np.mean(speed)) / rate_hz
    # A sum over the samples holds half a step more, a sum of sums a whole one.
    at_frames = np.interp(film.stamps_s + film.time_offset_s, series.time_ns / 1e9 + 1 / rate_hz, moved)
    return _in_band(at_frames, float(FRAME_RATE))


def printed_scale(film: Film, px: Floats) -> float:
    """Scale factor in m/px as the papers calibrate: least squares of displacement on a track (k,) in a band."""
    seen = np.isfinite(px)
    places = np.arange(len(px))
    whole = _in_band(np.interp(places, places[seen], px[seen]), float(FRAME_RATE))
    known, track = shaken_m(film)[: len(px)][seen], whole[seen]
    return float(track @ known / (track @ track))


def _in_band(values: Floats, rate_hz: float) -> Floats:
    """Values (n,) within BAND_HZ; the papers do not say by which filter, here Butterworth's, forwards and backwards."""
    from scipy.signal import butter, sosfiltfilt

    sections = butter(4, BAND_HZ, btype="bandpass", fs=rate_hz, output="sos")
    return np.asarray(sosfiltfilt(sections, values - np.mean(values)), dtype=np.float64)


def _with_predictions(
    film: Film, frames: Sequence[Frame], tracker: Tracker, begun: PixelTrack
) -> list[PixelTranslation]:
    """The track in frames that are looked for where the filter expects the target; `begun`: the track before."""
    scale = CameraScale(film.scale_m_per_px, film.scene.direction, round(1e9 * film.time_offset_s))
    return with_predictions(frames, tracker, begun, Loop(scale, film.acceleration))


@dataclass(frozen=True, slots=True)
class Loop:
    """What the filter that predicts knows: the camera's scale factor and clock, and the acceleration in m/s²."""

    scale: CameraScale
    acceleration: TimeSeries


def with_predictions(
    frames: Sequence[Frame], tracker: Tracker, begun: PixelTrack, loop: Loop
) -> list[PixelTranslation]:
    """The track in frames that are looked for where the filter expects the target; `begun`: the track before."""
    scale, series = loop.scale, loop.acceleration
    density = ACCELEROMETER.noise_std_m_s2**2 / ACCELEROMETER.rate_hz
    acceleration = Acceleration(series.time_ns, series.value, np.full(len(series.time_ns), density))
    kalman = KalmanFilter(KalmanSettings(bias=float(np.mean(series.value))))
    kalman.push(scale.displacement(begun))
    found: list[PixelTranslation] = []
    pushed, across_px = 0, 0.0
    for frame in frames:
        at_ns = frame.time_ns + scale.time_offset_ns
        due = int(np.searchsorted(series.time_ns, at_ns))
        kalman.push(part(acceleration, slice(pushed, due)))
        pushed = due
        found.append(tracker.push(frame, _expected(kalman.predict(at_ns), scale, across_px)))
        kalman.push(scale.displacement(PixelTrack.stack(found[-1:])))
        across = found[-1].y_px if scale.direction == "x" else found[-1].x_px
        across_px = across if np.isfinite(across) else across_px
    return found


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


@dataclass(frozen=True, slots=True)
class Way:
    """How a recording is estimated: sections of recording.toml, as keywords."""

    camera: dict[str, Any]
    fusion: dict[str, Any]


def fused(film: Film, folder: Path, ways: Mapping[str, Way]) -> dict[str, Fused]:
    """Calibrate and estimate the film's recording in `folder` in each way; ways that agree on the camera share a track.

    The error is taken against the displacement of the moment.
    """
    out: dict[str, Fused] = {}
    known: dict[str, Any] = {}
    for name, way in ways.items():
        asked = open_recording(folder, camera=way.camera, fusion=way.fusion)
        key = repr(way.camera)
        if key not in known:
            known[key] = calibrate_and_track(asked)
        calibration, tracking = known[key]
        result = estimate(asked, calibration, method=way.fusion["method"], tracking=tracking)
        rows = result.estimate
        out[name] = _judged(
            film, rows.time_ns / 1e9, rows.displacement_m, 1e3 * calibration.camera.scale.value_m_per_px
        )
    return out


def _judged(film: Film, time_s: Floats, value_m: Floats, scale_mm_per_px: float) -> Fused:
    error_mm = 1e3 * (value_m - film.truth_m(time_s))
    half_s = 0.5 / ACCELEROMETER.rate_hz
    held_mm = 1e3 * (value_m - film.truth_m(time_s - half_s))
    after = time_s >= film.spans[CALIBRATION][1]
    whole = float(np.sqrt(np.mean(error_mm[after] ** 2)))
    return Fused(by_excitation(film, time_s, error_mm), whole, by_excitation(film, time_s, held_mm), scale_mm_per_px)
