"""Folders and globs of images, and multi-page TIFF, read with OpenCV one at a time."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from midspan.errors import DataError
from midspan.sources.boundary import mapped, reading, require_memory
from midspan.sources.camera.formats import IMAGES, listed
from midspan.sources.camera.frames import FrameRequest, StoredFrames, luma
from midspan.sources.camera.picture_header import Page, pages, picture_bytes
from midspan.vision.frame_source import FrameInfo

# Pages of a TIFF decoded at once, and the bytes they may take: each call walks the file's list of pages from its start.
_PAGES_AT_ONCE = 16
_BLOCK_BYTES = 1 << 28
_TIFF, _LOSSY = (".tif", ".tiff"), (".jpg", ".jpeg")


class ImageFrames(StoredFrames):
    """Images of one size, 8 or 16 bits (or float TIFF), in natural order of their names: img2 before img10."""

    def __init__(self, path: Path, request: FrameRequest) -> None:
        import cv2

        super().__init__(path, request)
        files = listed(path)
        self._files = [file for file in files if file.suffix.lower() in IMAGES] if path.is_dir() else files
        if not self._files:
            raise DataError(f"{path} holds no images ({', '.join(IMAGES)}). Correct the folder or the glob.")
        self._suffix = self._files[0].suffix.lower()
        self._pages, largest = 1, 0
        pages = list(_pages(self._files[0])) if self._suffix in _TIFF else []
        if len(self._files) == 1 and self._suffix in _TIFF:
            largest = max((page.picture_bytes for page in pages), default=0)
            require_memory(path, largest, "a page")
            with _quiet():
                self._pages = max(int(cv2.imcount(str(self._files[0]), cv2.IMREAD_UNCHANGED)), 1)
        self._count = self._pages if self._pages > 1 else len(self._files)
        self._at_once = max(min(_PAGES_AT_ONCE, _BLOCK_BYTES // max(largest, 1)), 1)
        self._lossy = self._suffix in _LOSSY or any(page.lossy for page in pages)
        self._block: tuple[int, list[NDArray[np.generic]]] = (0, [])
        self._first: NDArray[np.generic] | None = None
        self._first = self._image(0)

    @property
    def info(self) -> FrameInfo:
        """Size and depth of the first image, the number of images."""
        first = self._image(0) if self._first is None else self._first
        rows, columns = first.shape
        notes = (f"{len(self._files)} images, {self._files[0].name} … {self._files[-1].name}",)
        if self._pages > 1:
            notes = (f"{self._pages} pages",)
        return FrameInfo(columns, rows, 8 * first.dtype.itemsize, self._count, self._suffix[1:], not self._lossy, notes)

    def _image(self, number: int) -> NDArray[np.generic]:
        file = self._files[0 if self._pages > 1 else number]
        pixels = luma(self._tiff_page(number) if self._pages > 1 else _read(file), reversed_colours=True)
        first = pixels if self._first is None else self._first
        if pixels.shape != first.shape or pixels.dtype != first.dtype:
            wanted, received = (f"{one.shape[1]} x {one.shape[0]} pixels of {one.dtype}" for one in (first, pixels))
            raise DataError(
                f"{file} must have the size and depth of the first image, {wanted}; received {received}. "
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
