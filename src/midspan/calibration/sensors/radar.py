"""The radar's part of a calibration: which fixed targets are used, their conversion factors, one clock offset."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from midspan.errors import UsageError
from midspan.radar.target import Target
from midspan.records import Floats, Source, TimeOffset


@dataclass(frozen=True, slots=True)
class RadarDiagnostics:
    """What a radar's calibration rests on, for the report; not stored in calibration.json.

    range_m, power_db (bins,): of the mean range profile, dB over the noise of one frame; phasors (n,): of the best
    target in some frames of the window, with what is static; leak: that part.
    """

    range_m: Floats
    power_db: Floats
    phasors: NDArray[np.complex128]
    leak: complex


@dataclass(frozen=True, slots=True)
class RadarTarget:
    """One peak of the range profile as it was judged; used: whether the result rests on it; reason: why not."""

    target: Target
    used: bool = True
    reason: str = ""


@dataclass(frozen=True, slots=True)
class RadarCalibration:
    """Fixed targets, clock offset and noise of a radar.

    targets: all that were found, the used ones first and of these the best one first; offset: of the radar's clock,
    shared by all; variance_factor: estimated variance over what the signal-to-noise ratio says; relative_std: of the
    conversion factors of the used targets together; carrier_hz, channels: of the radar that it was made with; literal:
    target, factor and unwrapping as printed (`papers/printed/radar_phase.py`); name: where there are several radars.
    """

    targets: tuple[RadarTarget, ...]
    offset: TimeOffset
    variance_factor: float
    relative_std: float
    carrier_hz: float
    channels: int
    literal: bool = False
    name: str | None = None
    diagnostics: RadarDiagnostics | None = field(default=None, compare=False, repr=False)

    @property
    def kind(self) -> str:
        """The section that it stands in."""
        return Source.RADAR.word

    @property
    def used(self) -> tuple[Target, ...]:
        """The targets that the result rests on, best first."""
        return tuple(item.target for item in self.targets if item.used)

    @property
    def best(self) -> Target:
        """The target that gives the zero."""
        return self.used[0]

    @property
    def bent_m(self) -> float:
        """Standard deviation, m, of the zero's error that does not average out: by what else is in the best target's
        bin; as printed the least error E, which is all that is known of it.
        """
        return self.best.noise_m if self.literal else self.best.bent_m

    def without_gain(self, gain: float, std: float) -> "RadarCalibration":
        """The same in metres: the factors were estimated from an accelerometer of this gain and relative deviation."""

        def metres(item: RadarTarget) -> RadarTarget:
            return replace(item, target=item.target.without_gain(gain, std))

        targets = tuple(metres(item) for item in self.targets)
        return replace(self, targets=targets, relative_std=math.hypot(self.relative_std, std))


def require_same_way(calibration: RadarCalibration, literal: bool) -> None:
    """UsageError where a calibration as printed would be followed otherwise, or the other way round."""
    if calibration.literal == literal:
        return
    made, asked = (str(value).lower() for value in (calibration.literal, literal))
    raise UsageError(
        f"radar: the calibration was made with fusion.literal = {made}, this estimate has fusion.literal = {asked}; "
        f"both must be the same. Write literal = {asked} under [fusion] of recording.toml and run `midspan calibrate` "
        "again, or leave the calibration out."
    )
