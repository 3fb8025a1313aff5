"""The conversion factor as geometry has it: what techniques without an accelerometer take, and what simulations know.

Z. Ma, J. Choi, L. Yang, H. Sohn, "Structural displacement estimation using accelerometer and FMCW millimeter wave
radar", Mechanical Systems and Signal Processing 182 (2023) 109582, doi 10.1016/j.ymssp.2022.109582, equations 9 and 11.
"""

import math

from midspan.checks import refuse


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
