"""Phase and hybrid as printed on the three scenes of their paper: error of the camera alone in mm, as recordings.

Calibrated in 50 s as in the paper; a scene's figure is the mean over its excitations, each without its mean error. The
existing flow is measured with the calibration of the hybrid as printed: it gives no scale factor of its own.

    python -m benchmarks printed_phase
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.table import show
from midspan.errors import UntrustedError
from midspan.papers.filming import Film, FilmSettings, film, write_recording
from midspan.papers.films import by_excitation
from midspan.recording.calibrate import calibrate_and_track
from midspan.recording.estimate import estimate
from midspan.recording.streams.recording import open_recording
from midspan.settings.stored.calibration import Calibration

SCENES, CALIBRATION_S = ("indoor", "outdoor", "footbridge-phase"), 50.0
PRINTED: dict[str, Any] = {"literal": True}
EXISTING: dict[str, Any] = {"form": "gradient", "active_pixels": "amplitude"}
# What is shown → tracker and what is not its default; the first one's calibration is the existing flow's.
FORMS: dict[str, tuple[str, dict[str, Any]]] = {
    "hybrid as printed": ("hybrid", PRINTED),
    "its pixels by amplitude": ("hybrid", PRINTED | {"active_pixels": "amplitude"}),
    "all pixels": ("hybrid", PRINTED | {"active_pixels": "all"}),
    "existing flow": ("phase", PRINTED | EXISTING),
    "existing flow, least slope": ("phase", EXISTING),
    "features as printed": ("features", PRINTED),
    "existing features": ("features", {"technique": "existing"}),
    "hybrid": ("hybrid", {}),
}


def errors(scene: Film, folder: Path, form: str, known: Calibration | None) -> tuple[list[object], Calibration]:
    """A row of the table: errors, mean, frames lost, active pixels and R²; and the calibration used."""
    name, settings = FORMS[form]
    asked = open_recording(folder, camera={"tracker": name, "tracker_settings": settings}, fusion={"method": "kalman"})
    calibration, tracking = (known, None) if known is not None else calibrate_and_track(asked)
    series = estimate(asked, calibration, method="kalman", tracking=tracking).measured[0]
    time_s = series.time_ns / 1e9
    seen = np.interp(time_s, scene.stamps_s + scene.time_offset_s, scene.seen_m())
    found = list(by_excitation(scene, time_s, 1e3 * (series.value_m - seen)).values())
    pixels = None if tracking is None else tracking.targets[0].tracker.active_pixels
    axis = "xy".index(scene.scene.direction)
    count = "" if pixels is None else int(np.count_nonzero((pixels.x, pixels.y)[axis]))
    fit = "" if pixels is None else pixels.r_squared[axis]
    lost = int(np.count_nonzero(~np.isfinite(series.value_m)))
    return [form, *found, float(np.mean(found)), lost, count, fit], calibration


def run(name: str) -> None:
    """All forms on one scene."""
    scene = film(name, FilmSettings(calibration_s=CALIBRATION_S))
    rows: list[list[object]] = []
    with tempfile.TemporaryDirectory() as place:
        folder = write_recording(scene, Path(place) / name)
        printed: Calibration | None = None
        for form in FORMS:
            try:
                row, used = errors(scene, folder, form, printed if form == "existing flow" else None)
            except UntrustedError as error:
                print(f"{form}: refused. {str(error)[:120]} …")
                continue
            printed = printed or used
            rows.append(row)
    show([name, *scene.scene.excitations, "mean mm", "lost", "pixels", "R²"], rows)


def main() -> None:
    for name in SCENES:
        run(name)
