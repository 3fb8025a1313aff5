"""Frames inside the boundary to the format libraries: damage shows while a file is read, not only when it is opened."""

from collections.abc import Iterator
from pathlib import Path

from midspan.records import Frame, Nanoseconds
from midspan.sources.boundary import reading
from midspan.vision.frame_source import FrameInfo, FrameSource


class GuardedFrames(FrameSource):
    """Frames of another source; whatever its library raises is a DataError that names the file."""

    def __init__(self, source: FrameSource, path: Path, kind: str) -> None:
        self._source, self._path, self._kind = source, path, kind

    @property
    def info(self) -> FrameInfo:
        """What is known of the source."""
        with reading(self._path, self._kind):
            return self._source.info

    def times_ns(self) -> Nanoseconds:
        """Time stamps of the source."""
        with reading(self._path, self._kind):
            return self._source.times_ns()

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames of the source."""
        with reading(self._path, self._kind):
            yield from self._source.frames(start, stop)
