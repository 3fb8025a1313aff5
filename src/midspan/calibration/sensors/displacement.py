"""A displacement sensor's part of a calibration: its noise, its clock offset, and its scale where that was learnt."""

from dataclasses import dataclass

from midspan.records import Source, TimeOffset


@dataclass(frozen=True, slots=True)
class DisplacementCalibration:
    """Noise per measurement (m) and clock offset of a displacement sensor, and its scale where that was learnt.

    scale: displacement in one unit read, which is 1 for a sensor of known unit; scale_std: its standard deviation, 0
    where it was not learnt; name: where there are several of these sensors. resolution_m: what its values, scaled, are
    rounded to; None where that is not known.
    """

    noise_std_m: float
    offset: TimeOffset
    scale: float = 1.0
    scale_std: float = 0.0
    name: str | None = None
    resolution_m: float | None = None

    @property
    def kind(self) -> str:
        """The section that it stands in."""
        return Source.DISPLACEMENT.word

    @property
    def relative_std(self) -> float:
        """Relative standard deviation of the scale."""
        return self.scale_std / abs(self.scale)
