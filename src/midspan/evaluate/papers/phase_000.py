"""The paper on phase and features: storey model, outdoor shaking table, footbridge.

Z. Ma, J. Choi, P. Liu, H. Sohn, Structural displacement estimation by fusing vision camera and accelerometer using
hybrid computer vision algorithm and adaptive multi-rate Kalman filter, Autom. Constr. 140 (2022) 104338, doi
10.1016/j.autcon.2022.104338, sections 4 and 5. "features" is the earlier paper's matching, "hybrid" the proposed one.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.evaluate.papers.claims import Curve, Effort, Measured
from midspan.evaluate.papers.films import (
    CameraAlone,
    Way,
    calibration_frames,
    camera_alone,
    errors_mm,
    frames_of,
    printed_scale,
)
from midspan.evaluate.papers.kalman_004 import fused_all, shot
from midspan.records import Floats, Frame, PixelTrack, Region
from midspan.simulate.scenarios.papers import Film
from midspan.vision.active_pixels import by_amplitude, slope_and_r_squared
from midspan.vision.phase_flow import gradient_form, phase_change, phase_slopes
from midspan.vision.steerable import quadrature
from midspan.vision.tracker import open_tracker, tracker_settings

QUICK = {"indoor": ("sine", "sweep"), "outdoor": ("sine", "sweep"), "footbridge-phase": ("jumping", "crossing")}
# As printed: settings of the trackers.
FEATURES: dict[str, Any] = {"literal": True}
HYBRID: dict[str, Any] = {"least_information": 0.0, "weighted": False}
PIXELS: dict[str, dict[str, Any]] = {
    "all": {"least_information": 1.0, "weighted": False},
    "amplitude": {"active_pixels": "amplitude", "weighted": False},
    "selected": HYBRID,
}
PRINTED = {"method": "adaptive-kalman", "literal": True}
WAYS = {
    "features, fused": Way({"tracker": "features", "tracker_settings": FEATURES}, PRINTED),
    "hybrid, fused": Way({"tracker": "hybrid", "tracker_settings": HYBRID}, PRINTED),
    "features, guarded": Way({"tracker": "features", "tracker_settings": FEATURES}, {"method": "adaptive-kalman"}),
    "hybrid, guarded": Way({"tracker": "hybrid", "tracker_settings": HYBRID}, {"method": "adaptive-kalman"}),
    "registration and smoother": Way({"tracker": "registration"}, {"method": "smoother"}),
}
MARGIN_PX = 4  # of a filter of nine taps


def scene(name: str) -> Callable[[Effort], Measured]:
    """What measures one of the paper's three tests."""

    def measure(effort: Effort) -> Measured:
        return _measured(shot(name, effort, QUICK[name]))

    return measure


def _measured(one: Film) -> Measured:
    frames = frames_of(one)
    tracks = {f"{name} pixels": _alone(one, frames, "hybrid", values) for name, values in PIXELS.items()}
    tracks["features"] = _alone(one, frames, "features", FEATURES)
    tracks["our hybrid"] = _alone(one, frames, "hybrid", {})
    tracks["registration"] = _alone(one, frames, "registration", {})
    hybrid = tracks["selected pixels"]
    phase = _phase_alone(one, frames)
    values: dict[str, Any] = {name: list(track.rmse_mm.values()) for name, track in tracks.items()}
    values["hybrid"] = values["selected pixels"]
    for name, floor in (("flow", 0.0), ("flow, mended", 0.1)):
        values[name] = list(errors_mm(one, flow(one, frames, hybrid.px, floor), one.scale_m_per_px).values())
    values |= {"lost by phase alone": phase, "lost by hybrid": hybrid.lost}
    values |= step_one(one, frames, tracks["features"].px)
    values |= fused_all(one, WAYS)
    values |= {f"{key}, mean": float(np.mean(values[key])) for key in tuple(values) if isinstance(values[key], list)}
    values["true scale"] = one.scene.scale_mm_per_px
    values["calibrated scale"] = abs(1e3 * printed_scale(one, tracks["features"].px[: calibration_frames(one)]))
    return Measured(values, (_errors(one, tracks),))


def _alone(one: Film, frames: Sequence[Frame], name: str, values: dict[str, Any]) -> CameraAlone:
    return camera_alone(one, frames, tracker=name, settings=tracker_settings(name, **values))


def _phase_alone(one: Film, frames: Sequence[Frame]) -> int:
    """Frames that the conventional phase tracker loses: it gets no prediction."""
    tracker = open_tracker("phase", frames[0], one.region, tracker_settings("phase"))
    track = PixelTrack.stack([tracker.push(frame) for frame in frames])
    return int(np.count_nonzero(~np.isfinite(track.along(one.scene.direction)[0])))


def step_one(one: Film, frames: Sequence[Frame], px: Floats) -> dict[str, float]:
    """R² of mean phase on motion in the calibration's frames, and the phase scale factor in mm/rad: figure 9.

    With step 1 the region follows the matched track (n,) px by whole pixels and the motion is what is left; without it
    stays where it was.
    """
    count = calibration_frames(one)
    motion = one.seen_m()[:count] / one.scale_m_per_px
    seen = np.isfinite(px[:count])
    places = np.where(seen, np.round(np.where(seen, px[:count], 0.0)), 0.0).astype(int)
    found: dict[str, float] = {}
    for name, place in (("with step 1", places), ("without step 1", np.zeros_like(places))):
        phase = _mean_phases(one, frames[:count], place)
        slope, r_squared = slope_and_r_squared(phase, motion - place)
        found[f"R², {name}"] = float(r_squared)
        found[f"mm/rad, {name}"] = 1e3 * one.scale_m_per_px / float(slope)
    return found


def _mean_phases(one: Film, frames: Sequence[Frame], places: NDArray[np.int64]) -> Floats:
    """Mean phase (n,) of the region at its places over the pixels of large amplitude, rad."""
    axis = one.scene.direction
    first = quadrature(_patch(one, frames[0], 0, MARGIN_PX), axis)
    index = np.flatnonzero(by_amplitude(np.abs(first)).ravel())
    phases = []
    for frame, place in zip(frames, places, strict=True):
        now = quadrature(_patch(one, frame, int(place), MARGIN_PX), axis)
        change = phase_change((now.real.copy(), now.imag.copy()), first.ravel()[index], index)
        phases.append(float(np.mean(change)))
    return np.array(phases)


def flow(one: Film, frames: Sequence[Frame], px: Floats, least_slope: float) -> Floats:
    """Translation (n,) in px by the conventional form, equation 3: the mean of phase over slope of the active pixels.

    The region follows the track (n,) px by whole pixels, so that no phase wraps. least_slope: pixels whose phase is
    flatter, rad/px, are left out; equation 3 has no such limit.
    """
    axis, k = one.scene.direction, "xy".index(one.scene.direction)
    first = quadrature(_patch(one, frames[0], 0, MARGIN_PX), axis)
    active = np.flatnonzero(by_amplitude(np.abs(first)).ravel())
    found = []
    for frame, where in zip(frames, px, strict=True):
        place = round(float(where)) if np.isfinite(where) else 0
        now = quadrature(_patch(one, frame, place, MARGIN_PX + 1), axis)
        slope = phase_slopes(now)[k].ravel()[active]
        inner = now[1:-1, 1:-1]
        change = phase_change((inner.real.copy(), inner.imag.copy()), first.ravel()[active], active)
        steep = np.abs(slope) > least_slope
        moved = gradient_form(change, slope) if least_slope > 0 else float(np.mean(-change[steep] / slope[steep]))
        found.append(place + moved)
    return np.array(found)


def _patch(one: Film, frame: Frame, place: int, margin: int) -> NDArray[np.float32]:
    """The region's pixels, moved by whole pixels along the motion, with a margin."""
    region: Region = one.region
    x, y = (place, 0) if one.scene.direction == "x" else (0, place)
    top, left = region.y + y - margin, region.x + x - margin
    cut = frame.pixels[top : top + region.height + 2 * margin, left : left + region.width + 2 * margin]
    values = np.ascontiguousarray(cut, dtype=np.float32)
    values -= values.mean()
    return values


def _errors(one: Film, tracks: dict[str, CameraAlone]) -> Curve:
    """Errors of the camera alone in the first excitation."""
    start, stop = next(span for name, span in one.spans.items() if name in one.scene.excitations)
    at_s = one.stamps_s + one.time_offset_s
    inside = (at_s >= start) & (at_s < min(stop, start + 8.0))
    shown = {"features": "features", "selected pixels": "hybrid", "registration": "registration (ours)"}
    lines = {
        label: (at_s[inside] - start, 1e3 * (one.scale_m_per_px * tracks[name].px - one.seen_m())[inside])
        for name, label in shown.items()
    }
    return Curve(f"{one.scene.title}, camera alone", "time (s)", "error (mm)", lines)
