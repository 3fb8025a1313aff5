"""The radar paper: a wall at 1.3 m, a building at 48 m, a target at an angle, a footbridge; raw samples of the radar.

Z. Ma, J. Choi, L. Yang, H. Sohn, Structural displacement estimation using accelerometer and FMCW millimeter wave radar,
Mech. Syst. Signal Process. 182 (2023) 109582, doi 10.1016/j.ymssp.2022.109582, sections 4 and 5. "existing" is plain
unwrapping, "aided" equations 12 to 15, "FIR" equations 17 to 21 with the paper's 101 coefficients.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from midspan.checks import refuse
from midspan.fusion.runners import run_method
from midspan.fusion.streams import KalmanSettings, MethodSettings
from midspan.papers.claims import Curve, Effort, Measured
from midspan.papers.printed.radar_phase import best_on_grid, unwrap_aided
from midspan.radar.channels import Phasors
from midspan.radar.chirp import SPEED_OF_LIGHT_M_S, ChirpProfile
from midspan.radar.measurement import TargetFrames, TargetSeries, displacement
from midspan.radar.range_profile import averaged, range_profile
from midspan.radar.target import Target, find_targets, ranked
from midspan.records import Acceleration, Displacement, Floats, Source, nanoseconds
from midspan.simulate.motion.motion import Motion, Sines, Window, random_motion
from midspan.simulate.radar.signal import LONG_RANGE, SHORT_RANGE, RadarModel, Reflector, noise_for

RATE_HZ, FRAMES = 100.0, 3000
BIAS_M_S2, NOISE_M_S2 = 0.02, 5e-5
# As printed: order 101, which is a delay of 0.5 s.
FIR: dict[str, Any] = {"literal": True, "half_window": 50, "cut_off_hz": 1.0}
INNER = slice(500, -300)
# Which motion of a test is drawn as which figure.
DRAWN = {("wall", 1): "Fig. 10 (b)", ("building", 1): "Fig. 15 (a)", ("bridge", 0): "Fig. 23"}
BEFORE_S = 10.0  # stamps are counted from so long before the first frame


@dataclass(frozen=True, slots=True)
class Case:
    """One test: where the target is, its factor, its signal-to-noise ratio a sample, and what else is in view."""

    chirp: ChirpProfile
    range_m: float
    factor: float
    snr_db: float
    motions: tuple[Motion, ...]
    others: tuple[Reflector, ...] = ()

    def model(self) -> RadarModel:
        """The wall, 10 % of another reflector of its bin at another angle, and what the view holds besides."""
        clutter = Reflector(self.range_m + 0.5 * self.chirp.bin_m, 100.0, 0.4 / self.factor, 0.5)
        view = (Reflector(self.range_m, 1000.0, 1.0 / self.factor), clutter, *self.others)
        return RadarModel(view, self.chirp, noise_for(1000.0, self.snr_db), phase_noise_rad=0.02)

    @property
    def phase_per_m(self) -> float:
        """As printed: with the start frequency, rad/m."""
        return 4 * np.pi * self.chirp.start_frequency_hz / SPEED_OF_LIGHT_M_S

    @property
    def start_over_middle(self) -> float:
        """The share of the ramp's mean frequency that its start is: by so much the printed factor is off."""
        return self.phase_per_m / self.chirp.phase_per_m(self.range_m)


def sine(amplitude_m: float, frequency_hz: float) -> Motion:
    """A sine that begins smoothly between 1 and 3 s."""
    return Window(Sines(np.array([amplitude_m]), np.array([frequency_hz])), start_s=1.0, ramp_s=2.0)


def vibration(peak_m: float, seed: int, high_hz: float = 3.0) -> Motion:
    """A recorded-like vibration of about `peak_m`."""
    motion = random_motion((0.3, high_hz), peak_m / 3, rng=np.random.default_rng(seed))
    return Window(motion, start_s=1.0, ramp_s=2.0)


def cases(seed: int) -> dict[str, Case]:
    """The four tests; the third motion of each is what both chains are calibrated on."""
    own = 10 * seed
    laboratory = (sine(0.04, 0.3), sine(0.04, 0.5), sine(0.02, 1.0), vibration(0.03, own + 1))
    walking = (vibration(2e-3, own + 2), vibration(3e-3, own + 3), vibration(2e-3, own + 4, 4.0))
    rng = np.random.default_rng([6, seed])
    # Two stronger reflectors on the way to the bridge's target: a tree and a fence that move on their own.
    trees = (
        Reflector(4.1, 2200.0, 1.0, 0.3, own=random_motion((0.2, 1.5), 0.4e-3, rng=rng)),
        Reflector(5.6, 1500.0, 0.9, -0.3, own=random_motion((0.5, 3.0), 0.2e-3, rng=rng)),
    )
    # Other parts of the building across the street.
    parts = tuple(Reflector(r, 900.0, 1.0, a) for r, a in ((31.0, 0.2), (34.5, -0.2), (38.0, 0.1), (42.0, -0.1)))
    return {
        "wall": Case(SHORT_RANGE, 1.318, 1.0, 0.0, laboratory),
        "building": Case(LONG_RANGE, 48.0, 1.0, -5.0, laboratory, parts),
        "angled": Case(SHORT_RANGE, 2.0543, 1.2748, 0.0, laboratory),
        "bridge": Case(SHORT_RANGE, 7.4605, 1.0, -5.0, walking, trees),
    }


@dataclass(frozen=True, slots=True)
class Seen:
    """What both sensors have of one motion: frames (n,), profiles, the accelerometer's samples, level (n,) at them."""

    at_s: Floats
    profiles: Phasors
    samples: Floats
    level: Floats
    true_m: Floats


@dataclass(frozen=True, slots=True)
class Known:
    """What both chains learn from one motion: the printed factors and the target that they choose, and ours."""

    factors: tuple[float, ...]
    chosen: int
    target: Target


def seen(case: Case, motion: Motion, seed: int) -> Seen:
    """One motion by both sensors."""
    model, rng = case.model(), np.random.default_rng(seed)
    cube = np.concatenate(list(model.blocks(motion, FRAMES, rng=rng)))
    profiles = averaged(range_profile(cube, case.chirp), case.chirp)
    felt = np.arange(-1.0, FRAMES / RATE_HZ + 1.0, 1 / RATE_HZ)
    value = motion.acceleration(felt) + rng.normal(0, NOISE_M_S2, len(felt)) + BIAS_M_S2
    at_s = model.frame_s(FRAMES)
    samples = np.column_stack((felt, value))
    return Seen(at_s, profiles, samples, np.interp(at_s, felt, value) - BIAS_M_S2, motion.displacement(at_s))


def known(case: Case, one: Seen) -> Known:
    """Factors, choice and target from one motion."""
    chosen, grids = best_on_grid(np.stack(_changes(case, one)), one.level, RATE_HZ)
    target = ranked(find_targets(one.profiles, one.at_s, samples=one.samples, axis=case.chirp.axis))[0]
    return Known(tuple(grid.conversion_factor for grid in grids), chosen, target)


def steps(case: Case, found: Known, one: Seen) -> tuple[dict[str, Floats], list[Floats]]:
    """Displacements (n,) in m by the printed chain's steps and by ours over one motion; and those by other targets."""
    change = _changes(case, one)
    value = [factor * c for factor, c in zip(found.factors, change, strict=True)]
    plain = found.factors[0] * unwrap_plain(_phase(case, one, case.range_m)) / case.phase_per_m
    series = ours(case, one, found.target)
    values = {
        "existing": plain,
        "factor 1": change[0],
        "aided": value[0],
        "FIR": _fir(one, value[0]),
        "radar": series.value_m,
        "smoother": _smoother(one, series),
    }
    return values, value[1:]


def errors_mm(one: Seen, found: dict[str, Floats], others: Sequence[Floats]) -> dict[str, float]:
    """Errors in mm of displacements."""
    errors = {name: _mm(x, one.true_m) for name, x in found.items()}
    by_others = [_mm(x, one.true_m) for x in others] or [np.nan]
    return errors | {"worst other": max(by_others), "best other": min(by_others)}


def _drawn(figure: str, one: Seen, found: dict[str, Floats]) -> Curve:
    """Six seconds of displacements like the paper's figures."""
    near = (one.at_s > 10.0) & (one.at_s < 16.0)
    lines = {"reference": one.true_m, **{name: found[name] for name in ("existing", "aided", "smoother")}}
    level = {name: 1e3 * (x - np.mean((x - one.true_m)[near])) for name, x in lines.items()}
    return Curve(figure, "time (s)", "displacement (mm)", {n: (one.at_s[near], x[near]) for n, x in level.items()})


def _changes(case: Case, one: Seen) -> list[Floats]:
    """Range changes of the target and of the others by equations 12 to 15."""
    ranges = (case.range_m, *(other.range_m for other in case.others))
    unit = case.phase_per_m
    aided = [
        unwrap_aided(_phase(case, one, r), one.level, period_s=1 / RATE_HZ, phase_per_m=unit) / unit for r in ranges
    ]
    return [change - change[0] for change in aided]


def _phase(case: Case, one: Seen, range_m: float) -> Floats:
    """Phase (n,) of one receiver at the whole bin of a range."""
    return np.angle(one.profiles[:, 0, round(range_m / case.chirp.bin_m)]).astype(float)


def ours(case: Case, one: Seen, target: Target) -> TargetSeries:
    """The series of our target, in a second pass followed through the bins that the first one found it in."""
    excursion = 0.0
    for _ in range(2):
        bins = target.bins(excursion, case.chirp.bin_m, case.chirp.bins)
        some = one.profiles[:, :, bins.astype(int)]
        frames = TargetFrames(one.at_s, some, np.ones(some.shape[:2], dtype=bool), bins, case.chirp.bin_m)
        unit = case.chirp.phase_per_m(target.range_m)
        series = displacement(frames, target, samples=one.samples, phase_per_m=unit)
        moved = series.range_change_m[np.isfinite(series.range_change_m)]
        excursion = float(np.max(np.abs(moved - np.median(moved)), initial=0.0)) if len(moved) else 0.0
    return series


def _blocks(one: Seen, value: Floats, variance: Floats | float) -> tuple[Acceleration, Displacement]:
    good = np.isfinite(value)
    density = np.full(len(one.samples), NOISE_M_S2**2 / RATE_HZ)
    source = np.full(int(good.sum()), Source.RADAR, dtype=np.uint8)
    felt = Acceleration(nanoseconds(one.samples[:, 0] + BEFORE_S), one.samples[:, 1], density)
    var = np.broadcast_to(np.asarray(variance), value.shape)[good]
    return felt, Displacement(nanoseconds(one.at_s[good] + BEFORE_S), value[good], var, source)


def _fir(one: Seen, value: Floats) -> Floats:
    acceleration, displacement = _blocks(one, value, 1e-10)
    settings = MethodSettings(KalmanSettings(bias=float(np.mean(acceleration.value_m_s2))), **FIR)
    estimate = run_method("fir", acceleration, displacement, settings).estimate
    return np.interp(one.at_s, estimate.time_ns / 1e9 - BEFORE_S, estimate.displacement_m)


def _smoother(one: Seen, series: TargetSeries) -> Floats:
    estimate = run_method("smoother", *_blocks(one, series.value_m, series.variance_m2)).estimate
    return np.interp(one.at_s, estimate.time_ns / 1e9 - BEFORE_S, estimate.displacement_m)


def _mm(value: Floats, true: Floats) -> float:
    """Standard deviation of the error in mm without the ends."""
    return 1e3 * float(np.std((value - true)[INNER]))


def tested(name: str, effort: Effort) -> Measured:
    """One test over its motions, in their order."""
    case = cases(effort.seed)[name]
    first = 1000 * effort.seed
    estimated = known(case, seen(case, case.motions[2], first + 90))
    found, curves = [], []
    for k, motion in enumerate(case.motions):
        one = seen(case, motion, first + k)
        series, others = steps(case, estimated, one)
        found.append(errors_mm(one, series, others))
        if (name, k) in DRAWN:
            curves.append(_drawn(DRAWN[name, k], one, series))
    values: dict[str, Any] = {key: [one[key] for one in found] for key in found[0]}
    fast = [1, 2, 3] if name != "bridge" else []
    values |= {f"{key}, fast": [found[k][key] for k in fast] for key in ("existing", "aided")}
    values |= {f"{key}, slow": found[0][key] for key in ("existing", "aided")}
    values |= {f"{key}, all": float(np.sqrt(np.mean(np.square(values[key])))) for key in found[0]}
    values["printed factor"] = estimated.factors[0]
    values["our factor"] = estimated.target.conversion_factor
    values["printed, off by"] = abs(estimated.factors[0] - case.factor * case.start_over_middle)
    values["ours, off by"] = abs(estimated.target.conversion_factor - case.factor)
    values["target chosen"] = float(estimated.chosen == 0)
    values["our target, off by bins"] = abs(estimated.target.range_m - case.range_m) / case.chirp.bin_m
    values["delay (s)"] = FIR["half_window"] / RATE_HZ
    return Measured(values, tuple(curves))


def chirp(effort: Effort) -> Measured:
    """Table 1: what slope, samples and sampling rate of the chirp give, and the bin that a simulated target is in."""
    far = 10.0
    model = RadarModel((Reflector(far, 1000.0, 0.0),), SHORT_RANGE, 0.0)
    cube = np.concatenate(list(model.blocks(sine(0.0, 1.0), 8, rng=np.random.default_rng(effort.seed))))
    power = np.abs(np.fft.fft(cube[0, 0, 0], 16 * SHORT_RANGE.samples))
    place = float(np.argmax(power)) / 16
    return Measured(
        {
            "resolution cm": 100 * SHORT_RANGE.bin_m,
            "of a simulated target cm": 100 * far / place,
            "largest range m": SHORT_RANGE.bin_m * SHORT_RANGE.bins,
            "resolution, off by %": 100 * abs(SHORT_RANGE.bin_m / 0.0489 - 1),
            "of a simulated target, off by %": 100 * abs(far / place / SHORT_RANGE.bin_m - 1),
        }
    )


def unwrap_plain(phase_rad: Floats) -> Floats:
    """Phase (n,) in rad without jumps of half a turn or more from frame to frame.

    Right while the range changes by less than a quarter of a wavelength a frame (97 mm/s at 77 GHz and 100 Hz); NaN
    marks missing frames, over which the last phase is held.
    """
    phase = np.asarray(phase_rad, dtype=np.float64)
    out = np.full(len(phase), np.nan)
    known = np.flatnonzero(np.isfinite(phase))
    out[known] = np.unwrap(phase[known])
    return out


def factor_by_distances(range_m: float, along_m: float) -> float:
    """Displacement by change of range, D / √(D² − L²), of a surface at right angles to the line of sight: equation 9.

    range_m: D, from radar to target, m; along_m: L, the part of it at right angles to the motion, m, below D.
    """
    if not 0.0 <= along_m < range_m:
        raise refuse("along_m", f"from 0 to below range_m = {range_m:g} m", along_m)
    return range_m / math.sqrt(range_m**2 - along_m**2)


def factor_by_angles(motion_rad: float, surface_rad: float = 0.5 * math.pi) -> float:
    """Displacement by change of range, 1 / (cos θ + sin θ tan(π/2 − φ)): equation 11.

    motion_rad: θ, from the line of sight to the motion; surface_rad: φ, from the line of sight to the target's surface,
    above 0 and below π. Raises UsageError where the motion leaves the range as it is: it runs along the surface.
    """
    if not 0.0 < surface_rad < math.pi:
        raise refuse("surface_rad", "above 0 and below π", surface_rad)
    change = math.cos(motion_rad) + math.sin(motion_rad) * math.tan(0.5 * math.pi - surface_rad)
    if abs(change) < 1e-12:
        raise refuse("motion_rad", "a direction that is not that of the surface", motion_rad)
    return 1.0 / change
