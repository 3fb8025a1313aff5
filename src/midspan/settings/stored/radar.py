"""The section of `calibration.json` of a radar, with the peaks of its range profile."""

import dataclasses
import math
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from midspan.calibration.sensors.radar import RadarCalibration, RadarTarget
from midspan.checks import ValueRange, shown
from midspan.radar.following import Background
from midspan.radar.target import Target
from midspan.settings.fields import Carrier, Form, IsNumber, Time, limited
from midspan.settings.stored.sections import (
    FACTOR,
    Complex,
    Factor,
    Number,
    NumberOrInf,
    NumberOrNan,
    NumberOrZero,
    Ratio,
    Std,
    Stored,
    StoredSensor,
    Text,
    Yes,
    null,
    offset_summary,
    offset_words,
)

# Of a range profile, whose transform has fewer places.
Bin = Annotated[float, IsNumber, limited(0.0, 1e6, "bins")]
Decibel = Annotated[float, IsNumber, limited(-300.0, 300.0, "dB")]
# What a radar's target in use must have, either sign of its factor; its coherence is 1 but for rounding.
USED = {"amplitude": ValueRange(1e-30, 1e30), "conversion_factor": FACTOR, "coherence": ValueRange(0.01, 1.001)}


def _complex(pairs: tuple[tuple[float, float], ...]) -> NDArray[np.complex128]:
    return np.array([complex(*pair) for pair in pairs])


class StoredBackground(Stored):
    """What is static in each bin that a radar's target moves through."""

    bins: Annotated[tuple[Bin, ...], Field(min_length=1)]
    phasors: Annotated[tuple[Complex, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _has_pairs(self) -> "StoredBackground":
        if len(self.bins) != len(self.phasors):
            raise ValueError(f"must have as many phasors as bins; received {len(self.phasors)} and {len(self.bins)}")
        return self


class StoredRadarTarget(Stored):
    """One peak of the range profile."""

    fields: ClassVar = {"noise_std_mm": "noise_m", "own_std_mm": "own_m"}
    place_bin: Bin = Field(description="fractional range bin")
    range_m: NumberOrNan = Field(math.nan, description="range; null: not known")
    snr_db: Annotated[Decibel, null(math.inf)] = Field(
        math.inf, description="signal-to-noise ratio, receivers combined; null: no noise"
    )
    amplitude: Number = Field(description="median amplitude, ADC counts")
    conversion_factor: NumberOrNan = Field(
        math.nan, description="displacement per change of range, signed; null: not known"
    )
    conversion_factor_std: Number | None = Field(None, description="its σ")
    time_offset_s: Time | None = Field(None, description="clock offset by this target alone")
    time_offset_std_s: NumberOrInf = Field(math.inf, description="its σ")
    coherence: Number | None = Field(
        None, description="share of the phase's acceleration that the accelerometer explains"
    )
    clutter: NumberOrNan = Field(math.nan, description="amplitude of clutter in its bin, relative to its own")
    disagreement_rad: NumberOrZero = Field(0.0, description="phase of the worst receiver relative to the others")
    noise_std_mm: NumberOrInf = Field(math.inf, description="noise of one frame")
    reach_bins: Annotated[Bin, null(0.0)] = Field(0.0, description="how far it moved")
    modulation_rad: NumberOrNan = Field(math.nan, description="σ of the phase from moving clutter in its bin")
    phase_noise_rad2: NumberOrZero = Field(0.0, description="variance of the phase beyond the receiver's noise")
    own_std_mm: NumberOrZero = Field(0.0, description="σ of the target's own motion")
    own_hz: NumberOrZero = Field(0.0, description="frequency of its own motion; 0: above about 0.3 Hz")
    leak: Complex = Field((0.0, 0.0), description="static clutter of the bin, which is subtracted, [real, imaginary]")
    background: Annotated[StoredBackground | None, Form("section")] = Field(
        None, description="static clutter of each bin, if the target moves from bin to bin"
    )
    weights: Annotated[tuple[Complex, ...], Field(min_length=1)] = Field(
        description="of the receivers, [real, imaginary] each"
    )
    used: Yes = Field(True, description="whether it counts")
    reason: Text = Field("", description="why not")

    @model_validator(mode="after")
    def _can_be_used(self) -> "StoredRadarTarget":
        for key, limits in USED.items() if self.used else ():
            value = getattr(self, key)
            # A factor of either sign.
            size = abs(value) if key == "conversion_factor" else value
            if value is not None and size not in limits:
                raise ValueError(f"{key} of a target in use must be {limits}; received {shown(value)}")
        return self

    def record(self, offset_s: float) -> RadarTarget:
        """The target; what is not known of it is another thing for one that is used than for one that is not.

        offset_s: of the radar's clock.
        """
        std, own_s, coherence = (0.0, offset_s, 1.0) if self.used else (math.inf, math.nan, 0.0)
        unknown = {"conversion_factor_std": std, "time_offset_s": own_s, "coherence": coherence}
        known = {name: value for name, value in self.values(Target).items() if value is not None}
        known |= {"leak": complex(*self.leak), "weights": _complex(self.weights)}
        if self.background is not None:
            bins, phasors = np.array(self.background.bins), _complex(self.background.phasors)
            known["background"] = Background(bins, phasors)
        return RadarTarget(Target(**unknown | known), self.used, self.reason)

    @classmethod
    def tree(cls, record: Target) -> dict[str, Any]:
        """The section of a target."""
        background = {} if record.background is None else {"background": StoredBackground.tree(record.background)}
        return super().tree(record) | background


class StoredRadar(StoredSensor):
    """A radar; its own conversion factor is that of the best target, and counts where somebody has changed it."""

    fields: ClassVar = {"targets": "", "target_range_m": "", "noise_std_mm": ""}
    conversion_factor: Factor = Field(description="of the best target, signed")
    conversion_factor_std: Std = Field(0.0, description="its σ")
    relative_std: Std | None = Field(None, description="relative σ of all used targets' factors together")
    variance_factor: Ratio = Field(1.0, description="estimated variance divided by the stated one")
    carrier_hz: Carrier = Field(description="carrier of the calibrated radar; another one is refused")
    channels: Annotated[int, IsNumber, Field(ge=1, le=4096)] = Field(description="number of its channels")
    literal: Yes = Field(
        False, description="target, factor and unwrapping as printed; a calibration of the other kind is refused"
    )
    # These two inform alone: those of the targets count.
    target_range_m: Any = Field(None, description="range to the best target; null: not known")
    noise_std_mm: Any = Field(
        None, description="noise of one frame of the best target; with literal its smallest error E"
    )
    targets: tuple[StoredRadarTarget, ...]

    @model_validator(mode="after")
    def _has_a_target(self) -> "StoredRadar":
        used = [target for target in self.targets if target.used]
        if not used:
            raise ValueError("targets must hold a target in use")
        if any(len(target.weights) != self.channels for target in used):
            raise ValueError(f"targets must have weights for {self.channels} channels each")
        return self

    def record(self, _kind: str) -> RadarCalibration:
        """The radar; the section's own conversion factor is that of the best target."""
        best, *others = sorted((one.record(self.time_offset_s) for one in self.targets), key=lambda item: not item.used)
        factor = {"conversion_factor": self.conversion_factor, "conversion_factor_std": self.conversion_factor_std}
        target = dataclasses.replace(best.target, **factor)  # type: ignore[arg-type]
        spread = best.target.relative_std if self.relative_std is None else self.relative_std
        more = {"targets": (dataclasses.replace(best, target=target), *others), "relative_std": spread}
        return RadarCalibration(**self.values(RadarCalibration) | more)

    @classmethod
    def tree(cls, record: RadarCalibration) -> dict[str, Any]:
        """The section of a radar; range and noise of the best target inform alone."""
        best = StoredRadarTarget.tree(record.best)
        of_best = {key: best[key] for key in ("conversion_factor", "conversion_factor_std", "noise_std_mm")}
        targets = [
            StoredRadarTarget.tree(one.target) | {"used": one.used, "reason": one.reason} for one in record.targets
        ]
        return super().tree(record) | of_best | {"target_range_m": best["range_m"], "targets": targets}

    @staticmethod
    def summary(radar: RadarCalibration) -> str:
        """Conversion factor, range of the target and clock offset."""
        target = radar.targets[0].target
        value, std = target.conversion_factor, target.conversion_factor_std
        return f"conversion factor {value:.5g} ± {std:.2g}, target {target.place}, {offset_summary(radar.offset)}"

    @staticmethod
    def rows(radar: RadarCalibration) -> list[tuple[str, str]]:
        """The values that the report lists."""
        best = radar.best
        value, std = best.conversion_factor, best.conversion_factor_std
        return [
            ("conversion factor", f"{value:.6g} ± {std:.2g} ({100 * std / abs(value):.2g} %)"),
            ("range", f"{best.range_m:.3f} m" if math.isfinite(best.range_m) else "not known"),
            ("clock offset", offset_words(radar.offset)),
            ("noise", f"{1e3 * best.noise_m:.3g} mm of displacement per frame"),
            ("variance factor", f"{radar.variance_factor:.3g}"),
            ("carrier", f"{radar.carrier_hz / 1e9:.5f} GHz"),
        ]
