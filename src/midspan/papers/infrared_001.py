"""The paper on vision and infrared: temperature ranges, references that follow the light, a day and a night.

J. Choi, Z. Ma, K. Kim, H. Sohn, Continuous structural displacement monitoring using accelerometer, vision, and infrared
(IR) cameras, Sensors 23 (2023) 5241, doi 10.3390/s23115241, section 3. "FOV", "ROI" and "optimised" are ranges of
temperature shown in grey levels.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from midspan.calibration.camera.view import PrintedSteps
from midspan.calibration.fit import Pair
from midspan.calibration.scale import calibrate_scale
from midspan.engine.sensors import ACROSS_STD_PX, MIN_STD_PX
from midspan.engine.target_opening import ThermalTarget
from midspan.errors import UsageError
from midspan.fusion.blocks import VELOCITY_WITHIN
from midspan.fusion.runners import run_method
from midspan.fusion.streams import KalmanFilter, KalmanSettings, MethodSettings
from midspan.papers.claims import Curve, Effort, Measured
from midspan.papers.motions import ACCELEROMETER, Sweep
from midspan.papers.printed.adaptive import PrintedFilter
from midspan.papers.printed.camera import calibrate_printed
from midspan.papers.printed.switching import Switch
from midspan.papers.printed.updating import UpdatingSettings, UpdatingTracker
from midspan.records import (
    NANOSECONDS,
    Acceleration,
    Displacement,
    Floats,
    Frame,
    PixelTrack,
    PixelTranslation,
    Prediction,
    Region,
    Source,
    TimeSeries,
    part,
)
from midspan.simulate.day.camera import Wall, wall_in_relief
from midspan.simulate.day.sky import Light
from midspan.simulate.motion.motion import Motion, Pulse, Sines, Sum, Window, random_motion
from midspan.simulate.scene.scene import Image
from midspan.simulate.scene.texture import textured_scene
from midspan.simulate.scene.thermal import Course, ThermalView, WarmBody
from midspan.thermal.limits import Limits
from midspan.thermal.temperature_range import (
    Expected,
    RangeSurface,
    candidates,
    field_range,
    in_grey,
    optimise_range,
    region_range,
)
from midspan.vision.reference.policy import KeyFrameSettings
from midspan.vision.reference.tracker import KeyFrameTracker
from midspan.vision.target import lost
from midspan.vision.tracker import Tracker, open_tracker, tracker_settings

# Scale factors of the paper, mm/px: camera, infrared.
CAMERA_MM, INFRARED_MM = 0.945, 1.094
BAND_HZ = (0.3, 3.0)
# As printed: its l and h divide the differences by nine; SURF matches with rejection I and II.
DIVISIONS = 9
FEATURES = tracker_settings("features", literal=True)
IN_GREY = tracker_settings("features", literal=True, detector="sift")
INFRARED_SIZE, INFRARED_ROI = (90, 112), Region(20, 14, 72, 60)
WALL_ROI, WALL_HZ = Region(20, 20, 56, 56), 10.0
FELT_HZ = ACCELEROMETER.rate_hz
DENSITY = ACCELEROMETER.noise_std_m_s2**2 / FELT_HZ


@dataclass(frozen=True, slots=True)
class Standing(WarmBody):
    """Something warm or cold that stands near the target: it moves in the picture as the target does."""

    moved_px: Callable[[float], float] = float

    def paint(self, image: Image, time_s: float) -> None:
        """Paint it over `image` (rows, columns) in °C."""
        body = WarmBody(0.0, self.left_px, self.top_px + self.moved_px(time_s), 12.0, 24.0, 0.0, self.celsius)
        body.paint(image, time_s)


@dataclass(frozen=True, slots=True)
class Filmed:
    """Frames with their stamps, the true translation (n,) in px, the scale factor in mm/px, the acceleration, and the
    true displacement (k,) in m at its samples.
    """

    frames: list[Frame]
    px: Floats
    scale_mm: float
    acceleration: TimeSeries
    truth_m: Floats

    @property
    def at_s(self) -> Floats:
        """Times (n,) of the frames, s."""
        return np.array([frame.time_ns for frame in self.frames]) / NANOSECONDS

    def fused_mm(self, track: PixelTrack, *, literal: bool) -> float:
        """Error in mm of a track that is fused with the acceleration: by the printed filter, or smoothed."""
        series = (self.at_s, self.scale_mm * track.y_px, (1e-3 * self.scale_mm) ** 2 * track.variance_y_px2)
        density = np.full(len(self.acceleration.value), DENSITY)
        acceleration = Acceleration(self.acceleration.time_ns, self.acceleration.value, density)
        return _fused(acceleration, series, self.truth_m, literal=literal)

    def followed(
        self, tracker: Tracker, frames: Sequence[Frame] | None = None, *, printed: bool
    ) -> list[PixelTranslation]:
        """The track with a filter's predictions, which takes what was found: the adaptive one as printed, or ours.

        frames: other pictures of the same instants.
        """
        frames, series = self.frames if frames is None else frames, self.acceleration
        filtered = self._printed() if printed else KalmanFilter(KalmanSettings(bias=float(np.mean(series.value))))
        take = filtered.wait if isinstance(filtered, PrintedFilter) else filtered.push
        scale_m, min_std_px = 1e-3 * self.scale_mm, 0.0 if printed else MIN_STD_PX
        samples = Acceleration(series.time_ns, series.value, np.full(len(series.time_ns), DENSITY))
        found: list[PixelTranslation] = []
        pushed, across_px = 0, 0.0
        for frame in frames:
            due = int(np.searchsorted(series.time_ns, frame.time_ns, side="right"))
            filtered.push(part(samples, slice(pushed, due)))
            pushed = due
            value_m, variance_m2 = filtered.predict(frame.time_ns)
            std_px = max(float(np.sqrt(variance_m2)) / scale_m, min_std_px)
            known = np.isfinite(value_m) and np.isfinite(std_px)
            expected = Prediction(across_px, value_m / scale_m, ACROSS_STD_PX, std_px) if known else None
            one = tracker.push(frame, expected)
            found.append(one)
            if np.isfinite(one.y_px):
                across_px = one.x_px
                row = np.array([one.y_px * scale_m]), np.array([one.variance_y_px2 * scale_m**2])
                take(Displacement(np.array([frame.time_ns]), *row, np.array([Source.CAMERA], dtype=np.uint8)))
        return found

    def _printed(self) -> PrintedFilter:
        """The adaptive filter as printed at the film's beginning."""
        speed_m_s = float(np.sqrt(np.mean(np.diff(self.truth_m) ** 2))) * FELT_HZ
        kalman = KalmanSettings(bias=ACCELEROMETER.bias_m_s2, velocity_std=VELOCITY_WITHIN * speed_m_s)
        begins_ns = int(self.acceleration.time_ns[0])
        return PrintedFilter(MethodSettings(kalman, literal=True), begins_ns, step_s=1 / FELT_HZ, speed_m_s=speed_m_s)

    def pair(self, track: PixelTrack) -> Pair:
        """A track with the acceleration, to be calibrated."""
        samples = np.column_stack((self.acceleration.time_ns / NANOSECONDS, self.acceleration.value))
        samples[:, 1] -= np.mean(samples[:, 1])
        rows = np.column_stack((self.at_s, track.y_px, track.variance_y_px2))
        inner = (self.at_s > 0.2) & (self.at_s < samples[-1, 0] - 0.2)
        return Pair(np.column_stack((samples, np.ones(len(samples)))), rows[inner])

    def error_mm(self, track: PixelTrack) -> float:
        """Standard deviation of a track's error where it is known, mm; NaN where it is nowhere."""
        seen = np.isfinite(track.y_px)
        return self.scale_mm * float(np.std((track.y_px - self.px)[seen])) if seen.any() else float("nan")


# Infrared: cases 1 to 5 and the bridge.


def scale_factors(effort: Effort) -> Measured:
    """Figure 10: both scale factors by the printed calibration and by ours, from case 1."""
    length_s = 15.0 if effort.quick else 30.0
    motion = from_rest(_sine(1.0), length_s)
    warm = infrared(
        motion, fans(effort.seed, *cups(motion, INFRARED_MM, 33.5, 16.5)), 10 * effort.seed + 1,
        length_s=length_s, rate_hz=15.0, scale=INFRARED_MM,
    )  # fmt: skip
    at_s = np.arange(int(length_s * WALL_HZ)) / WALL_HZ
    px = motion.displacement(at_s) / (1e-3 * CAMERA_MM)
    frames = lit(relief(np.random.default_rng([6, effort.seed])), px, [lamp(0.0, 0.8)] * len(at_s), effort.seed)
    seen = filmed(frames, px, CAMERA_MM, motion, length_s, effort.seed)
    few = slice(None, 200)
    known = replace(warm, frames=warm.frames[few], px=warm.px[few])
    grey = in_grey(warm.frames, estimated(known).best)
    ours = ThermalTarget(warm.frames[0], INFRARED_ROI, lambda frame: open_tracker("template", frame, INFRARED_ROI))
    plain = open_tracker("registration", seen.frames[0], WALL_ROI)
    values: dict[str, float] = {}
    for name, one, printed, own in (
        ("vision", seen, _pushed(open_tracker("features", seen.frames[0], WALL_ROI, FEATURES), seen.frames), plain),
        ("infrared", warm, in_range(grey), ours),
    ):
        scale_mm = 1e3 * calibrate_printed(one.pair(printed), 0.1, PrintedSteps(BAND_HZ))[0].value_m_per_px
        found_mm = 1e3 * calibrate_scale(one.pair(_pushed(own, one.frames)), 0.1).scale.value_m_per_px
        values |= {f"{name}, printed": scale_mm, f"{name}, ours": found_mm, f"{name}, true": one.scale_mm}
        values |= {
            f"{name}, off by %": 100 * abs(scale_mm / one.scale_mm - 1),
            f"{name}, ours, off by %": 100 * abs(found_mm / one.scale_mm - 1),
        }
    return Measured(values)


def _pushed(tracker: Tracker, frames: Sequence[Frame]) -> PixelTrack:
    return PixelTrack.stack([tracker.push(frame) for frame in frames])


def infrared(motion: Motion, view: ThermalView, seed: int, *, length_s: float, rate_hz: float, scale: float) -> Filmed:
    """The motion before a thermal camera."""
    at_s = np.arange(int(length_s * rate_hz)) / rate_hz
    moved = motion.displacement(at_s) / (1e-3 * scale)
    moved -= moved[0]
    pictures = view.film(np.stack([0.0 * moved, moved], axis=1), at_s, rng=np.random.default_rng([1, seed]))
    frames = [Frame(round(1e9 * s), p, k) for k, (s, p) in enumerate(zip(at_s, pictures, strict=True))]
    return filmed(frames, moved, scale, motion, length_s, seed)


def filmed(frames: list[Frame], px: Floats, scale_mm: float, motion: Motion, length_s: float, seed: int) -> Filmed:
    """Frames of a motion with its acceleration and its true displacement from the first frame on."""
    sensed = felt(motion, length_s, seed)
    truth_m = motion.displacement(sensed.time_ns / NANOSECONDS) - motion.displacement(np.zeros(1))
    return Filmed(frames, px, scale_mm, sensed, truth_m)


def felt(motion: Motion, length_s: float, seed: int) -> TimeSeries:
    """The motion by the accelerometer."""
    return ACCELEROMETER.measure(motion, (0.0, length_s), rng=np.random.default_rng([11, seed]))


def cups(motion: Motion, scale: float, warm_c: float, cold_c: float) -> tuple[WarmBody, WarmBody]:
    """Two cups of water on either side of the target."""

    def moved(time_s: float) -> float:
        return float(motion.displacement(np.array([time_s]))[0] - motion.displacement(np.zeros(1))[0]) / (1e-3 * scale)

    return (
        Standing(left_px=0.0, top_px=18.0, celsius=warm_c, moved_px=moved),
        Standing(left_px=98.0, top_px=44.0, celsius=cold_c, moved_px=moved),
    )


def fans(seed: int, *bodies: WarmBody, contrast_k: float = 0.9, mean_c: float = 25.9) -> ThermalView:
    """A target with a contrast of `contrast_k`, and what else is in view."""
    scene = textured_scene("natural", INFRARED_SIZE, rng=np.random.default_rng([2, seed]), reach_px=10.0, lens_px=1.0)
    return ThermalView((scene,), contrast_k, Course(mean_c), bodies)


def in_range(frames: Sequence[Frame]) -> PixelTrack:
    """Matched features in grey levels; UsageError where the range shows too few."""
    tracker = open_tracker("features", frames[0], INFRARED_ROI, IN_GREY)
    return PixelTrack.stack([tracker.push(frame) for frame in frames])


def estimated(one: Filmed) -> RangeSurface:
    """The optimised range of a calibration."""
    expected = Expected(one.px, "y", BAND_HZ)
    return optimise_range(one.frames, INFRARED_ROI, in_range, expected, DIVISIONS)


def by_range(
    one: Filmed, surface: RangeSurface, known: Filmed, finger_s: tuple[float, float] = (np.inf, np.inf)
) -> tuple[dict[str, float], dict[str, Floats]]:
    """Errors in mm, frames lost in % and matches by each range, which the calibration `known` gave, and ours in °C;
    and the matches (n,) of each.

    finger_s: from when to when something warm is in front of the target; matches are counted apart there.
    """
    limits: dict[str, Limits | None] = {
        "FOV": field_range(known.frames),
        "ROI": region_range(known.frames, INFRARED_ROI),
        "ROI of each frame": None,
        "optimised": surface.best,
    }
    warm = (one.at_s >= finger_s[0]) & (one.at_s < finger_s[1])
    found: dict[str, float] = {}
    counts: dict[str, Floats] = {}
    for name, own in limits.items():
        rows = _tracked(one, own)
        track = PixelTrack.stack(rows)
        matches = counts[name] = np.array([_matches(row) for row in rows])
        found[name], found[f"{name} lost (%)"] = one.error_mm(track), 100 * float(np.mean(~np.isfinite(track.y_px)))
        found[f"{name} (matches)"] = float(np.mean(matches[~warm]))
        found[f"{name} with the finger (matches)"] = float(np.mean(matches[warm])) if warm.any() else float("nan")
        if name == "optimised":
            found["optimised, fused"] = one.fused_mm(track, literal=True)
    tracker = ThermalTarget(one.frames[0], INFRARED_ROI, lambda frame: open_tracker("template", frame, INFRARED_ROI))
    ours = PixelTrack.stack(one.followed(tracker, printed=False))
    lost = 100 * float(np.mean(~np.isfinite(ours.y_px)))
    found |= {"°C": one.error_mm(ours), "°C lost (%)": lost, "°C, smoothed": one.fused_mm(ours, literal=False)}
    return found, counts


def _tracked(one: Filmed, limits: Limits | None) -> list[PixelTranslation]:
    """The track in grey levels, all lost where the range shows the target too few; limits: None: each frame's own."""
    try:
        if limits is None:
            grey = [in_grey([frame], region_range([frame], INFRARED_ROI))[0] for frame in one.frames]
        else:
            grey = in_grey(one.frames, limits)
        return one.followed(open_tracker("features", grey[0], INFRARED_ROI, IN_GREY), grey, printed=True)
    except UsageError:
        return [lost(frame.time_ns) for frame in one.frames]


def ranges(effort: Effort) -> Measured:
    """Cases 1 to 5: the range is estimated from case 1 and used in the others; a finger crosses in case 2."""
    length_s, rate_hz = (12.0, 15.0) if effort.quick else (30.0, 15.0)
    finger = WarmBody(length_s - 6.5, 8.0, 14.0, 12.0, 60.0, 24.0, celsius=33.0)
    rng, seed = np.random.default_rng([3, effort.seed]), effort.seed
    motions: dict[str, Motion] = {
        "case 1": _sine(1.0),
        "case 2": _sine(1.0),
        "case 3": _sine(2.0),
        "case 4": Sweep(4e-3, 0.0, 3.0, length_s),
        "case 5": random_motion((0.3, 3.0), 1.5e-3, rng=rng),
    }
    motions = {name: from_rest(motion, length_s) for name, motion in motions.items()}
    films = {
        name: infrared(
            motion,
            fans(seed, *cups(motion, INFRARED_MM, 33.5, 16.5), *((finger,) if name == "case 2" else ())),
            10 * seed + int(name[-1]),
            length_s=length_s,
            rate_hz=rate_hz,
            scale=INFRARED_MM,
        )
        for name, motion in motions.items()
    }
    case_1 = films.pop("case 1")
    few = slice(None, 200)
    known = replace(case_1, frames=case_1.frames[few], px=case_1.px[few])
    surface = estimated(known)
    # The finger is 12 px wide and goes by at 24 px/s: from its way into the region to its way out.
    front = (length_s - 6.5 + 0.5, length_s - 6.5 + 3.5)
    both = {name: by_range(one, surface, known, *([front] if name == "case 2" else [])) for name, one in films.items()}
    found = {name: values for name, (values, _) in both.items()}
    quiet = ("case 3", "case 4", "case 5")
    values: dict[str, Any] = {_of(key, "case 2"): value for key, value in found["case 2"].items()}
    values |= {_of(key, "cases 3 to 5"): [found[name][key] for name in quiet] for key in found["case 2"]}
    values |= {f"{key}, mean": float(np.mean([found[name][key] for name in quiet])) for key in found["case 2"]}
    for name in ("ROI", "optimised"):
        left = found["case 2"][f"{name} with the finger (matches)"] / found["case 2"][f"{name} (matches)"]
        values[f"{name}, left with the finger (%)"] = 100 * left
    values |= _corners(surface)
    counts = {name: (films["case 2"].at_s, one) for name, one in both["case 2"][1].items()}
    return Measured(values, (Curve("Fig. 12 (b)", "time (s)", "matches", counts),))


def _of(key: str, case: str) -> str:
    """The name of a number of one case; its unit in brackets comes last."""
    name, bracket, unit = key.partition(" (")
    return f"{name}, {case}{bracket}{unit}"


def from_rest(motion: Motion, length_s: float) -> Motion:
    """The motion from rest: the filter that predicts starts at rest."""
    return Window(motion, 0.5, length_s + 2.0, ramp_s=1.0)


def _sine(frequency_hz: float) -> Motion:
    return Sines(np.array([4e-3]), np.array([frequency_hz]))


def _corners(surface: RangeSurface) -> dict[str, float]:
    """The best range, whether it is one of the corners, and the steps l and h."""
    region, field = (surface.low_c[0], surface.high_c[0]), (surface.low_c[-1], surface.high_c[-1])
    best = (surface.best.low_c, surface.best.high_c)
    corner = any(np.allclose(best, other) for other in (region, field))
    return {
        "best low (°C)": best[0],
        "best high (°C)": best[1],
        "is a corner": float(corner),
        "ranges": float(surface.error_px.size),
    }


def grid(effort: Effort) -> Measured:
    """Figure 11: the candidates between the paper's own ranges."""
    low, high = candidates(Limits(23.65, 28.08), Limits(15.94, 33.52), DIVISIONS)
    return Measured(
        {
            "l K": low[0] - low[1],
            "h K": high[1] - high[0],
            "l, off by K": abs(low[0] - low[1] - 0.857),
            "h, off by K": abs(high[1] - high[0] - 0.604),
            "[16.79, 28.08] off the grid by K": float(np.min(np.abs(low - 16.79)) + np.min(np.abs(high - 28.08))),
        }
    )


def bridge(effort: Effort) -> Measured:
    """Figure 20: four people jump on a cold bridge, a bus passes with its exhaust."""
    length_s, rate_hz = (12.0, 15.0) if effort.quick else (30.0, 15.0)
    rng = np.random.default_rng([4, effort.seed])
    motion = from_rest(random_motion((2.0, 2.3), 2.5e-3, rng=rng), length_s)
    cold = cups(motion, 3.827, 9.0, -14.0)
    exhaust = WarmBody(0.7 * length_s, -20.0, 40.0, 20.0, 26.0, 60.0, celsius=25.0)
    setting = {"length_s": length_s, "rate_hz": rate_hz, "scale": 3.827}
    case = [
        infrared(motion, fans(effort.seed, *cold, *more, mean_c=-1.0), 50 + effort.seed, **setting)
        for more in ((), (exhaust,))
    ]
    few = slice(None, int(10 * rate_hz), 3)
    known = replace(case[0], frames=case[0].frames[few], px=case[0].px[few])
    surface = estimated(known)
    return Measured(by_range(case[1], surface, known)[0] | _corners(surface))


# Vision: cases 6 and 7.


def lit(wall: Wall, moved: Floats, lights: Sequence[Light], seed: int) -> list[Frame]:
    """Frames (8 bit, noise of 2 DN) of a wall under one light each."""
    rng, frames = np.random.default_rng([5, seed]), []
    for k, (y, light) in enumerate(zip(moved, lights, strict=True)):
        picture = 300.0 * wall.brightness((0.0, float(y)), light, None) + rng.normal(0.0, 2.0, wall.size_px)
        frames.append(Frame(round(1e9 * k / WALL_HZ), np.clip(np.rint(picture), 0, 255).astype(np.uint8), k))
    return frames


def relief(rng: np.random.Generator) -> Wall:
    """A stone whose bumps are all that throws shade."""
    wall = wall_in_relief((96, 96), rng=rng, slope=0.25)
    return replace(wall, post_at_px=-1e4, eaves_px=0.0)


def lamp(angle_rad: float, strength: float) -> Light:
    """A flashlight at an angle from the wall's normal, in a room with some light of its own."""
    return Light(float(np.sin(angle_rad)), 0.2, float(np.cos(angle_rad)), strength, 0.02)


def moving_light(effort: Effort) -> Measured:
    """Case 6: for 210 s under a flashlight that moves from 30 s on."""
    length_s = 150.0 if effort.quick else 210.0
    at_s = np.arange(int(length_s * WALL_HZ)) / WALL_HZ
    pushes = tuple(Pulse(h, t, 8.0) for h, t in ((3e-3, 50.0), (-2e-3, 110.0), (3e-3, 170.0)))
    motion = from_rest(Sum((Sines(np.array([2e-3]), np.array([1.0])), *pushes)), length_s)
    moved = motion.displacement(at_s) / (1e-3 * CAMERA_MM)
    moved -= moved[0]
    later = np.clip(at_s - 30.0, 0.0, None)
    # To the side until 80 s, where it swings from then on: a fixed reference never sees its light again.
    angles = np.where(later < 50.0, 1.2 * later / 50.0, 1.05 + 0.15 * np.cos(2 * np.pi * (later - 50.0) / 60.0))
    wall = relief(np.random.default_rng([6, effort.seed]))
    lights = [lamp(float(a), 0.9 - 0.5 * abs(np.sin(a))) for a in angles]
    one = filmed(lit(wall, moved, lights, effort.seed), moved, CAMERA_MM, motion, length_s, effort.seed)
    updating = UpdatingTracker(one.frames[0], WALL_ROI, UpdatingSettings("features", FEATURES, literal=True))
    trackers: dict[str, Tracker] = {
        "fixed": open_tracker("features", one.frames[0], WALL_ROI, FEATURES),
        "updating": updating,
        "key frames": KeyFrameTracker(one.frames[0], WALL_ROI, KeyFrameSettings(tracker="template")),
    }
    tracks = {name: one.followed(tracker, printed=name != "key frames") for name, tracker in trackers.items()}
    values = {name: one.error_mm(PixelTrack.stack(rows)) for name, rows in tracks.items()}
    lost = {name: 100 * float(np.mean([not np.isfinite(row.y_px) for row in rows])) for name, rows in tracks.items()}
    matches = {name: np.array([_matches(row) for row in tracks[name]]) for name in ("fixed", "updating")}
    values |= {f"{name} lost (%)": share for name, share in lost.items()}
    values["updating (updates)"] = updating.state.updates
    curve = Curve("Fig. 16 (b)", "time (s)", "matches", {name: (at_s, one) for name, one in matches.items()})
    return Measured(values, (curve,))


def _matches(row: PixelTranslation) -> float:
    return row.strength if np.isfinite(row.y_px) else 0.0


def day_and_night(effort: Effort) -> Measured:
    """Case 7: the light goes out between 38 and 60 s and comes back before 100 s; the air cools from 60 s on."""
    length_s = 120.0
    at_s = np.arange(int(length_s * WALL_HZ)) / WALL_HZ
    motion = from_rest(random_motion((0.3, 2.2), 1.5e-3, rng=np.random.default_rng([7, effort.seed])), length_s)
    true = motion.displacement(at_s) - motion.displacement(np.zeros(1))
    strength = np.interp(at_s, [38.0, 56.0, 60.0, 94.0, 100.0], [0.8, 0.02, 0.0, 0.0, 0.8])
    lights = [lamp(float(a), float(s)) for a, s in zip(np.interp(at_s, [0, 60], [-0.3, 0.3]), strength, strict=True)]
    wall = relief(np.random.default_rng([8, effort.seed]))
    px, warmer_px = (true / (1e-3 * scale) for scale in (CAMERA_MM, INFRARED_MM))
    seen = filmed(lit(wall, px, lights, effort.seed), px, CAMERA_MM, motion, length_s, effort.seed)
    warm = filmed(_cooling(true, at_s, effort.seed), warmer_px, INFRARED_MM, motion, length_s, effort.seed)
    sensed = seen.acceleration
    calibration = slice(None, 100, 2)
    known = replace(warm, frames=warm.frames[calibration], px=warm.px[calibration])
    levels = estimated(known).best
    grey = in_grey(warm.frames, levels)
    rule = UpdatingSettings("features", FEATURES, literal=True)
    printed = {
        "camera": seen.followed(UpdatingTracker(seen.frames[0], WALL_ROI, rule), printed=True),
        "infrared": warm.followed(
            UpdatingTracker(grey[0], INFRARED_ROI, replace(rule, tracker_settings=IN_GREY)), grey, printed=True
        ),
    }
    chosen = _chosen(at_s, printed)
    rows = [printed[name][k] for k, name in enumerate(chosen)]
    scale = np.array([{"camera": CAMERA_MM, "infrared": INFRARED_MM}[name] for name in chosen])
    value_mm = scale * np.array([row.y_px for row in rows])
    acceleration = Acceleration(sensed.time_ns, sensed.value, np.full(len(sensed.value), DENSITY))
    changes = np.flatnonzero(np.array(chosen[1:]) != np.array(chosen[:-1])) + 1
    seen_s = np.concatenate(([0.0], at_s[np.isfinite(value_mm)], [at_s[-1]]))
    gaps = np.diff(seen_s)
    variance = (scale * 1e-3) ** 2 * np.array([row.variance_y_px2 for row in rows])
    fused = _fused(acceleration, (at_s, value_mm, variance), seen.truth_m, literal=True)
    alone = seen.error_mm(PixelTrack.stack(printed["camera"]))
    values: dict[str, Any] = {
        "vision lost (%)": 100 * float(np.mean([not np.isfinite(row.y_px) for row in printed["camera"]])),
        "vision alone": alone,
        "switched": float(np.nanstd(value_mm - 1e3 * true)),
        "switched and fused": fused,
        "switches": len(changes),
        "to infrared (s)": float(at_s[changes[0]]) if len(changes) else float("nan"),
        "to vision (s)": float(at_s[changes[-1]]) if len(changes) else float("nan"),
        "longest gap (s)": float(gaps.max()),
        "gap from (s)": float(seen_s[np.argmax(gaps)]),
        "ours": _ours(acceleration, (seen, warm), at_s, seen.truth_m),
    }
    counts = {name: (at_s, np.array([_matches(row) for row in rows])) for name, rows in printed.items()}
    return Measured(values, (Curve("Fig. 18 (d)", "time (s)", "matches", counts),))


def _cooling(true_m: Floats, at_s: Floats, seed: int) -> list[Frame]:
    """A target that keeps its temperatures for 60 s, then cools until 100 s: another pattern comes through."""
    scenes = tuple(
        textured_scene("natural", INFRARED_SIZE, rng=np.random.default_rng([9, k, seed]), reach_px=10.0, lens_px=1.0)
        for k in range(2)
    )
    view = ThermalView(scenes, 0.9, Course(25.9, -3.0, 240.0))
    cooled = np.clip(at_s - 60.0, 0.0, 40.0)
    moved = true_m / (1e-3 * INFRARED_MM)
    pictures = view.film(np.stack([0.0 * moved, moved], axis=1), cooled, rng=np.random.default_rng([10, seed]))
    return [Frame(round(1e9 * s), p, k) for k, (s, p) in enumerate(zip(at_s, pictures, strict=True))]


def _chosen(at_s: Floats, rows: dict[str, list[PixelTranslation]]) -> list[str]:
    """Which camera measures in each frame: by day vision, by night infrared, between them that with more matches."""
    # [0, 38] day, [38, 52] transition, [52, 92] night, [92, 108] transition, [108, 120] day, s.
    switch, chosen = Switch(("camera", "infrared")), []
    for k, time_s in enumerate(at_s):
        for name, own in rows.items():
            switch.push(name, own[k].time_ns, _matches(own[k]))
        if time_s < 38.0 or time_s >= 108.0:
            chosen.append("camera")
        else:
            chosen.append("infrared" if 52.0 <= time_s < 92.0 else switch.chosen)
    return chosen


def _fused(
    acceleration: Acceleration, series: tuple[Floats, Floats, Floats], truth_m: Floats, *, literal: bool
) -> float:
    """Error in mm of a series (time in s, mm, m²) after fusion, the filter's first seconds left out."""
    at_s, value_mm, variance = series
    good = np.isfinite(value_mm) & np.isfinite(variance)
    source = np.full(int(good.sum()), Source.CAMERA, dtype=np.uint8)
    stamps = np.round(1e9 * at_s[good]).astype(np.int64)
    displacement = Displacement(stamps, 1e-3 * value_mm[good], variance[good], source)
    method = "adaptive-kalman" if literal else "smoother"
    settings = MethodSettings(KalmanSettings(bias=ACCELEROMETER.bias_m_s2), literal=literal)
    rows = run_method(method, acceleration, displacement, settings).estimate
    error = 1e3 * (rows.displacement_m - truth_m[-len(rows.time_ns) :])
    # The estimated noise R remembers 20 frames: 2 s, and the start is one of them.
    return float(np.std(error[round(5.0 * FELT_HZ) :]))


def _ours(acceleration: Acceleration, films: tuple[Filmed, Filmed], at_s: Floats, truth_m: Floats) -> float:
    """Error in mm of key frames before both cameras, infrared in °C, each with its variance, smoothed."""
    seen, warm = films
    camera = KeyFrameTracker(seen.frames[0], WALL_ROI, KeyFrameSettings(tracker="template"))
    thermal = ThermalTarget(
        warm.frames[0],
        INFRARED_ROI,
        lambda frame: KeyFrameTracker(frame, INFRARED_ROI, KeyFrameSettings(tracker="template")),
    )
    parts = []
    for tracker, one in ((camera, seen), (thermal, warm)):
        rows = one.followed(tracker, printed=False)
        variance = np.array([row.variance_y_px2 + row.reference_variance_y_px2 for row in rows])
        parts.append((at_s, one.scale_mm * np.array([row.y_px for row in rows]), (1e-3 * one.scale_mm) ** 2 * variance))
    # The second camera's frames come a little later: two measurements of one instant have no order.
    both = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    both[0][len(at_s) :] += 1e-3
    order = np.argsort(both[0])
    return _fused(acceleration, (both[0][order], both[1][order], both[2][order]), truth_m, literal=False)
