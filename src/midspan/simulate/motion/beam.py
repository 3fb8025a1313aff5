"""A simply supported beam with a force at mid-span, by modal superposition, each mode solved exactly at fine steps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.checks import positive, refuse
from midspan.records import Floats
from midspan.simulate.motion.motion import FineSteps, Motion, Pulse, Sines, Sum, Window

MIN_STEP_RATE_HZ = 2000.0


@dataclass(frozen=True, slots=True)
class Beam:
    """A uniform simply supported beam; the values are those of Ma et al., two-stage FIR filter, section 4.1.

    Length in m, flexural rigidity in N m², mass in kg/m, damping as a fraction of critical, number of modes that move
    mid-span (the odd ones).
    """

    length_m: float = 40.0
    rigidity_n_m2: float = 6.03e10
    mass_kg_m: float = 1.5e3
    damping: float = 0.01
    modes: int = 5

    def frequencies_hz(self) -> Floats:
        """Natural frequencies (modes,) in Hz of the odd modes: n² π / (2 L²) · √(EI / m)."""
        number = 2.0 * np.arange(self.modes) + 1
        root = np.sqrt(self.rigidity_n_m2 / self.mass_kg_m)
        result: Floats = number**2 * np.pi / (2 * self.length_m**2) * root
        return result


def _recurrence(omega: float, damping: float, step_s: float) -> tuple[Floats, Floats, Floats]:
    """Exact transition (2, 2) of x'' + 2ζω x' + ω² x = p, loads (2,) at both ends (doi 10.1109/TAC.1978.1101743)."""
    from scipy.linalg import expm

    system = np.zeros((4, 4))
    system[0, 1] = 1.0
    system[1] = [-(omega**2), -2 * damping * omega, 1.0, 0.0]
    system[2, 3] = 1.0
    whole = expm(system * step_s)
    slope = whole[:2, 3] / step_s
    return whole[:2, :2].copy(), whole[:2, 2] - slope, slope


def respond(beam: Beam, force_n: Floats, *, step_rate_hz: float = 4000.0) -> FineSteps:
    """Motion of mid-span, at rest at the start, under a force (n,) in N there, given at even steps.

    Each mode is solved exactly for a force that is linear between the steps, so acceleration, velocity and displacement
    agree with each other whatever the step. `step_rate_hz` is at least 2000 Hz.
    """
    if positive("step_rate_hz", step_rate_hz, "Hz") < MIN_STEP_RATE_HZ:
        raise refuse("step_rate_hz", f"at least {MIN_STEP_RATE_HZ:g} Hz", step_rate_hz)
    modal_mass = beam.mass_kg_m * beam.length_m / 2
    pressure = np.ascontiguousarray(force_n, dtype=np.float64) / modal_mass
    total: NDArray[np.float64] = np.zeros((3, len(pressure)))
    for frequency in beam.frequencies_hz():
        omega = float(2 * np.pi * frequency)
        transition, load_now, load_next = _recurrence(omega, beam.damping, 1 / step_rate_hz)
        states = _core.modal_response(pressure, transition.tolist(), load_now.tolist(), load_next.tolist())
        acceleration = pressure - 2 * beam.damping * omega * states[:, 1] - omega**2 * states[:, 0]
        total += np.stack([states[:, 0], states[:, 1], acceleration])
    return FineSteps(0.0, 1 / step_rate_hz, total[0], total[1], total[2])


def paper_force(rng: np.random.Generator | None = None, *, duration_s: float = 100.0) -> Motion:
    """The force in N of the paper's beam as a function of time: slow bumps and 0.7, 3.1, 8 and 10.3 Hz.

    Ratio 2 : 1 : 0.5 : 0.06 : 0.17 times 1e5 N (read off the paper's spectra: the text gives no amplitudes). It begins
    and ends at rest. `rng` draws the phases; without it they are zero. The `Motion` is used for its value only.
    """
    phase = np.zeros(4) if rng is None else rng.uniform(0, 2 * np.pi, 4)
    tones = Sines(1e5 * np.array([1, 0.5, 0.06, 0.17]), np.array([0.7, 3.1, 8.0, 10.3]), phase_rad=phase)
    # A Gaussian of 6 s has 99.7 % of its spectrum below 0.08 Hz: pseudo-static compared with a first mode of 6 Hz.
    slow = (Pulse(2e5, 0.27 * duration_s, 0.06 * duration_s), Pulse(1.5e5, 0.68 * duration_s, 0.08 * duration_s))
    return Window(Sum((tones, *slow)), 0.0, duration_s, ramp_s=3.0)


def paper_beam_motion(seed: int | None = None, *, duration_s: float = 100.0, step_rate_hz: float = 4000.0) -> FineSteps:
    """The motion of mid-span of the paper's beam over `duration_s` (peak about 8 mm); `seed` draws the phases."""
    rng = None if seed is None else np.random.default_rng(seed)
    time = np.arange(round(duration_s * step_rate_hz) + 1) / step_rate_hz
    force = paper_force(rng, duration_s=duration_s).displacement(time)
    return respond(Beam(), force, step_rate_hz=step_rate_hz)
