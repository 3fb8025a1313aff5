"""The numeric core; see core/src."""

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats

__version__: str
BIAS_WALK_RATIO: float

def unwrap_aided(phase_rad: Floats, acceleration_step_m: Floats, rad_per_m: float) -> Floats: ...
def local_spline(
    at_s: Floats, knot_s: Floats, value: Floats, longest_s: float, reach_s: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]: ...
def filtered_at(series: Floats, index: NDArray[np.int64], fraction: Floats, wanted: Floats, bend: Floats) -> Floats: ...
def follow_equal_runs(
    value: Floats, before: tuple[float, int, float], forget: float, gentle: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]: ...
def blocked(
    share: Floats, noise_share: float, gain: float, limits: tuple[float, float], clear_frames: int
) -> NDArray[np.bool_]: ...
def whiten(
    pieces: Floats,
    rows: Floats,
    values: Floats,
    density: float,
    slow: tuple[float, float] | None = None,
    longer: Floats | None = None,
) -> tuple[Floats, Floats, Floats, Floats, float]: ...
def integrate(time_s: Floats, value: Floats) -> Floats: ...
def derivative(edges_s: Floats, cubics: Floats, time_s: Floats, order: int) -> Floats: ...

class PhaseFollower:
    def __init__(
        self,
        rad_per_m: float,
        trust: tuple[float, float, float, float],
        start: tuple[float, float, float, float],
    ) -> None: ...
    @property
    def origin(self) -> float: ...
    def push(self, steps: Floats) -> Floats: ...
