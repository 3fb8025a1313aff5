"""What every source of frames offers, whatever it reads from."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

from midspan.notices import Notice
from midspan.records import Floats, Frame, Nanoseconds, PixelTrack, Region


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """What is known of a source of frames: `frame_count` counts all frames of the file (None: not known).

    `bit_depth` is that of the luma, `lossless` None where the codec can be either, `radiometric` whether pixels are
    temperatures. `damage`: what of the file was lost, mended or is doubtful, which a result should report; `notices`:
    what else it should report, each under a code of its own. `quarter_turns`: by which the pictures were turned
    counterclockwise from how the sensor was read out.
    """

    width: int
    height: int
    bit_depth: int
    frame_count: int | None
    codec: str
    lossless: bool | None
    notes: tuple[str, ...] = ()
    radiometric: bool = False
    damage: tuple[str, ...] = ()
    notices: tuple[Notice, ...] = ()
    quarter_turns: int = 0


# Where a track's target was, if nothing tells it.
NOWHERE = Region(0, 0, 1, 1)


@dataclass(frozen=True, slots=True, eq=False)
class StoredTrack:
    """A target that was tracked before: its translations, one row a frame, as they came from the tracker.

    strength (n,): good matches or the quality in percent; reference_px2 (n, 2): the part of the variances along x and y
    that the reference frame makes, which those of `rows` do not have.
    """

    name: str
    region: Region
    rows: PixelTrack
    strength: Floats
    reference_px2: Floats


class FrameSource(ABC):
    """Frames in the order of time; indices count the frames that are left after `every`.

    tracks: of a source that holds what was tracked, and no frames.
    """

    tracks: tuple[StoredTrack, ...] = ()

    @property
    @abstractmethod
    def info(self) -> FrameInfo:
        """What is known by now; notes can be added while frames are read (frames lost to damage)."""

    @abstractmethod
    def times_ns(self) -> Nanoseconds:
        """Time stamps (frames,) in ns of the camera's clock, strictly increasing, after `every`."""

    @abstractmethod
    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames start … stop-1 after `every`, one at a time; a frame lost to damage is passed over with its index."""
