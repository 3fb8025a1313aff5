"""The kinds of recording: a family, what is done to it, whether it breaks the model, which words name the cause."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.honest import displacement, frames
from benchmarks.honest.lines import Lines
from midspan.records import Floats

RADAR_FACTORS = (1.0, 1.8)


@dataclass(frozen=True)
class Truth:
    """What is true of a recording: the motion (m), the instant of its zero, scale and offset (NaN: not compared).

    wander_mm: standard deviation of what a slow error of the sensor adds in 10 s.
    """

    motion: Lines
    zero_s: float
    scale: float
    offset_s: float
    drift_mm: float = 0.0

    def displacement_mm(self, time_s: Floats) -> Floats:
        """True displacement (n,) from the zero."""
        zero = 0.0 if np.isnan(self.zero_s) else self.motion.at(np.array([self.zero_s]))[0]
        return np.asarray(1e3 * (self.motion.at(time_s) - zero))


@dataclass(frozen=True)
class Kind:
    """A kind of recording.

    count: recordings of a full run; make: writes one into a folder; cause: pattern of the messages that name what is
    wrong, None where nothing is.
    """

    family: str
    name: str
    count: int
    make: Callable[[np.random.Generator, Path], Truth]
    cause: str | None = None

    @property
    def label(self) -> str:
        """Family and name."""
        return f"{self.family}-{self.name}"

    def write(self, seed: int, folder: Path) -> Truth:
        """Write the recording of a seed."""
        return self.make(np.random.default_rng([seed, zlib.crc32(self.label.encode())]), folder)


def _slow(change: displacement.Change, rng: np.random.Generator, folder: Path) -> Truth:
    made = displacement.scene(rng)
    change(made)
    displacement.write(made, folder)
    # Tilt and low-pass give each frequency another gain: there is no one true value.
    no_scale = change in (displacement.tilt, displacement.logger)
    offset = made.offset_s if made.keys else np.nan
    return Truth(made.motion, np.nan, np.nan if no_scale else made.gain, offset, 1e3 * made.drift_m)


def _picture(
    change: frames.Change, write: Callable[[frames.View, Path], None], rng: np.random.Generator, folder: Path
) -> Truth:
    made = frames.view(rng, frames_hz=float(rng.choice([8.0, 10.0, 15.0])))
    change(made)
    write(made, folder)
    # A low-pass delays each frequency by another time: there is no one true offset.
    offset = np.nan if change is frames.logger else made.offset_s
    return Truth(made.motion, float(made.true_s[0]), 1e3 * made.scale, offset)


def _range(change: frames.Change, rng: np.random.Generator, folder: Path) -> Truth:
    made = frames.view(rng, frames_hz=50.0)
    made.scale = float(rng.uniform(*RADAR_FACTORS))
    change(made)
    frames.write_radar(made, folder)
    return Truth(made.motion, float(made.true_s[0]), made.scale, made.offset_s)


def _displacements(changes: dict[displacement.Change, str | None], count: int) -> tuple[Kind, ...]:
    return tuple(
        Kind("displacement", change.__name__, count, partial(_slow, change), cause) for change, cause in changes.items()
    )


def _camera(change: frames.Change, count: int, cause: str | None = None) -> Kind:
    return Kind("camera", change.__name__, count, partial(_picture, change, frames.write_camera), cause)


def _infrared(change: frames.Change, count: int, cause: str | None = None) -> Kind:
    return Kind("infrared", change.__name__, count, partial(_picture, change, frames.write_infrared), cause)


def _radar(change: frames.Change, count: int, cause: str | None = None) -> Kind:
    return Kind("radar", change.__name__, count, partial(_range, change), cause)


AXIS = "axis|align|direction|cross|turned"
TILT = "tilt|gravity|lean"
LOGGER = "low-pass|filter|logger|delay|clock"
KINDS: tuple[Kind, ...] = (
    *_displacements(dict.fromkeys(displacement.OBEYING, None), 15),
    *_displacements(
        {
            displacement.gain: "gain|sensitivity|scale|factor",
            displacement.axis: AXIS,
            displacement.colour: "slow error|correlat|colou?r|drift",
            displacement.step: "step|jump|shift|level",
            displacement.rain: "noise|outlier|reject",
            displacement.outliers: "noise|outlier|reject",
            displacement.rtk: "jump|float|outlier",
            displacement.exposure: "exposure|averag",
            displacement.logger: LOGGER,
            displacement.tilt: TILT,
            displacement.flicker: "noise|drift",
        },
        12,
    ),
    _camera(frames.plain, 15),
    _camera(frames.exposure, 8, "exposure|averag"),
    _camera(frames.bracket, 8, "bracket|mount|vibrat|shak|stiff"),
    _camera(frames.tilt, 8, TILT),
    _camera(frames.axis, 8, AXIS),
    _camera(frames.logger, 8, LOGGER),
    _radar(frames.plain, 8),
    _radar(frames.tilt, 4, TILT),
    _radar(frames.own, 4, "own|target|on its own"),
    _infrared(frames.plain, 8),
    _infrared(frames.pattern, 8, "pattern"),
)
