"""The radar's part of a calibration: which fixed targets are used, their conversion factors, one clock offset."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.radar.following import Background
from midspan.radar.target import Target
from midspan.recording.stored.json_values import finite_or_none
from midspan.records import Floats, TimeOffset


@dataclass(frozen=True, slots=True)
class RadarDiagnostics:
    """What a radar's calibration rests on, for the report; not stored in calibration.json.

    range_m, power_db (bins,): of the mean range profile, dB over the noise of one frame; frame_s (n,): seconds on the
    radar's clock of thinned frames of the window; phasors, phase_rad (n,): of the best target, what stands still not
    taken out of the phasors; the phase unwrapped. leak: what of the phasors stands still. limit_speed_m_s: from which
    plain unwrapping fails.
    """

    range_m: Floats
    power_db: Floats
    frame_s: Floats
    phasors: NDArray[np.complex128]
    phase_rad: Floats
    leak: complex
    limit_speed_m_s: float


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
    shared by all; variance_factor: learnt variance over what the signal-to-noise ratio says; relative_std: of the
    conversion factors of the used targets together; carrier_hz, channels: of the radar that it was made with; literal:
    target, factor and unwrapping as printed (`recording/radar/literal.py`).
    """

    targets: tuple[RadarTarget, ...]
    offset: TimeOffset
    variance_factor: float
    relative_std: float
    carrier_hz: float
    channels: int
    literal: bool = False
    diagnostics: RadarDiagnostics | None = field(default=None, compare=False, repr=False)

    @property
    def used(self) -> tuple[Target, ...]:
        """The targets that the result rests on, best first."""
        return tuple(item.target for item in self.targets if item.used)

    @property
    def best(self) -> Target:
        """The target that gives the zero."""
        return self.used[0]

    def to_dict(self) -> dict[str, Any]:
        """The section `radar` of calibration.json; complex numbers as [real, imaginary]."""
        best = self.best
        return {
            "conversion_factor": best.conversion_factor,
            "conversion_factor_std": best.conversion_factor_std,
            "relative_std": self.relative_std,
            "target_range_m": finite_or_none(best.range_m),
            "time_offset_s": self.offset.value_s,
            "time_offset_std_s": finite_or_none(math.sqrt(self.offset.variance)),
            "noise_std_mm": 1e3 * best.noise_m,
            "variance_factor": self.variance_factor,
            "carrier_hz": self.carrier_hz,
            "channels": self.channels,
            "literal": self.literal,
            "targets": [_target_dict(item) for item in self.targets],
        }


def _target_dict(item: RadarTarget) -> dict[str, Any]:
    target = item.target
    return {
        "place_bin": target.place_bin,
        "range_m": finite_or_none(target.range_m),
        "snr_db": finite_or_none(target.snr_db),
        "amplitude": target.amplitude,
        "conversion_factor": finite_or_none(target.conversion_factor),
        "conversion_factor_std": finite_or_none(target.conversion_factor_std),
        "time_offset_s": finite_or_none(target.time_offset_s),
        "time_offset_std_s": finite_or_none(target.time_offset_std_s),
        "coherence": target.coherence,
        "clutter": finite_or_none(target.clutter),
        "disagreement_rad": target.disagreement_rad,
        "noise_std_mm": finite_or_none(1e3 * target.noise_m),
        "reach_bins": target.reach_bins,
        "modulation_rad": finite_or_none(target.modulation_rad),
        "phase_noise_rad2": target.phase_noise_rad2,
        "leak": _pair(target.leak),
        **({} if target.background is None else {"background": _background_dict(target.background)}),
        "weights": [_pair(weight) for weight in target.weights],
        "used": item.used,
        "reason": item.reason,
    }


def _background_dict(background: Background) -> dict[str, Any]:
    return {"bins": background.bins.tolist(), "phasors": [_pair(phasor) for phasor in background.phasors]}


def _pair(value: complex) -> list[float]:
    return [float(value.real), float(value.imag)]
