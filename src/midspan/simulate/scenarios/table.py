"""The recordings that `midspan simulate` can write: a table of names and what each is made of."""

from dataclasses import replace

import numpy as np

from midspan.checks import option
from midspan.records import Region
from midspan.simulate.day.infrared import DayCourse
from midspan.simulate.day.setup import CameraPlan, DaySetup, hours, span_hours
from midspan.simulate.day.sky import Headlights, Sky
from midspan.simulate.motion.beam import paper_beam_motion
from midspan.simulate.motion.motion import Rest, modes, random_motion
from midspan.simulate.motion.sensors import AccelerometerModel, DisplacementSensorModel
from midspan.simulate.scenarios.radar import RADAR_SCENARIOS, lively
from midspan.simulate.scenarios.stage import CameraSetup, GnssSetup, Scenario, stage
from midspan.simulate.scenarios.tilting import TILTING_SCENARIOS
from midspan.simulate.scene.camera import Camera, Light, cramer_rao_std_px
from midspan.simulate.scene.disturbances import Car, Disturbance, Foliage, Panel, Water
from midspan.simulate.scene.texture import textured_scene
from midspan.simulate.scene.thermal import ThermalCamera, WarmBody

DAY_S = 264.0  # 24 hours last so long: 11 s an hour
# Autumn: the sun stays before the wall until it sets, and moves as fast as in the light sweeps of the benchmarks.


# Modes at 0.9 and 2.3 Hz that come and go, and a slow sag below 0.05 Hz; at rest for 1.5 s.
_footbridge = modes(
    (0.80, 1.00, 1.6e-3, 60), (2.20, 2.40, 0.3e-3, 60), (0.006, 0.05, 2.0e-3, 16), start_s=1.5, ramp_s=2.0
)


_SKY = Sky(
    length_s=DAY_S,
    declination_deg=-8.0,
    fog=(span_hours(DAY_S, 18.2, 19.9),),
    rain=(span_hours(DAY_S, 3.6, 4.4),),
    ramp_s=5.0,
)
_THERMAL = ThermalCamera(
    netd_k=0.05,
    pattern_k=0.04,
    column_k=0.02,
    drift_k_per_s=0.004,
    shutters_s=hours(DAY_S, 2.3, 7.2, 12.1, 16.6, 21.0),
    closed_s=0.7,
)
_BODIES = tuple(WarmBody(start_s=s, top_px=25.0, height_px=90.0, width_px=36.0) for s in hours(DAY_S, 9.0, 14.0))

DAY_SCENARIOS: dict[str, Scenario] = {
    "day-and-night": Scenario(
        line="noon to noon in 4.4 minutes, camera and infrared at 4 Hz: shadows, darkness, headlights, rain, fog, heat",
        title="simulated footbridge by day and by night",
        duration_s=DAY_S,
        motion=_footbridge,
        accelerometer=AccelerometerModel(rate_hz=100.0, noise_std_m_s2=2.5e-3, bias_m_s2=0.05),
        window_s=(0.0, 38.0),
        day=DaySetup(
            sky=_SKY,
            camera=CameraPlan((168, 224), scale_mm_per_px=-1.0, time_offset_s=0.137),
            infrared=CameraPlan((120, 160), scale_mm_per_px=-1.1, start_s=0.06, time_offset_s=-0.083),
            course=DayCourse(mean_c=14.0, swing_k=6.0, period_s=DAY_S),
            thermal=_THERMAL,
            bodies=_BODIES,
            # Together with the post's shadow at noon, whose edges would be the best texture of the picture.
            camera_roi=(22, 64, 64, 64),
            cars=Headlights(hours(DAY_S, 7.6, 9.8, 12.6, 15.0), row_px=140.0),
        ),
    ),
}


# A footbridge under walkers: modes at 1.9 and 4.6 Hz that come and go, a slow sag; at rest for 1.5 s.
pedestrians = modes(
    (1.80, 2.00, 1.1e-3, 20), (4.45, 4.75, 0.25e-3, 30), (0.06, 0.14, 0.8e-3, 12), start_s=1.5, ramp_s=2.0
)
# A tall building in wind: sway at 0.3 Hz, a second mode at 1.1 Hz, a slow lean; at rest for 1 s.
_wind = modes((0.27, 0.33, 12e-3, 12), (1.05, 1.15, 3e-3, 16), (0.04, 0.10, 4e-3, 10), start_s=1.0, ramp_s=2.5)
# Modes at 2.2 and 5.1 Hz, far above what 3 frames a second can follow, on a slow sag of 0.1 Hz.
_fast_modes = modes(
    (2.10, 2.30, 1.5e-3, 20), (5.00, 5.20, 0.5e-3, 20), (0.06, 0.14, 1.5e-3, 14), start_s=1.5, ramp_s=2.0
)
# A long span under traffic and wind: some centimetres below 0.2 Hz and a mode at 0.8 Hz.
_long_span = modes((0.03, 0.20, 14e-3, 40), (0.75, 0.85, 5e-3, 30), start_s=2.0, ramp_s=4.0)


# The same footbridge sideways: modes at 0.95 and 2.8 Hz, a slow lean; at rest for 1.5 s.
sideways = modes((0.90, 1.00, 1.4e-3, 20), (2.70, 2.90, 0.4e-3, 24), (0.06, 0.14, 0.5e-3, 12), start_s=1.5, ramp_s=2.0)


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

_FOOTBRIDGE = Scenario(
    line="footbridge under walkers, camera at 10 Hz, unknown clock offset; the demonstration",
    title="simulated footbridge, quarter span",
    duration_s=60.0,
    motion=pedestrians,
    accelerometer=_GOOD_ACCELEROMETER,
    camera=CameraSetup(),
)

SCENARIOS: dict[str, Scenario] = {
    "footbridge": _FOOTBRIDGE,
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
    "street": replace(
        _FOOTBRIDGE,
        line="footbridge with passing cars, leaves in the wind and the sun going in: the region must be chosen well",
        title="simulated footbridge over a street",
        camera=CameraSetup(
            time_offset_s=-0.09,
            start_s=0.2,
            light=Light(25.0, gain=0.75),
            # A road with cars along the bottom and leaves in the upper left corner.
            disturbances=lambda rng: (Car(top_px=196), Foliage(Region(0, 0, 110, 90), std_dn=18.0, rng=rng)),
        ),
    ),
    "decoys": replace(
        _FOOTBRIDGE,
        line="leaves, water and cars fill most of the picture with more contrast than the wall to be looked at",
        title="simulated footbridge over a river",
        camera=CameraSetup(time_offset_s=0.072, disturbances=_decoys),
    ),
    "several-targets": replace(
        _FOOTBRIDGE,
        line="two signs nearer than the wall, one of them at half the distance, and one that swings on its own",
        title="simulated footbridge, several targets",
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
    "two-axes": replace(
        _FOOTBRIDGE,
        line="footbridge that moves down and sideways, accelerometer with two axes; truth for both",
        title="simulated footbridge, two axes",
        across=sideways,
        camera=CameraSetup(time_offset_s=0.091),
    ),
    "gaps": replace(
        _FOOTBRIDGE,
        line="footbridge with an unreadable and a missing segment of acceleration, lost frames and 3 s of darkness",
        title="simulated footbridge with gaps",
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
    **TILTING_SCENARIOS,
}

NAMES: dict[str, str] = {name: scenario.line for name, scenario in SCENARIOS.items()}


def pixel_bound(name: str, region: Region | None = None, *, seed: int = 0) -> tuple[float, float]:
    """Cramér-Rao bound (x, y) in px of one frame of scenario `name`, in `region` or all of it; NaN: no camera."""
    setup = SCENARIOS[option("scenario", name, SCENARIOS)].camera
    if setup is None or setup.posed is not None:
        return (np.nan, np.nan)
    view = stage(SCENARIOS[name], seed).view(setup)
    return cramer_rao_std_px(view.scene, view.camera, region=region)
