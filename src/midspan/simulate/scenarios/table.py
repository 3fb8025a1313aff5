"""The recordings that `midspan simulate` can write: a table of names and what each is made of."""

from dataclasses import replace

import numpy as np

from midspan.checks import option
from midspan.records import Region
from midspan.simulate.motion.beam import paper_beam_motion
from midspan.simulate.motion.motion import Motion, Rest, Sum, Window, random_motion
from midspan.simulate.motion.sensors import AccelerometerModel, DisplacementSensorModel
from midspan.simulate.scenarios.day import DAY_SCENARIOS
from midspan.simulate.scenarios.papers import FREE, PAPER_SCENES
from midspan.simulate.scenarios.published import PUBLISHED
from midspan.simulate.scenarios.radar import RADAR_SCENARIOS, lively
from midspan.simulate.scenarios.stage import CameraSetup, GnssSetup, Scenario
from midspan.simulate.scenarios.stage import pixel_bound as _pixel_bound
from midspan.simulate.scene.camera import Camera, Light
from midspan.simulate.scene.disturbances import Car, Disturbance, Foliage, Water
from midspan.simulate.scene.panel import Panel
from midspan.simulate.scene.texture import textured_scene

PHASE_SCENES = {"indoor", "outdoor", "footbridge-phase"}


def pedestrians(rng: np.random.Generator) -> Motion:
    """A footbridge under walkers: modes at 1.9 and 4.6 Hz that come and go, a slow sag; at rest for 1.5 s."""
    parts = (
        random_motion((1.80, 2.00), 1.1e-3, rng=rng, lines=20),
        random_motion((4.45, 4.75), 0.25e-3, rng=rng, lines=30),
        random_motion((0.06, 0.14), 0.8e-3, rng=rng, lines=12),
    )
    return Window(Sum(parts), start_s=1.5, ramp_s=2.0)


def _wind(rng: np.random.Generator) -> Motion:
    """A tall building in wind: sway at 0.3 Hz, a second mode at 1.1 Hz, a slow lean; at rest for 1 s."""
    parts = (
        random_motion((0.27, 0.33), 12e-3, rng=rng, lines=12),
        random_motion((1.05, 1.15), 3e-3, rng=rng, lines=16),
        random_motion((0.04, 0.10), 4e-3, rng=rng, lines=10),
    )
    return Window(Sum(parts), start_s=1.0, ramp_s=2.5)


def _fast_modes(rng: np.random.Generator) -> Motion:
    """Modes at 2.2 and 5.1 Hz, far above what 3 frames a second can follow, on a slow sag of 0.1 Hz."""
    parts = (
        random_motion((2.10, 2.30), 1.5e-3, rng=rng, lines=20),
        random_motion((5.00, 5.20), 0.5e-3, rng=rng, lines=20),
        random_motion((0.06, 0.14), 1.5e-3, rng=rng, lines=14),
    )
    return Window(Sum(parts), start_s=1.5, ramp_s=2.0)


def _long_span(rng: np.random.Generator) -> Motion:
    """A long span under traffic and wind: some centimetres below 0.2 Hz and a mode at 0.8 Hz."""
    parts = (
        random_motion((0.03, 0.20), 14e-3, rng=rng, lines=40),
        random_motion((0.75, 0.85), 5e-3, rng=rng, lines=30),
    )
    return Window(Sum(parts), start_s=2.0, ramp_s=4.0)


def _street(rng: np.random.Generator) -> tuple[Disturbance, ...]:
    """A road with cars along the bottom and leaves in the upper left corner."""
    return (Car(top_px=196), Foliage(Region(0, 0, 110, 90), std_dn=18.0, rng=rng))


def sideways(rng: np.random.Generator) -> Motion:
    """The same footbridge sideways: modes at 0.95 and 2.8 Hz, a slow lean; at rest for 1.5 s."""
    parts = (
        random_motion((0.90, 1.00), 1.4e-3, rng=rng, lines=20),
        random_motion((2.70, 2.90), 0.4e-3, rng=rng, lines=24),
        random_motion((0.06, 0.14), 0.5e-3, rng=rng, lines=12),
    )
    return Window(Sum(parts), start_s=1.5, ramp_s=2.0)


def _decoys(rng: np.random.Generator) -> tuple[Disturbance, ...]:
    """Most of the picture moves on its own and has more contrast than the wall behind it."""
    rng_leaves, rng_water = rng.spawn(2)
    return (
        Foliage(Region(0, 0, 200, 120), std_dn=22.0, rng=rng_leaves),
        Water(Region(0, 130, 140, 66), std_dn=25.0, rng=rng_water),
        Car(top_px=200, height_px=34, width_px=90, period_s=7.0),
    )


def _signs(rng: np.random.Generator) -> tuple[Panel, ...]:
    """A sign at half the distance, one at two thirds, and one that swings on its chain at 0.7 Hz."""
    near, middle, swinging, swing = rng.spawn(4)
    return (
        Panel(Region(16, 20, 88, 88), textured_scene("blocks", (88, 88), rng=near), 2.0),
        Panel(Region(216, 20, 88, 88), textured_scene("natural", (88, 88), rng=middle), 1.5),
        Panel(
            Region(116, 130, 88, 88),
            textured_scene("natural", (88, 88), rng=swinging),
            own_px=random_motion((0.5, 0.9), 0.8, rng=swing, lines=16),
        ),
    )


_GOOD_ACCELEROMETER = AccelerometerModel(rate_hz=100.0, noise_std_m_s2=2.5e-3, bias_m_s2=0.05)

SCENARIOS: dict[str, Scenario] = {
    "footbridge": Scenario(
        line="footbridge under walkers, camera at 10 Hz, unknown clock offset; the demonstration",
        title="simulated footbridge, quarter span",
        duration_s=60.0,
        motion=pedestrians,
        accelerometer=_GOOD_ACCELEROMETER,
        camera=CameraSetup(),
    ),
    "beam": Scenario(
        line="the 40 m beam of the two-stage FIR paper under its force, camera at 10 Hz (0.3 and 2 Hz are aliases)",
        title="simulated simply supported beam, mid-span",
        duration_s=100.0,
        motion=lambda rng: paper_beam_motion(int(rng.integers(2**31))),
        accelerometer=AccelerometerModel(rate_hz=100.0, bias_m_s2=0.02),
        camera=CameraSetup(time_offset_s=0.083),
        snr_db=40.0,
    ),
    "building": Scenario(
        line="tall building swaying sideways before a facade, camera at 30 Hz of which every third frame is used",
        title="simulated building, roof, sideways",
        duration_s=60.0,
        motion=_wind,
        accelerometer=AccelerometerModel(rate_hz=100.0, noise_std_m_s2=1.5e-3, bias_m_s2=-0.03),
        camera=CameraSetup(
            rate_hz=30.0,
            start_s=0.3,
            time_offset_s=-0.212,
            scale_mm_per_px=-6.0,
            direction="x",
            texture="facade",
            size_px=(192, 256),
            camera=Camera(exposure_s=0.006),
            every=3,
        ),
    ),
    "slow-camera": Scenario(
        line="camera at 3 Hz, modes at 2.2 and 5.1 Hz above its Nyquist frequency",
        title="simulated girder, slow camera",
        duration_s=90.0,
        motion=_fast_modes,
        accelerometer=_GOOD_ACCELEROMETER,
        camera=CameraSetup(rate_hz=3.0, time_offset_s=0.061, texture="blocks"),
    ),
    "street": Scenario(
        line="footbridge with passing cars, leaves in the wind and the sun going in: the region must be chosen well",
        title="simulated footbridge over a street",
        duration_s=60.0,
        motion=pedestrians,
        accelerometer=_GOOD_ACCELEROMETER,
        camera=CameraSetup(time_offset_s=-0.09, start_s=0.2, light=Light(25.0, gain=0.75), disturbances=_street),
    ),
    "decoys": Scenario(
        line="leaves, water and cars fill most of the picture with more contrast than the wall to be looked at",
        title="simulated footbridge over a river",
        duration_s=60.0,
        motion=pedestrians,
        accelerometer=_GOOD_ACCELEROMETER,
        camera=CameraSetup(time_offset_s=0.072, disturbances=_decoys),
    ),
    "several-targets": Scenario(
        line="two signs nearer than the wall, one of them at half the distance, and one that swings by itself",
        title="simulated footbridge, several targets",
        duration_s=60.0,
        motion=pedestrians,
        accelerometer=_GOOD_ACCELEROMETER,
        camera=CameraSetup(
            time_offset_s=0.114,
            panels=_signs,
            targets=(
                ("near", Region(32, 36, 56, 56)),
                ("middle", Region(232, 36, 56, 56)),
                ("swinging", Region(132, 146, 56, 56)),
                ("wall", Region(236, 150, 56, 56)),
            ),
        ),
    ),
    "two-axes": Scenario(
        line="footbridge that moves down and sideways, accelerometer with two axes; truth for both",
        title="simulated footbridge, two axes",
        duration_s=60.0,
        motion=pedestrians,
        across=sideways,
        accelerometer=_GOOD_ACCELEROMETER,
        camera=CameraSetup(time_offset_s=0.091),
    ),
    "gaps": Scenario(
        line="footbridge with an unreadable and a missing stretch of acceleration, lost frames and 3 s of darkness",
        title="simulated footbridge with gaps",
        duration_s=60.0,
        motion=pedestrians,
        accelerometer=_GOOD_ACCELEROMETER,
        camera=CameraSetup(dropped=((16.0, 17.5), (50.0, 50.3)), black=((30.0, 33.0),)),
        absent=((41.0, 42.2),),
        unread=((24.0, 24.25),),
    ),
    "lively-start": Scenario(
        line="in lively motion from the first frame, which falls half way between two samples of acceleration at 50 Hz",
        title="simulated footbridge, lively from the start",
        duration_s=60.0,
        motion=lively,
        accelerometer=replace(_GOOD_ACCELEROMETER, rate_hz=50.0),
        camera=CameraSetup(time_offset_s=0.13),
    ),
    "no-excitation": Scenario(
        line="nothing moves: calibration must be refused",
        title="simulated structure at rest",
        duration_s=30.0,
        motion=lambda rng: Rest(),
        accelerometer=_GOOD_ACCELEROMETER,
        camera=CameraSetup(),
    ),
    "gnss": Scenario(
        line="long span with GNSS heights at 1 Hz instead of a camera, noise 2 mm, with gaps",
        title="simulated long span with GNSS",
        duration_s=180.0,
        motion=_long_span,
        accelerometer=AccelerometerModel(rate_hz=50.0, noise_std_m_s2=3e-3, bias_m_s2=0.04),
        gnss=GnssSetup(
            DisplacementSensorModel(rate_hz=1.0, noise_std_m=2e-3), absent=((70.0, 82.0),), unread=((120.0, 124.0),)
        ),
    ),
    **RADAR_SCENARIOS,
    **DAY_SCENARIOS,
}

NAMES: dict[str, str] = {name: scenario.line for name, scenario in SCENARIOS.items()}

# The papers' tests: films by their name in PAPER_SCENES, all others as scenarios.
FILMS = {f"{'000' if name in PHASE_SCENES else '004'}-{name}": name for name in PAPER_SCENES}
PAPER_NAMES: dict[str, str] = {
    **{name: f"{name[:3]}, {PAPER_SCENES[film].title}" for name, film in FILMS.items()},
    **{name: scenario.line for name, scenario in PUBLISHED.items()},
}


def chosen_here(name: str) -> str:
    """What a paper does not print of its test `name`; empty for a scenario of our own."""
    return FREE if name in FILMS else (SCENARIOS | PUBLISHED)[name].free


def pixel_bound(name: str, region: Region | None = None, *, seed: int = 0) -> tuple[float, float]:
    """Cramér-Rao bound (x, y) in px of one frame of scenario `name`, in `region` or the whole picture."""
    option("scenario", name, SCENARIOS)
    return _pixel_bound(SCENARIOS[name], region, seed=seed)
