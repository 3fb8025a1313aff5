"""The memory of a target's motion, which all trackers share, and the record of a frame that does not show it."""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

from midspan.records import NANOSECONDS, Event, PixelTranslation, Prediction, Status

if TYPE_CHECKING:
    from midspan._core import Row

MAX_DISTANCE_PX = 1_000_000
FULL_QUALITY = 100.0  # strength of a quality of 1, so that a minimum number of matches is a minimum percentage too
# By the core's codes: why a target was not looked for in a frame (`PixelTranslation.unseen`), what its row rests on.
UNSEEN, STATUSES = ("", "dark", "frozen"), tuple(Status)
UNPREDICTED_STD_PX = 1.0  # of the place that a target at its last speed reaches by the next frame


@dataclass(frozen=True, slots=True)
class Motion:
    """Last translation (px), its time, the speed (px/s), how many frames the target has been lost since, and whether
    that was because it could not be distinguished from places that look like it: where it was then says nothing of
    where it is.
    """

    x_px: float = 0.0
    y_px: float = 0.0
    time_ns: int | None = None
    speed_x_px_s: float = 0.0
    speed_y_px_s: float = 0.0
    lost_frames: int = 0
    confused: bool = False

    def expected(self, time_ns: int, prediction: Prediction | None) -> tuple[float, float]:
        """Translation (px) to look at first: the predicted one, else as far as before at the last speed."""
        if prediction is not None and math.isfinite(prediction.x_px + prediction.y_px):
            x, y = prediction.x_px, prediction.y_px
        else:
            elapsed_s = 0.0 if self.time_ns is None else (time_ns - self.time_ns) / NANOSECONDS
            x, y = self.x_px + self.speed_x_px_s * elapsed_s, self.y_px + self.speed_y_px_s * elapsed_s
        limit = MAX_DISTANCE_PX
        return min(max(x, -limit), limit), min(max(y, -limit), limit)

    def extrapolated(self, time_ns: int) -> Prediction:
        """The expected translation (px) without a prediction, with its standard deviations (px)."""
        x, y = self.expected(time_ns, None)
        return Prediction(x, y, UNPREDICTED_STD_PX, UNPREDICTED_STD_PX)

    def speed_to(self, time_ns: int, x_px: float, y_px: float) -> tuple[float, float]:
        """Speed (px/s) of a target that is now here; 0 where that is not known."""
        if self.time_ns is None or self.lost_frames > 0 or time_ns <= self.time_ns:
            return 0.0, 0.0
        elapsed_s = (time_ns - self.time_ns) / NANOSECONDS
        return (x_px - self.x_px) / elapsed_s, (y_px - self.y_px) / elapsed_s

    def seen(self, time_ns: int, translation: tuple[float, float], **more: Any) -> Self:
        """After a frame that shows the target; the speed is only known between two frames that both do."""
        x, y = translation
        speed = self.speed_to(time_ns, x, y)
        return replace(
            self,
            x_px=x,
            y_px=y,
            time_ns=time_ns,
            speed_x_px_s=speed[0],
            speed_y_px_s=speed[1],
            lost_frames=0,
            confused=False,
            **more,
        )

    def missed(self, *, confused: bool = False) -> Self:
        """After a frame that does not show the target, or in which it cannot be distinguished from places that look
        like it."""
        return replace(
            self,
            speed_x_px_s=0.0,
            speed_y_px_s=0.0,
            lost_frames=self.lost_frames + 1,
            confused=self.confused or confused,
        )


def lost(time_ns: int, events: tuple[Event, ...] = ()) -> PixelTranslation:
    """What a frame gives that does not show the target: NaN, LOST; `events`: what happened in it."""
    nan = math.nan
    return PixelTranslation(time_ns, nan, nan, nan, nan, 0.0, Status.LOST, events=events)


def translation_of(row: "Row", events: tuple[Event, ...] = ()) -> PixelTranslation:
    """The translation of a row of the core; `events`: what happened in the frame."""
    return PixelTranslation(*row[:6], STATUSES[row[6]], *row[8:11], events, UNSEEN[row[11]], *row[7])
