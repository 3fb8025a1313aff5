"""What a scenario is made of, and everything in it drawn from the seed, ready to be measured."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from midspan.records import Floats, Region, TimeSeries, nanoseconds
from midspan.signals.acceleration import GRAVITY_M_S2
from midspan.simulate.day.setup import DaySetup
from midspan.simulate.motion.motion import Motion, random_motion
from midspan.simulate.motion.sensors import (
    AccelerometerModel,
    DisplacementSensorModel,
    frame_stamps,
    noise_std_for,
    stepped,
)
from midspan.simulate.radar.setup import RadarSetup
from midspan.simulate.scene.camera import Camera, Light, View
from midspan.simulate.scene.disturbances import Disturbance, Panel
from midspan.simulate.scene.fisheye import Fisheye, bent_scene
from midspan.simulate.scene.pose import Plane, Pose, PosedView
from midspan.simulate.scene.texture import textured_scene
from midspan.vision.pose import rotation_vector

Span = tuple[float, float]  # start and end in s


@dataclass(frozen=True, slots=True)
class Posed:
    """A camera that turns: pose, what it looks at, rows and columns of its picture, focal length (px) and lens.

    sensed: the motion as the accelerometer meets it.
    """

    pose: Pose
    planes: tuple[Plane, ...]
    size_px: tuple[int, int]
    focal_px: float
    sensed: Motion
    k1: float = 0.0


@dataclass(frozen=True, slots=True)
class CameraSetup:
    """A camera of a scenario; spans are in s of true time.

    `start_s` is the time of the first frame on the camera's clock; true time = that clock + `time_offset_s`.
    Frames in `dropped` are absent from the file, those in `black` are dark. `panels` are parts at other distances;
    `targets` (name, region) are written as [[camera.target]], with the distances and their deviations in `declared_m`
    and the lens where there are any. `says_exposure`: whether the settings state the exposure.
    `fisheye`: the lens, whose scene and frames take the place of `texture` and `size_px`. `clock_step`: true time (s)
    at which the camera's clock is set, and by how much (s). `posed`: draws the pose from the structure's motion; it
    takes the place of scale, texture, size and panels.
    """

    rate_hz: float = 10.0
    start_s: float = 0.0
    time_offset_s: float = 0.137
    scale_mm_per_px: float = -1.5
    direction: str = "y"
    texture: str = "natural"
    size_px: tuple[int, int] = (240, 320)  # rows, columns
    camera: Camera = field(default_factory=Camera)
    every: int = 1
    light: Light | None = None
    disturbances: Callable[[np.random.Generator], tuple[Disturbance, ...]] | None = None
    dropped: tuple[Span, ...] = ()
    black: tuple[Span, ...] = ()
    panels: Callable[[np.random.Generator], tuple[Panel, ...]] | None = None
    targets: tuple[tuple[str, Region], ...] = ()
    declared_m: tuple[tuple[float, float], ...] = ()
    says_exposure: bool = True
    fisheye: Fisheye | None = None
    clock_step: tuple[float, float] = (np.inf, 0.0)
    posed: Callable[[Motion, np.random.Generator], Posed] | None = None


@dataclass(frozen=True, slots=True)
class GnssSetup:
    """A displacement sensor of a scenario; rows in `absent` are missing, values in `unread` are left empty.

    `clock_step`: true time (s) at which its clock is set, and by how much (s). `white`: errors declared as such.
    """

    sensor: DisplacementSensorModel
    absent: tuple[Span, ...] = ()
    unread: tuple[Span, ...] = ()
    clock_step: tuple[float, float] = (np.inf, 0.0)
    white: bool = True


@dataclass(frozen=True, slots=True)
class GyroscopeSetup:
    """A gyroscope about the image's x axis in a box that turns, and an accelerometer along its view.

    density: of the rate's white noise, one-sided, °/s/√Hz; bias: °/s; the rest is of the accelerometer along the view:
    white noise (m/s²), vibration from 1 to 3 Hz (m/s² rms) and a slow error of its bias (m/s² rms).
    """

    density: float = 0.005
    bias: float = 0.2
    noise_std_m_s2: float = 1e-3
    vibration_m_s2: float = 1e-2
    slow_m_s2: float = 1e-4

    def measure(self, pitch: Motion, time_s: Floats, *, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Rate (n,), °/s, and specific force along the view (n,), m/s², of a box that turns by `pitch`, rad."""
        noisy, shaken, slow = rng.spawn(3)
        rate_hz = 1.0 / float(time_s[1] - time_s[0])
        rate = np.degrees(pitch.velocity(time_s)) + self.bias
        rate += noisy.normal(0.0, self.density * np.sqrt(0.5 * rate_hz), len(time_s))
        along = GRAVITY_M_S2 * np.sin(pitch.displacement(time_s))
        along += noisy.normal(0.0, self.noise_std_m_s2, len(time_s))
        along += random_motion((1.0, 3.0), self.vibration_m_s2, rng=shaken).displacement(time_s)
        return rate, along + random_motion((0.005, 0.05), self.slow_m_s2, rng=slow).displacement(time_s)


@dataclass(frozen=True, slots=True)
class VibrometerSetup:
    """A laser vibrometer: its rate (Hz), white noise (m/s) and by how much its clock is late (s)."""

    rate_hz: float = 100.0
    noise_std_m_s: float = 1e-4
    time_offset_s: float = 0.05


@dataclass(frozen=True, slots=True)
class Scenario:
    """A recording to be simulated: `line` says what it shows; `motion` draws the motion from a generator.

    With `snr_db` the accelerometer's noise is set from the motion. Accelerometer rows in `absent` are missing, values
    in `unread` are left empty; spans are in s of true time. `across` draws the motion along the other image axis, which
    has a column of acceleration of its own. `window_s` is written as calibration.window_s. `free`: of a paper's test,
    what the paper does not print and is chosen here.
    """

    line: str
    title: str
    duration_s: float
    motion: Callable[[np.random.Generator], Motion]
    accelerometer: AccelerometerModel
    camera: CameraSetup | None = None
    gnss: GnssSetup | None = None
    snr_db: float | None = None
    absent: tuple[Span, ...] = ()
    unread: tuple[Span, ...] = ()
    across: Callable[[np.random.Generator], Motion] | None = None
    radar: RadarSetup | None = None
    window_s: Span | None = None
    day: DaySetup | None = None
    gyroscope: GyroscopeSetup | None = None
    vibrometer: VibrometerSetup | None = None
    free: str = ""


@dataclass(frozen=True, slots=True)
class Stage:
    """A scenario with its seed: the motion and the generators of what remains random.

    sensed: the motion as the sensors meet it, which is the true one until something is broken.
    """

    scenario: Scenario
    motion: Motion
    sensed: Motion
    accelerometer: AccelerometerModel
    rng_accelerometer: np.random.Generator
    rng_scene: np.random.Generator
    rng_sensor: np.random.Generator
    rng_across: np.random.Generator
    rng_radar: np.random.Generator
    rng_breaks: np.random.Generator
    across: Motion | None = None
    posed: Posed | None = None

    def acceleration(self, *, across: bool = False) -> TimeSeries:
        """Acceleration in m/s² as stored, with its gaps; NaN where no number is written. across: the other axis'."""
        motion, rng = self.sensed, self.rng_accelerometer
        if across:
            assert self.across is not None
            motion, rng = self.across, self.rng_across
        whole = self.accelerometer.measure(motion, (0.0, self.scenario.duration_s), rng=rng)
        return with_gaps(whole, absent=self.scenario.absent, unread=self.scenario.unread)

    def rotation(self) -> tuple[Floats, Floats, Floats]:
        """Times (n,), s, rate about the image's x axis, °/s, and specific force along the view, m/s²."""
        assert self.posed is not None
        assert self.scenario.gyroscope is not None
        time = np.arange(round(self.scenario.duration_s * self.accelerometer.rate_hz)) / self.accelerometer.rate_hz
        rng = self.rng_sensor.spawn(1)[0]
        return (time, *self.scenario.gyroscope.measure(self.posed.pose.rotation[0], time, rng=rng))

    def speed(self, setup: VibrometerSetup) -> tuple[Floats, Floats]:
        """Times (n,) on the vibrometer's clock, s, and velocity, mm/s."""
        stamps = frame_stamps(self.scenario.duration_s, setup.rate_hz, 0.0, setup.time_offset_s)
        value = self.sensed.velocity(stamps + setup.time_offset_s)
        noise = self.rng_sensor.spawn(1)[0].normal(0.0, setup.noise_std_m_s, len(stamps))
        return stamps, 1e3 * (value + noise)

    def written_stamps_s(self, setup: CameraSetup) -> Floats:
        """Time stamps (n,) in s of the frames as they are written: of a clock that may be set in between."""
        stamps = self.frame_stamps_s(setup)
        return stepped(stamps, stamps + setup.time_offset_s, setup.clock_step)

    def frame_stamps_s(self, setup: CameraSetup) -> Floats:
        """Time stamps (n,) in s on the camera's clock of the frames that are stored."""
        stamps = frame_stamps(self.scenario.duration_s, setup.rate_hz, setup.start_s, setup.time_offset_s)
        return stamps[~within(stamps + setup.time_offset_s, setup.dropped)]

    def posed_view(self, setup: CameraSetup) -> PosedView | None:
        """The camera that turns before its planes; None where it does not turn."""
        if (own := self.posed) is None:
            return None
        return PosedView(own.planes, own.pose, own.size_px, own.focal_px, own.k1, setup.camera)

    def pose_truth(self) -> dict[str, Floats]:
        """Columns (n,) of the camera's translation in mm and rotation in mdeg in its own axes at the first frame, at
        every sampling instant; none where it does not turn.
        """
        setup, rate = self.scenario.camera, self.accelerometer.rate_hz
        if self.posed is None or setup is None or not setup.declared_m:
            return {}
        time = np.arange(round(self.scenario.duration_s * rate)) / rate
        first = self.frame_stamps_s(setup)[:1] + setup.time_offset_s
        place, turned = self.posed.pose.at(time)
        place_0, turned_0 = self.posed.pose.at(first)
        moved = 1e3 * (place - place_0) @ turned_0[0]
        turns = 1e3 * np.degrees(rotation_vector(turned_0[0].T @ turned))
        names = [f"translation_{axis}_mm" for axis in "xyz"] + [f"rotation_{axis}_mdeg" for axis in "xyz"]
        return dict(zip(names, np.hstack((moved, turns)).T, strict=True))

    def view(self, setup: CameraSetup) -> View:
        """The camera looking at its scene."""
        rng_texture, rng_disturbances, rng_panels = self.rng_scene.spawn(3)
        scene = (
            textured_scene(setup.texture, setup.size_px, rng=rng_texture)
            if setup.fisheye is None
            else bent_scene(setup.fisheye, rng=rng_texture)
        )
        return View(
            scene,
            setup.scale_mm_per_px * 1e-3,
            setup.direction,
            setup.camera,
            setup.light,
            setup.disturbances(rng_disturbances) if setup.disturbances else (),
            setup.panels(rng_panels) if setup.panels else (),
            self.across,
        )

    def displacement(self, setup: GnssSetup) -> TimeSeries:
        """Displacement in m as stored, with its gaps; NaN where no number is written."""
        whole = setup.sensor.measure(self.sensed, (0.0, self.scenario.duration_s), rng=self.rng_sensor)
        kept = with_gaps(whole, absent=setup.absent, unread=setup.unread)
        stamps_s = kept.time_ns / 1e9
        moved = stepped(stamps_s, stamps_s + setup.sensor.time_offset_s, setup.clock_step)
        return replace(kept, time_ns=kept.time_ns + nanoseconds(moved - stamps_s))

    def zero_m(self, motion: Motion | None = None) -> float:
        """The true displacement in m at the zero of the results: the first frame, else the sensor's own zero."""
        camera, radar = self.scenario.camera, self.scenario.radar
        if camera is not None:
            first = self.frame_stamps_s(camera)[:1] + camera.time_offset_s
        elif radar is not None:
            first = np.array([radar.first_s])
        elif self.scenario.day is not None:
            first = np.array([self.scenario.day.first_s])
        else:
            return 0.0
        return float((motion or self.motion).displacement(first)[0])

    def truth_mm(self, motion: Motion | None = None) -> Floats:
        """Rows (n, 3) of time in s, displacement in mm from the zero, velocity in mm/s, at every sampling instant.

        motion: another one than the main, that across.
        """
        motion = motion or self.motion
        rate = self.accelerometer.rate_hz
        time = np.arange(round(self.scenario.duration_s * rate)) / rate
        moved = motion.displacement(time) - self.zero_m(motion)
        return np.stack([time, 1e3 * moved, 1e3 * motion.velocity(time)], axis=1)


def stage(scenario: Scenario, seed: int) -> Stage:
    """The scenario with everything random drawn from `seed`; the same seed gives the same recording."""
    rng_motion, rng_accelerometer, rng_scene, rng_sensor, rng_other = np.random.default_rng(seed).spawn(5)
    rng_across, rng_motion_across, rng_radar, rng_breaks = rng_other.spawn(4)
    motion = scenario.motion(rng_motion)
    accelerometer = scenario.accelerometer
    if scenario.snr_db is not None:
        time = np.arange(round(scenario.duration_s * accelerometer.rate_hz)) / accelerometer.rate_hz
        noise = noise_std_for(motion.acceleration(time), scenario.snr_db)
        accelerometer = replace(accelerometer, noise_std_m_s2=noise)
    across = None if scenario.across is None else scenario.across(rng_motion_across)
    generators = (rng_accelerometer, rng_scene, rng_sensor, rng_across, rng_radar, rng_breaks)
    turns = None if scenario.camera is None else scenario.camera.posed
    posed = None if turns is None else turns(motion, rng_scene)
    sensed = motion if posed is None else posed.sensed
    return Stage(scenario, motion, sensed, accelerometer, *generators, across, posed)


def within(time_s: Floats, spans: tuple[Span, ...]) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which of the times (n,) lie in one of the half-open spans, all in s."""
    inside = np.zeros(len(time_s), dtype=np.bool_)
    for start, end in spans:
        inside |= (time_s >= start) & (time_s < end)
    return inside


def with_gaps(series: TimeSeries, *, absent: tuple[Span, ...], unread: tuple[Span, ...]) -> TimeSeries:
    """The series without its rows in `absent`, and with NaN for the values in `unread`."""
    time = series.time_ns / 1e9
    value = np.where(within(time, unread), np.nan, series.value)
    kept = ~within(time, absent)
    return replace(series, time_ns=series.time_ns[kept], value=value[kept])
