"""A radar's calibrated target, where it is met, and what the radar's stage remembers of it."""

import math
from dataclasses import dataclass, field

import numpy as np

from midspan.radar.following import bins_within
from midspan.radar.range_gap import FirstFrames, RangeGap
from midspan.radar.target import Target
from midspan.records import Floats

# What the first mean square of innovations is expected to be (0.05 cycles), rad².
FIRST_RAD2 = 0.1
# The first frames tell the speed, and are not judged.
FIRST_COUNT = -2.0


@dataclass(frozen=True, slots=True)
class FollowedTarget:
    """A calibrated target and where it is met.

    phase_per_m: rad per m of range; bins (k,): whole bins in which it moves, or the one place (1,) where it stays;
    bin_m: from bin to bin, m (NaN: it stays); period_s: from frame to frame; moved_m: standard deviation of the
    structure's usual displacement, 0 where it is far less than a cycle.
    """

    target: Target
    phase_per_m: float
    bins: Floats
    bin_m: float
    period_s: float
    moved_m: float = 0.0

    @classmethod
    def of(
        cls, target: Target, phase_per_m: float, bin_m: float, *, period_s: float, bins: int, moved_m: float = 0.0
    ) -> "FollowedTarget":
        """In those of a radar's `bins`, `bin_m` apart (NaN: single targets are stored), that are around it."""
        some = bins_within(target.place_bin, target.reach_bins, bins) if bin_m > 0 else np.array([target.place_bin])
        return cls(target, phase_per_m, some, bin_m, period_s, moved_m)


@dataclass(slots=True)
class FollowedState:
    """What a chain remembers of one target.

    first_rad: wrapped phase that counts as zero; zero_rad2: variance of its noise where that frame was hardly
    seen, and of cycles lost among the first frames; first: these, by which the speed is found, None afterwards;
    begun: stamp, phase in rad, variance and strength of each of them;
    phase_rad, speed_rad_s: the target's own prediction at last_ns, the last used frame, less what the acceleration
    alone tells there, while nothing else predicts (alone_rad at alone_ns and its speed alone_rad_s; NaN: nothing);
    own_rad2,
    given_rad2: mean squares of its innovations and of the given predictions'; own_count, given_count: over this many;
    clear: frames in a row that show the target; power: running mean of its power over the calibrated one;
    strength: amplitude over the calibrated one in the last frame, modulated: running mean square of its steps, halved;
    unseen_ns: the first frame since it was seen last, -1 while it is seen;
    reported: whether an event was given for that; refuted: whether the given predictions are wrong; gap: range less
    phase; before: the same before the cycle was lost, while it is in doubt; doubt_rad2: variance of the zero while it
    is in doubt, lost_rad2: for good; astray_ns: when the given prediction last named another cycle than the target's
    own; fallen, forgotten_ns: whether the variance of its own motion is a small one by now, and
    when it fell last.
    """

    clear: int
    power: float = 1.0
    strength: float = math.nan
    modulated: float = 0.0
    first_rad: float = 0.0
    zero_rad2: float = 0.0
    first: FirstFrames | None = field(default_factory=FirstFrames)
    begun: tuple[tuple[int, float, float, float], ...] = ()
    phase_rad: float = 0.0
    speed_rad_s: float = 0.0
    last_ns: int = 0
    alone_rad: float = math.nan
    alone_rad_s: float = 0.0
    alone_ns: int = 0
    own_rad2: float = FIRST_RAD2
    own_count: float = FIRST_COUNT
    given_rad2: float = 0.0
    given_count: float = FIRST_COUNT
    unseen_ns: int = -1
    reported: bool = False
    refuted: bool = False
    gap: RangeGap = field(default_factory=RangeGap)
    before: RangeGap | None = None
    doubt_rad2: float = 0.0
    lost_rad2: float = 0.0
    astray_ns: int = -1
    fallen: bool = True
    forgotten_ns: int = 0
