"""The scenes of the papers on camera and accelerometer: error in mm of every tracker, alone and fused, beside theirs.

How the figures are taken stands in `midspan.evaluate.papers`; a scene's figure is the mean over its excitations, as the
papers' tables have it. The published errors were measured with lasers on real structures; these are simulated.

    python -m benchmarks paper_scenes
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.table import goal, show
from midspan.evaluate.papers import CameraAlone, camera_alone, fused, recorded_frames
from midspan.records import Frame
from midspan.simulate.scenarios.papers import PAPER_SCENES, Film, film, write_recording
from midspan.vision.tracker import tracker_settings

# What is shown → tracker and what is not its default. The published feature matching is "features as printed".
TRACKERS: dict[str, tuple[str, dict[str, Any]]] = {
    "registration": ("registration", {}),
    "template": ("template", {}),
    "hybrid": ("hybrid", {}),
    "phase": ("phase", {}),
    "features": ("features", {}),
    "features as printed": ("features", {"literal": True}),
}
SEEDS = (0, 1, 2)
# Camera alone, mm: lossless and H.264; and the tracker that was published with each scene.
CAMERA_GOALS = {"shaking-table": (0.015, 0.06), "outdoor": (0.16, 0.9), "footbridge-phase": (0.007, 0.035)}
PUBLISHED_WITH = dict.fromkeys(("shaking-table", "four-storey", "footbridge"), "features")
PUBLISHED_WITH |= dict.fromkeys(("indoor", "outdoor", "footbridge-phase"), "hybrid")
CODECS = {"lossless": False, "H.264 crf 20": True}


def alone(scene: Film, frames: list[Frame], shown: str) -> CameraAlone:
    """One of TRACKERS on a film."""
    name, values = TRACKERS[shown]
    return camera_alone(scene, frames, tracker=name, settings=tracker_settings(name, **values))


def camera_tables(scene: Film, name: str, frames: dict[str, list[Frame]]) -> None:
    """All trackers on one scene, both codecs, beside the bound and the goals."""
    bound_mm = scene.bound_px * scene.scene.scale_mm_per_px
    found = {(codec, shown): alone(scene, frames[codec], shown) for codec in CODECS for shown in TRACKERS}
    rows = [[*key, *one.rmse_mm.values(), one.mean_mm, one.mean_mm / bound_mm, one.lost] for key, one in found.items()]
    show(["camera alone", "tracker", *scene.scene.excitations, "mean mm", "of bound", "lost"], rows)
    print(f"bound {bound_mm:.4g} mm ({scene.bound_px:.4g} px)")
    for codec in CODECS:
        for other in ("features", "features as printed"):
            share = found[codec, "hybrid"].mean_mm / found[codec, other].mean_mm
            if np.isfinite(share):
                goal(f"{name}, {codec}: hybrid over {other}", share, 0.5)
            else:
                print(f"--      {name}, {codec}: {other} lost the target")


def fused_tables(scene: Film, name: str, folders: dict[str, Path]) -> None:
    """The published pair of tracker and filter, and the best of ours, on one scene."""
    published = PUBLISHED_WITH[name]
    asked = {
        published: ("adaptive-kalman", "adaptive-kalman as printed", "kalman"),
        "registration": ("adaptive-kalman", "smoother"),
    }
    found = {
        (codec, tracker, method): one
        for codec, folder in folders.items()
        for tracker, methods in asked.items()
        for method, one in fused(scene, folder, tracker=tracker, methods=methods).items()
    }
    rows = [[*key, *one.rmse_mm.values(), one.mean_mm, one.whole_mm] for key, one in found.items()]
    show(["fused", "tracker", "method", *scene.scene.excitations, "mean mm", "with the zero"], rows)
    for codec in CODECS:
        ours = found[codec, published, "adaptive-kalman"].mean_mm
        goal(f"{name}, {codec}: {published} + adaptive-kalman", ours, scene.scene.published_mm, unit="mm")
        smoothed = found[codec, "registration", "smoother"].mean_mm
        goal(f"{name}, {codec}: registration + smoother against that", smoothed, ours, unit="mm")


def camera_goals(name: str) -> None:
    """The camera's goals, which are narrow: the mean over several seeds decides."""
    found: dict[str, list[float]] = {codec: [] for codec in CODECS}
    for seed in SEEDS:
        scene = film(name, seed=seed)
        with tempfile.TemporaryDirectory() as place:
            for codec, compressed in CODECS.items():
                folder = write_recording(scene, Path(place) / codec, compressed=compressed)
                found[codec].append(alone(scene, recorded_frames(folder), "registration").mean_mm)
    for codec, limit in zip(CODECS, CAMERA_GOALS[name], strict=True):
        each = ", ".join(f"{value:.4g}" for value in found[codec])
        goal(f"{name}, {codec}: registration alone, seeds {each}", float(np.mean(found[codec])), limit, unit="mm")


def run(name: str, *, seed: int = 0) -> None:
    """One scene: camera alone and fused."""
    scene = film(name, seed=seed)
    print(f"\n{name}: {scene.scene.title}, {scene.scene.scale_mm_per_px:g} mm/px, published {scene.scene.published_mm}")
    with tempfile.TemporaryDirectory() as place:
        folders = {
            codec: write_recording(scene, Path(place) / codec, compressed=compressed)
            for codec, compressed in CODECS.items()
        }
        camera_tables(scene, name, {codec: recorded_frames(folder) for codec, folder in folders.items()})
        fused_tables(scene, name, folders)


def main() -> None:
    for name in PAPER_SCENES:
        run(name)
    for name in CAMERA_GOALS:
        camera_goals(name)
