"""Temperatures made ready for a tracker, frame by frame: no shutter, no fixed pattern, nothing that is not the target.

Nothing is rounded to grey levels: the tracker gets float temperatures, so that no range has to be chosen.
"""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from midspan.checks import refuse
from midspan.errors import DataError
from midspan.records import NANOSECONDS, Event, Floats, Frame, PixelTranslation, Region, Status
from midspan.thermal.limits import LimitFollower, Limits, LimitState, is_foreign, reflected
from midspan.thermal.pattern import FixedPattern, estimate_pattern
from midspan.thermal.shutter import ShutterState, ShutterWatch

PATTERN_FRAMES = 24  # that the fixed pattern is learned from
AROUND_PX = 16  # of the target, where the pattern is learned as well
PATTERN_EVERY_S = 0.05  # least time between two frames that are learned from


@dataclass(frozen=True, slots=True)
class Cleaned:
    """What comes of a frame: the one to track, None while the shutter is closed, what is worth reporting, and the share
    of the target that something of another temperature covers.
    """

    frame: Frame | None
    events: tuple[Event, ...] = ()
    foreign: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class CleaningState:
    """What is remembered: of shutter and limits, the pattern in use, the frames kept to learn it from with their
    translations (px), when the last of them was taken, and how many there were; whether the shutter was closed.
    """

    shutter: ShutterState
    limits: LimitState
    pattern: FixedPattern | None
    kept: tuple[tuple[NDArray[np.float32], float, float], ...]
    kept_ns: int
    tries: int
    closed: bool


class ThermalCleaner:
    """Makes frames in °C ready for a tracker of one region; `tracked` tells it what the tracker found in each."""

    def __init__(self, reference: Frame, region: Region) -> None:
        """`reference`: the first frame (rows, columns) in °C; `region`: the target's in it, px."""
        rows, columns = reference.pixels.shape
        if not region.inside(columns, rows):
            raise refuse("region", f"inside the image of {columns}x{rows} px", region)
        self._shape, self._region = (rows, columns), region
        self._watch = ShutterWatch()
        self._follower = LimitFollower(reference.pixels[region.slices], reference.time_ns)
        self._pattern: FixedPattern | None = None
        self._kept: deque[tuple[NDArray[np.float32], float, float]] = deque(maxlen=PATTERN_FRAMES)
        self._last: Frame | None = None
        self._kept_ns = -(1 << 62)
        self._tries, self._closed = 0, False

    @property
    def limits(self) -> Limits:
        """The target's temperatures of the moment, °C."""
        return self._follower.limits

    @property
    def pattern(self) -> FixedPattern | None:
        """The fixed pattern in use, None while it is not known."""
        return self._pattern if self._pattern is not None and self._pattern.known else None

    @property
    def last_pattern(self) -> FixedPattern | None:
        """The one in use, or what was tried in vain; None before the first try."""
        return self._pattern

    def use(self, pattern: FixedPattern) -> None:
        """Take this pattern out of the frames from now on."""
        self._pattern = pattern

    @property
    def state(self) -> CleaningState:
        """Everything that changes from frame to frame, between `tracked` and the next `push`."""
        watched = (self._watch.state, self._follower.state, self._pattern, tuple(self._kept))
        return CleaningState(*watched, self._kept_ns, self._tries, self._closed)

    def restore(self, state: CleaningState) -> None:
        """Continue from a `state` taken earlier, with the same reference frame and region."""
        self._watch.restore(state.shutter)
        self._follower.restore(state.limits)
        self._pattern, self._kept_ns = state.pattern, state.kept_ns
        self._tries, self._closed = state.tries, state.closed
        self._kept = deque(state.kept, maxlen=self._kept.maxlen)
        self._last = None

    def push(self, frame: Frame, region_now: Region | None = None) -> Cleaned:
        """The frame as it should be tracked; `region_now`: where the target was last seen, px.

        Frames come in the order of their times. Raises DataError when a frame has another size than the first.
        """
        if frame.pixels.shape != self._shape:
            raise DataError(
                f"All frames must have the size of the first, {self._shape[::-1]} px; frame {frame.index} has "
                f"{frame.pixels.shape[::-1]} px. Split the sequence where the camera's format changed."
            )
        verdict = self._watch.push(frame)
        self._last = None
        if not verdict.usable:
            return Cleaned(None, verdict.events)
        if verdict.step_k:
            self._follower.jump(verdict.step_k)
        if verdict.reopened:
            self._pattern, self._tries, self._closed = None, 0, True
            self._kept.clear()
        target = frame.pixels[(region_now or self._region).slices]
        limits = self._follower.push(target, frame.time_ns)
        self._last = frame
        pixels = frame.pixels if self.pattern is None else self.pattern.removed(frame.pixels)
        clean = Frame(frame.time_ns, reflected(pixels, limits), frame.index)
        return Cleaned(clean, verdict.events, float(np.mean(is_foreign(target, limits))))

    def tracked(self, found: PixelTranslation) -> bool:
        """Learn the fixed pattern from what the tracker found in the frame that was pushed last.

        Returns whether it is known from now on, and is that of the reference frame: no shutter has closed since.
        """
        frame = self._last
        if frame is None or found.status is not Status.TRACKING or self.pattern is not None:
            return False
        if frame.time_ns - self._kept_ns < PATTERN_EVERY_S * NANOSECONDS:
            return False
        self._kept_ns = frame.time_ns
        self._kept.append((np.asarray(frame.pixels, dtype=np.float32), found.x_px, found.y_px))
        self._tries += 1
        # Where the scene has not moved enough, another try comes when all frames are others.
        if len(self._kept) == PATTERN_FRAMES and self._tries % PATTERN_FRAMES == 0:
            self._pattern = self._estimate()
        return self.pattern is not None and not self._closed

    def _estimate(self) -> FixedPattern:
        """The pattern of the frames kept, on the target as these show it and around it; 0 elsewhere."""
        moved: Floats = np.array([(x, y) for _, x, y in self._kept])
        middle = np.round(moved.mean(axis=0))
        whole = np.stack([pixels for pixels, _, _ in self._kept])
        # What stands there in most frames; what only passes by is weighed down as noise.
        place = _around(self._region, middle, np.mean(is_foreign(whole, self.limits), axis=0) > 0.5)
        stack = whole[:, place[0], place[1]].astype(np.float64)
        found = estimate_pattern(reflected(stack, self.limits, 1.0).astype(np.float64), moved - middle)
        values = np.zeros(self._shape)
        values[place] = found.values_k
        return replace(found, values_k=values)


def _around(region: Region, moved_px: Floats, foreign: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Rows and columns of a moved region with up to AROUND_PX about it, inside a picture, as far as nothing foreign
    (rows, columns) lies there: a static warm body next to the target would count as a pattern that is many
    times the target's contrast, and lead the translations astray with it.
    """
    right, down = (int(px) for px in moved_px)
    top, left = max(region.y + down, 0), max(region.x + right, 0)
    bottom = min(region.y + down + region.height, foreign.shape[0])
    end = min(region.x + right + region.width, foreign.shape[1])
    columns = np.any(foreign[top:bottom], axis=0)
    left, end = left - _clear(columns[:left][::-1]), end + _clear(columns[end:])
    rows = np.any(foreign[:, left:end], axis=1)
    return slice(top - _clear(rows[:top][::-1]), bottom + _clear(rows[bottom:])), slice(left, end)


def _clear(foreign: NDArray[np.bool_]) -> int:
    """How many lines, from the target outwards, hold nothing foreign (n,), AROUND_PX at most."""
    near = foreign[:AROUND_PX]
    return int(np.argmax(near)) if near.any() else len(near)
