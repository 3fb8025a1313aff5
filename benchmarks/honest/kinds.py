"""The kinds of recording: a family, what is done to it, whether it breaks the model, which words name the cause."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.honest import camera_outdoors, displacement, displacement_outdoors, frames, radar_outdoors
from benchmarks.honest.lines import Lines
from benchmarks.honest.oscillators import Oscillation
from benchmarks.honest.station import Station
from midspan.records import Floats

RADAR_FACTORS = (1.0, 1.8)


@dataclass(frozen=True)
class Truth:
    """What is true of a recording: the motion (m), the instant of its zero, scale and offset (NaN: not compared).

    zero_s: NaN where the sensor's own zero is the motion's; drift_mm: standard deviation of what a slow error of the
    sensor adds in 10 s; clock: stamps (m,) of the accelerometer and their true instants (m,), where these differ;
    free_zero: whether the zero is a convention, so that a result is compared without its mean; stretch_s: true times
    whose rows are also judged by themselves; frames_s (n,): instants of a radar's frames, of which the zero is that of
    the first one used: the last one before the first row.
    """

    motion: Lines | Oscillation
    zero_s: float
    scale: float
    offset_s: float
    drift_mm: float = 0.0
    clock: tuple[Floats, Floats] | None = None
    free_zero: bool = False
    stretch_s: tuple[float, float] | None = None
    frames_s: Floats | None = None

    def true_s(self, time_s: Floats) -> Floats:
        """True instants (n,) of times on the accelerometer's clock."""
        return time_s if self.clock is None else np.interp(time_s, *self.clock)

    def displacement_mm(self, time_s: Floats) -> Floats:
        """True displacement (n,) from the zero at times on the accelerometer's clock."""
        true_s, zero_s = self.true_s(time_s), self.zero_s
        if self.frames_s is not None:
            # A clock offset as calibrated is right to a millisecond.
            zero_s = self.frames_s[max(int(np.searchsorted(self.frames_s, true_s[0] + 1e-3)) - 1, 0)]
        zero = 0.0 if np.isnan(zero_s) else self.motion.at(np.array([zero_s]))[0]
        return np.asarray(1e3 * (self.motion.at(true_s) - zero))


@dataclass(frozen=True)
class Kind:
    """A kind of recording.

    count: recordings of a full run; make: writes one into a folder; cause: pattern of the messages that name what is
    wrong, None where nothing is; outdoors: whether it is one of the troubles of an outdoor installation.
    """

    family: str
    name: str
    count: int
    make: Callable[[np.random.Generator, Path], Truth]
    cause: str | None = None
    outdoors: bool = False

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


def _slow_outdoors(change: displacement.Change, rng: np.random.Generator, folder: Path) -> Truth:
    outdoors = displacement_outdoors
    made = outdoors.gnss(rng) if change in outdoors.OF_GNSS else outdoors.installation(rng)
    change(made)
    displacement.write(made, folder)
    clock = None if np.array_equal(made.stamps_s, made.time_s) else (made.stamps_s, made.time_s)
    scale = np.nan if change in outdoors.WITHOUT_SCALE else 1.0
    drift_mm = 1e3 * made.drift_m
    return Truth(made.motion, np.nan, scale, np.nan, drift_mm, clock, stretch_s=made.stretch_s)


def _truth(made: Station, scale: float) -> Truth:
    offset = made.offset_s if made.has_offset else np.nan
    scale = scale if made.has_scale else np.nan
    return Truth(made.motion, float(made.true_s[0]), scale, offset, free_zero=not made.has_zero)


def _camera_outdoors(change: camera_outdoors.Change, rng: np.random.Generator, folder: Path) -> Truth:
    made = camera_outdoors.installation(rng)
    change(made)
    camera_outdoors.write_camera(made, folder)
    return _truth(made, 1e3 * made.scale)


def _highrise(rng: np.random.Generator, folder: Path) -> Truth:
    made = camera_outdoors.highrise(rng)
    camera_outdoors.write_camera(made, folder)
    return _truth(made, 1e3 * made.scale)


def _infrared_outdoors(change: camera_outdoors.Change, rng: np.random.Generator, folder: Path) -> Truth:
    made = camera_outdoors.installation(rng, size_px=camera_outdoors.INFRARED_PX)
    change(made)
    camera_outdoors.write_infrared(made, folder)
    return _truth(made, 1e3 * made.scale)


def _radar_outdoors(change: radar_outdoors.Change, rng: np.random.Generator, folder: Path) -> Truth:
    made = radar_outdoors.installation(rng)
    change(made)
    radar_outdoors.write(made, folder)
    return replace(_truth(made, made.scale), frames_s=made.taken_s)


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
CLOCK = "clock|time must increase"
HUM = "anti-alias|aliased|machine|narrow|line at"
WRONG = r"(?!)"  # matches nothing: such a recording is good enough, and every refusal is wrong
NODDING = "mast|nod|tilt of the camera|camera (tilts|leans|moves|sways)|slow error|error of its own"
ZOOM = "focus|zoom|breath|magnif|depth|distance"
AIR = "haze|shimmer|air|slow error|error of its own"
OUTDOORS_COUNT = 6
# No record shows a slow error as slow as itself, nor the delay of a logger.
UNSEEN = ("displacement-multipath", "displacement-logger")


def _name(change: Callable[..., None]) -> str:
    # A name that Python has itself ends with an underscore.
    return change.__name__.rstrip("_")


def _outdoors(
    family: str, make: Callable[..., Truth], changes: dict[Callable[..., None], str | None]
) -> tuple[Kind, ...]:
    return tuple(
        Kind(family, _name(change), OUTDOORS_COUNT, partial(make, change), cause, outdoors=True)
        for change, cause in changes.items()
    )


OUTDOORS: tuple[Kind, ...] = (
    *_outdoors(
        "displacement",
        _slow_outdoors,
        {
            displacement_outdoors.calm: None,
            displacement_outdoors.float_: "jump|float|shift|outlier|displacement differs",
            displacement_outdoors.clockstep: CLOCK,
            displacement_outdoors.accstep: CLOCK,
            displacement_outdoors.accdrift: CLOCK,
            displacement_outdoors.backlater: CLOCK,
            displacement_outdoors.rounding: WRONG,
            displacement_outdoors.hum: HUM,
            displacement_outdoors.backlash: "backlash|hysteresis|play|friction|stick",
            displacement_outdoors.level: "resol|quanti|steps of|rounded",
            displacement_outdoors.multipath: "slow error|multipath",
            displacement_outdoors.clip: "clip|range|satur",
        },
    ),
    *_outdoors(
        "camera",
        _camera_outdoors,
        {
            camera_outdoors.calm: None,
            camera_outdoors.mast: NODDING,
            camera_outdoors.breathe: ZOOM,
            camera_outdoors.grow: ZOOM,
            camera_outdoors.haze: AIR,
            camera_outdoors.railing: "reson|railing|mount",
            camera_outdoors.rolling: "rolling|read-?out|shutter",
            camera_outdoors.clockstep: CLOCK,
            camera_outdoors.hum: HUM,
        },
    ),
    Kind("camera", "highrise", OUTDOORS_COUNT, _highrise, "too little|noise|noisy|quiet", outdoors=True),
    *_outdoors(
        "infrared",
        _infrared_outdoors,
        {camera_outdoors.calm: None, camera_outdoors.reflection: "reflect|haze|slow error|error of its own"},
    ),
    *_outdoors(
        "radar",
        _radar_outdoors,
        {
            radar_outdoors.calm: None,
            radar_outdoors.jam: "interfer|jam",
            radar_outdoors.jitter: "jitter|irregular|stamps",
            radar_outdoors.clockstep: CLOCK,
            radar_outdoors.hum: HUM,
        },
    ),
)
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
    *OUTDOORS,
)
