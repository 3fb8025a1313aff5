"""The filters of a group's points, from acceleration and a slow displacement to rows, in the core (`core/src/bank`).

Each point has six states: displacement, velocity, bias of the acceleration, slow error of the displacement sensor,
delay of its stamps, relative error of the accelerometer's gain. Nothing is calibrated before. A permanent shift of the
sensor's zero is reported, covered by the band at first and taken for the new zero within some minutes. A slow error
that lasts longer than some seconds does not show: the accelerometer does not tell it from a motion.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from midspan import _core
from midspan.checks import positive, refuse
from midspan.records import Floats, Floats32, GroupRows, Nanoseconds

# Standard deviation of the displacement's slow error where none is stated, in those of its noise.
SLOW_RATIO = 1.0


class BankSensor(IntEnum):
    """Which sensor of a point blocks are of."""

    ACCELERATION = 0
    DISPLACEMENT = 1


class BankCode(IntEnum):
    """What happened to a point.

    LATE: readings came after the rows that they belong to, and are left out. OVERFLOW: too many wait. SHIFTED: the
    displacement sensor's zero has shifted, or the acceleration missed a motion. LOST, TRACKING: its rows are, or are
    not any more. FROZEN: the displacement sensor repeats one value, which is left out from then on.
    """

    LATE = 1
    OVERFLOW = 2
    SHIFTED = 3
    LOST = 4
    TRACKING = 5
    FROZEN = 6


class BankEvent(NamedTuple):
    """What happened to a point (its number in the group), and when."""

    point: int
    time_ns: int
    code: BankCode


@dataclass(frozen=True, slots=True)
class BankSettings:
    """What is known of the sensors of a group before.

    acceleration_std_m_s2: standard deviation of the accelerometer's noise, a sample. displacement_std_m: of the
    displacement sensor's, a measurement; more shows in its innovations. slow_std_m: of its slow error, of which more
    shows where it lasts some seconds only; None: as large as its noise. slow_time_s: correlation time of that.
    delay_std_s: of the delay of its stamps, 0: they are exact. gain_std: of the accelerometer's relative gain error, 0:
    it is exact. bias_walk: density of the bias's random walk, (m/s²)²/s. wait_s: a sensor that is behind is waited for
    so long. coasting_s, lost_s: age of the last accepted measurement from which on rows are coasting and lost; at least
    5 and 10 of its intervals. as_stated: the displacement sensor is as stated, so that no measurement is an outlier and
    its noise is not followed. rounded: rows are rounded to what their standard deviation leaves of them.
    """

    acceleration_std_m_s2: float
    displacement_std_m: float
    slow_std_m: float | None = None
    slow_time_s: float = 30.0
    delay_std_s: float = 0.15
    gain_std: float = 0.03
    bias_walk: float = 1e-8
    wait_s: float = 2.0
    coasting_s: float = 0.5
    lost_s: float = 10.0
    as_stated: bool = False
    rounded: bool = True

    def __post_init__(self) -> None:
        """Refuse what is not positive."""
        positive("acceleration_std_m_s2", self.acceleration_std_m_s2, "m/s²")
        positive("displacement_std_m", self.displacement_std_m, "m")
        positive("slow_time_s", self.slow_time_s, "s")
        if self.slow_std_m is None:
            object.__setattr__(self, "slow_std_m", SLOW_RATIO * self.displacement_std_m)


@dataclass(frozen=True, slots=True)
class BankBlocks:
    """Blocks (m,) of evenly timed readings of one sensor of the points, each of count[j] readings from t0_ns[j] on and
    every dt_ns[j] after; values (sum of count,): those of all, one after another, m/s² or m, not-a-number: missing.
    """

    sensor: BankSensor
    point: NDArray[np.uint32]
    t0_ns: Nanoseconds
    dt_ns: Nanoseconds
    count: NDArray[np.uint32]
    values: Floats | Floats32


class Bank:
    """The filters of the points of a group; a point's rows depend on its own readings alone.

    Readings may come in any order, twice, or not at all: they are put in order while they are waited for. Rows are the
    same however the readings are cut into blocks and calls, as long as they are in time.
    """

    def __init__(self, points: int, settings: BankSettings) -> None:
        if points < 1:
            raise refuse("points", "at least 1", points)
        self._settings = settings
        self._bank = _core.Bank(points, settings)

    @classmethod
    def restored(cls, state: bytes, settings: BankSettings) -> Self:
        """Go on from where `state` was read."""
        bank = cls.__new__(cls)
        bank._settings = settings
        bank._bank = _core.Bank.restored(state, settings)
        return bank

    def __len__(self) -> int:
        """How many points there are."""
        return len(self._bank)

    @property
    def settings(self) -> BankSettings:
        """What was given."""
        return self._settings

    def push(self, blocks: BankBlocks) -> None:
        """Take blocks; what is late, doubled or no number is left out."""
        displacement = blocks.sensor is BankSensor.DISPLACEMENT
        self._bank.push(displacement, blocks.point, blocks.t0_ns, blocks.dt_ns, blocks.count, blocks.values)

    def rows(self, until_ns: int) -> GroupRows:
        """Give the rows that are complete when it is `until_ns`: up to where both sensors reach, and on without one
        that is more than `wait_s` behind.

        Displacements and velocities are multiples of a power of two that is at most 1/256 of their standard deviation;
        that of the displacement is rounded up to seven bits.
        """
        return GroupRows(*self._bank.rows(until_ns))

    def events(self) -> list[BankEvent]:
        """Give what happened since the last call."""
        return [BankEvent(point, time_ns, BankCode(code)) for point, time_ns, code in self._bank.events()]

    def state(self) -> bytes:
        """All that has an effect on what comes later: some 250 bytes a point, and what waits."""
        return self._bank.state()
