"""What `midspan simulate --break` breaks: a recording that no longer obeys the model, with its truth."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from midspan.checks import option
from midspan.errors import UsageError
from midspan.records import Floats
from midspan.signals.acceleration import GRAVITY_M_S2
from midspan.simulate.motion.motion import Motion, random_motion
from midspan.simulate.scenarios.stage import Scenario, Stage
from midspan.simulate.scene.disturbances import Breathing

Signal = Callable[[Floats], Floats]  # of times (n,) in s
Facts = dict[str, float]  # what a break drew, as known.json says it
Change = Callable[[Stage, np.random.Generator], tuple[Stage, Facts]]

NOISE_HZ = 10.0  # steps of a sensor's own error; no scenario's slow sensor is faster
LEANING = ("building", "radar-tall-building")
AT_REST = ("no-excitation",)
# An RTK solution converges with this time, and is fixed again after that one, s.
CONVERGES_S, FIXED_S = 25.0, 40.0


@dataclass(frozen=True, slots=True)
class Sensed(Motion):
    """A motion as broken sensors meet it: the accelerometer `felt` (m/s²), every other sensor `seen` (m)."""

    motion: Motion
    felt: Signal
    seen: Signal

    def derivative(self, time_s: Floats, order: int) -> Floats:
        """As `Motion.derivative`, of what the sensors meet; the velocity is the true one."""
        return (self.seen, self.motion.velocity, self.felt)[order](time_s)


@dataclass(frozen=True, slots=True)
class Break:
    """A way to break a recording: one line on what it does, the scenarios that it fits, and the change itself."""

    line: str
    fits: Callable[[str, Scenario], bool]
    change: Change


def _felt(staged: Stage, felt: Signal) -> Stage:
    return replace(staged, sensed=Sensed(staged.motion, felt, staged.sensed.displacement))


def _seen(staged: Stage, added_m: Signal) -> Stage:
    before = staged.sensed.displacement
    changed = Sensed(staged.motion, staged.sensed.acceleration, lambda t: before(t) + added_m(t))
    return replace(staged, sensed=changed)


def _errs(staged: Stage, added_m: Signal) -> Stage:
    """An error of the displacement sensor, whose errors are declared as white no longer."""
    scenario = staged.scenario
    assert scenario.gnss is not None
    return _seen(replace(staged, scenario=replace(scenario, gnss=replace(scenario.gnss, white=False))), added_m)


def _instants(staged: Stage, rate_hz: float) -> Floats:
    count = int(staged.scenario.duration_s * rate_hz)
    return np.arange(count + 1) / rate_hz


def _tilt(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    # The slope at the top of a cantilever in its first mode is 1.38 times its displacement there over its height.
    slope = 1.38 / rng.uniform(30.0, 100.0)
    before = staged.sensed.acceleration
    leaning = _felt(staged, lambda t: before(t) - GRAVITY_M_S2 * slope * staged.motion.displacement(t))
    facts = {"slope_per_m": slope}
    if staged.scenario.camera is None:
        return leaning, facts
    view_m, tilt_rad = 10.0, np.radians(1e-3 * rng.uniform(1.0, 3.0))
    slow = random_motion((0.01, 0.05), view_m * tilt_rad, rng=rng, lines=12)
    return _seen(leaning, slow.displacement), facts | {"camera_tilt_std_mdeg": 1e3 * float(np.degrees(tilt_rad))}


def _axis(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    angle = np.radians(rng.uniform(3.0, 15.0))
    before, cross = staged.sensed.acceleration, random_motion((0.5, 4.0), 1e-3, rng=rng, lines=240, flat="acceleration")
    time = _instants(staged, 20.0)
    share = np.std(before(time)) / np.std(cross.acceleration(time))
    turned = _felt(staged, lambda t: np.cos(angle) * before(t) + np.sin(angle) * share * cross.acceleration(t))
    return turned, {"angle_deg": float(np.degrees(angle))}


def _gain(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    factor = 1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.10)
    before = staged.sensed.acceleration
    return _felt(staged, lambda t: factor * before(t)), {"gain": factor}


def _logger(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, sosfilt, sosfilt_zi

    # Steps of 40 times the highest corner: the bilinear transform bends frequencies by (pi f / rate)^2 / 3 = 0.2 %, and
    # by nothing at the corner itself.
    step_rate_hz = 500.0
    corner, order = rng.uniform(5.0, 12.0), int(rng.choice([4, 6, 8]))
    sections = butter(order, corner, fs=step_rate_hz, output="sos")
    time = _instants(staged, step_rate_hz)
    parts = np.array_split(time, len(time) // 20_000 + 1)
    value = np.concatenate([staged.sensed.acceleration(part) for part in parts])
    filtered, _ = sosfilt(sections, value, zi=sosfilt_zi(sections) * value[0])
    return _felt(staged, CubicSpline(time, filtered)), {"corner_hz": corner, "order": float(order)}


def _bracket(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    setup = staged.scenario.camera
    assert setup is not None
    centre = setup.rate_hz / setup.every * rng.uniform(0.6, 0.95)
    std = rng.uniform(0.05, 0.15) * float(np.std(staged.motion.displacement(_instants(staged, 20.0))))
    shake = random_motion((0.98 * centre, 1.02 * centre), std, rng=rng, lines=40)
    return _seen(staged, shake.displacement), {"frequency_hz": centre, "std_mm": 1e3 * std}


def _exposure(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    share, scenario = rng.uniform(0.5, 0.9), staged.scenario
    if scenario.camera is not None:
        exposure_s = share / scenario.camera.rate_hz
        camera = replace(scenario.camera.camera, exposure_s=exposure_s)
        changed = replace(scenario, camera=replace(scenario.camera, camera=camera, says_exposure=False))
    else:
        assert scenario.gnss is not None
        exposure_s = share / scenario.gnss.sensor.rate_hz
        sensor = replace(scenario.gnss.sensor, exposure_s=exposure_s)
        changed = replace(scenario, gnss=replace(scenario.gnss, sensor=sensor))
    return replace(staged, scenario=changed), {"exposure_s": exposure_s}


def _colour(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    tau, std = rng.uniform(5.0, 60.0), rng.uniform(1.0, 3.0) * _noise_m(staged)
    return _errs(staged, _gauss_markov(staged, rng, std, tau)), {"std_mm": 1e3 * std, "time_s": tau}


def _gauss_markov(staged: Stage, rng: np.random.Generator, std: float, time_s: float) -> Signal:
    """A first-order Gauss-Markov process of a correlation time, straight between its steps."""
    time = _instants(staged, NOISE_HZ)
    keep = np.exp(-1.0 / (NOISE_HZ * time_s))
    path = std * rng.standard_normal(len(time))
    for k in range(1, len(path)):
        path[k] = keep * path[k - 1] + np.sqrt(1.0 - keep**2) * path[k]
    return lambda t: np.interp(t, time, path)


def _step(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    count, length = int(rng.integers(1, 4)), staged.scenario.duration_s
    at = np.sort(rng.uniform(0.1 * length, 0.9 * length, count))
    size = rng.choice([-1.0, 1.0], count) * rng.uniform(3.0, 20.0, count) * _noise_m(staged)
    facts = {f"{name}_{k}": value for k in range(count) for name, value in (("at_s", at[k]), ("mm", 1e3 * size[k]))}
    return _errs(staged, lambda t: (np.asarray(t)[:, None] >= at) @ size), facts


def _burst(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    share, noise = rng.uniform(0.10, 0.20), _noise_m(staged)
    time = _instants(staged, NOISE_HZ)
    loud = np.zeros(len(time), dtype=np.bool_)
    while np.mean(loud) < share:
        length = rng.uniform(2.0, 15.0)
        start = rng.uniform(0.0, time[-1] - length)
        loud |= (time >= start) & (time < start + length)
    # Together with the sensor's own white noise: together ten times as much.
    added = np.where(loud, np.sqrt(99.0) * noise * rng.standard_normal(len(time)), 0.0)

    def error(time_s: Floats) -> Floats:
        return added[np.clip(np.rint(time_s * NOISE_HZ).astype(np.int64), 0, len(time) - 1)]

    return _errs(staged, error), {"share": float(np.mean(loud)), "times": 10.0}


def _pattern(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    del rng
    day = staged.scenario.day
    assert day is not None
    changed = replace(day, thermal=replace(day.thermal, pattern_k=0.1))
    return replace(staged, scenario=replace(staged.scenario, day=changed)), {"pattern_k": 0.1}


def _mast(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    setup = staged.scenario.camera
    assert setup is not None
    hertz, px = 10 ** rng.uniform(-1.0, np.log10(0.5)), rng.uniform(0.15, 1.0)
    std = px * 1e-3 * abs(setup.scale_mm_per_px)
    # A mode of 3 % of damping is as wide as this.
    nod = random_motion((0.97 * hertz, 1.03 * hertz), std, rng=rng, lines=40)
    return _seen(staged, nod.displacement), {"frequency_hz": hertz, "std_px": px, "std_mm": 1e3 * std}


def _breathing(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    setup = staged.scenario.camera
    assert setup is not None
    share, tau, away_px = rng.uniform(1e-3, 3e-3), rng.uniform(3.0, 20.0), rng.uniform(60.0, 300.0)
    # The drive of a lens is slower than any frame: as smooth as motion of the same times.
    grown = random_motion((0.05 / tau, 0.5 / tau), share, rng=rng, lines=24)
    rows, columns = setup.size_px
    middle = (0.5 * columns, 0.5 * rows + away_px) if setup.direction == "y" else (0.5 * columns + away_px, 0.5 * rows)
    others, breathing = setup.disturbances, Breathing(grown.displacement, middle)
    camera = replace(setup, disturbances=lambda one: (*(others(one) if others else ()), breathing))
    changed = replace(staged, scenario=replace(staged.scenario, camera=camera))
    return changed, {"share": share, "time_s": tau, "away_px": away_px}


def _haze(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    setup = staged.scenario.camera
    assert setup is not None
    px, tau = rng.uniform(0.2, 0.5), 10 ** rng.uniform(0.0, 1.0)
    moved = _gauss_markov(staged, rng, px * 1e-3 * abs(setup.scale_mm_per_px), tau)
    return _seen(staged, moved), {"std_px": px, "time_s": tau}


def _float(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    start = rng.uniform(0.2, 0.6) * staged.scenario.duration_s
    off = rng.choice([-1.0, 1.0]) * rng.uniform(0.060, 0.100)

    def converging(time_s: Floats) -> Floats:
        age = time_s - start
        return np.where((age >= 0.0) & (age < FIXED_S), off * np.exp(-np.maximum(age, 0.0) / CONVERGES_S), 0.0)

    return _errs(staged, converging), {"at_s": start, "mm": 1e3 * off, "converges_s": CONVERGES_S, "fixed_s": FIXED_S}


def _clock_step(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    scenario = staged.scenario
    at, size, sign = rng.uniform(0.35, 0.65) * scenario.duration_s, rng.choice([0.02, 0.06, 0.3]), rng.choice([-1, 1])
    rate_hz = scenario.camera.rate_hz if scenario.camera else scenario.gnss.sensor.rate_hz if scenario.gnss else 1.0
    # Back by an interval or more the stamps would not increase.
    step = float(sign * size if size < 0.9 / rate_hz else size)
    if scenario.camera is not None:
        changed = replace(scenario, camera=replace(scenario.camera, clock_step=(at, step)))
    else:
        assert scenario.gnss is not None
        changed = replace(scenario, gnss=replace(scenario.gnss, clock_step=(at, step)))
    return replace(staged, scenario=changed), {"at_s": at, "step_s": step}


def _railing(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    from scipy.interpolate import CubicSpline
    from scipy.signal import bilinear, lfilter, lfilter_zi

    # As for the logger: 40 times the highest frequency.
    step_rate_hz = 500.0
    hertz, damping = rng.uniform(6.0, 12.0), rng.uniform(0.02, 0.05)
    w = 2.0 * np.pi * hertz
    # The foot's acceleration becomes that of the top: (2 ζ ω s + ω²) / (s² + 2 ζ ω s + ω²).
    upper, lower = bilinear([2.0 * damping * w, w * w], [1.0, 2.0 * damping * w, w * w], fs=step_rate_hz)
    time = _instants(staged, step_rate_hz)
    value = np.concatenate([staged.sensed.acceleration(part) for part in np.array_split(time, len(time) // 20_000 + 1)])
    top, _ = lfilter(upper, lower, value, zi=lfilter_zi(upper, lower) * value[0])
    return _felt(staged, CubicSpline(time, top)), {"frequency_hz": hertz, "damping": damping}


def _hum(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    rate_hz = staged.accelerometer.rate_hz
    alias = rng.choice([-1.0, 1.0]) * 10 ** rng.uniform(np.log10(0.2), np.log10(5.0))
    size, times, phase = (
        10 ** rng.uniform(-2.0, np.log10(0.2)),
        float(rng.integers(1, 3)),
        rng.uniform(0.0, 2.0 * np.pi),
    )
    hertz, before = times * rate_hz + alias, staged.sensed.acceleration
    hums = _felt(staged, lambda t: before(t) + size * np.sin(2.0 * np.pi * hertz * t + phase))
    return hums, {"machine_hz": hertz, "shows_hz": abs(alias), "amplitude_m_s2": size}


def _rounding(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    del rng
    # Three samples share a stamp, the middle one's: on the mean the stamps are right.
    step = 3.0 / staged.accelerometer.rate_hz
    return replace(staged, accelerometer=replace(staged.accelerometer, stamp_step_s=step)), {"step_s": step}


def _interference(staged: Stage, rng: np.random.Generator) -> tuple[Stage, Facts]:
    setup = staged.scenario.radar
    assert setup is not None
    count, length = ((10, 0.05), (40, 0.2), (150, 0.03))[rng.integers(3)]
    # The first frames' phase is the zero, and a record that begins jammed has none.
    starts = np.sort(rng.uniform(0.02, 1.0, count)) * staged.scenario.duration_s
    spans = tuple((float(start), float(start + length)) for start in starts)
    changed = replace(staged.scenario, radar=replace(setup, jammed=spans))
    facts = {"bursts": float(count), "each_s": length, "first_s": float(starts[0]), "above_target_db": setup.jam_db}
    return replace(staged, scenario=changed), facts


def _noise_m(staged: Stage) -> float:
    assert staged.scenario.gnss is not None
    return staged.scenario.gnss.sensor.noise_std_m


def _moves_along_one_axis(name: str, scenario: Scenario) -> bool:
    return scenario.across is None and name not in AT_REST


def _camera(name: str, scenario: Scenario) -> bool:
    return scenario.camera is not None and name not in AT_REST


def _camera_alone(name: str, scenario: Scenario) -> bool:
    return _camera(name, scenario) and scenario.radar is None


def _slow_sensor(name: str, scenario: Scenario) -> bool:
    return scenario.gnss is not None


def _radar(name: str, scenario: Scenario) -> bool:
    return scenario.radar is not None and name not in AT_REST


# In this order, however they were asked for: new ones at the end, for a break's generator follows from its place.
BREAKS: dict[str, Break] = {
    "tilt": Break(
        "gravity reaches the accelerometer of a structure that leans, and a camera tilts slowly",
        lambda n, s: n in LEANING,
        _tilt,
    ),
    "axis": Break(
        "the accelerometer is turned by 3 to 15 degrees towards an axis that shakes as much",
        _moves_along_one_axis,
        _axis,
    ),
    "gain": Break("the accelerometer's gain is 2 to 10 % off", _moves_along_one_axis, _gain),
    "logger": Break("the accelerometer's logger has a low-pass of 5 to 12 Hz", _moves_along_one_axis, _logger),
    "bracket": Break("the camera's bracket vibrates above the frames' Nyquist frequency", _camera_alone, _bracket),
    "exposure": Break(
        "an exposure of 50 to 90 % of the interval is not declared",
        lambda n, s: _camera(n, s) or _slow_sensor(n, s),
        _exposure,
    ),
    "colour": Break("a Gauss-Markov error of 5 to 60 s, 1 to 3 times the white noise", _slow_sensor, _colour),
    "step": Break("level shifts of 3 to 20 times the noise", _slow_sensor, _step),
    "burst": Break("ten times the noise for 10 to 20 % of the time", _slow_sensor, _burst),
    "pattern": Break("a fixed pattern of 0.1 K", lambda n, s: s.day is not None, _pattern),
    "mast": Break("the camera's mast nods by 0.15 to 1 px rms at 0.1 to 0.5 Hz", _camera_alone, _mast),
    "breathing": Break(
        "the autofocus hunts: 0.1 to 0.3 % of magnification in 3 to 20 s, the axis 60 to 300 px off the middle",
        _camera_alone,
        _breathing,
    ),
    "haze": Break("hot air moves the picture by 0.2 to 0.5 px rms in 1 to 10 s", _camera_alone, _haze),
    "float": Break(
        "an RTK receiver converges from 60 to 100 mm off (25 s) and is fixed again after 40 s", _slow_sensor, _float
    ),
    "clock-step": Break(
        "the slower sensor's clock is set by 20, 60 or 300 ms in the middle",
        lambda n, s: _camera_alone(n, s) or _slow_sensor(n, s),
        _clock_step,
    ),
    "railing": Break(
        "the accelerometer stands on a railing of its own resonance, 6 to 12 Hz", _moves_along_one_axis, _railing
    ),
    "interference": Break(
        "another radar's chirps: bursts of 6 dB above the target in every bin", _radar, _interference
    ),
    "rounding": Break(
        "the accelerometer's stamps are rounded to three of its intervals", _moves_along_one_axis, _rounding
    ),
    "hum": Break(
        "no anti-alias filter, and a machine near a multiple of the accelerometer's rate", _moves_along_one_axis, _hum
    ),
}


def broken(
    staged: Stage, scenario: str, breaks: Sequence[str], scenarios: Mapping[str, Scenario]
) -> tuple[Stage, dict[str, Facts]]:
    """The stage of `scenario` with every break of `breaks` (names of BREAKS), and what each one drew.

    A break draws from a generator of its own: what it does depends on the seed and not on the others. Raises UsageError
    for an unknown name, or a break that the scenario has nothing for, naming those of `scenarios` that it fits.
    """
    facts = {}
    for name in breaks:
        option("--break", name, BREAKS)
        if not BREAKS[name].fits(scenario, staged.scenario):
            fitting = ", ".join(other for other, one in scenarios.items() if BREAKS[name].fits(other, one))
            raise UsageError(f"--break {name} does not fit {scenario!r}: {BREAKS[name].line}. It fits {fitting}.")
    for (name, one), rng in zip(BREAKS.items(), staged.rng_breaks.spawn(len(BREAKS)), strict=True):
        if name in breaks:
            staged, facts[name] = one.change(staged, rng)
    return staged, facts
