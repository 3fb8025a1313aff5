"""A sensor that helps others, in a calibration: a velocity, or the camera's tilt or its rate."""

from dataclasses import dataclass

from midspan.records import Quantity, TimeOffset

# What each of them measures.
MEASURES = {
    "velocity": Quantity.VELOCITY,
    "gyroscope": Quantity.TILT_RATE,
    "inclinometer": Quantity.TILT,
    "gravity": Quantity.TILT,
}
# Fewer angles tell no noise, nor a tilt.
MIN_ANGLES = 4


def turns_image(axis: str) -> float:
    """The sign with which a rotation about the other image axis moves the image along one, x right and y down."""
    return 1.0 if axis == "y" else -1.0


@dataclass(frozen=True, slots=True)
class AuxiliaryCalibration:
    """Noise, zero and clock offset of a velocity sensor, a gyroscope or an inclinometer.

    kind: its section. noise_std: per sample, in m/s, rad/s or rad; zero_std: standard deviation of its zero (a
    gyroscope's bias), infinite where that is unknown; zero_walk: density of the zero's random walk, unit²/s. focal_px,
    focal_std_px: focal length by which a rotation moves the image, px/rad, along the axis; 1 ± 0 for a velocity.
    verified: whether the motion shows its sign and scale.
    """

    kind: str
    noise_std: float
    offset: TimeOffset
    zero_std: float
    zero_walk: float = 0.0
    focal_px: float = 1.0
    focal_std_px: float = 0.0
    verified: bool = True

    @property
    def measures(self) -> Quantity:
        """What it measures."""
        return MEASURES[self.kind]
