"""What light takes of a picture whose reference stays the first frame, and how far its shading may move the result.

A bump or a ledge is shaded anew when the light turns: part of that looks as if the target had moved. A tracker with one
reference frame does not see it; the picture does, as it is less and less the reference's. Under light from another
side a picture is a · reference + b · something else, and the shift that is taken for motion goes with b: its variance
with the share of the picture's contrast, squared, that is not the reference's.
"""

from dataclasses import dataclass, replace
from statistics import median
from typing import Any

from numpy.typing import NDArray

from midspan import _core
from midspan.records import NANOSECONDS, Frame, PixelTranslation, Region, Status

# The picture is looked at so often; the middle one of the last so many looks counts: what passes by is no light.
LOOK_S, LOOKS = 1.0, 5
# The best of the first looks after the reference tells what noise takes, as light may turn already; it scatters by
# this share, and pictures without noise by this much.
USUAL_LOOKS, SCATTER, LEAST_SCATTER = 6, 0.5, 1e-3
# Standard deviation (px) that a picture of which nothing is the reference's any more stands for.
LIGHT_PX = 0.12
# A standard deviation beyond which changed light is reported, px.
NOTABLE_PX = 0.05


def is_dark(pixels: NDArray[Any], step: int = 1) -> bool:
    """Whether an integer frame (rows, columns) is black: neither its mean nor its brightest pixels leave the bottom.

    One in `step` rows and columns is looked at. Cameras put 10 or 12 bits into files of 16, so full scale is not known;
    a dark frame also has no contrast. Black is 0, or in video of limited range 16 of 255.
    """
    return _core.is_dark(pixels, step)


@dataclass(frozen=True, slots=True)
class LightState:
    """What a `LightWatch` remembers: the shares of the first and of the last looks, when the next one is due, the
    variance (px²); the largest one so far, and the stamp of the first that is worth reporting.
    """

    first: tuple[float, ...] = ()
    last: tuple[float, ...] = ()
    due_ns: int | None = None
    variance_px2: float = 0.0
    largest_px2: float = 0.0
    notable_ns: int | None = None

    def looked(self, share: float, time_ns: int) -> "LightState":
        """After a look that found this `share` of the picture not the reference's."""
        last = (*self.last[-LOOKS + 1 :], share)
        if len(self.first) < USUAL_LOOKS:
            return replace(self, first=(*self.first, share), last=last)
        usual = (1.0 + SCATTER) * min(self.first) + LEAST_SCATTER
        variance = LIGHT_PX**2 * max(median(last) - usual, 0.0)
        notable = self.notable_ns
        if notable is None and variance > NOTABLE_PX**2:
            notable = time_ns
        return replace(
            self,
            last=last,
            variance_px2=variance,
            largest_px2=max(self.largest_px2, variance),
            notable_ns=notable,
        )


class LightWatch:
    """Takes a target's frames and tells the variance (px²) that light adds to where it was found."""

    def __init__(self, reference: Frame, region: Region) -> None:
        """`region` of the frame `reference` is what light is compared with."""
        place = (region.x, region.y, region.width, region.height)
        self._reference = _core.LightReference(reference.pixels, place)
        self.state = LightState()

    def restore(self, state: LightState) -> None:
        """Continue from a `state` taken earlier."""
        self.state = state

    def push(self, frame: Frame, found: PixelTranslation) -> float:
        """The variance (px²) along either axis beside what was `found` in `frame`, as the picture shows it."""
        due_ns = self.state.due_ns
        if found.status is Status.TRACKING and (due_ns is None or frame.time_ns >= due_ns):
            share = self._reference.unlike(frame.pixels, found.x_px, found.y_px)
            if share is not None:
                if due_ns is not None:
                    self.state = self.state.looked(share, frame.time_ns)
                self.state = replace(self.state, due_ns=frame.time_ns + round(LOOK_S * NANOSECONDS))
        return self.state.variance_px2
