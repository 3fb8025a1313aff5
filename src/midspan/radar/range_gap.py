"""Which cycle the phase came back on after an outage, shown by the range itself while the frames come in.

The beat frequency tells the range without ambiguity, to some cycles of the phase a frame. Range less phase is constant
while no cycle is lost; compared before and after an outage it tells how many were. What else lies in the bin pulls the
range to and fro as the phase turns, and does not average out where the phase rests.
"""

import cmath
import math
from dataclasses import dataclass

# Frames that the mean looks back over, and the fewest that tell anything.
MEMORY_FRAMES, MIN_FRAMES = 1000, 24
# A cycle is accepted when the difference is near a whole number of cycles and this many standard deviations from where
# the next one begins.
SURE_STD, NEAR_WHOLE = 4.0, 0.25
# How much faster than the target's phase that of clutter may turn against it: half as much for what moves half as much
# as the target, one for what is static, more for what moves the other way.
SLOPES = (0.5, 1.0, 1.7)
# A target's speed at its first frames, of which this many are needed, is accepted from this standard deviation on,
# cycles a frame, and after this many frames in any case.
MIN_FIRST_FRAMES, SURE_SPEED_CYCLES, MAX_FIRST_FRAMES = 10, 0.12, 64
# What moves the range slowly without the phase is averaged as by this many independent parts.
PARTS = 8


@dataclass(frozen=True, slots=True)
class RangeGap:
    """Range by the beat frequency less range by the phase, in cycles: its running mean over `count` frames.

    square: mean square about the mean; step: mean square from frame to frame; last: of the last frame; turns: mean of
    the unit vectors that turn by `SLOPES` times the phase, 0 where it lies evenly.
    """

    mean: float = math.nan
    count: int = 0
    square: float = 0.0
    step: float = 0.0
    last: float = 0.0
    turns: tuple[complex, ...] = (0j, 0j, 0j)

    def met(self, cycles: float, phase_rad: float) -> "RangeGap":
        """With one frame more: its gap in cycles, at an unwrapped phase."""
        turns = [cmath.rect(1.0, slope * phase_rad) for slope in SLOPES]
        if self.count == 0:
            return RangeGap(cycles, 1, 0.0, 0.0, cycles, tuple(turns))
        count = min(self.count + 1, MEMORY_FRAMES)
        away, share = cycles - self.mean, 1.0 / count
        mean = self.mean + share * away
        return RangeGap(
            mean,
            count,
            self.square + share * (away * (cycles - mean) - self.square),
            self.step + ((cycles - self.last) ** 2 - self.step) / (count - 1),
            cycles,
            tuple(old + share * (new - old) for old, new in zip(self.turns, turns, strict=True)),
        )

    def shifted(self, cycles: int) -> "RangeGap":
        """The gap once the phase has been raised by whole cycles."""
        return RangeGap(self.mean - cycles, self.count, self.square, self.step, self.last - cycles, self.turns)

    @property
    def std(self) -> float:
        """Standard deviation of the mean in cycles, infinite after too few frames."""
        if self.count < MIN_FRAMES:
            return math.inf
        white = 0.5 * self.step
        uneven = max(abs(turn) for turn in self.turns)
        return math.sqrt(white / self.count + max(self.square - white, 0.0) * (uneven**2 + 1.0 / PARTS))


def cycles_lost(before: RangeGap, after: RangeGap) -> int | None:
    """By how many cycles the phase must be raised after an outage; None while that cannot be reported."""
    std = math.hypot(before.std, after.std)
    if not math.isfinite(std):
        return None
    difference = after.mean - before.mean
    cycles = round(difference)
    rest = abs(difference - cycles)
    return cycles if rest <= NEAR_WHOLE and 0.5 - rest >= SURE_STD * std else None


@dataclass(frozen=True, slots=True)
class FirstFrames:
    """Straight line through the gap of a target's first frames, whose speed is not known yet.

    A speed of one cycle a frame more turns the phase alike; range and phase then run apart by a cycle a frame. Where
    the range is not measured it is known to stay within the usual motion: moved, its standard deviation in cycles; NaN
    where the range is measured. sums: of frame numbers n, gaps g, n², n g and g².
    """

    moved: float = math.nan
    count: int = 0
    sums: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def met(self, cycles: float) -> "FirstFrames":
        """With the gap of one frame more, cycles."""
        n, g = float(self.count), cycles
        new = (n, g, n * n, n * g, g * g)
        sums = tuple(a + b for a, b in zip(self.sums, new, strict=True))
        return FirstFrames(self.moved, self.count + 1, sums)  # type: ignore[arg-type]

    @property
    def cycles_per_frame(self) -> tuple[int, float] | None:
        """Whole cycles a frame by which the speed is to be raised, and the chance that it is not by this many.

        None while more frames are needed.
        """
        slope, std = self._line()
        if std <= SURE_SPEED_CYCLES:
            return round(slope), 0.0
        if self.count < MAX_FIRST_FRAMES or math.isinf(std) or self.moved == self.moved:
            return None
        return (round(slope) if std <= 2.0 * SURE_SPEED_CYCLES else 0), math.erfc(0.5 / (math.sqrt(2.0) * std))

    def _line(self) -> tuple[float, float]:
        """Slope of the gap, cycles a frame, and its standard deviation."""
        measured = self.moved != self.moved
        if self.count < (MIN_FIRST_FRAMES if measured else 2):
            return 0.0, math.inf if measured or self.moved > 0.5 * SURE_SPEED_CYCLES else 0.0
        n, g, nn, ng, gg = (total / self.count for total in self.sums)
        spread = nn - n * n
        slope = (ng - n * g) / spread
        if not measured:
            # The motion is one piece over few frames: at worst a straight line itself, of the same deviation.
            return slope, self.moved / math.sqrt(spread)
        rest = max(gg - g * g - slope * slope * spread, 0.0) / (self.count - 2)
        return slope, math.sqrt(rest / spread)
