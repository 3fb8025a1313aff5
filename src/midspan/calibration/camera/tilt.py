"""A camera that tilts moves each target in proportion to its distance: those at different distances contradict it."""

from collections.abc import Sequence
from math import degrees

# Scale factors nearer to each other than this share belong to targets at one distance.
SAME_DISTANCE = 0.1


def tilt_error_m(scales: Sequence[float], kept: int, other: int, apart_m: float) -> float:
    """What a tilt makes of the displacement of a target that is kept, m rms, if it explains how far another is apart.

    scales: of all targets in use, m/px, in proportion to their distances; kept, other: two of them; apart_m: the rms
    of their difference. With displacements d + θ D of targets at the distances D the kept one is wrong by
    apart D / |D - D'|. 0 where a tilt cannot be the cause: both are at one distance, or targets at different distances
    agree.
    """
    distances = [abs(scale) for scale in scales]
    agreeing = [distance for k, distance in enumerate(distances) if k != other]
    if _alike(distances[kept], distances[other]) or not _alike(min(agreeing), max(agreeing)):
        return 0.0
    return apart_m * distances[kept] / abs(distances[kept] - distances[other])


def tilt_text(kept: tuple[str, float], other: tuple[str, float], error_m: float) -> str:
    """What names and scale factors of two such targets say; error_m: see `tilt_error_m`."""
    per = error_m / abs(kept[1])
    (near, near_m), (far, far_m) = sorted(((name, per * abs(scale)) for name, scale in (kept, other)), key=_size)
    return (
        f"Their distances are as 1 to {far_m / near_m:.2g}: either the camera tilts, which makes the displacement of "
        f"{near} wrong by {1e3 * near_m:.2g} mm rms and that of {far} by {1e3 * far_m:.2g} mm, or one of them moves by "
        f"itself. Where it is tilt, use {near} alone with camera.distance_m and with camera.tilt_std_mdeg = "
        f"{1e3 * degrees(near_m):.2g} divided by that distance, which puts it into the band; where one may not stand "
        "still, leave that one out of camera.target, or add a third."
    )


def _size(named: tuple[str, float]) -> float:
    return named[1]


def _alike(one: float, other: float) -> bool:
    return abs(one - other) <= SAME_DISTANCE * max(one, other)
