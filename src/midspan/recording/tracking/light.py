"""What light takes of a picture whose reference stays the first frame, and how far its shading may move the result.

A bump or a ledge is shaded anew when the light turns: part of that looks as if the target had moved. A tracker with one
reference frame does not see it; the picture does, as it is less and less the reference's. Under light from another
side a picture is a · reference + b · something else, and the shift that is taken for motion goes with b: its variance
with the share of the picture's contrast, squared, that is not the reference's.
"""

from collections import deque

import numpy as np

from midspan.recording.streams.span import shown
from midspan.records import NANOSECONDS, Floats, Frame, Nanoseconds, PixelTranslation, Region, Status

# The picture is looked at so often; the middle one of the last so many looks counts: what passes by is no light.
LOOK_S, LOOKS = 1.0, 5
# The best of the first looks after the reference tells what noise takes, as light may turn already; it scatters by
# this share, and pictures without noise by this much.
USUAL_LOOKS, SCATTER, LEAST_SCATTER = 6, 0.5, 1e-3
# Means of so many pixels a side are compared, in so many blocks a side: what hides less than half of them is no light.
THINNED, BLOCKS, LEAST_BLOCK = 3, 4, 5
# Pixels near the top of 8 bits are cut off: more light changes them without any shading.
CLIPPED = 250.0
# Standard deviation (px) that a picture of which nothing is the reference's any more stands for.
LIGHT_PX = 0.12
# A standard deviation beyond which changed light is told, px.
NOTABLE_PX = 0.05


class LightWatch:
    """Takes a target's frames and tells the variance (px²) that light adds to where it was found."""

    def __init__(self, reference: Frame, region: Region) -> None:
        """`region` of the frame `reference` is what light is compared with."""
        self._region = region
        self._reference = _small(reference, region, 0.0, 0.0)
        self._full = CLIPPED if reference.pixels.dtype == np.uint8 else np.inf
        self._first: list[float] = []
        self._last: deque[float] = deque(maxlen=LOOKS)
        self._due_ns: int | None = None
        self.variance_px2 = 0.0

    def push(self, frame: Frame, found: PixelTranslation) -> float:
        """The variance (px²) along either axis beside what was `found` in `frame`, as the picture shows it."""
        if found.status is not Status.TRACKING or self._reference is None:
            return self.variance_px2
        if self._due_ns is not None and frame.time_ns < self._due_ns:
            return self.variance_px2
        seen = _small(frame, self._region, found.x_px, found.y_px)
        if seen is None:
            return self.variance_px2
        if self._due_ns is not None:
            self._look(unlike(self._reference, seen, self._full))
        self._due_ns = frame.time_ns + round(LOOK_S * NANOSECONDS)
        return self.variance_px2

    def _look(self, share: float) -> None:
        self._last.append(share)
        if len(self._first) < USUAL_LOOKS:
            self._first.append(share)
            return
        usual = (1.0 + SCATTER) * min(self._first) + LEAST_SCATTER
        self.variance_px2 = LIGHT_PX**2 * max(float(np.median(self._last)) - usual, 0.0)


def light_warnings(variance_px2: Floats, time_ns: Nanoseconds) -> list[str]:
    """A sentence where light may have moved a target with a fixed reference: variances (n, 2) px² at stamps (n,)."""
    std_px = np.sqrt(np.max(variance_px2, axis=1, initial=0.0))
    notable = std_px > NOTABLE_PX
    if not notable.any():
        return []
    return [
        f"camera: from {shown(int(time_ns[np.argmax(notable)]))} on light has changed the target beside its reference "
        f"frame; its shading may have moved the result by up to {std_px.max():.2g} px (standard deviation), which the "
        'band holds. Take camera.reference = "key-frames".'
    ]


def unlike(reference: Floats, seen: Floats, full: float = np.inf) -> float:
    """Share (0 to 1) of the contrast, squared, of a picture (rows, columns) that is not the reference's.

    The middle one of the picture's blocks counts, each by its contrast in the reference. Values from `full` on are cut
    off and left out.
    """
    side = int(np.clip(min(reference.shape) // LEAST_BLOCK, 1, BLOCKS))
    shares, weights = [], []
    for strip, other in zip(np.array_split(reference, side), np.array_split(seen, side), strict=True):
        pairs = zip(np.array_split(strip, side, axis=1), np.array_split(other, side, axis=1), strict=True)
        for own, its in pairs:
            clear = np.maximum(own, its) < full
            if not clear.any():
                continue
            a, b = own[clear] - own[clear].mean(), its[clear] - its[clear].mean()
            energy, product = float(np.sum(a * a)), float(np.sum(a * b))
            alike = max(product, 0.0) ** 2 / max(energy * float(np.sum(b * b)), 1e-12)
            shares.append(1.0 - min(alike, 1.0))
            weights.append(energy)
    if not shares:
        return 0.0
    order = np.argsort(shares)
    reached = np.cumsum(np.array(weights)[order])
    return float(np.array(shares)[order][np.searchsorted(reached, 0.5 * reached[-1])])


def _small(frame: Frame, region: Region, x_px: float, y_px: float) -> Floats | None:
    """The target that lies x, y px from its region as means of pixels; None where it leaves the frame."""
    left, top = int(np.floor(x_px)), int(np.floor(y_px))
    across, down = x_px - left, y_px - top
    rows, columns = region.height // THINNED * THINNED, region.width // THINNED * THINNED
    y, x = region.y + top, region.x + left
    if y < 0 or x < 0 or y + rows + 1 > frame.pixels.shape[0] or x + columns + 1 > frame.pixels.shape[1]:
        return None
    cut = np.asarray(frame.pixels[y : y + rows + 1, x : x + columns + 1], dtype=np.float64)
    cut = (1.0 - down) * cut[:-1] + down * cut[1:]
    cut = (1.0 - across) * cut[:, :-1] + across * cut[:, 1:]
    means: Floats = cut.reshape(rows // THINNED, THINNED, columns // THINNED, THINNED).mean(axis=(1, 3))
    return means
