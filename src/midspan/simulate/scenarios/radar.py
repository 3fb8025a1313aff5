"""The scenarios with a radar: what moves, what the radar sees of it, and what gets in its way."""

from dataclasses import replace

import numpy as np

from midspan.simulate.motion.motion import Motion, Pulse, modes, random_motion
from midspan.simulate.motion.sensors import AccelerometerModel
from midspan.simulate.radar.setup import FAR, NEAR, RadarSetup
from midspan.simulate.radar.signal import Reflector
from midspan.simulate.scenarios.stage import CameraSetup, Scenario

MEMS = AccelerometerModel(rate_hz=100.0, noise_std_m_s2=3e-3, bias_m_s2=0.05)
FORCE_BALANCE = AccelerometerModel(rate_hz=100.0, noise_std_m_s2=1e-4, bias_m_s2=-0.004)

# Spans of `radar-blockage`, s: a van hides two targets of three, then a lorry all of them.
VAN, LORRY = (25.0, 35.0), (43.0, 45.5)


# A footbridge under walkers: modes at 2.1 and 5.3 Hz that come and go, a slow sag; at rest for 1.5 s.
_walkers = modes((2.00, 2.20, 0.9e-3, 20), (5.10, 5.45, 0.2e-3, 30), (0.05, 0.15, 1.0e-3, 14), start_s=1.5, ramp_s=2.0)


def lively(rng: np.random.Generator) -> Motion:
    """4 mm rms at 2 to 3 Hz from before the first sample to after the last."""
    return random_motion((2.0, 3.0), 4e-3, rng=rng, lines=70)


# A tall building in a storm: sway of some 40 mm at 0.3 Hz, a second mode at 1.2 Hz; at rest for 1 s.
_storm = modes((0.28, 0.32, 22e-3, 14), (1.15, 1.25, 5e-3, 30), start_s=1.0, ramp_s=4.0)
# A long span for a quarter of an hour: some millimetres below 0.2 Hz, modes at 0.8 and 2.3 Hz; at rest for 2 s.
_traffic = modes((0.03, 0.20, 5e-3, 155), (0.75, 0.85, 2e-3, 92), (2.25, 2.35, 0.3e-3, 92), start_s=2.0, ramp_s=4.0)


def _below_the_deck(rng: np.random.Generator) -> tuple[Reflector, ...]:
    """An abutment at an angle with a bracket of the radar in its bin, leakage, ground, a person, a passing car."""
    ranges, shares = rng.uniform(5.2, 6.6, 5), rng.uniform(0.75, 0.95, 5)
    passing_s = float(rng.uniform(15.0, 45.0))
    ground = (Reflector(r, 220.0, ratio=s, azimuth_rad=-0.3) for r, s in zip(ranges, shares, strict=True))
    return (
        Reflector(3.42, 900.0, ratio=1 / 1.27, azimuth_rad=0.2),
        Reflector(3.47, 110.0, ratio=0.0, azimuth_rad=-0.5),
        Reflector(0.10, 2500.0, ratio=0.0),
        Reflector(0.85, 500.0, ratio=0.0, azimuth_rad=0.6),
        *ground,
        Reflector(8.1, 600.0, ratio=0.9, own=random_motion((0.3, 1.2), 8e-3, rng=rng, lines=40)),
        Reflector(
            13.0,
            1500.0,
            ratio=0.9,
            own=Pulse(-3.5, passing_s, 2.0),
            blocked=((-np.inf, passing_s - 5.0), (passing_s + 5.0, np.inf)),
        ),
    )


def _across_the_street(rng: np.random.Generator) -> tuple[Reflector, ...]:
    """The facade opposite, which comes nearer as the building moves forward, one at an angle, the own parapet."""
    return (
        Reflector(18.6, 900.0, ratio=-1.0),
        Reflector(31.2, 500.0, ratio=-0.62, azimuth_rad=0.7),
        Reflector(1.1, 2000.0, ratio=0.0),
        Reflector(24.9, 700.0, ratio=-0.8, azimuth_rad=-0.4, own=random_motion((0.2, 0.9), 6e-3, rng=rng, lines=60)),
    )


def _three_walls(rng: np.random.Generator) -> tuple[Reflector, ...]:
    """Three fixed walls, two of them hidden by a van for ten seconds, all by a lorry for two and a half."""
    del rng
    clear = ((-np.inf, VAN[0]), (VAN[1], np.inf))
    empty = ((-np.inf, LORRY[0]), (LORRY[1], np.inf))
    return (
        Reflector(2.13, 900.0, ratio=1 / 1.06, azimuth_rad=0.1, blocked=(VAN, LORRY)),
        Reflector(3.74, 800.0, ratio=1 / 1.31, azimuth_rad=0.5, blocked=(VAN, LORRY)),
        Reflector(5.52, 700.0, ratio=1 / 1.58, azimuth_rad=-0.4, blocked=(LORRY,)),
        Reflector(0.10, 2500.0, ratio=0.0),
        Reflector(1.21, 2000.0, ratio=1.0, blocked=clear),
        Reflector(1.36, 2500.0, ratio=1.0, blocked=empty),
    )


def _piers(rng: np.random.Generator) -> tuple[Reflector, ...]:
    """Three piers at different angles, of which the last has a tree in front of it."""
    leaves = random_motion((0.2, 1.5), 1.5e-3, rng=rng, lines=120)
    return (
        Reflector(6.24, 900.0, ratio=1 / 1.42, azimuth_rad=0.2),
        Reflector(9.07, 600.0, ratio=1 / 1.95, azimuth_rad=-0.3),
        Reflector(11.33, 500.0, ratio=1 / 2.3, own=leaves),
    )


def _below_and_hidden(rng: np.random.Generator) -> tuple[Reflector, ...]:
    """The view below the deck, the abutment hidden for five seconds."""
    wall, *others = _below_the_deck(rng)
    return (replace(wall, blocked=((38.0, 43.0),)), *others)


_FOOTBRIDGE = Scenario(
    line="footbridge, radar at 100 Hz on a wall at an angle among leakage, ground, a person and a car; MEMS",
    title="simulated footbridge with a radar",
    duration_s=60.0,
    motion=_walkers,
    accelerometer=MEMS,
    radar=RadarSetup(_below_the_deck),
)

RADAR_SCENARIOS: dict[str, Scenario] = {
    "radar-footbridge": _FOOTBRIDGE,
    "radar-tall-building": Scenario(
        line="tall building, 40 mm at 0.3 Hz, faster than plain unwrapping of the radar's phase can follow",
        title="simulated building with a radar",
        duration_s=90.0,
        motion=_storm,
        accelerometer=FORCE_BALANCE,
        radar=RadarSetup(_across_the_street, targets=2, profile=FAR, start_s=0.2, time_offset_s=-0.064),
    ),
    "radar-blockage": replace(
        _FOOTBRIDGE,
        line="three targets of a radar: two hidden for 10 s, then all for 2.5 s; lost packets",
        title="simulated footbridge, radar with a view that is blocked",
        radar=RadarSetup(
            _three_walls, targets=3, noise_std=250.0, time_offset_s=0.041, lost=((12.0, 12.04), (52.0, 52.3))
        ),
        # Before the van comes: what stands in front of a target is not to be calibrated on.
        window_s=(0.0, 24.0),
    ),
    "radar-slow-time": Scenario(
        line="a quarter of an hour of a long span, radar stored as slow-time I/Q of three targets at 50 Hz (HDF5)",
        title="simulated long span with a radar, slow-time I/Q",
        duration_s=900.0,
        motion=_traffic,
        accelerometer=replace(MEMS, rate_hz=50.0, noise_std_m_s2=1.5e-3),
        radar=RadarSetup(
            _piers,
            targets=3,
            profile=replace(NEAR, samples=64, frame_period_s=0.02, receivers=1),
            time_offset_s=-0.037,
            start_s=0.1,
            slow_time=True,
        ),
    ),
    "radar-lively-start": Scenario(
        line="in lively motion from the radar's first frame, half way between two samples of acceleration at 50 Hz",
        title="simulated footbridge with a radar, lively from the start",
        duration_s=60.0,
        motion=lively,
        accelerometer=replace(MEMS, rate_hz=50.0),
        radar=RadarSetup(_below_the_deck, time_offset_s=0.07),
    ),
    "radar-and-camera": replace(
        _FOOTBRIDGE,
        line="footbridge with a camera at 10 Hz, dark for 5 s, and a radar whose target is hidden for another 5 s",
        title="simulated footbridge with a camera and a radar",
        camera=CameraSetup(time_offset_s=0.137, black=((20.0, 25.0),)),
        radar=RadarSetup(_below_and_hidden, time_offset_s=0.052),
        window_s=(0.0, 37.0),
    ),
}
"""Name → scenario; see `scenarios.SCENARIOS`."""
