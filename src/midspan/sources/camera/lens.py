"""The camera's lens: its file, and its calibration from pictures of a checkerboard."""

import json
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan._version import __version__
from midspan.checks import option
from midspan.errors import DataError, UntrustedError, UsageError
from midspan.progress import Progress, silent
from midspan.records import Floats
from midspan.sources.camera.formats import open_frames
from midspan.sources.camera.frames import FrameRequest, timed_or_counted
from midspan.trees import read_json
from midspan.vision.checkerboard import Board, LensFit, calibrate_lens, find_board, is_new
from midspan.vision.frame_source import FrameSource
from midspan.vision.lens import MODELS, Lens
from midspan.writing import write_whole

# Of a long video this many pictures, evenly spread, are searched for the board, and this many views are fitted.
MAX_PICTURES = 150
MAX_VIEWS = 60


@dataclass(frozen=True, slots=True)
class LensRequest:
    """How a lens is calibrated: the board, the model, and every n-th picture (None: at most 150, evenly spread)."""

    board: Board = field(default_factory=Board)
    model: str = "pinhole"
    every: int | None = None


@dataclass(frozen=True, slots=True)
class CalibratedLens:
    """The fit, how many pictures were searched and in how many the board was found, and one picture to draw on."""

    fit: LensFit
    pictures: int
    found: int
    picture: NDArray[Any] = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """The tree of plain values that a lens file holds."""
        fit, lens = self.fit, self.fit.lens
        return {
            "midspan": __version__,
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            **lens.to_dict(),
            "rms_px": fit.rms_px,
            "focal_std": fit.focal_std,
            "rim_std": fit.rim_std if np.isfinite(fit.rim_std) else None,
            "coverage": fit.coverage,
            "boards": fit.boards,
            "boards_found": self.found,
            "pictures": self.pictures,
            "warnings": list(fit.warnings),
        }

    def save(self, path: Path) -> Path:
        """Write the lens file; nothing half-written is left."""
        write_whole(path, (json.dumps(self.to_dict(), indent=2, ensure_ascii=False) + "\n").encode())
        return path


def load_lens(path: str | Path) -> Lens:
    """The lens of a file that `midspan lens` wrote. Raises DataError for a file that is not one."""
    path = Path(path)
    try:
        return Lens.from_dict(read_json(path))
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}). Make it with `midspan lens`.") from None
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, UsageError) as error:
        what = f"has no {error}" if isinstance(error, KeyError) else str(error)
        raise DataError(f"{path}: is no lens file: {what}. Make it again with `midspan lens`.") from None


def lens_from_pictures(source: str | Path, request: LensRequest, progress: Progress = silent) -> CalibratedLens:
    """Calibrate a lens from pictures of a checkerboard: a folder, a glob or a stack of images, or a video.

    Raises DataError for pictures that cannot be read, UntrustedError with the reason when the result could not be
    trusted: fewer than 8 different views, views that do not fix the focal length, a misfit above 1 px rms.
    """
    option("lens model", request.model, MODELS)

    def opened(every: int) -> FrameSource:
        # Their times do not matter.
        return timed_or_counted(lambda rate_hz: open_frames(Path(source), FrameRequest(None, rate_hz, every=every)))[0]

    frames = opened(request.every or 1)
    every = -(-len(frames.times_ns()) // MAX_PICTURES)
    frames = opened(every) if request.every is None and every > 1 else frames
    total = len(frames.times_ns())
    if not total:
        raise DataError(f"{source}: holds no pictures. Give pictures of a checkerboard.")
    size = (frames.info.width, frames.info.height)
    views: list[Floats] = []
    searched, found, picture = 0, 0, np.zeros((1, 1), dtype=np.uint8)
    for frame in frames.frames():
        progress(searched, total, "looking for the board")
        pixels = np.asarray(frame.pixels)
        searched += 1
        if pixels.shape != size[::-1]:
            raise DataError(
                f"{source}: all pictures must have one size, {size[0]}x{size[1]} px; picture {frame.index + 1} has "
                f"{pixels.shape[1]}x{pixels.shape[0]} px. A lens belongs to one size; take the others out."
            )
        corners = find_board(pixels, request.board)
        if corners is None:
            continue
        found, picture = found + 1, pixels
        if is_new(corners, views, size):
            views.append(corners)
    progress(1, 1, "looking for the board")
    views = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, MAX_VIEWS).astype(int))] if views else []
    try:
        fit = calibrate_lens(views, request.board, size, request.model)
    except UntrustedError as error:
        raise UntrustedError(f"{source}: {found} of {searched} pictures show the board. {error}") from None
    return CalibratedLens(fit, searched, found, picture)
