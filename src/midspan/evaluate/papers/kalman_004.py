"""The feature-matching paper with its adaptive Kalman filter: shaking table, four-storey model, footbridge.

Z. Ma, J. Choi, H. Sohn, Real-time structural displacement estimation by fusing asynchronous acceleration and computer
vision measurements, Comput.-Aided Civ. Infrastruct. Eng. 37 (2022) 688-703, doi 10.1111/mice.12767, section 4.
"proposed" is its feature matching with region shift and rejection I and II, "existing" that of Yu and Zhang with the
scale factor of a known size; "fused" adds the adaptive filter.
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from midspan.evaluate.papers.claims import Curve, Effort, Measured
from midspan.evaluate.papers.films import CameraAlone, Way, camera_alone, errors_mm, frames_of, fused
from midspan.records import Floats, Prediction, Region
from midspan.simulate.scenarios.papers import PAPER_SCENES, Film, FilmSettings, film, write_recording
from midspan.vision.features import FeatureSettings, earlier_rules, good_matches
from midspan.vision.tracker import open_tracker, tracker_settings

# Scene → what the paper's known size gives over what its calibration gives; largest displacement known beforehand, mm.
KNOWN_SIZE = {"shaking-table": 2.146 / 2.289, "four-storey": 36.842 / 40.225, "footbridge": 1.495 / 1.359}
LARGEST_MM = {"shaking-table": 45.0, "four-storey": 60.0, "footbridge": 4.5}
QUICK = {
    "shaking-table": ("sine", "sweep"),
    "four-storey": ("multitone", "pseudo-static"),
    "footbridge": ("jumping", "crossing"),
}
PROPOSED: dict[str, Any] = {"literal": True}
# As printed, and ours.
WAYS = {
    "fused": Way({"tracker": "features", "tracker_settings": PROPOSED}, {"method": "adaptive-kalman", "literal": True}),
    "registration and smoother": Way({"tracker": "registration"}, {"method": "smoother"}),
}


def shot(name: str, effort: Effort, quick: tuple[str, ...]) -> Film:
    """The scene's film, short where it must be quick."""
    settings = FilmSettings(10.0, 8.0, quick) if effort.quick else FilmSettings()
    return film(name, settings, seed=effort.seed)


def fused_all(scene: Film, ways: dict[str, Way]) -> dict[str, Any]:
    """Errors by way, over the excitations; and "…, half a sample off": against the truth half a sample earlier."""
    with tempfile.TemporaryDirectory() as place:
        found = fused(scene, write_recording(scene, Path(place) / "recording"), ways)
    values: dict[str, Any] = {name: list(one.rmse_mm.values()) for name, one in found.items()}
    values |= {f"{name}, half a sample off": list(one.later_mm.values()) for name, one in found.items()}
    return values


def scene(name: str) -> Callable[[Effort], Measured]:
    """What measures one of the paper's three tests."""

    def measure(effort: Effort) -> Measured:
        return _measured(shot(name, effort, QUICK[name]), name)

    return measure


def _measured(one: Film, name: str) -> Measured:
    frames, true = frames_of(one), one.scale_m_per_px
    limit_px = LARGEST_MM[name] / (KNOWN_SIZE[name] * one.scene.scale_mm_per_px)
    earlier = tracker_settings("features", technique="existing", max_displacement_px=limit_px)
    proposed = camera_alone(one, frames, tracker="features", settings=tracker_settings("features", **PROPOSED))
    existing = camera_alone(one, frames, tracker="features", settings=earlier)
    ours = camera_alone(one, frames, tracker="registration")
    calibrated, known = 1e-3 * proposed.found_mm_per_px, KNOWN_SIZE[name] * true
    values: dict[str, Any] = {
        "true scale": abs(1e3 * true),
        "calibrated": abs(1e3 * calibrated),
        "known size": abs(1e3 * known),
        "calibrated, off by %": 100 * abs(calibrated / true - 1),
        "known size, off by %": 100 * abs(known / true - 1),
        "proposed, true scale": list(proposed.rmse_mm.values()),
        "proposed, calibrated": list(errors_mm(one, proposed.px, calibrated).values()),
        "proposed, known size": list(errors_mm(one, proposed.px, known).values()),
        "existing, true scale": list(existing.rmse_mm.values()),
        "existing, known size": list(errors_mm(one, existing.px, known).values()),
        "registration": list(ours.rmse_mm.values()),
        "lost": proposed.lost,
    }
    values |= fused_all(one, WAYS)
    values |= {f"{key}, mean": float(np.mean(values[key])) for key in tuple(values) if isinstance(values[key], list)}
    if name == "shaking-table":
        values |= _matches(one, proposed)
    return Measured(values, (_histories(one, proposed, existing),))


def _matches(one: Film, proposed: CameraAlone) -> dict[str, float]:
    """Good matches where the sweep reaches far, with the region that follows and with one that stays.

    The one that stays sees nothing but its own pixels of each frame.
    """
    place = one.region
    inside = (slice(place.y, place.y + place.height), slice(place.x, place.x + place.width))
    start, stop = one.spans["sweep"]
    moved = np.abs(one.seen_m() / one.scale_m_per_px)
    at_s = one.stamps_s + one.time_offset_s
    far = np.flatnonzero((at_s >= start) & (at_s < stop) & (moved > 12.0))
    frames = frames_of(one)
    cut = [replace(frame, pixels=np.ascontiguousarray(frame.pixels[inside])) for frame in frames]
    whole = Region(0, 0, place.width, place.height)
    fixed = open_tracker("features", cut[0], whole, tracker_settings("features", **PROPOSED))
    matches = []
    for k in far:
        found = fixed.push(cut[k])
        matches.append(found.strength if np.isfinite(found.x_px) else 0.0)
    return {"matches, following": float(np.nanmean(proposed.good[far])), "matches, fixed": float(np.mean(matches))}


def _histories(one: Film, proposed: CameraAlone, existing: CameraAlone) -> Curve:
    """Errors of the camera alone in the first excitation, by the scale factors of each technique."""
    name, (start, stop) = next((n, span) for n, span in one.spans.items() if n in one.scene.excitations)
    at_s = one.stamps_s + one.time_offset_s
    inside = (at_s >= start) & (at_s < min(stop, start + 8.0))
    known = KNOWN_SIZE.get(_name(one), 1.0) * one.scale_m_per_px
    scales = {"existing": (existing, known), "proposed": (proposed, 1e-3 * proposed.found_mm_per_px)}
    lines: dict[str, tuple[Floats, Floats]] = {
        label: (at_s[inside] - start, 1e3 * (scale * track.px - one.seen_m())[inside])
        for label, (track, scale) in scales.items()
    }
    return Curve(f"{one.scene.title}, {name}", "time (s)", "error (mm)", lines)


def _name(one: Film) -> str:
    return next(name for name, made in PAPER_SCENES.items() if made is one.scene)


def rejection(effort: Effort) -> Measured:
    """Processor time of both rejections on the same matches, of which one in five is wrong."""
    rng = np.random.default_rng(effort.seed)
    count, times = 60 if effort.quick else 200, {"I and II": 0.0, "existing": 0.0}
    settings, earlier = FeatureSettings(literal=True), FeatureSettings(technique="existing")
    for _ in range(count):
        first = rng.uniform(0, 64, (120, 2))
        now = first + np.array([0.4, 3.1]) + rng.normal(0, 0.2, (120, 2))
        wrong = rng.random(120) < 0.2
        now[wrong] = rng.uniform(0, 64, (int(wrong.sum()), 2))
        begun = time.process_time()
        good_matches(first, now, settings, prediction=Prediction(0.4, 3.1, 0.2, 0.2), rng=rng)
        middle = time.process_time()
        earlier_rules(now - first, earlier)
        times["I and II"] += middle - begun
        times["existing"] += time.process_time() - middle
    return Measured({name: 1e6 * spent / count for name, spent in times.items()})
