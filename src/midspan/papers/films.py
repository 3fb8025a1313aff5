"""The papers on camera and accelerometer on their simulated scenes, run as a user runs them.

A scene is written as a recording, calibrated and estimated; as printed is what `midspan estimate --literal` does. One
run gives the error after fusion and that of its camera alone, each by the scale factor that was calibrated and by the
true one: what the calibration gets wrong and what the tracker gets wrong stand apart. Errors are standard deviations
over one excitation each.
"""

import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from midspan.calibration.sensors.camera import CameraCalibration
from midspan.engine.tracking import CameraTracking
from midspan.papers.filming import CALIBRATION, Film, write_recording
from midspan.papers.motions import ACCELEROMETER
from midspan.progress import silent
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.estimate import estimate
from midspan.recording.streams.recording import Recording, open_recording
from midspan.recording.tracking.opening import open_tracking
from midspan.records import (
    Floats,
    Frame,
    Nanoseconds,
    PixelTrack,
)
from midspan.settings.stored.calibration import Calibration
from midspan.vision.tracker import open_tracker, tracker_settings

# What the printed calibration is given: its band reaches from 0.3 Hz to a tenth of the camera's 29.97 frames a second,
# of which every third is used (AMKF paper, sections 3.1.1 and 4.1).
CALIBRATED: dict[str, Any] = {"band_hz": (0.3, 2.997)}
HALF_SAMPLE_S = 0.5 / ACCELEROMETER.rate_hz


@dataclass(frozen=True, slots=True)
class Way:
    """How a recording is run: the options --tracker, --method and --literal, camera.tracker_settings, keys of [fusion].

    like: the way before this one whose calibration is taken (--calibration); left out, it is calibrated anew.
    """

    tracker: str
    method: str
    literal: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)
    like: str = ""
    fusion: Mapping[str, Any] = field(default_factory=dict)

    def opened(self, folder: Path) -> Recording:
        """The recording in `folder` with these options."""
        camera = {"tracker": self.tracker, "tracker_settings": dict(self.settings)}
        fusion = {"method": self.method, "literal": self.literal, **self.fusion}
        found = open_recording(folder, camera=camera, fusion=fusion, calibration=CALIBRATED)
        return Recording(found.file, found.settings.calibrated_as_printed()) if self.literal else found


@dataclass(frozen=True, slots=True)
class Track:
    """A target's track in a film: px (n,) along the motion, NaN where it was lost, and good (n,), its matches or the
    share of the phases that agree.
    """

    film: Film
    px: Floats
    good: Floats

    @property
    def lost(self) -> int:
        """Frames in which the target was not found."""
        return int(np.count_nonzero(~np.isfinite(self.px)))

    @property
    def wrong(self) -> int:
        """Frames in which it was not found, or a pixel or more off."""
        off = self.px - self.film.seen_m() / self.film.scale_m_per_px
        return int(np.count_nonzero(~(np.abs(off - np.nanmedian(off)) < 1.0)))

    def errors_mm(self, scale_m_per_px: float | None = None) -> dict[str, float]:
        """Error of each excitation by a scale factor, the true one when left out; NaN where nothing was found.

        It is taken against the displacement averaged over each exposure: more a camera alone cannot tell.
        """
        scale = self.film.scale_m_per_px if scale_m_per_px is None else scale_m_per_px
        error = 1e3 * (scale * self.px - self.film.seen_m())
        return by_excitation(self.film, self.film.stamps_s + self.film.time_offset_s, error)


@dataclass(frozen=True, slots=True)
class Run:
    """What a way gives for a film: its camera alone, and fused.

    fused_mm: error of each excitation; apart_mm: that by the true scale factor, of the same track; late_mm: the latter
    against the truth half a sample earlier, since a filter that holds the acceleration is late by that; of a way that
    is not as printed the first only. tracker: with what it has estimated; frame_ms: processor time of a frame, tracked
    and fused.
    """

    track: Track
    recording: Recording
    calibration: Calibration
    tracker: Any
    fused_mm: dict[str, float]
    apart_mm: dict[str, float]
    late_mm: dict[str, float]
    frame_ms: float

    @property
    def camera(self) -> CameraCalibration:
        """The camera's part of the calibration."""
        assert self.calibration.camera is not None
        return self.calibration.camera

    @property
    def scale_m_per_px(self) -> float:
        """The scale factor that was calibrated."""
        return self.camera.scale.value_m_per_px

    @property
    def scale_off(self) -> float:
        """By what share it is off."""
        return abs(self.scale_m_per_px / self.track.film.scale_m_per_px - 1.0)


def mean_mm(errors: Mapping[str, float]) -> float:
    """Mean of the excitations' errors, mm."""
    return float(np.mean(list(errors.values())))


def with_means(values: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers by name, and "…, mean" of each that is a list over the excitations."""
    return dict(values) | {f"{key}, mean": float(np.mean(one)) for key, one in values.items() if isinstance(one, list)}


def calibration_frames(film: Film) -> int:
    """How many frames belong to the calibration."""
    return int(np.searchsorted(film.stamps_s + film.time_offset_s, film.spans[CALIBRATION][1]))


def half_sample_mm(film: Film) -> dict[str, float]:
    """What a filter that is half a sample late, and has no other error, errs in each excitation."""
    time_s = np.arange(film.stamps_s[0], film.stamps_s[-1], 2.0 * HALF_SAMPLE_S)
    return by_excitation(film, time_s, 1e3 * (film.truth_m(time_s) - film.truth_m(time_s - HALF_SAMPLE_S)))


def run_all(film: Film, ways: Mapping[str, Way]) -> dict[str, Run]:
    """The film's recording, run in each way."""
    runs: dict[str, Run] = {}
    with tempfile.TemporaryDirectory() as place:
        folder = write_recording(film, Path(place) / "recording")
        for name, way in ways.items():
            runs[name] = run_film(film, folder, way, runs[way.like].calibration if way.like else None)
    return runs


def run_film(film: Film, folder: Path, way: Way, calibration: Calibration | None = None) -> Run:
    """Calibrate, unless the calibration is given, and estimate the film's recording in `folder`."""
    asked = way.opened(folder)
    if calibration is None:
        calibration, tracking = calibrate_and_track(asked)
        assert tracking is not None
    else:
        tracking = open_tracking(asked.cameras[0], calibration.camera, silent)
    left, begun_s = len(tracking.time_ns) - tracking.done, time.process_time()
    rows = estimate(asked, calibration, method=way.method, tracking=tracking).estimate
    frame_ms = 1e3 * (time.process_time() - begun_s) / left
    apart, late = {}, {}
    if way.literal and not way.like:
        known = _with_scale(calibration, film.scale_m_per_px)
        by_true = estimate(asked, known, method=way.method, tracking=tracking).estimate
        apart = _fused_mm(film, by_true.time_ns, by_true.displacement_m)
        late = _fused_mm(film, by_true.time_ns, by_true.displacement_m, late_s=HALF_SAMPLE_S)
    fused = _fused_mm(film, rows.time_ns, rows.displacement_m)
    track, tracker = track_of(film, tracking), tracking.targets[0].tracker
    return Run(track, asked, calibration, tracker, fused, apart, late, frame_ms)


def _with_scale(calibration: Calibration, scale_m_per_px: float) -> Calibration:
    """The calibration with another scale factor."""
    camera = calibration.camera
    assert camera is not None
    scale = replace(camera.scale, value_m_per_px=scale_m_per_px)
    targets = tuple(replace(target, scale=scale) for target in camera.targets)
    return replace(calibration, camera=replace(camera, scale=scale, targets=targets))


def track_of(film: Film, tracking: CameraTracking) -> Track:
    """The first target's track in each frame of the film, as far as a recording's camera was tracked."""
    target = tracking.targets[0]
    places = np.searchsorted(np.rint(1e9 * film.stamps_s), target.track.time_ns)
    px, good = np.full((2, len(film.stamps_s)), np.nan)
    px[places], good[places] = target.track.along(film.scene.direction)[0], target.strengths
    return Track(film, px, np.where(np.isfinite(px), good, np.nan))


def followed(film: Film, tracker: str, **settings: Any) -> Track:
    """The film's track by a tracker that gets no prediction."""
    frames = frames_of(film)
    own = open_tracker(tracker, frames[0], film.region, tracker_settings(tracker, **settings))
    found = [own.push(frame) for frame in frames]
    px = PixelTrack.stack(found).along(film.scene.direction)[0]
    good = np.array([one.strength for one in found])
    return Track(film, px, np.where(np.isfinite(px), good, np.nan))


def frames_of(film: Film) -> list[Frame]:
    """The film's frames with their stamps, as a lossless video gives them."""
    return [
        Frame(round(1e9 * s), pixels, k) for k, (s, pixels) in enumerate(zip(film.stamps_s, film.frames, strict=True))
    ]


def _fused_mm(film: Film, time_ns: Nanoseconds, value_m: Floats, late_s: float = 0.0) -> dict[str, float]:
    """Error of each excitation against the displacement of the moment, or of `late_s` before."""
    time_s = time_ns / 1e9
    return by_excitation(film, time_s, 1e3 * (value_m - film.truth_m(time_s - late_s)))


def by_excitation(film: Film, time_s: Floats, error_mm: Floats) -> dict[str, float]:
    """Standard deviation in mm of an error (n,) at true times (n,) in each excitation; what is NaN does not count."""
    found = {}
    for name, (start, stop) in film.spans.items():
        inside = (time_s >= start) & (time_s < stop) & np.isfinite(error_mm)
        if name != CALIBRATION:
            found[name] = float(np.std(error_mm[inside])) if inside.any() else float("nan")
    return found
