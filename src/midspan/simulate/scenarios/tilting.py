"""Structures that turn as they move, with a camera before targets at several distances."""

from dataclasses import dataclass

import numpy as np

from midspan.records import Region
from midspan.signals.acceleration import GRAVITY_M_S2
from midspan.simulate.motion.motion import Leaning, Motion, Pulse, Rest, Scaled, Sum, modes, random_motion
from midspan.simulate.motion.sensors import AccelerometerModel, DisplacementSensorModel
from midspan.simulate.scenarios.stage import (
    CameraSetup,
    GnssSetup,
    GyroscopeSetup,
    Posed,
    Scenario,
    VibrometerSetup,
)
from midspan.simulate.scene.camera import Camera
from midspan.simulate.scene.pose import Plane, Pose
from midspan.simulate.scene.texture import textured_scene

MDEG = float(np.radians(1e-3))
FOCAL_PX = 5000.0
# A span of 45 m at its quarter: slope over displacement in its second mode, rad/m.
SPAN_SLOPE = np.pi / 45.0
# A target moves by less than this within its part of the picture, px.
RIM_PX = 12


@dataclass(frozen=True, slots=True)
class TiltingFootbridge:
    """Pose and planes of a box at a footbridge's quarter span that looks along it at posts at these distances.

    The box leans with the bridge, later under walkers than it sinks, and nods on its bracket. upwards: 1 where the
    motion counts upwards, -1 downwards.
    """

    distances_m: tuple[float, ...] = (3.0, 10.0)
    size_px: int = 128
    upwards: float = 1.0

    def __call__(self, motion: Motion, rng: np.random.Generator) -> Posed:
        """The camera's pose with the bridge's motion, and what it looks at."""
        drawn, *textures = rng.spawn(1 + len(self.distances_m))
        nods = random_motion((3.3, 3.7), 1.5 * MDEG, rng=drawn, lines=20)
        sun = random_motion((0.004, 0.02), 4.0 * MDEG, rng=drawn, lines=6)
        slope = self.upwards * SPAN_SLOPE
        pitch = Sum((Scaled(motion, 0.6 * slope), Scaled(motion, 0.4 * slope, late_s=2.0), nods, sun))
        roll = random_motion((3.3, 3.7), 0.5 * MDEG, rng=drawn, lines=20)
        planes = stacked(self.distances_m, textures, self.size_px)
        pose = Pose((Rest(), Scaled(motion, -self.upwards), Rest()), (pitch, Rest(), roll))
        return Posed(pose, planes, (self.size_px * len(planes), self.size_px), FOCAL_PX, motion, k1=-0.05)


@dataclass(frozen=True, slots=True)
class Tower:
    """Pose and planes of a box on a tower's top that looks down at the tower's side and foot, these distances below.

    Of the motion's parts, first mode, second mode and wind, each leans by its slope: lean over displacement times the
    height, of a cantilever's modes and of its bending under an even load.
    """

    height_m: float = 60.0
    distances_m: tuple[float, ...] = (20.0, 60.0)
    slopes: tuple[float, ...] = (1.377, -4.78, 1.333)
    size_px: int = 128

    def __call__(self, motion: Motion, rng: np.random.Generator) -> Posed:
        """The camera's pose with the tower's motion, and what it looks at."""
        drawn, *textures = rng.spawn(1 + len(self.distances_m))
        assert isinstance(motion, Sum)
        sun = random_motion((0.004, 0.02), 3.0 * MDEG, rng=drawn, lines=6)
        leans = (Scaled(part, slope / self.height_m) for part, slope in zip(motion.parts, self.slopes, strict=True))
        lean = Sum((*leans, sun))
        # The picture's top is where the tower moves to: tipping that way turns the view the other way.
        pose = Pose((Rest(), Scaled(motion, -1.0), Rest()), (Scaled(lean, -1.0), Rest(), Rest()))
        planes = stacked(self.distances_m, textures, self.size_px)
        return Posed(pose, planes, (self.size_px * len(planes), self.size_px), FOCAL_PX, Leaning(motion, lean))


@dataclass(frozen=True, slots=True)
class SixDegrees:
    """Pose and planes of a box at a footbridge's quarter span that moves and turns in every way.

    It sees planes left and right at one distance and one below, between them, at another. The distances are as
    declared within `distance_std_m` each.
    """

    distances_m: tuple[float, float, float] = (3.0, 3.0, 10.0)
    distance_std_m: tuple[float, float, float] = (0.006, 0.006, 0.02)
    shape: tuple[int, int] = (440, 720)
    size_px: int = 112
    focal_px: float = 2500.0

    def __call__(self, motion: Motion, rng: np.random.Generator) -> Posed:
        """The camera's pose with the bridge's vertical motion, and what it looks at."""
        drawn, measured, *textures = rng.spawn(2 + len(self.distances_m))
        sway = Sum((_random(drawn, (1.05, 1.15), 0.8e-3), _random(drawn, (0.004, 0.02), 1.0e-3)))
        along = Sum((_random(drawn, (0.8, 0.9), 0.3e-3), _random(drawn, (0.004, 0.02), 1.5e-3)))
        pitch = Sum((Scaled(motion, 0.6 * SPAN_SLOPE), Scaled(motion, 0.4 * SPAN_SLOPE, late_s=2.0)))
        pitch = Sum((pitch, _random(drawn, (0.004, 0.02), 6.0 * MDEG)))
        yaw = Sum((_random(drawn, (1.6, 1.8), 1.5 * MDEG), _random(drawn, (0.004, 0.02), 8.0 * MDEG)))
        # It sways about an axis a metre below.
        roll = Sum((Scaled(sway, 0.2), _random(drawn, (0.004, 0.02), 10.0 * MDEG)))
        planes = tuple(
            Plane(region, textured_scene("natural", (self.size_px, self.size_px), rng=texture), float(distance_m))
            for region, texture, distance_m in zip(
                self.regions(), textures, measured.normal(self.distances_m, self.distance_std_m), strict=True
            )
        )
        pose = Pose((sway, Scaled(motion, -1.0), along), (pitch, yaw, roll))
        return Posed(pose, planes, self.shape, self.focal_px, motion, k1=-0.05)

    def regions(self) -> tuple[Region, Region, Region]:
        """Where the planes lie in the picture."""
        size, (rows, columns) = self.size_px, self.shape
        return (
            Region(0, 0, size, size),
            Region(columns - size, 0, size, size),
            Region(columns // 2, rows - size, size, size),
        )

    def targets(self) -> tuple[tuple[str, Region], ...]:
        """Names and regions as the settings have them."""
        inner = self.size_px - 2 * RIM_PX
        own = (Region(one.x + RIM_PX, one.y + RIM_PX, inner, inner) for one in self.regions())
        return tuple(zip(("left", "right", "far"), own, strict=True))


def _random(rng: np.random.Generator, band_hz: tuple[float, float], std_m: float) -> Motion:
    return random_motion(band_hz, std_m, rng=rng, lines=8 if band_hz[0] < 0.1 else 30)


def stacked(distances_m: tuple[float, ...], rngs: list[np.random.Generator], size_px: int) -> tuple[Plane, ...]:
    """Planes one below the other in the picture, each a square of `size_px`."""
    return tuple(
        Plane(
            Region(0, k * size_px, size_px, size_px),
            textured_scene("natural", (size_px, size_px), rng=rng),
            distance_m,
        )
        for k, (distance_m, rng) in enumerate(zip(distances_m, rngs, strict=True))
    )


def _swaying(rng: np.random.Generator) -> Motion:
    """Two modes and the wind's slow push."""
    bands = ((0.24, 0.26, 8e-3, 40), (1.48, 1.52, 0.3e-3, 40), (0.003, 0.02, 5e-3, 8))
    return Sum(tuple(random_motion((low, high), std_m, rng=rng, lines=n) for low, high, std_m, n in bands))


def _walked(rng: np.random.Generator) -> Motion:
    """Modes at 2.1 and 6 Hz, and three people who cross."""
    still = modes((2.05, 2.15, 1.0e-3, 40), (5.9, 6.1, 0.05e-3, 40), start_s=1.5, ramp_s=2.0)
    people = tuple(Pulse(-2.0e-3, float(at_s + rng.uniform(-4.0, 4.0)), 5.5) for at_s in (20.0, 50.0, 80.0))
    return Sum((still(rng), *people))


def _regions(names: tuple[str, ...], size_px: int) -> tuple[tuple[str, Region], ...]:
    inner = size_px - 2 * RIM_PX
    return tuple((name, Region(RIM_PX, k * size_px + RIM_PX, inner, inner)) for k, name in enumerate(names))


TILTING_SCENARIOS: dict[str, Scenario] = {
    "tilting-footbridge": Scenario(
        line="footbridge whose box leans and nods, camera at 10 Hz before two targets at 3 and 10 m",
        title="simulated footbridge, quarter span, two targets",
        duration_s=100.0,
        motion=_walked,
        accelerometer=AccelerometerModel(rate_hz=100.0, noise_std_m_s2=1e-3, bias_m_s2=9.81),
        camera=CameraSetup(
            time_offset_s=0.114,
            camera=Camera(exposure_s=0.004),
            targets=_regions(("near", "far"), 128),
            posed=TiltingFootbridge(),
        ),
    ),
    "gyroscope": Scenario(
        line="footbridge whose box leans and nods, camera at 30 Hz before one target at 3 m; gyroscope and gravity",
        title="simulated footbridge, one target and a gyroscope",
        duration_s=80.0,
        motion=lambda rng: Scaled(_walked(rng), -1.0),
        # Along the image's y axis, downwards.
        accelerometer=AccelerometerModel(rate_hz=100.0, noise_std_m_s2=1e-3, bias_m_s2=-GRAVITY_M_S2),
        camera=CameraSetup(
            rate_hz=30.0,
            time_offset_s=0.02,
            camera=Camera(exposure_s=0.004),
            targets=_regions(("near",), 128),
            posed=TiltingFootbridge((3.0,), upwards=-1.0),
        ),
        gyroscope=GyroscopeSetup(),
    ),
    "vibrometer": Scenario(
        line="bridge with a laser vibrometer and a GNSS receiver at 1 Hz",
        title="simulated bridge, velocity and GNSS",
        duration_s=100.0,
        motion=_walked,
        accelerometer=AccelerometerModel(rate_hz=100.0, noise_std_m_s2=1e-3, bias_m_s2=0.03),
        gnss=GnssSetup(DisplacementSensorModel(rate_hz=1.0, noise_std_m=1e-3)),
        vibrometer=VibrometerSetup(),
    ),
    "six-degrees": Scenario(
        line="footbridge whose box moves in all six degrees, camera at 20 Hz before targets at 3, 3 and 10 m",
        title="simulated footbridge, six degrees of freedom",
        duration_s=60.0,
        motion=_walked,
        accelerometer=AccelerometerModel(rate_hz=100.0, noise_std_m_s2=1e-3, bias_m_s2=9.81),
        camera=CameraSetup(
            rate_hz=20.0,
            time_offset_s=0.114,
            camera=Camera(exposure_s=0.004),
            targets=SixDegrees().targets(),
            declared_m=tuple(zip(SixDegrees().distances_m, SixDegrees().distance_std_m, strict=True)),
            posed=SixDegrees(),
        ),
    ),
    "tower": Scenario(
        line="60 m tower in wind, camera on its top at 30 Hz looks down at targets at 20 and 60 m; gravity and lean",
        title="simulated tower, two targets",
        duration_s=100.0,
        motion=_swaying,
        accelerometer=AccelerometerModel(rate_hz=100.0, noise_std_m_s2=1e-3, bias_m_s2=0.03),
        camera=CameraSetup(
            rate_hz=30.0,
            time_offset_s=0.114,
            camera=Camera(exposure_s=0.004),
            targets=_regions(("side", "foot"), 128),
            posed=Tower(),
        ),
    ),
}
