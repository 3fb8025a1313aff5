"""The least error that is possible for known noise levels, in closed form and by the covariance recursion.

With acceleration noise of density S_a and a displacement sampled at rate F with variance R, S_d = R/F, both levels meet
at the corner w = (S_a/S_d)^(1/4). The stationary optimum of the double integrator then has the variance

    causal:      sqrt(2) · S_d · w           (Kalman filter)
    non-causal:  S_d · w / (2 · sqrt(2))     (smoother: half the standard deviation)

as long as the displacement is sampled much faster than the corner. The recursion has no such limit.
"""

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from midspan.checks import option, positive
from midspan.errors import UsageError
from midspan.fusion.runners import run_method
from midspan.fusion.streams import NO_ERRORS, KalmanSettings, MethodSettings
from midspan.recording.result import Result
from midspan.records import Acceleration, Displacement, Floats, Nanoseconds, Source, nanoseconds
from midspan.simulate.files.folder import MARK
from midspan.simulate.scenarios.table import pixel_bound

# The bound's segment is left to settle by this many periods of the corner before it is called stationary.
SETTLING_CORNERS = 30.0
# Methods that are optimal for known noise, so that the recursion of their covariance is the bound.
CLOSED, OPTIMAL = ("smoother", "kalman"), ("smoother", "kalman", "lag")


@dataclass(frozen=True, slots=True)
class KnownNoise:
    """Noise of one sample of each sensor, and their rates: m/s², Hz, m, Hz; all above 0."""

    acceleration_std_m_s2: float
    acceleration_rate_hz: float
    displacement_std_m: float
    displacement_rate_hz: float

    def __post_init__(self) -> None:
        for name in self.__slots__:
            positive(name, getattr(self, name))

    @property
    def acceleration_density(self) -> float:
        """Two-sided density S_a of the acceleration's noise, (m/s²)²/Hz."""
        return self.acceleration_std_m_s2**2 / self.acceleration_rate_hz

    @property
    def displacement_density(self) -> float:
        """Two-sided density S_d of the displacement's noise, m²/Hz."""
        return self.displacement_std_m**2 / self.displacement_rate_hz

    @property
    def corner_rad_s(self) -> float:
        """Where the displacement's noise and the twice integrated acceleration's meet, rad/s."""
        return float((self.acceleration_density / self.displacement_density) ** 0.25)


def closed_bound(noise: KnownNoise, method: str = "smoother") -> float:
    """Least standard deviation (m) of `method` ("smoother" or "kalman") in closed form; bias known, no gaps."""
    option("method", method, CLOSED)
    factor = np.sqrt(2.0) if method == "kalman" else 1.0 / (2.0 * np.sqrt(2.0))
    return float(np.sqrt(factor * noise.displacement_density * noise.corner_rad_s))


def exact_bound(noise: KnownNoise, method: str = "smoother", *, lag_s: float = 0.5) -> float:
    """Least standard deviation (m) in the middle of a long record, from the covariance recursion; bias known.

    method: "smoother", "kalman" or "lag", the last with `lag_s` seconds.
    """
    length_s = max(2.0 * SETTLING_CORNERS / noise.corner_rad_s, 60.0 / noise.displacement_rate_hz)
    settings = KalmanSettings(bias_walk=0.0, bias_std=1e-12)
    variance = variance_rows(*still(noise, length_s), method, settings, lag_s=lag_s)
    n = len(variance)
    return float(np.sqrt(np.mean(variance[2 * n // 5 : 3 * n // 5])))


def still(noise: KnownNoise, length_s: float) -> tuple[Acceleration, Displacement]:
    """Both sensors at rest for `length_s` with regular samples and these noise levels, in numbers but not in values."""
    time_ns = _grid(length_s, noise.acceleration_rate_hz)
    met_ns = _grid(length_s, noise.displacement_rate_hz)
    acceleration = Acceleration(time_ns, np.zeros(len(time_ns)), np.full(len(time_ns), noise.acceleration_density))
    source = np.full(len(met_ns), Source.DISPLACEMENT, dtype=np.uint8)
    variance = np.full(len(met_ns), noise.displacement_std_m**2)
    return acceleration, Displacement(met_ns, np.zeros(len(met_ns)), variance, source)


def _grid(length_s: float, rate_hz: float) -> Nanoseconds:
    return nanoseconds(np.arange(int(length_s * rate_hz) + 1) / rate_hz)


def variance_rows(
    acceleration: Acceleration,
    displacement: Displacement,
    method: str,
    settings: KalmanSettings | None = None,
    *,
    lag_s: float = 0.5,
) -> Floats:
    """Least variance (n,) in m² at each of the n samples, for the stamps, densities and variances of these blocks.

    Infinite before the first measurement. The values do not matter: the recursion is run on zeros, with the noise as
    declared. A measurement whose value or variance is not finite stays unused. settings: what is known of bias and
    start; left out: the filter's own.
    """
    option("method", method, OPTIMAL)
    usable = np.isfinite(displacement.value_m)
    zero = replace(displacement, value_m=np.where(usable, 0.0, np.nan))
    quiet = replace(acceleration, value_m_s2=np.zeros(len(acceleration.time_ns)))
    settings = replace(settings or KalmanSettings(), bias=0.0, rates=NO_ERRORS, noise_memory=np.inf)
    rows = run_method(method, quiet, zero, MethodSettings(kalman=settings, lag_s=lag_s)).estimate
    variance = np.full(len(acceleration.time_ns), np.inf)
    variance[np.searchsorted(acceleration.time_ns, rows.time_ns)] = rows.variance_m2
    return variance


def zeroed_bound(
    acceleration: Acceleration,
    displacement: Displacement,
    method: str = "smoother",
    settings: KalmanSettings | None = None,
) -> float:
    """Least rms error (m) of a result that is counted from the first measurement's instant, as with a camera.

    The zero itself is only known as well as the smoother knows the displacement there, and its error goes into every
    row: sqrt(mean variance + variance at the zero). Rows from the first to the last measurement count.
    """
    usable = np.flatnonzero(np.isfinite(displacement.value_m) & np.isfinite(displacement.variance_m2))
    first, last = (
        int(np.clip(np.searchsorted(acceleration.time_ns, displacement.time_ns[i]), 0, len(acceleration.time_ns) - 1))
        for i in (usable[0], usable[-1])
    )
    variance = variance_rows(acceleration, displacement, method, settings)
    smoothed = variance if method == "smoother" else variance_rows(acceleration, displacement, "smoother", settings)
    return float(np.sqrt(np.mean(variance[first : last + 1]) + smoothed[first]))


def least_error_mm(result: Result) -> float:
    """The least rms error (mm) of a camera's result from a simulated recording, its zero at the first frame included.

    From the Cramér-Rao bound of the region, the accelerometer's known noise and the true stamps. Raises UsageError
    where the recording is not simulated or has no camera.
    """
    recording, camera = result.recording, result.calibration.first_camera
    file = None if recording is None else recording.folder / MARK
    track = result.track
    if recording is None or file is None or not file.is_file() or camera is None or track is None:
        raise UsageError("The least error is only known for a simulated recording with a camera (with its known.json).")
    known: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    bounds = pixel_bound(known["scenario"], camera.region, seed=known["seed"])
    std_m = bounds["xy".index(camera.direction)] * abs(known["camera"]["scale_mm_per_px"]) / 1e3
    camera_ns = track.time_ns + round(1e9 * known["camera"]["time_offset_s"])
    prepared = recording.prepared
    density = known["accelerometer"]["noise_std_m_s2"] ** 2 / prepared.rate_hz
    n, m = len(prepared.time_ns), len(camera_ns)
    acceleration = Acceleration(prepared.time_ns, np.zeros(n), np.full(n, density))
    source = np.full(m, Source.CAMERA, dtype=np.uint8)
    return 1e3 * zeroed_bound(acceleration, Displacement(camera_ns, np.zeros(m), np.full(m, std_m**2), source))
