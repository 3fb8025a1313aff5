"""A camera that tilts moves each target in proportion to its distance: those at different distances contradict it."""

from math import degrees

# Scale factors nearer to each other than this share belong to targets at one distance.
SAME_DISTANCE = 0.1


def tilt_text(kept: tuple[str, float], other: tuple[str, float], error_m: float, *, decided: bool = False) -> str:
    """What a tilt makes of two targets, by their names and scale factors (m/px), and what to do about it.

    error_m: what it makes of the displacement of the one that is kept, rms. With displacements d + θ D of targets at
    the distances D that is D / |D - D'| of what they are apart. decided: whether the accelerometer excludes all other
    causes.
    """
    per = error_m / abs(kept[1])
    (near, near_m), (far, far_m) = sorted(((name, per * abs(scale)) for name, scale in (kept, other)), key=_size)
    makes = (
        f"which makes the displacement of {near} wrong by {1e3 * near_m:.2g} mm rms and that of {far} by "
        f"{1e3 * far_m:.2g} mm"
    )
    use = (
        f"use {near} alone with camera.distance_m and with camera.tilt_std_mdeg = {1e3 * degrees(near_m):.2g} divided "
        "by that distance, which puts it into the band"
    )
    ratio = f"Their distances are as 1 to {far_m / near_m:.2g}: "
    if decided:
        return (
            f"{ratio}the camera tilts, {makes}, and the accelerometer excludes that one of them moves by itself. Mount "
            f"the camera more stiffly, measure its tilt, or {use}."
        )
    return (
        f"{ratio}either the camera tilts, {makes}, or one of them moves by itself. Where it is tilt, {use}; where one "
        "may not stand still, leave that one out of camera.target, or add a third."
    )


def moved_text() -> str:
    """What to do about two targets at one distance that differ."""
    return (
        "One of them moves by itself, as in a slow drift, and neither the accelerometer nor a majority tells which. "
        "Leave out of camera.target the one that may not stand still, or add a third."
    )


def _size(named: tuple[str, float]) -> float:
    return named[1]
