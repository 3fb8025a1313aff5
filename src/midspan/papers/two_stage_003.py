"""The two-stage FIR paper: aliases, the beam of section 4, the storey model and the footbridge of section 5.

Z. Ma, P. Liu, J. Choi, H. Sohn, High-sampled structural displacement estimation through the FIR filter-based two-stage
fusion of high-sampled acceleration and temporally aliased low-sampled displacement measurements. "existing" is Lee's
filter with the paper's cut-off of 1 Hz and accuracy of 0.97, "Kalman" the adaptive one of the earlier paper as printed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from midspan.fusion.runners import run_method
from midspan.fusion.streams import KalmanSettings, MethodSettings, Smoothed, smooth
from midspan.papers.claims import Curve, Effort, Measured
from midspan.papers.motions import ACCELEROMETER, CAMERA_HZ
from midspan.records import Acceleration, Displacement, Floats, Source
from midspan.simulate.motion.beam import paper_beam_motion
from midspan.simulate.motion.motion import Motion, Pulse, Sines, Sum, Window, random_motion
from midspan.simulate.motion.sensors import AccelerometerModel, DisplacementSensorModel, noise_std_for, simulate_pair

RATE_HZ, BIAS_M_S2 = ACCELEROMETER.rate_hz, 0.02
TONES_HZ = (2.2, 3.3, 5.1, 6.3, 10.3)
# The beam's two aliases in a displacement at 10 Hz, Hz.
ALIASES_HZ = (0.3, 2.0)
# Rows nearer to the ends than the filters' reach are the estimator's; no more is left out than this, s.
MAX_EDGE_S = 12.0

Method = Callable[[Acceleration, Displacement], Smoothed]


def _printed(name: str, bias_m_s2: float = 0.0, **keys: Any) -> Method:
    settings = MethodSettings(KalmanSettings(bias=bias_m_s2), literal=True, **keys)
    return lambda a, d: run_method(name, a, d, settings)


# As printed; SHORT with the lengths that leave the delay of 2.5 s that section 5.1.2 states at 3 frames/s: the
# paper prints no length.
FIRS: dict[str, Method] = {
    "existing": _printed("fir", BIAS_M_S2, cut_off_hz=1.0),
    "proposed": _printed("two-stage-fir"),
    "smoother": smooth,
}
ALL: dict[str, Method] = {"Kalman": _printed("adaptive-kalman", BIAS_M_S2), **FIRS}
SHORT = _printed("two-stage-fir", taps=201, anti_alias_taps=201, spline_frames=0)


@dataclass(frozen=True, slots=True)
class Sensors:
    """Noise of both sensors, m/s² and m a sample, the accelerometer's bias, and by how much the camera is late, s."""

    acceleration_std: float
    displacement_std: float
    bias_m_s2: float = BIAS_M_S2
    late_s: float = 0.0


STOREY = Sensors(1e-3, 1e-4)


@dataclass(frozen=True, slots=True)
class Record:
    """Both series on one clock, and the truth (n,) at the samples."""

    acceleration: Acceleration
    displacement: Displacement
    truth_m: Floats

    def run(self, methods: dict[str, Method]) -> dict[str, tuple[Floats, float]]:
        """Each method's error (n,) in mm and its delay in s, infinite for the whole record."""
        found = {name: method(self.acceleration, self.displacement) for name, method in methods.items()}
        return {
            name: (1e3 * (one.estimate.displacement_m - self.truth_m[-len(one.estimate.time_ns) :]), one.delay_s)
            for name, one in found.items()
        }


def recorded(motion: Motion, length_s: float, slow_hz: float, sensors: Sensors, seed: int) -> Record:
    """The motion by an accelerometer at 100 Hz and a displacement at `slow_hz`; the filters do not know `late_s`."""
    pair = simulate_pair(
        motion,
        length_s,
        accelerometer=AccelerometerModel(RATE_HZ, sensors.acceleration_std, sensors.bias_m_s2),
        displacement=DisplacementSensorModel(slow_hz, sensors.displacement_std, -sensors.late_s),
        seed=seed,
    )
    a, d = pair.acceleration, pair.displacement
    density = np.full(len(a.value), sensors.acceleration_std**2 / RATE_HZ)
    variance, source = np.full(len(d.value), sensors.displacement_std**2), np.full(len(d.value), Source.DISPLACEMENT)
    acceleration = Acceleration(a.time_ns, a.value, density)
    displacement = Displacement(d.time_ns, d.value, variance, source.astype(np.uint8))
    return Record(acceleration, displacement, pair.true_displacement_m)


def errors_mm(record: Record, methods: dict[str, Method], edge_s: float | None = None) -> dict[str, float]:
    """Standard deviation of each method's error in mm without its ends: as long as the longest delay, or `edge_s`."""
    found = record.run(methods)
    reach = max(delay for _, delay in found.values() if np.isfinite(delay)) if edge_s is None else edge_s
    edge = round(min(reach, MAX_EDGE_S) * RATE_HZ)
    return {name: float(np.std(error[edge : len(error) - edge])) for name, (error, _) in found.items()}


def amplitude(values: Floats, frequency_hz: float, rate_hz: float) -> float:
    """Amplitude of a tone in values (n,), by least squares with a constant."""
    angle = 2 * np.pi * frequency_hz * np.arange(len(values)) / rate_hz
    columns = np.column_stack((np.cos(angle), np.sin(angle), np.ones(len(values))))
    found = np.linalg.lstsq(columns, values, rcond=None)[0]
    return float(np.hypot(found[0], found[1]))


# Table 3.

PRINTED_ALIASES = {
    (15, 10.3): 4.7,
    (10, 5.1): 4.9, (10, 6.3): 4.7, (10, 10.3): 0.3,
    (6, 3.3): 2.7, (6, 5.1): 0.9, (6, 6.3): 0.3, (6, 10.3): 1.7,
    (5, 3.3): 1.7, (5, 5.1): 0.1, (5, 6.3): 1.3, (5, 10.3): 0.3,
    (3, 2.2): 0.8, (3, 3.3): 0.3, (3, 5.1): 0.9, (3, 6.3): 0.3, (3, 10.3): 1.3,
}  # fmt: skip
"""Frames a second and tone in Hz → the alias that the paper's table 3 prints, Hz."""


def alias_hz(tone_hz: float, rate_hz: float) -> float:
    """Where a tone appears in samples at a rate: its distance from the nearest multiple of the rate."""
    return abs(tone_hz - rate_hz * round(tone_hz / rate_hz))


def sampled_alias_hz(tone_hz: float, rate_hz: float, length_s: float = 100.0) -> float:
    """The peak of the spectrum of a sampled tone."""
    at_s = np.arange(round(length_s * rate_hz)) / rate_hz
    power = np.abs(np.fft.rfft(np.sin(2 * np.pi * tone_hz * at_s + 0.4)))
    return float(np.argmax(power) / length_s)


def aliases(effort: Effort) -> Measured:
    """Every cell of table 3, by formula and from a spectrum."""
    formula = np.array([alias_hz(tone, rate) for rate, tone in PRINTED_ALIASES])
    seen = np.array([sampled_alias_hz(tone, rate) for rate, tone in PRINTED_ALIASES])
    printed = np.array(list(PRINTED_ALIASES.values()))
    return Measured(
        {
            "cells": len(printed),
            "as the paper": int(np.count_nonzero(np.abs(formula - printed) < 0.01)),
            "formula less spectrum": float(np.max(np.abs(formula - seen))),
            "10 frames/s, 6.3 Hz": alias_hz(6.3, 10.0),
        }
    )


# Section 4: the beam.


def beam(seed: int, *, snr_db: float = 40.0, late_s: float = 0.0) -> Record:
    """The beam for 100 s: 100 Hz at 40 dB and 10 Hz at `snr_db`."""
    motion = paper_beam_motion(100 + seed)
    at_s = np.arange(0, 100, 1 / RATE_HZ)
    noise = noise_std_for(motion.acceleration(at_s), 40.0), noise_std_for(motion.displacement(at_s), snr_db)
    return recorded(motion, 100.0, 10.0, Sensors(*noise, late_s=late_s), seed)


def beam_displacement(effort: Effort) -> Measured:
    """Figures 13 to 15."""
    record = beam(effort.seed)
    found = record.run(FIRS)
    inner = slice(1000, -1000)
    error = {name: one[inner] for name, (one, _) in found.items()}
    rms = {name: float(np.std(one)) for name, one in error.items()}
    spectrum = {name: [amplitude(one, f, RATE_HZ) for f in ALIASES_HZ] for name, one in error.items()}
    slow = 1e3 * record.displacement.value_m[100:-100]
    hz = np.asarray(np.fft.rfftfreq(len(error["existing"]), 1 / RATE_HZ), dtype=np.float64)
    lines = {"reference": record.truth_m[inner] * 1e3}
    lines |= {name: record.truth_m[inner] * 1e3 + one for name, one in error.items() if name != "smoother"}
    at_s = 10 + np.arange(len(error["existing"])) / RATE_HZ
    near = (at_s > 60) & (at_s < 65)
    values: dict[str, Any] = dict(rms)
    values["reduction"] = 100 * (1 - rms["proposed"] / rms["existing"])
    values |= {f"{name} at 0.3 Hz": one[0] for name, one in spectrum.items()}
    values |= {f"{name} at 2 Hz (mm)": one[1] for name, one in spectrum.items()}
    values |= {f"10 Hz record at {f:g} Hz": amplitude(slow, f, 10.0) for f in ALIASES_HZ}
    values |= {f"motion at {f:g} Hz": amplitude(lines["reference"], f, RATE_HZ) for f in ALIASES_HZ}
    return Measured(
        values,
        (
            Curve("Fig. 14 (b)", "time (s)", "error (mm)", {n: (at_s[near], e[near]) for n, e in error.items()}),
            Curve(
                "Fig. 15",
                "frequency (Hz)",
                "amplitude (mm)",
                {n: (hz[8:960], _spectrum(x)[8:960]) for n, x in lines.items()},
                log=True,
            ),
        ),
    )


def _spectrum(values: Floats) -> Floats:
    """Amplitudes (k,) of the transform of values (n,)."""
    found: Floats = np.abs(np.fft.rfft(values)) * (2 / len(values))
    return found


def beam_noise(effort: Effort) -> Measured:
    """Figures 16 (a) and (b)."""
    levels = (20, 30, 40, 100) if effort.quick else (20, 30, 40, 60, 80, 100)
    late_ms = (0, 5, 10) if effort.quick else (0, 2, 4, 6, 8, 10)
    noisy = [errors_mm(beam(effort.seed, snr_db=float(snr)), FIRS, 5.0) for snr in levels]
    late = [errors_mm(beam(effort.seed, late_s=1e-3 * ms), FIRS, 5.0) for ms in late_ms]
    values = {f"{name} at {snr} dB": one[name] for snr, one in zip(levels, noisy, strict=True) for name in FIRS}
    values |= {f"{name} {ms} ms late": one[name] for ms, one in zip(late_ms, late, strict=True) for name in FIRS}
    axes = (("Fig. 16 (a)", "SNR of the displacement (dB)", levels, noisy), ("Fig. 16 (b)", "late (ms)", late_ms, late))
    return Measured(
        values,
        tuple(
            Curve(figure, x, "RMSE (mm)", {n: (np.array(at, float), np.array([o[n] for o in one])) for n in FIRS})
            for figure, x, at, one in axes
        ),
    )


# Section 5.1: the storey model.

STOREY_S = 54.0
TONE_M = 2.8e-3


def storey_motion(tone_hz: float, seed: int) -> Motion:
    """0.1 Hz and a tone, from rest: the shaker is switched on."""
    phase = np.random.default_rng([3, seed]).uniform(0, 2 * np.pi, 2)
    motion = Sines(np.array([8e-3, TONE_M]), np.array([0.1, tone_hz]), phase_rad=phase)
    return Window(motion, 0.0, STOREY_S, ramp_s=2.0)


def storey(effort: Effort) -> Measured:
    """Figures 20 to 22 and table 2: five tones, the camera's frames as they come or every N-th."""
    every = (1, 5, 10) if effort.quick else (1, 2, 3, 5, 6, 10)

    def errors(n: int, tone: float) -> dict[str, float]:
        motion = storey_motion(tone, effort.seed)
        return errors_mm(recorded(motion, STOREY_S, CAMERA_HZ / n, STOREY, effort.seed), ALL)

    found = {(n, tone): errors(n, tone) for n in every for tone in TONES_HZ}
    short = [_short_at_3(tone, effort.seed) for tone in TONES_HZ]
    at_3 = {name: np.array([found[10, tone][name] for tone in TONES_HZ]) for name in ALL}
    clean = [(n, tone) for n, tone in found if CAMERA_HZ / n > 2 * tone + 1]
    low = [(n, tone) for n, tone in found if n > 1 and alias_hz(tone, CAMERA_HZ / n) < 0.5 and CAMERA_HZ / n < 2 * tone]
    values: dict[str, Any] = {f"{name} at 3 frames/s": one for name, one in at_3.items()}
    for name in ALL:
        values[f"{name}, excitations 2 and 4"] = at_3[name][[1, 3]]
        values[f"{name}, excitation 1"] = at_3[name][0]
        values[f"{name}, excitations 3 and 5"] = at_3[name][[2, 4]]
        values[f"{name}, not aliased"] = np.mean([found[key][name] for key in clean])
        values[f"{name}, aliased below 0.5 Hz"] = np.mean([found[key][name] for key in low])
        values[f"{name}, mean of all"] = np.mean([one[name] for one in found.values()])
    values["proposed in 2.5 s at 3 frames/s"] = np.array([error for error, _, _ in short])
    values["delay (s)"], values["delay of 201 taps (s)"] = short[0][1:]
    values["proposed is best (cases)"] = sum(
        one["proposed"] < min(one["existing"], one["Kalman"]) for one in found.values()
    )
    values["all (cases)"] = len(found)
    rates = np.array([CAMERA_HZ / n for n in every])
    curves = tuple(
        Curve(
            f"Fig. 22 ({letter})",
            "frames/s",
            f"RMSE (mm), 0.1 + {tone} Hz",
            {name: (rates, np.array([found[n, tone][name] for n in every])) for name in ALL},
            log=True,
            dots=True,
        )
        for letter, tone in zip("abcde", TONES_HZ, strict=True)
    )
    return Measured(values, curves)


def _short_at_3(tone: float, seed: int) -> tuple[float, float, float]:
    """Error in mm of the proposed filters in the paper's delay, at 3 frames/s; the delay of the longer ones and theirs,
    s.
    """
    record = recorded(storey_motion(tone, seed), STOREY_S, CAMERA_HZ / 10, STOREY, seed)
    found = record.run({"proposed": FIRS["proposed"], "short": SHORT})
    edge = round(MAX_EDGE_S * RATE_HZ)
    error, delay_s = found["short"]
    return float(np.std(error[edge : len(error) - edge])), found["proposed"][1], delay_s


def pushed(effort: Effort) -> Measured:
    """Figure 24: 5.1 Hz while the model is pushed by hand, at 3, 5 and 10 frames/s."""
    rng = np.random.default_rng([4, effort.seed])
    at_s = np.array([14.0, 30.0, 41.0]) + rng.uniform(-1, 1, 3)
    hands = tuple(Pulse(h, t, 2.5) for h, t in zip((25e-3, -15e-3, 20e-3), at_s, strict=True))
    tone = Sines(np.array([TONE_M]), np.array([5.1]), phase_rad=rng.uniform(0, 2 * np.pi))
    motion = Window(Sum((tone, *hands)), 0.0, STOREY_S, ramp_s=2.0)
    found = [errors_mm(recorded(motion, STOREY_S, CAMERA_HZ / n, STOREY, effort.seed), FIRS) for n in (10, 6, 3)]
    values = {
        f"{name} at {rate} frames/s": one[name] for rate, one in zip((3, 5, 10), found, strict=True) for name in FIRS
    }
    return Measured(values | {f"{name}, 3, 5, 10 frames/s": [one[name] for one in found] for name in FIRS})


# Section 5.2: the footbridge.

MODES_HZ, BRIDGE_S = (2.0, 2.102, 2.224, 2.51), 49.0
BRIDGE = Sensors(1e-3, 5e-5)


def bridge_motion(excitation: int, seed: int) -> Motion:
    """1 and 2: sixteen people cross slowly and two jump, near 2.5 Hz and near 1.55 Hz; 3: four jump in the modes."""
    rng = np.random.default_rng([5, excitation, seed])
    if excitation == 3:
        sizes = 1e-3 * np.array([0.8, 1.2, 0.6, 0.5])
        return Window(Sines(sizes, np.array(MODES_HZ), phase_rad=rng.uniform(0, 2 * np.pi, 4)), 0.0, BRIDGE_S, 2.0)
    band = (2.46, 2.56) if excitation == 1 else (1.50, 1.62)
    crowd = tuple(Pulse(-1.2e-3, t, 5.0) for t in (15.0, 33.0))
    return Window(Sum((random_motion(band, 0.6e-3, rng=rng, lines=12), *crowd)), 0.0, BRIDGE_S, 2.0)


def bridge(effort: Effort) -> Measured:
    """Figures 26 and 27: three excitations, every N-th frame of 29.97 a second."""
    every = (1, 6, 10, 12, 30) if effort.quick else (1, 3, 6, 9, 10, 12, 15, 20, 30, 45, 60)
    found = {
        (n, k): errors_mm(recorded(bridge_motion(k, effort.seed), BRIDGE_S, CAMERA_HZ / n, BRIDGE, effort.seed), FIRS)
        for n in every
        for k in (1, 2, 3)
    }
    values: dict[str, Any] = {f"{name} at 3 frames/s": [found[10, k][name] for k in (1, 2, 3)] for name in FIRS}
    values |= {f"{name}, excitation 2": found[10, 2][name] for name in FIRS}
    values["reduction"] = [100 * (1 - found[10, k]["proposed"] / found[10, k]["existing"]) for k in (1, 2, 3)]
    values["largest reduction"] = max(values["reduction"])
    for name in FIRS:
        course = np.array([found[n, 3][name] for n in every])
        values[f"{name}, largest over least"] = course.max() / course.min()
        values[f"{name}, N 1 to 6"] = max(course[[n <= 6 for n in every]])
        values[f"{name}, N from 12 on"] = min(course[[n >= 12 for n in every]])
        values[f"{name}, N = 30"] = found[30, 3][name]
    curve = Curve(
        "Fig. 27 (c)",
        "N",
        "RMSE (mm)",
        {name: (np.array(every, float), np.array([found[n, 3][name] for n in every])) for name in FIRS},
        log=True,
        dots=True,
    )
    return Measured(values, (curve,))


def bridge_spectrum(effort: Effort) -> Measured:
    """Figure 28: excitation 3 at one frame a second; amplitudes at the modes and at their aliases."""
    record = recorded(bridge_motion(3, effort.seed), BRIDGE_S, CAMERA_HZ / 30, BRIDGE, effort.seed)
    found = record.run(FIRS)
    inner = slice(600, -600)
    aliased = sorted({round(alias_hz(f, CAMERA_HZ / 30), 3) for f in MODES_HZ})[1:]
    values: dict[str, Any] = {}
    for name, (error, _) in found.items():
        whole = 1e3 * record.truth_m[inner] + error[inner]
        values[f"{name} at the modes"] = _tones(1e3 * record.truth_m[inner] - whole, MODES_HZ)
        values[f"{name} at the aliases"] = max(_tones(error[inner], aliased))
    values["modes"] = _tones(1e3 * record.truth_m[inner], MODES_HZ)
    return Measured(values)


def _tones(values: Floats, frequencies_hz: Sequence[float]) -> list[float]:
    """Amplitudes of several tones at once, by least squares with a constant and a slope."""
    at_s = np.arange(len(values)) / RATE_HZ
    angle = 2 * np.pi * np.multiply.outer(at_s, np.asarray(frequencies_hz))
    columns = np.column_stack((np.cos(angle), np.sin(angle), np.ones(len(values)), at_s))
    found = np.linalg.lstsq(columns, values, rcond=None)[0]
    count = len(frequencies_hz)
    return [float(value) for value in np.hypot(found[:count], found[count : 2 * count])]
