"""Folders and globs of images, and multi-page TIFF, read with OpenCV one at a time."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.records import Frame, Nanoseconds
from midspan.sources.boundary import reading
from midspan.sources.camera.frames import FrameRequest, luma
from midspan.sources.camera.picture_header import Page, pages, picture_bytes
from midspan.sources.camera.timing import file_times, rate_times
from midspan.sources.declared_size import require_memory
from midspan.sources.file_bytes import mapped
from midspan.vision.frame_source import FrameInfo, FrameSource

# Pages of a TIFF decoded at once, and the bytes they may take: each call walks the file's list of pages from its start.
_PAGES_AT_ONCE = 16
_BLOCK_BYTES = 1 << 28
_LOSSY = (".jpg", ".jpeg")


class ImageFrames(FrameSource):
    """Images of one size, 8 or 16 bits (or float TIFF), in natural order of their names: img2 before img10."""

    def __init__(self, path: Path, request: FrameRequest, suffixes: Sequence[str]) -> None:
        self._path = path
        self._request = request
        self._files = _listed(path, suffixes)
        self._pages, largest = _page_count(self._files[0]) if len(self._files) == 1 else (1, 0)
        self._at_once = max(min(_PAGES_AT_ONCE, _BLOCK_BYTES // max(largest, 1)), 1)
        self._lossy = _is_lossy(self._files[0])
        self._block: tuple[int, list[NDArray[np.generic]]] = (0, [])
        self._first: NDArray[np.generic] | None = None
        self._first = self._page(0)

    @property
    def info(self) -> FrameInfo:
        """Size and depth of the first image, the number of images."""
        first = self._page(0) if self._first is None else self._first
        rows, columns = first.shape
        suffix = self._files[0].suffix.lower()
        depth = 8 * first.dtype.itemsize
        notes = (f"{len(self._files)} images, {self._files[0].name} … {self._files[-1].name}",)
        if self._pages > 1:
            notes = (f"{self._pages} pages",)
        return FrameInfo(columns, rows, depth, self._count, suffix.lstrip("."), not self._lossy, notes)

    @property
    def _count(self) -> int:
        return self._pages if self._pages > 1 else len(self._files)

    def times_ns(self) -> Nanoseconds:
        """Time stamps from `times`, else the rate."""
        if self._request.times is not None:
            times = file_times(self._request.times, self._path, self._count)
        else:
            times = rate_times(self._path, self._request, self._count)
        return times[:: self._request.every]

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """The images' luma; DataError names an image that cannot be read or has another size."""
        times = self.times_ns()
        for index in range(*slice(start, stop).indices(times.size)):
            yield Frame(int(times[index]), self._page(index * self._request.every), index)

    def _page(self, number: int) -> NDArray[np.generic]:
        if self._pages > 1:
            return self._checked(self._tiff_page(number), self._files[0])
        return self._checked(_read(self._files[number]), self._files[number])

    def _checked(self, image: NDArray[np.generic], file: Path) -> NDArray[np.generic]:
        pixels = luma(image, reversed_colours=True)
        first = pixels if self._first is None else self._first
        if pixels.shape != first.shape or pixels.dtype != first.dtype:
            raise DataError(
                f"{file} must have the size and depth of the first image, {_size(first)}; received {_size(pixels)}. "
                "Remove it from the folder or narrow the glob."
            )
        return pixels

    def _tiff_page(self, number: int) -> NDArray[np.generic]:
        import cv2

        start, pages = self._block
        if not start <= number < start + len(pages):
            start = number
            count = min(self._at_once, self._pages - start)
            with _quiet():
                ok, found = cv2.imreadmulti(str(self._files[0]), start=start, count=count, flags=cv2.IMREAD_UNCHANGED)
            if not ok or not found:
                raise DataError(f"{self._files[0]}: page {number + 1} cannot be read. Check that the file is whole.")
            pages = [np.asarray(page) for page in found]
            self._block = (start, pages)
        return pages[number - start]


def _size(image: NDArray[np.generic]) -> str:
    return f"{image.shape[1]} x {image.shape[0]} pixels of {image.dtype}"


def _listed(path: Path, suffixes: Sequence[str]) -> list[Path]:
    """The files of a folder or glob in natural order: numbers in names count as numbers."""
    if path.is_dir():
        files = [file for file in path.iterdir() if file.suffix.lower() in suffixes and not file.name.startswith(".")]
    elif path.is_file():
        files = [path]
    else:
        folder = next(parent for parent in path.parents if not any(sign in str(parent) for sign in "*?["))
        files = [file for file in folder.glob(str(path.relative_to(folder))) if file.is_file()]
    if not files:
        raise DataError(f"{path} holds no images ({', '.join(suffixes)}). Correct the folder or the glob.")
    return sorted(files, key=lambda file: [int(t) if t.isdigit() else t.lower() for t in re.split(r"(\d+)", str(file))])


def _page_count(file: Path) -> tuple[int, int]:
    """The pages of a file, and the bytes of the largest of a TIFF."""
    import cv2

    if file.suffix.lower() not in (".tif", ".tiff"):
        return 1, 0
    largest = max((page.picture_bytes for page in _pages(file)), default=0)
    require_memory(file, largest, "a page")
    with _quiet():
        return max(int(cv2.imcount(str(file), cv2.IMREAD_UNCHANGED)), 1), largest


def _is_lossy(file: Path) -> bool:
    """Whether a picture is packed with a loss."""
    if file.suffix.lower() not in (".tif", ".tiff"):
        return file.suffix.lower() in _LOSSY
    return any(page.lossy for page in _pages(file))


def _pages(file: Path) -> Iterator[Page]:
    """The pages of a TIFF by its list; DataError, naming the file, where that list is damaged."""
    try:
        with mapped(file) as data:
            yield from pages(data)
    except DataError as error:
        raise DataError(f"{file} {error}.") from error


@contextmanager
def _quiet() -> Iterator[None]:
    """OpenCV prints a line for every unknown TIFF tag of a camera maker; errors come back as results anyway."""
    import cv2

    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def _read(file: Path) -> NDArray[np.generic]:
    import cv2

    with reading(file, "an image"):
        require_memory(file, file.stat().st_size, "the file")
        # Through memory: OpenCV's own opening of files fails on some letters in names.
        data = np.fromfile(file, dtype=np.uint8)
        require_memory(file, picture_bytes(data.data), "its picture")
        with _quiet():
            image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    if image is None:
        raise DataError(f"{file} cannot be read as an image. Check that the file is whole, or remove it.")
    return np.asarray(image)
