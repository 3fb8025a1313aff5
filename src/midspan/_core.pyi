"""The numeric core; see core/src."""

import numpy as np
from numpy.typing import NDArray

from midspan.records import Floats

__version__: str

def unwrap_aided(phase_rad: Floats, acceleration_step_m: Floats, rad_per_m: float) -> Floats: ...
def local_spline(
    at_s: Floats, knot_s: Floats, value: Floats, longest_s: float, reach_s: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]: ...
def filtered_at(series: Floats, index: NDArray[np.int64], fraction: Floats, wanted: Floats, bend: Floats) -> Floats: ...
