"""What flows between the rooms: frozen records, SI inside, the unit in each field's name.

Time is int64 nanoseconds of one declared clock (the accelerometer's, or the sensor's own before its time offset is
applied); seconds appear only as differences. A record that holds arrays is a block: field arrays of equal length n.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from midspan.notices import Notice

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Nanoseconds = NDArray[np.int64]

NANOSECONDS = 1_000_000_000


def seconds(time_ns: Nanoseconds, origin_ns: int) -> Floats:
    """Time stamps (n,) as seconds after `origin_ns`."""
    return (np.asarray(time_ns, dtype=np.int64) - np.int64(origin_ns)).astype(np.float64) / NANOSECONDS


def nanoseconds(time_s: Floats, origin_ns: int = 0) -> Nanoseconds:
    """Seconds (n,) after `origin_ns` as time stamps."""
    return np.int64(origin_ns) + np.rint(np.asarray(time_s, dtype=np.float64) * NANOSECONDS).astype(np.int64)


class Arrays(Protocol):
    """A block: a dataclass whose fields are all arrays."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


def joined(blocks: "Sequence[Block]") -> "Block":
    """One block out of blocks of the same kind, in their order; also from a single one."""
    if len(blocks) == 1:
        return blocks[0]
    names = blocks[0].__dataclass_fields__
    return type(blocks[0])(*[np.concatenate([getattr(block, name) for block in blocks]) for name in names])


def part(block: "Block", which: slice | NDArray[np.generic]) -> "Block":
    """The rows `which` (a slice, mask or index array) of a block."""
    return type(block)(*[getattr(block, name)[which] for name in block.__dataclass_fields__])


class _Code(IntEnum):
    @property
    def word(self) -> str:
        """The lower-case word of the result files."""
        return self.name.lower()


class Source(_Code):
    """Which sensor fixes a row of the result; `prediction` is the accelerometer alone."""

    PREDICTION = 0
    CAMERA = 1
    INFRARED = 2
    RADAR = 3
    DISPLACEMENT = 4


class Status(_Code):
    """What a row of the result rests on."""

    TRACKING = 0
    COASTING = 1
    LOST = 2


@dataclass(frozen=True, slots=True)
class Region:
    """Region of interest: left column x, top row y, width and height, in whole pixels."""

    x: int
    y: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns of an image that it holds."""
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)

    def inside(self, columns: int, rows: int) -> bool:
        """Whether the region lies wholly in an image of `columns` by `rows` pixels."""
        inside_x = self.x >= 0 and self.width > 0 and self.x + self.width <= columns
        return inside_x and self.y >= 0 and self.height > 0 and self.y + self.height <= rows


@dataclass(frozen=True, slots=True)
class TimeSeries:
    """A channel as it was read: `time_ns` (n,) and `value` (n,) in SI (m/s² or m), NaN where the file had no number.

    `notes` says in plain sentences what the reader found and assumed (delimiter, unit, epoch …), `damage` which data of
    the file are damaged or cut off and therefore left out, `notices` which of the notes a result should report, too.
    """

    time_ns: Nanoseconds
    value: Floats
    name: str = ""
    unit: str = ""
    notes: tuple[str, ...] = ()
    damage: tuple[str, ...] = ()
    notices: tuple[Notice, ...] = ()


@dataclass(frozen=True, slots=True)
class Acceleration:
    """A block of acceleration: `time_ns` (n,) strictly increasing, `value_m_s2` (n,) finite.

    `noise_density` (n,) is the two-sided power spectral density of its white noise in (m/s²)²/Hz for the interval that
    ends at the sample; it is raised where samples were missing and had to be bridged.
    """

    time_ns: Nanoseconds
    value_m_s2: Floats
    noise_density: Floats


@dataclass(frozen=True, slots=True)
class Displacement:
    """A block of displacement measurements, each with its variance and the code of its `Source`: arrays (n,).

    A value or variance that is not finite marks a measurement that must not be used.
    """

    time_ns: Nanoseconds
    value_m: Floats
    variance_m2: Floats
    source: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Frame:
    """One image: `pixels` (rows, columns) of luma or temperature, any integer or float type; `index` in its source.

    covered: share (0 to 1) of the target that an earlier stage knows to be occluded; trackers do not learn from that.
    """

    time_ns: int
    pixels: NDArray[np.generic]
    index: int = 0
    covered: float = 0.0


@dataclass(frozen=True, slots=True)
class Prediction:
    """Where the target should be in the next frame: pixels since the reference frame, with standard deviations."""

    x_px: float
    y_px: float
    std_x_px: float
    std_y_px: float


@dataclass(frozen=True, slots=True)
class Event:
    """Something worth reporting: when, of what kind, in one sentence; axis: that it concerns, 0 the main one.

    sensor: whose measurements it is about, empty where it is about none; the text says it as well.
    """

    time_ns: int
    kind: str
    text: str
    axis: int = 0
    sensor: str = field(default="", compare=False)


@dataclass(frozen=True, slots=True)
class PixelTranslation:
    """Translation of the target since the reference frame: x to the right, y down, in pixels, with variances.

    `quality` runs from 0 to 1 (for template matching the correlation coefficient). With status LOST the values are NaN.
    strength: good matches, of trackers without matches the quality in percent; 0 where lost. reference_variance_x_px2,
    reference_variance_y_px2: of the reference's own place, common to all frames that are compared with it; they are not
    part of `variance_x_px2`, `variance_y_px2`. events: what happened in this frame. unseen: why nothing was
    looked for in it, "dark" or "frozen" (the picture before once more); else empty. zoom, variance_zoom: by how much
    the picture has grown about the target's middle; infinite variance: not measured.
    """

    time_ns: int
    x_px: float
    y_px: float
    variance_x_px2: float
    variance_y_px2: float
    quality: float
    status: Status
    strength: float = 0.0
    reference_variance_x_px2: float = 0.0
    reference_variance_y_px2: float = 0.0
    events: tuple[Event, ...] = ()
    unseen: str = ""
    zoom: float = 0.0
    variance_zoom: float = math.inf

    def later(self, by_ns: int) -> "PixelTranslation":
        """The same on a clock that shows so much more."""
        if by_ns == 0:
            return self
        events = tuple(replace(event, time_ns=event.time_ns + by_ns) for event in self.events)
        return replace(self, time_ns=self.time_ns + by_ns, events=events)


def unzoomed(
    seen: tuple[Floats, Floats], zoom: tuple[Floats, Floats], lever_px: Floats | float
) -> tuple[Floats, Floats]:
    """Translation (n,) in px and its variance without the picture's zoom z.

    What moves by p, r px from the optical axis, is seen to move by (1 + z) p + r z. zoom: its values (n,) and their
    variance; lever_px: r.
    """
    (place, variance), (z, of_zoom) = seen, zoom
    return (place - lever_px * z) / (1.0 + z), variance + lever_px * lever_px * of_zoom


@dataclass(frozen=True, slots=True)
class PixelTrack:
    """A block of `PixelTranslation`s, one row a frame: arrays (n,); `status` holds `Status` codes."""

    time_ns: Nanoseconds
    x_px: Floats
    y_px: Floats
    variance_x_px2: Floats
    variance_y_px2: Floats
    quality: Floats
    status: NDArray[np.uint8]
    zoom: Floats
    variance_zoom: Floats

    @classmethod
    def stack(cls, rows: list[PixelTranslation]) -> "PixelTrack":
        """The block of single translations in their order."""
        kinds = dict.fromkeys(cls.__slots__, np.float64) | {"time_ns": np.int64, "status": np.uint8}
        return cls(**{name: np.array([getattr(r, name) for r in rows], dtype=kind) for name, kind in kinds.items()})

    def without_zoom(self, lever_px: tuple[float, float]) -> "PixelTrack":
        """The rows without what the picture's zoom makes of them along x and y; a lever of 0: nothing."""
        x, y = (
            unzoomed((place, variance), (self.zoom, self.variance_zoom), arm) if arm else (place, variance)
            for place, variance, arm in zip(
                (self.x_px, self.y_px), (self.variance_x_px2, self.variance_y_px2), lever_px, strict=True
            )
        )
        return replace(self, x_px=x[0], y_px=y[0], variance_x_px2=x[1], variance_y_px2=y[1])

    def along(self, direction: str) -> tuple[Floats, Floats]:
        """Translation and its variance (n,) along the image axis "x" or "y"."""
        if direction == "x":
            return self.x_px, self.variance_x_px2
        return self.y_px, self.variance_y_px2


@dataclass(frozen=True, slots=True)
class ChirpFrame:
    """One frame of a chirp radar: `samples` (chirps, receivers, samples) complex64, ADC counts; `index` in its source.

    `valid` (chirps, receivers) is False where a lost packet has left a hole.
    """

    time_ns: int
    samples: NDArray[np.complex64]
    valid: NDArray[np.bool_]
    index: int = 0


@dataclass(frozen=True, slots=True)
class RangeFrame:
    """One frame of `RangeFrames`: `phasors` (channels, bins), `valid` (channels,)."""

    time_ns: int
    phasors: NDArray[np.complex64]
    valid: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class RangeFrames:
    """A block of frames resolved in range: `phasors` (n, channels, bins) complex64 whose phase grows with the range.

    `valid` (n, channels) is False where data are missing; such phasors must not be used.
    """

    time_ns: Nanoseconds
    phasors: NDArray[np.complex64]
    valid: NDArray[np.bool_]

    def __iter__(self) -> Iterator[RangeFrame]:
        """Its frames, one by one."""
        for row, stamp in enumerate(self.time_ns.tolist()):
            yield RangeFrame(stamp, self.phasors[row], self.valid[row])


@dataclass(frozen=True, slots=True)
class PhaseMeasurement:
    """Phase of one radar target, counted from its first used frame, without jumps of a cycle, in rad, with variance.

    variance_rad2: of what is new in every frame; reference_variance_rad2: of the phase's zero since the first used
    frame (cycles that may have been lost), common to frames that follow each other and not part of `variance_rad2`.
    Where the target is not used the phase is NaN, its variance infinite and the status COASTING while the cycle can
    still be predicted, else LOST. strength: amplitude over the calibrated one, 0 where nothing was received. events:
    what happened in this frame. earlier: with the first phase, those of the frames before it by which the target's
    speed was found: the first of them is the first frame used.
    """

    time_ns: int
    phase_rad: float
    variance_rad2: float
    reference_variance_rad2: float
    status: Status
    strength: float
    events: tuple[Event, ...] = ()
    earlier: tuple["PhaseMeasurement", ...] = ()


class Quantity(IntEnum):
    """What a channel measures: see `core/src/estimator/settings.rs`."""

    DISPLACEMENT = 0
    VELOCITY = 1
    TILT = 2
    TILT_RATE = 3


def places(channels: "Sequence[Channel]") -> "tuple[Channel, ...]":
    """The channels that tell where the structure is."""
    return tuple(one for one in channels if one.measures is Quantity.DISPLACEMENT)


@dataclass(frozen=True, slots=True)
class Channel:
    """One target of one sensor along one axis, as the estimator sees it; its measurements are in the sensor's own unit.

    sensor: name of the sensor, of which there may be several of a kind; source: how its rows are marked. axis: 0 for
    the main one. units_per_m: measured units (px, rad, m) per metre of displacement, signed. variance_factor: estimated
    variance over the one that comes with each measurement. exposure_s: the time over which one measurement averages.
    zero_std_m: standard deviation of its zero at its first measurement; infinite: unknown. zero_walk_m2_s: density of
    the random walk of its zero; the rows' own band grows by it where no other sensor's zero stays. reverting_s: time in
    which a shift of its zero may revert; 0: a zero that has shifted stays. coasting_s, lost_s:
    age of the last accepted measurement from which on rows are marked so. interval_s: its usual interval between
    measurements; 0: unknown. slow_std_m, slow_time_s, slow_hz: standard deviation, the time in which it decays and
    natural frequency of its sensor's slow error (0 Hz: first-order Gauss-Markov; else a damped oscillator);
    slow_walk_m2_s: density of the random walk that this error has besides.
    measures: what; of a tilt or its rate, units_per_m counts per metre of the slow error of the sensor tilt_of, whose
    tilt that error is, and its rate needs an oscillator. "": of its own sensor. Of an image that another camera's tilt
    moves as well, slow_units_per_m are its measured units per metre of that; None: as of the first that has it.
    """

    sensor: str
    source: Source
    units_per_m: float
    target: str = "1"
    axis: int = 0
    variance_factor: float = 1.0
    exposure_s: float = 0.0
    zero_std_m: float = 0.0
    zero_walk_m2_s: float = 0.0
    reverting_s: float = 0.0
    coasting_s: float = 0.25
    lost_s: float = 10.0
    interval_s: float = 0.0
    slow_std_m: float = 0.0
    slow_time_s: float = math.inf
    slow_hz: float = 0.0
    slow_walk_m2_s: float = 0.0
    measures: Quantity = Quantity.DISPLACEMENT
    tilt_of: str = ""
    slow_units_per_m: float | None = None


@dataclass(frozen=True, slots=True)
class Measured:
    """A block of measurements, each in its channel's unit: arrays (n,), `channel` its number in the estimator's table.

    reference_variance: of the channel's zero in addition to its variance at the first measurement, common to
    measurements that follow each other. A value or variance that is not finite marks a measurement that must not be
    used.
    """

    time_ns: Nanoseconds
    channel: NDArray[np.int64]
    value: Floats
    variance: Floats
    reference_variance: Floats


class SampleKind(IntEnum):
    """What a sample of the acceleration rests on."""

    MEASURED = 0
    BRIDGED = 1
    INSERTED = 2


@dataclass(frozen=True, slots=True)
class Samples:
    """A block of acceleration along all axes: time_ns (n,), value_m_s2 and noise_density (n, axes), kind (n,).

    noise_density: as of `Acceleration`. kind: code of `SampleKind`; BRIDGED rows are marked coasting, INSERTED
    ones (put into long gaps in time) are no rows of the result.
    """

    time_ns: Nanoseconds
    value_m_s2: Floats
    noise_density: Floats
    kind: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A block of results, one row an accelerometer sample: arrays (n,); `source` and `status` hold their codes."""

    time_ns: Nanoseconds
    displacement_m: Floats
    variance_m2: Floats
    velocity_m_s: Floats
    source: NDArray[np.uint8]
    status: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class GroupRows:
    """Rows of the points of a group as runs (k,): evenly timed rows of one point with one status, ordered by time for
    each point. `point` counts from 0 in the group; run j has count[j] rows, at t0_ns[j] (UTC) and every dt_ns[j] after.

    displacement_m, std_m, velocity_m_s: rows of all runs, one after another (sum of count,).
    """

    point: NDArray[np.uint32]
    t0_ns: Nanoseconds
    dt_ns: Nanoseconds
    count: NDArray[np.uint32]
    status: NDArray[np.uint8]
    displacement_m: Floats
    std_m: Floats
    velocity_m_s: Floats


def member_name(group: str, number: int) -> str:
    """The name of a point of a group."""
    return f"{group}-{number}"


def member_of(point: str) -> tuple[str, int] | None:
    """Group and number that a point's name would mean; None where it means none."""
    name, _, digits = point.rpartition("-")
    if not name or not digits.isascii() or not digits.isdecimal() or len(digits) > 9 or digits != str(int(digits)):
        return None
    return name, int(digits)


@dataclass(frozen=True, slots=True)
class Innovation:
    """Measured minus predicted displacement, its predicted variance and the gate's verdict: arrays (n,)."""

    time_ns: Nanoseconds
    value_m: Floats
    variance_m2: Floats
    verdict: NDArray[np.int8]


@dataclass(frozen=True, slots=True)
class Readings:
    """A block of readings from outside, nothing of it checked: `time_ns` (n,), `value` (n, axes) in SI.

    time_ns: on the stream's own clock until `Merge` has put it on the common one.
    """

    time_ns: Nanoseconds
    value: Floats


@dataclass(frozen=True, slots=True)
class Tracked:
    """A frame whose targets have been found already: their translations, with the frame's stamp on their clock."""

    time_ns: int
    own_ns: int
    translations: tuple[PixelTranslation, ...]


@dataclass(frozen=True, slots=True)
class Arrival:
    """A record of the named stream; `sequence` counts the stream's records, so that lost ones show as a step."""

    stream: str
    sequence: int
    record: Readings | Frame | Tracked | RangeFrame | Event

    @property
    def newest_ns(self) -> int:
        """The newest stamp of the record."""
        return int(self.record.time_ns[-1] if isinstance(self.record, Readings) else self.record.time_ns)


@dataclass(frozen=True, slots=True)
class Tick:
    """The clock of what runs the engine, as data: `now_ns` never decreases. A replay makes ticks from stamps."""

    now_ns: int


@dataclass(frozen=True, slots=True)
class Complete:
    """All streams have brought what they have up to `time_ns` of the common clock: nobody is waited for."""

    time_ns: int


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """From stamp `from_ns` of the stream's own clock on, `offset_ns` is added to its stamps to get the common clock."""

    stream: str
    offset_ns: int
    from_ns: int


Block = TypeVar("Block", bound="Arrays")


@dataclass(frozen=True, slots=True)
class ScaleFactor:
    """Displacement per pixel of translation of the target, signed, in m/px, with its variance in (m/px)²."""

    value_m_per_px: float
    variance: float

    def wider(self, relative_std: float) -> "ScaleFactor":
        """The same with an error of this relative standard deviation besides."""
        return replace(self, variance=self.variance + (relative_std * self.value_m_per_px) ** 2)


@dataclass(frozen=True, slots=True)
class TimeOffset:
    """Seconds to add to a sensor's clock to get the accelerometer's clock, with its variance in s²."""

    value_s: float
    variance: float


@dataclass(frozen=True, slots=True)
class InputNoise:
    """Noise of an acceleration, its two-sided density being density + motion_s times the mean square of the motion.

    density: (m/s²)²/Hz; motion_s: s, what errors in proportion to the motion make.
    """

    density: float
    motion_s: float = 0.0


@dataclass(frozen=True, slots=True)
class NoiseLevel:
    """White noise: standard deviation per sample in the unit of the channel."""

    std: float
