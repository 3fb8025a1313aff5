"""The feature-matching paper with its adaptive Kalman filter: shaking table, four-storey model, footbridge.

Z. Ma, J. Choi, H. Sohn, Real-time structural displacement estimation by fusing asynchronous acceleration and computer
vision measurements, Comput.-Aided Civ. Infrastruct. Eng. 37 (2022) 688-703, doi 10.1111/mice.12767, section 4.
"proposed" is its feature matching with region shift and rejection I and II, "existing" that of Yu and Zhang with the
scale factor of a known size; "fused" adds the adaptive filter.
"""

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from midspan.papers.claims import Curve, Effort, Measured
from midspan.papers.filming import Film, FilmSettings, film
from midspan.papers.films import Run, Track, Way, followed, frames_of, half_sample_mm, run_all, with_means
from midspan.papers.printed.features import earlier_rules, printed_matches
from midspan.records import Floats, Prediction, Region
from midspan.vision.features import FeatureSettings
from midspan.vision.tracker import open_tracker, tracker_settings

# Scene → what the paper's known size gives over what its calibration gives; largest displacement known beforehand, mm.
KNOWN_SIZE = {"shaking-table": 2.146 / 2.289, "four-storey": 36.842 / 40.225, "footbridge": 1.495 / 1.359}
LARGEST_MM = {"shaking-table": 45.0, "four-storey": 60.0, "footbridge": 4.5}
QUICK = {
    "shaking-table": ("sine", "sweep"),
    "four-storey": ("multitone", "pseudo-static"),
    "footbridge": ("jumping", "crossing"),
}
WAYS = {
    "proposed": Way("features", "adaptive-kalman", literal=True),
    "registration": Way("registration", "smoother"),
}
OURS = "registration and smoother"  # what our default is called where it is fused


def printed_film(name: str, effort: Effort, quick: tuple[str, ...], noise: float = 1.0) -> Film:
    """The scene's film with its bound raised by a factor, short where it must be quick."""
    # The papers calibrate with 50 s. In much less, the printed calibration's errors hide what its trackers differ by.
    settings = FilmSettings(30.0, 8.0, quick, noise) if effort.quick else FilmSettings(50.0, noise=noise)
    return film(name, settings, seed=effort.seed)


def existing_technique(one: Film, limit_px: float) -> Track:
    """The film tracked by the technique of Yu and Zhang: the region stays, `limit_px` is known beforehand."""
    return followed(one, "features", technique="existing", max_displacement_px=limit_px)


def fused_values(one: Film, runs: dict[str, Run]) -> dict[str, Any]:
    """Errors after fusion by way, what their scale factors are off by, and the processor time of a frame."""
    values: dict[str, Any] = {"half a sample late (mm)": list(half_sample_mm(one).values())}
    for way, run in runs.items():
        name = OURS if way == "registration" else way
        values[f"{name}, fused"] = list(run.fused_mm.values())
        values[f"factor of {name} (mm/px)"] = abs(1e3 * run.scale_m_per_px)
        values[f"{name} off by"] = values[f"factor of {name} off by (%)"] = 100.0 * run.scale_off
        values[f"{name}, frame"] = run.frame_ms
        if run.apart_mm:
            values[f"{name}, fused, true factor"] = list(run.apart_mm.values())
            values[f"{name}, fused, half a sample off"] = list(run.late_mm.values())
    return values | {"true factor (mm/px)": one.scene.scale_mm_per_px}


def scene(name: str, effort: Effort, *, noise: float = 1.0) -> Measured:
    """One of the paper's three tests, in a film whose bound is raised by a factor."""
    one = printed_film(name, effort, QUICK[name], noise)
    runs, known = run_all(one, WAYS), KNOWN_SIZE[name] * one.scale_m_per_px
    existing = existing_technique(one, LARGEST_MM[name] / abs(1e3 * known))
    proposed, ours = runs["proposed"], runs["registration"]
    values: dict[str, Any] = {
        "factor of known size (mm/px)": abs(1e3 * known),
        "known size off by": 100 * abs(KNOWN_SIZE[name] - 1),
        "proposed, calibrated factor": list(proposed.track.errors_mm(proposed.scale_m_per_px).values()),
        "proposed, known size": list(proposed.track.errors_mm(known).values()),
        "proposed, true factor": list(proposed.track.errors_mm().values()),
        "existing, calibrated factor": list(existing.errors_mm(proposed.scale_m_per_px).values()),
        "existing, known size": list(existing.errors_mm(known).values()),
        "existing, true factor": list(existing.errors_mm().values()),
        "registration, calibrated factor": list(ours.track.errors_mm(ours.scale_m_per_px).values()),
        "registration, true factor": list(ours.track.errors_mm().values()),
    }
    values |= fused_values(one, runs)
    if name == "shaking-table":
        values |= _matches(one, proposed.track)
    tracks = {
        "existing": (existing, known),
        "proposed": (proposed.track, proposed.scale_m_per_px),
        "ours (registration)": (ours.track, ours.scale_m_per_px),
    }
    return Measured(with_means(values), (error_curve(one, "{}", tracks),))


def _matches(one: Film, proposed: Track) -> dict[str, float]:
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
    fixed = open_tracker("features", cut[0], whole, tracker_settings("features", literal=True))
    matches = []
    for k in far:
        found = fixed.push(cut[k])
        matches.append(found.strength if np.isfinite(found.x_px) else 0.0)
    return {
        "matches, following": float(np.nanmean(proposed.good[far])),
        "matches, fixed": float(np.mean(matches)),
        "frames lost": proposed.lost,
    }


def error_curve(one: Film, figure: str, tracks: Mapping[str, tuple[Track, float]]) -> Curve:
    """Errors of the camera alone in the first excitation, each track by its scale factor in m/px; {} is its name."""
    name, (start, stop) = next((n, span) for n, span in one.spans.items() if n in one.scene.excitations)
    at_s = one.stamps_s + one.time_offset_s
    inside = (at_s >= start) & (at_s < min(stop, start + 8.0))
    lines: dict[str, tuple[Floats, Floats]] = {
        label: (at_s[inside] - start, 1e3 * (scale * track.px - one.seen_m())[inside])
        for label, (track, scale) in tracks.items()
    }
    return Curve(f"{one.scene.title}, {figure.format(name)}", "time (s)", "error (mm)", lines)


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
        printed_matches(first, now, settings, prediction=Prediction(0.4, 3.1, 0.2, 0.2), rng=rng)
        middle = time.process_time()
        earlier_rules(first, now, earlier)
        times["I and II"] += middle - begun
        times["existing"] += time.process_time() - middle
    return Measured({name: 1e6 * spent / count for name, spent in times.items()})
