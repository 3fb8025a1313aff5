"""The paper on phase and features: storey model, outdoor shaking table, footbridge.

Z. Ma, J. Choi, P. Liu, H. Sohn, Structural displacement estimation by fusing vision camera and accelerometer using
hybrid computer vision algorithm and adaptive multi-rate Kalman filter, Autom. Constr. 140 (2022) 104338, doi
10.1016/j.autcon.2022.104338, sections 4 and 5. "features" is the earlier paper's matching [24], "existing features"
that of Yu and Zhang [18], "flow" the existing phase-based optical flow [26], "hybrid" the proposed algorithm.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.calibration.camera.best_range import felt_motion
from midspan.papers.claims import Effort, Measured
from midspan.papers.filming import FRAME_RATE, Film
from midspan.papers.films import (
    Run,
    Track,
    Way,
    calibration_frames,
    followed,
    frames_of,
    run_all,
    with_means,
)
from midspan.papers.kalman_004 import error_curve, existing_technique, fused_values, printed_film
from midspan.papers.printed.phase import phase_change
from midspan.recording.streams.window import calibration_window
from midspan.records import Floats, Frame, Region
from midspan.signals.band_pass import band_passed
from midspan.vision.active_pixels import slope_and_r_squared
from midspan.vision.phase_model import region_patch
from midspan.vision.steerable import MARGIN_PX, quadrature

QUICK = {"indoor": ("sine", "sweep"), "outdoor": ("sine", "sweep"), "footbridge-phase": ("jumping", "crossing")}
# The largest displacement that the technique of [18] must know beforehand, as in the earlier paper, mm.
LARGEST_MM = {"indoor": 45.0, "outdoor": 45.0, "footbridge-phase": 4.5}
# The existing flow: equation 3 with the pixels of large amplitude (table 3).
FLOW: dict[str, Any] = {"form": "gradient", "active_pixels": "amplitude"}
# With the mean of two samples and this noise, m/s², the filter gives the published errors of table 1 (0.237 → 0.129 mm
# of 0.34 and 0.16 mm of the trackers); with the first sample held, as equation 7 is printed, no noise does.
MEAN_INPUT = {"input_rule": "mean", "input_noise_m_s2": 0.02}
WAYS = {
    "features": Way("features", "adaptive-kalman", literal=True),
    "hybrid": Way("hybrid", "adaptive-kalman", literal=True),
    "features, mean input": Way("features", "adaptive-kalman", literal=True, like="features", fusion=MEAN_INPUT),
    "hybrid, mean input": Way("hybrid", "adaptive-kalman", literal=True, like="hybrid", fusion=MEAN_INPUT),
    "features guarded": Way("features", "adaptive-kalman", settings={"literal": True}),
    "hybrid guarded": Way("hybrid", "adaptive-kalman", settings={"literal": True}),
    "registration": Way("registration", "smoother"),
}
# What the hybrid is compared with outdoors and on the bridge.
PIXELS = {
    f"{kind} pixels{guarded}": Way(
        "hybrid",
        "adaptive-kalman",
        literal=not guarded,
        settings={"literal": True, "active_pixels": kind},
        like=f"hybrid{guarded}",
    )
    for guarded in ("", " guarded")
    for kind in ("amplitude", "all")
}
# By the factor of registration: that of its own track is refused where too many phases are wrong.
STEEP = {"flow, steep slopes": Way("phase", "kalman", settings=FLOW, like="registration")}


def scene(name: str, effort: Effort, *, noise: float = 1.0) -> Measured:
    """One of the paper's three tests, in a film whose bound is raised by a factor."""
    one = printed_film(name, effort, QUICK[name], noise)
    runs = run_all(one, WAYS if name == "indoor" else WAYS | PIXELS | STEEP)
    limit_px = LARGEST_MM[name] / one.scene.scale_mm_per_px
    alone = {
        "flow": followed(one, "phase", literal=True, **FLOW),
        "existing features": existing_technique(one, limit_px),
    }
    values = _camera_alone(runs, alone) | fused_values(one, runs) | _estimated(one, runs)
    shown = {"features": "features", "hybrid": "hybrid", "ours (registration)": "registration"}
    tracks = {label: (runs[name].track, one.scale_m_per_px) for label, name in shown.items()}
    return Measured(with_means(values), (error_curve(one, "camera alone", tracks),))


def _camera_alone(runs: dict[str, Run], existing: dict[str, Track]) -> dict[str, Any]:
    """Errors of the camera alone by the calibrated factor and by the true one.

    Existing techniques, which give no factor, by the hybrid's as printed; "guarded": by that of our calibration.
    """
    tracks = {name: (run.track, run.scale_m_per_px) for name, run in runs.items()}
    for name, track in existing.items():
        tracks[name] = track, runs["hybrid"].scale_m_per_px
        tracks[f"{name} guarded"] = track, runs["hybrid guarded"].scale_m_per_px
    values: dict[str, Any] = {}
    for name, (track, scale) in tracks.items():
        values[name] = list(track.errors_mm(scale).values())
        values[f"{name}, true factor"] = list(track.errors_mm().values())
        values[f"{name}, frames"] = track.wrong
    return values


def _estimated(one: Film, runs: dict[str, Run]) -> dict[str, Any]:
    """Both scale factors, active pixels and R² of mean phase on displacement by the printed calibration: figures 9, 12
    and 14.
    """
    axis, hybrid = "xy".index(one.scene.direction), runs["hybrid"]
    assert hybrid.camera.phase_scale_m_per_rad is not None
    models = {"selected pixels": hybrid.tracker}
    models |= {name: runs[name].tracker for name in ("amplitude pixels", "all pixels") if name in runs}
    found: dict[str, Any] = {f"R², {name}": tracker.model.r_squared[axis] for name, tracker in models.items()}
    for name, tracker in models.items():
        active = (tracker.active_pixels.x, tracker.active_pixels.y)[axis]
        found[f"{name} (%)"] = 100.0 * float(np.mean(active))
    found["R², without step 1"] = without_step_one(one, hybrid)
    found["beta (mm/rad)"] = 1e3 * hybrid.camera.phase_scale_m_per_rad
    return found


def without_step_one(one: Film, run: Run) -> float:
    """R² of the same pixels' mean phase on displacement where the region stays as it was in the first frame."""
    frames = frames_of(one)[: calibration_frames(one)]
    stamps = np.array([frame.time_ns for frame in frames])
    window, band_hz = calibration_window(run.recording), run.recording.settings.calibration.band_hz
    felt = felt_motion(run.recording.prepared, window, run.camera, stamps, band_hz)
    axis, chosen = one.scene.direction, run.tracker.active_pixels
    active = np.flatnonzero((chosen.x, chosen.y)["xy".index(axis)])
    first = _responses(frames[0], chosen.region, axis).ravel()[active]
    seen = np.flatnonzero(np.isfinite(felt.translation_px))
    phase = []
    for k in seen:
        now = _responses(frames[k], chosen.region, axis)
        phase.append(float(np.mean(phase_change((now.real.copy(), now.imag.copy()), first, active))))

    def passed(values: Floats) -> Floats:
        return band_passed(values - values.mean(), float(FRAME_RATE), felt.band_hz)

    return float(slope_and_r_squared(passed(np.array(phase)), passed(felt.translation_px[seen]))[1])


def _responses(frame: Frame, region: Region, axis: str) -> NDArray[np.complex64]:
    """Local phase and amplitude of a region's pixels."""
    cut = np.asarray(frame.pixels[region_patch(region, 0, 0, MARGIN_PX)], dtype=np.float32)
    return quadrature(np.ascontiguousarray(cut - cut.mean()), axis)
