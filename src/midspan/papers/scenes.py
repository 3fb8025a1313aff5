"""The papers' tests as recordings that `midspan simulate` writes, besides its own scenarios.

Two-stage FIR (003), radar (002), vision and infrared (001): geometry, scale factors, rates, chirps and kinds of
excitation are theirs; `free` of each says what is chosen here. The films of the papers on feature matching (004) and on
phase (000) are in `filming`.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from midspan.errors import UsageError
from midspan.papers.filming import FREE, PAPER_SCENES, FilmSettings, film, write_recording
from midspan.papers.motions import ACCELEROMETER, CAMERA_HZ, Excitation, Later, Sweep, random, sine
from midspan.records import Region
from midspan.simulate.day.infrared import DayCourse
from midspan.simulate.day.setup import CameraPlan, DaySetup
from midspan.simulate.day.sky import Sky
from midspan.simulate.files.folder import Progress, check_free
from midspan.simulate.motion.motion import Motion, Pulse, Sines, Sum, Window, random_motion
from midspan.simulate.radar.setup import RadarSetup
from midspan.simulate.radar.signal import LONG_RANGE, SHORT_RANGE, Reflector, noise_for
from midspan.simulate.scenarios.stage import CameraSetup, Scenario
from midspan.simulate.scenarios.table import SCENARIOS
from midspan.simulate.scenarios.write import write
from midspan.simulate.scene.camera import Camera
from midspan.simulate.scene.fisheye import Fisheye
from midspan.simulate.scene.thermal import ThermalCamera, WarmBody

Drawn = Callable[[np.random.Generator], Motion]


def _tones(sizes_m: Sequence[float], hertz: Sequence[float], length_s: float) -> Drawn:
    """Sines of random phase, from rest and to rest."""

    def drawn(rng: np.random.Generator) -> Motion:
        phase = rng.uniform(0, 2 * np.pi, len(hertz))
        return Window(Sines(np.array(sizes_m), np.array(hertz), phase_rad=phase), 1.0, length_s - 1.0, ramp_s=2.0)

    return drawn


def _in_turn(parts: Sequence[Excitation], each_s: float) -> Drawn:
    """One excitation after the other, each `each_s` long and at rest in between."""

    def drawn(rng: np.random.Generator) -> Motion:
        begins = [1.0 + k * each_s for k in range(len(parts))]
        ends = [0.5 + (k + 1) * each_s for k in range(len(parts))]
        moving = [Later(part(each_s, rng), begin) for part, begin in zip(parts, begins, strict=True)]
        return Sum(tuple(Window(*one, ramp_s=1.5) for one in zip(moving, begins, ends, strict=True)))

    return drawn


def _crossing(band_hz: tuple[float, float]) -> Drawn:
    """Sixteen people cross slowly while two jump."""

    def drawn(rng: np.random.Generator) -> Motion:
        crowd = tuple(Pulse(-1.2e-3, at_s, 5.0) for at_s in (15.0, 33.0))
        return Window(Sum((random_motion(band_hz, 0.6e-3, rng=rng, lines=12), *crowd)), 1.0, 48.0, ramp_s=2.0)

    return drawn


def _pushes(length_s: float, rng: np.random.Generator) -> Motion:
    """1 Hz and slow pushes by hand."""
    slow = tuple(Pulse(height, at_s, 8.0) for height, at_s in ((3e-3, 50.0), (-2e-3, 110.0), (3e-3, 170.0)))
    return Window(Sum((Sines(np.array([2e-3]), np.array([1.0])), *slow)), 1.0, length_s - 1.0, ramp_s=2.0)


def _plan(scale_mm_per_px: float, every: int) -> CameraSetup:
    """A camera at 29.97 Hz of which every N-th frame is used."""
    return CameraSetup(
        rate_hz=CAMERA_HZ,
        time_offset_s=every / CAMERA_HZ,
        scale_mm_per_px=-scale_mm_per_px,
        direction="x",
        size_px=(128, 128),
        camera=Camera(exposure_s=0.004),
        every=every,
    )


_CLOCKS = "one interval of the used frames between the clocks"
_STOREY_FREE = (
    f"8 mm at 0.1 Hz, 2.8 mm of the tone, phases, texture, noise, {_CLOCKS}; 6.4346 is taken as mm/px (the paper "
    "prints pixels/mm)"
)
_BRIDGE_FREE = f"amplitudes, the jumpers' frequencies in excitations 1 and 2, texture, noise, {_CLOCKS}"


def _storey(number: int, tone_hz: float) -> Scenario:
    return Scenario(
        line=f"003, storey model before stones at 1 m, excitation {number}: 0.1 + {tone_hz} Hz, 3 frames/s",
        title=f"storey model of the two-stage paper, excitation {number}",
        duration_s=56.0,
        motion=_tones((8e-3, 2.8e-3), (0.1, tone_hz), 56.0),
        accelerometer=ACCELEROMETER,
        camera=_plan(6.4346, 10),
        free=_STOREY_FREE,
    )


def _footbridge(number: int, motion: Drawn) -> Scenario:
    return Scenario(
        line=f"003, footbridge at 2 m, excitation {number}, 3 frames/s",
        title=f"footbridge of the two-stage paper, excitation {number}",
        duration_s=50.0,
        motion=motion,
        accelerometer=ACCELEROMETER,
        camera=_plan(1.345, 10),
        free=_BRIDGE_FREE,
    )


def _view(range_m: float, bin_m: float, factor: float, *others: Reflector) -> RadarSetup:
    """The target, 10 % of another reflector of its bin at another angle, and what else is in view."""
    clutter = Reflector(range_m + 0.5 * bin_m, 100.0, 0.4 / factor, 0.5)
    seen = (Reflector(range_m, 1000.0, 1.0 / factor), clutter, *others)
    long = bin_m > 0.1
    return RadarSetup(
        lambda rng: seen,
        profile=LONG_RANGE if long else SHORT_RANGE,
        noise_std=noise_for(1000.0, -5.0 if long or others else 0.0),
        phase_noise_rad=0.02,
    )


_RADAR_FREE = (
    "amplitudes (31 to 51.6 mm at 0.3 and 0.5 Hz, above 15.5 mm at 1 Hz), clutter, noise of the receiver, clocks"
)
_EXCITATIONS = {
    "1 Hz": sine(0.02, 1.0), "0.3 Hz": sine(0.04, 0.3), "0.5 Hz": sine(0.04, 0.5), "recorded": random(0.3, 3.0, 0.01)
}  # fmt: skip
_TEST = _in_turn(tuple(_EXCITATIONS.values()), 10.0)
_WALK = _in_turn((random(0.3, 4.0, 0.7e-3), random(0.3, 3.0, 0.7e-3), random(0.3, 3.0, 1e-3)), 13.0)
_PARTS = tuple(Reflector(r, 900.0, 1.0, a) for r, a in ((31.0, 0.2), (34.5, -0.2), (38.0, 0.1), (42.0, -0.1)))
_LABORATORY = {
    "002-wall": ("wall at 1.318 m", _view(1.318, SHORT_RANGE.bin_m, 1.0)),
    "002-building": ("building at 48 m", _view(48.0, LONG_RANGE.bin_m, 1.0, *_PARTS)),
    "002-angled": ("model at 2.0543 m, factor 1.2748", _view(2.0543, SHORT_RANGE.bin_m, 1.2748)),
}


def _radar(line: str, setup: RadarSetup, motion: Drawn = _TEST) -> Scenario:
    return Scenario(
        line=f"002, {line}",
        title=f"radar paper, {line}",
        duration_s=42.0,
        motion=motion,
        accelerometer=ACCELEROMETER,
        radar=setup,
        window_s=(0.0, 14.0),
        free=_RADAR_FREE,
    )


_TREE = Reflector(4.1, 2200.0, 1.0, 0.3, own=random_motion((0.2, 1.5), 0.4e-3, rng=np.random.default_rng(6)))
_FENCE = Reflector(5.6, 1500.0, 0.9, -0.3, own=random_motion((0.5, 3.0), 0.2e-3, rng=np.random.default_rng(7)))

# A cup of hot and one of cold water at the edges, and a finger that crosses the target from 23.5 s to 27 s.
_CUPS = (
    WarmBody(0.0, 0.0, 18.0, 12.0, 24.0, 0.0, celsius=33.5),
    WarmBody(0.0, 98.0, 44.0, 12.0, 24.0, 0.0, celsius=16.5),
)
_FINGER = WarmBody(23.5, 8.0, 14.0, 12.0, 60.0, 24.0, celsius=33.0)
_LAB_FREE = (
    "amplitudes, textures of 96 × 96 and 90 × 112 px, 0.9 K of contrast, noise of 0.05 K; the flashlight is a sun"
)


def _lab(
    line: str,
    motion: Excitation,
    *bodies: WarmBody,
    length_s: float = 30.0,
    sky_s: float = 86400.0,
    air_s: float = 86400.0,
    rate_hz: float = 30.0,
) -> Scenario:
    """The storey model of the paper on vision and infrared; sky_s, air_s: what is a day to the light and to the air."""
    setup = DaySetup(
        sky=Sky(length_s=sky_s),
        camera=CameraPlan((96, 96), scale_mm_per_px=-0.945, rate_hz=rate_hz),
        infrared=CameraPlan((90, 112), scale_mm_per_px=-1.094, rate_hz=rate_hz, start_s=0.01),
        contrast_k=0.9,
        course=DayCourse(mean_c=25.9, swing_k=1.5 if air_s < 1e4 else 0.0, period_s=air_s),
        thermal=ThermalCamera(netd_k=0.05, pattern_k=0.03),
        bodies=bodies,
        camera_roi=(20, 20, 56, 56),
        infrared_roi=(20, 14, 72, 60),
    )
    return Scenario(
        line=f"001, {line}",
        title=f"vision and infrared, {line}",
        duration_s=length_s,
        motion=lambda rng: Window(motion(length_s, rng), 0.5, length_s, ramp_s=1.0),
        accelerometer=ACCELEROMETER,
        day=setup,
        free=_LAB_FREE,
    )


# 2 m away at 0.945 mm/px is a focal length of 2116 px; the target lies 1030 px from the axis.
_FISHEYE = Fisheye(
    (2116.0, 2116.0, 1919.5, 1439.5),
    (-0.02, 0.004, -0.001, 0.0),
    (2880, 3840),
    lit=Region(2806, 976, 128, 128),
    roi=Region(2838, 1008, 64, 64),
)
_FISHEYE_LAB = Scenario(
    line="001, vision camera as filmed: fisheye frames of 3840 × 2880 px, 1 Hz",
    title="fisheye camera of the paper on vision and infrared",
    duration_s=20.0,
    motion=lambda rng: Window(sine(20e-3, 1.0)(20.0, rng), 0.5, 20.0, ramp_s=1.0),
    accelerometer=ACCELEROMETER,
    camera=CameraSetup(rate_hz=30.0, time_offset_s=0.05, scale_mm_per_px=-0.945, direction="x", fisheye=_FISHEYE),
    free="amplitude, length, the lens, the target's place 1030 px from its axis, texture of 128 × 128 px in black "
    "frames, noise, 0.05 s between the clocks",
)

# Cold air, a warm and a cold body at the edges, and the exhaust of a bus that passes in a second.
_COLD = (
    WarmBody(0.0, 0.0, 18.0, 12.0, 24.0, 0.0, celsius=9.0),
    WarmBody(0.0, 98.0, 44.0, 12.0, 24.0, 0.0, celsius=-14.0),
    WarmBody(43.0, -20.0, 40.0, 20.0, 26.0, 60.0, celsius=25.0),
)
_COLD_BRIDGE = Scenario(
    line="001, footbridge, infrared alone, 3.827 mm/px, four people jump, a bus's exhaust at 43 s",
    title="footbridge of the paper on vision and infrared",
    duration_s=60.0,
    # Four people jump.
    motion=lambda rng: Window(random_motion((2.0, 2.3), 2.5e-3, rng=rng, lines=12), 0.5, 60.0, ramp_s=1.0),
    accelerometer=ACCELEROMETER,
    day=DaySetup(
        sky=Sky(),
        camera=None,
        infrared=CameraPlan((90, 112), scale_mm_per_px=-3.827, rate_hz=30.0, start_s=0.01),
        contrast_k=1.5,
        course=DayCourse(mean_c=-1.0, swing_k=0.0),
        thermal=ThermalCamera(netd_k=0.05, pattern_k=0.015),
        bodies=_COLD,
        infrared_roi=(20, 14, 72, 60),
    ),
    free="2.5 mm near 2.1 Hz, texture of 90 × 112 px, 1.5 K of contrast, noise of 0.05 K, bodies of 9, -14 and 25 °C",
)

PUBLISHED: dict[str, Scenario] = {
    **{f"003-storey-{k}": _storey(k, tone) for k, tone in enumerate((2.2, 3.3, 5.1, 6.3, 10.3), start=1)},
    "003-bridge-1": _footbridge(1, _crossing((2.46, 2.56))),
    "003-bridge-2": _footbridge(2, _crossing((1.50, 1.62))),
    "003-bridge-3": _footbridge(3, _tones((0.8e-3, 1.2e-3, 0.6e-3, 0.5e-3), (2.0, 2.102, 2.224, 2.51), 50.0)),
    **{
        name: scenario
        for key, (line, view) in _LABORATORY.items()
        for name, scenario in (
            (key, _radar(f"{line}, four excitations in turn", view)),
            *(
                (f"{key}-{k}", _radar(f"{line}, {word} alone", view, _in_turn((one,), 40.0)))
                for k, (word, one) in enumerate(_EXCITATIONS.items(), start=1)
            ),
        )
    },
    "002-bridge": _radar(
        "footbridge at 7.4605 m, two stronger targets", _view(7.4605, SHORT_RANGE.bin_m, 1.0, _TREE, _FENCE), _WALK
    ),
    "001-case-1": _lab("case 1, calibration at 1 Hz", sine(4e-3, 1.0), *_CUPS),
    "001-case-2": _lab("case 2, 1 Hz with a finger from 23.5 to 27 s", sine(4e-3, 1.0), *_CUPS, _FINGER),
    "001-case-3": _lab("case 3, 2 Hz", sine(4e-3, 2.0), *_CUPS),
    "001-case-4": _lab("case 4, sweep to 3 Hz", lambda length_s, rng: Sweep(4e-3, 0.0, 3.0, length_s), *_CUPS),
    "001-case-5": _lab("case 5, recorded bridge", random(0.3, 3.0, 1.5e-3), *_CUPS),
    "001-case-6": _lab("case 6, light that swings for 210 s", _pushes, length_s=210.0, sky_s=900.0, rate_hz=10.0),
    "001-case-7": _lab(
        "case 7, day, night and day in 120 s",
        random(0.3, 2.2, 1.5e-3),
        length_s=120.0,
        sky_s=140.0,
        air_s=600.0,
        rate_hz=10.0,
    ),
    "001-bridge": _COLD_BRIDGE,
    "001-fisheye": _FISHEYE_LAB,
}
"""Name → scenario; the first three digits are the paper's key."""

# Films by their name in PAPER_SCENES, after the key of their paper, and the factor on the noise; NOISY: as published.
NOISY = "-noisy"
FILMS = {
    f"{scene.paper}-{name}{more}": (name, noise)
    for name, scene in PAPER_SCENES.items()
    for more, noise in (("", 1.0), (NOISY, scene.noise))
}
PAPER_NAMES: dict[str, str] = {
    **{
        name: f"{name[:3]}, {PAPER_SCENES[scene].title}{', noise as of the published errors' * name.endswith(NOISY)}"
        for name, (scene, _) in FILMS.items()
    },
    **{name: scenario.line for name, scenario in PUBLISHED.items()},
}


def chosen_here(name: str) -> str:
    """What a paper does not print of its test `name`; empty for a scenario of our own."""
    return FREE if name in FILMS else (SCENARIOS | PUBLISHED)[name].free


def write_scene(
    name: str, folder: str | Path, *, seed: int = 0, breaks: Sequence[str] = (), progress: Progress | None = None
) -> Path:
    """As `midspan.simulate.scenarios.write.write`, for PAPER_NAMES too; a film of a paper takes no break."""
    if name not in FILMS:
        return write(name, folder, seed=seed, breaks=breaks, progress=progress, scenarios=SCENARIOS | PUBLISHED)
    target = Path(folder).resolve()
    check_free(target)
    if breaks:
        raise UsageError(f"--break {breaks[0]} does not fit {name!r}, a paper's film. Leave it out.")
    scene, noise = FILMS[name]
    return write_recording(film(scene, FilmSettings(noise=noise), seed=seed), target)
