"""The record that the FIR methods' gate and their filling of missing frames are tested on."""

import numpy as np
from fusion_oracles import acceleration_block, displacement_block

from midspan.fusion.fir import FirFilter
from midspan.fusion.two_stage import TwoStageFir

METHODS = {"fir": FirFilter, "two-stage-fir": TwoStageFir}
# The faster tone folds: neither the displacement alone nor a spline through the frames beside a missing one knows it.
PARTS = ((8e-3, 0.1), (3e-3, 3.3))


def moving(time, order):
    """Displacement (order 0, m) or acceleration (order 2, m/s²) at the times, s."""
    return sum((-1 if order else 1) * a * (2 * np.pi * f) ** order * np.sin(2 * np.pi * f * time) for a, f in PARTS)


def two_tones(time, met, seed):
    """Both sensors at their times, s: 2 mm/s² with a bias of 5 mm/s², 0.1 mm."""
    rng = np.random.default_rng(seed)
    acceleration = moving(time, 2) + 5e-3 + rng.normal(0, 2e-3, len(time))
    value = moving(met, 0) + rng.normal(0, 1e-4, len(met))
    return acceleration_block(time, acceleration, 4e-8), displacement_block(met, value, 1e-8)
