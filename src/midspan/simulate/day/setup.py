"""A camera and a thermal camera on one structure through a day: how they are set up, and the files they leave."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from midspan.records import Floats
from midspan.simulate.day.camera import DayCamera, wall_in_relief
from midspan.simulate.day.infrared import DayCourse, DayInfrared
from midspan.simulate.day.sky import Drops, Headlights, Sky, Span
from midspan.simulate.files.folder import Progress, counted, exact_in_video, write_celsius, write_table, write_video
from midspan.simulate.motion.motion import Motion
from midspan.simulate.motion.sensors import frame_stamps
from midspan.simulate.scene.texture import textured_scene
from midspan.simulate.scene.thermal import ThermalCamera, ThermalView, WarmBody

VIDEO, INFRARED, TIMES = "camera.mkv", "infrared.npz", "camera_times.csv"


@dataclass(frozen=True, slots=True)
class CameraPlan:
    """One of both cameras: displacement = scale_mm_per_px × translation down the picture of `size_px` (rows, columns).

    True time = its clock + `time_offset_s`; its first frame is at `start_s` of its clock.
    """

    size_px: tuple[int, int]
    scale_mm_per_px: float
    rate_hz: float = 4.0
    start_s: float = 0.0
    time_offset_s: float = 0.0

    def stamps_s(self, duration_s: float) -> Floats:
        """Time stamps (n,) of its frames in s on its own clock."""
        return frame_stamps(duration_s, self.rate_hz, self.start_s, self.time_offset_s)

    def moved_px(self, motion: Motion, stamps_s: Floats) -> Floats:
        """Translation (n, 2) of the scene along x and y at its own stamps (n,)."""
        down = motion.displacement(stamps_s + self.time_offset_s) / (1e-3 * self.scale_mm_per_px)
        return np.stack([np.zeros_like(down), down], axis=1)


@dataclass(frozen=True, slots=True)
class DaySetup:
    """Both cameras, their day and what happens in it; all times are true ones in s, 0 at noon.

    camera: None where there is the thermal one alone. contrast_k: of the surfaces' temperatures; thermal: what the
    thermal camera adds. Where targets are given (`camera_roi`, `infrared_roi`: x, y, width, height in px) they are
    written into the settings.
    """

    sky: Sky
    camera: CameraPlan | None
    infrared: CameraPlan
    contrast_k: float = 1.5
    course: DayCourse = field(default_factory=DayCourse)
    thermal: ThermalCamera = field(default_factory=ThermalCamera)
    bodies: tuple[WarmBody, ...] = ()
    cars: Headlights = field(default_factory=Headlights)
    camera_roi: tuple[int, int, int, int] | None = None
    infrared_roi: tuple[int, int, int, int] | None = None
    reach_px: float = 16.0

    @property
    def first_s(self) -> float:
        """True time of the camera's first frame, the zero of the displacement."""
        plan = self.camera or self.infrared
        return plan.start_s + plan.time_offset_s

    def day_camera(self, plan: CameraPlan, rng: np.random.Generator) -> DayCamera:
        """The camera before its wall."""
        rng_wall, rng_drops, rng_seed = rng.spawn(3)
        wall = wall_in_relief(plan.size_px, rng=rng_wall, reach_px=self.reach_px)
        drops = Drops(plan.size_px, self.sky.rain, rng=rng_drops) if self.sky.rain else None
        return DayCamera(wall, self.sky, drops=drops, cars=self.cars, seed=int(rng_seed.integers(2**31)))

    def day_infrared(self, rng: np.random.Generator) -> DayInfrared:
        """The thermal camera before its wall."""
        rng_sun, rng_kept, rng_drops, rng_seed = rng.spawn(4)
        scenes = tuple(
            textured_scene("natural", self.infrared.size_px, rng=r, reach_px=self.reach_px, lens_px=0.9)
            for r in (rng_sun, rng_kept)
        )
        view = ThermalView(scenes, self.contrast_k, self.course, self.bodies, self.thermal)
        drops = Drops(self.infrared.size_px, self.sky.rain, rng=rng_drops, count=6) if self.sky.rain else None
        return DayInfrared(view, self.sky, drops, seed=int(rng_seed.integers(2**31)))

    def settings(self, duration_s: float) -> dict[str, Any]:
        """The sections [camera], where there is one, and [infrared] of recording.toml."""
        # Temperatures turn around, so that key frames are needed; a template tells best how well they still match.
        sections: dict[str, Any] = {"infrared": {"file": INFRARED, "direction": "y", "tracker": "template"}}
        if self.camera is not None:
            times = {} if exact_in_video(self.camera.stamps_s(duration_s)) else {"times": TIMES}
            camera = {"file": VIDEO, **times, "rate_hz": self.camera.rate_hz, "direction": "y"}
            sections = {"camera": camera, **sections}
        for name, roi in (("camera", self.camera_roi), ("infrared", self.infrared_roi)):
            if roi is not None:
                sections[name]["roi"] = list(roi)
        return sections

    def write(
        self, folder: Path, motion: Motion, *, duration_s: float, rng: np.random.Generator, progress: Progress
    ) -> dict[str, Any]:
        """Write the files of both cameras on a motion frame by frame; returns what is known of them."""
        rng_camera, rng_infrared = rng.spawn(2)
        stamps = self.infrared.stamps_s(duration_s)
        before = 0 if self.camera is None else len(self.camera.stamps_s(duration_s))

        def done(frames: int) -> None:
            progress(frames, before + len(stamps))

        if self.camera is not None:
            self._write_video(folder, self.camera, self.day_camera(self.camera, rng_camera), (motion, duration_s, done))
        infrared, plan = self.day_infrared(rng_infrared), self.infrared
        moved, times = plan.moved_px(motion, stamps), stamps + plan.time_offset_s
        pictures = (infrared.film_number(number, moved, times) for number in range(len(stamps)))
        counted_pictures = counted(pictures, lambda picture: 1, lambda count: done(before + count))
        write_celsius(folder / INFRARED, counted_pictures, stamps, plan.size_px)
        return self._known(duration_s)

    def _write_video(
        self, folder: Path, plan: CameraPlan, camera: DayCamera, run: tuple[Motion, float, Callable[[int], None]]
    ) -> None:
        motion, duration_s, done = run
        stamps = plan.stamps_s(duration_s)
        moved, times = plan.moved_px(motion, stamps), stamps + plan.time_offset_s
        pictures = (camera.picture(number, moved[number], float(times[number])) for number in range(len(stamps)))
        write_video(folder / VIDEO, pictures, stamps_s=stamps, rate_hz=plan.rate_hz, done=done)
        if not exact_in_video(stamps):
            write_table(folder / TIMES, {"time_s": stamps}, decimals={"time_s": 9})

    def _known(self, duration_s: float) -> dict[str, Any]:
        plans = {
            name: {"scale_mm_per_px": plan.scale_mm_per_px, "time_offset_s": plan.time_offset_s}
            for name, plan in (("camera", self.camera), ("infrared", self.infrared))
            if plan is not None
        }
        day: dict[str, list[Any]] = {
            "night_s": [list(self.sky.night(k)) for k in range(int(duration_s / self.sky.length_s) + 1)],
            "fog_s": [list(span) for span in self.sky.fog],
            "rain_s": [list(span) for span in self.sky.rain],
            "headlights_s": list(self.cars.starts_s),
            "shutter_s": list(self.thermal.shutters_s),
            "warm_body_s": [body.start_s for body in self.bodies],
        }
        return {**plans, "day": day}


def hours(day_s: float, *at: float) -> tuple[float, ...]:
    """True times in s of this many hours after noon, where 24 hours last `day_s`."""
    return tuple(day_s * hour / 24.0 for hour in at)


def span_hours(day_s: float, start: float, end: float) -> Span:
    """A span in s between hours after noon, where 24 hours last `day_s`."""
    return day_s * start / 24.0, day_s * end / 24.0
