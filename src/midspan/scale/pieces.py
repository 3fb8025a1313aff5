"""A long recording shared by several workers: cut by the first, its pieces estimated by all, joined by the last.

A piece goes under pieces/, by the key of what it follows from: what was done before an interruption is taken. The rows
appear under rows/ when all are there and agree; until then the recording has none.
"""

import io
import json
import os
import shutil
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from zipfile import BadZipFile

import numpy as np

from midspan.errors import MidspanError
from midspan.scale.work import Cut, Outcome, codes_of, failed, opened, record, work_whole
from midspan.sinks.write import write_result
from midspan.writing import cannot_be_written, replacing_folder, write_whole

if TYPE_CHECKING:
    from midspan.recording.streams.recording import Recording
    from midspan.records import Estimate


@dataclass(frozen=True, slots=True)
class Piece:
    """One of the pieces of a recording, by its number."""

    cut: Cut
    number: int

    @property
    def rows_file(self) -> Path:
        """Where its rows go."""
        return self.cut.folder / f"part-{self.number:04d}.parquet"

    @property
    def seams_file(self) -> Path:
        """Where its rows around both ends go, after the rows, with what came of it."""
        return self.cut.folder / f"seams-{self.number:04d}.npz"


@dataclass(frozen=True, slots=True)
class Done:
    """What came of a piece; whole: the recording has to be estimated whole."""

    rows: int
    warnings: dict[str, int]
    seconds: float
    whole: bool = False


def pieces_of(cut: Cut) -> list[Piece]:
    """Its pieces in the order of time."""
    return [Piece(cut, number) for number in range(len(cut.spans))]


# The recording that this worker read last, by the key of its task: of several pieces it reads the files once.
_LAST = dict[str, "Recording"]()


def _recording(cut: Cut) -> "Recording":
    if cut.key not in _LAST:
        _LAST.clear()
        _LAST[cut.key] = opened(cut.task.job)
    return _LAST[cut.key]


def work_piece(piece: Piece) -> Done:
    """Estimate a piece, unless an earlier run did; UsageError where it cannot be written."""
    if (earlier := _finished(piece)) is not None:
        return earlier[0]
    from midspan.recording.pieces import estimate_piece, seam, with_rows

    begun_s = time.monotonic()
    cut, span = piece.cut, piece.cut.spans[piece.number]
    try:
        result = estimate_piece(_recording(cut), cut.calibration, span)
    except Exception:
        # The whole reports what is wrong.
        result = None
    if result is None:
        return Done(0, {}, time.monotonic() - begun_s, whole=True)
    ends = [seam(result.estimate, span.first_ns), seam(result.estimate, span.end_ns)]
    result = with_rows(result, span)
    with cannot_be_written(piece.rows_file):
        piece.rows_file.parent.mkdir(parents=True, exist_ok=True)
    table = result.table()
    # Of the piece alone it would say nothing of the recording.
    del table.metadata["verdict"]
    write_result(piece.rows_file, table)
    done = Done(len(result.estimate.time_ns), codes_of(result), time.monotonic() - begun_s)
    _keep(piece, ends, done)
    return done


def _keep(piece: Piece, ends: "Sequence[Estimate]", done: Done) -> None:
    arrays = {f"{k}-{name}": getattr(rows, name) for k, rows in enumerate(ends) for name in rows.__dataclass_fields__}
    buffer = io.BytesIO()
    np.savez(buffer, done=np.array(json.dumps(asdict(done))), **arrays)
    write_whole(piece.seams_file, buffer.getvalue())


def _finished(piece: Piece) -> "tuple[Done, tuple[Estimate, Estimate]] | None":
    """What came of a piece, and its rows around both ends; None where it was not done."""
    from midspan.records import Estimate

    try:
        with np.load(piece.seams_file) as file:
            done = Done(**json.loads(str(file["done"])))
            begin, end = (Estimate(*[file[f"{k}-{name}"] for name in Estimate.__dataclass_fields__]) for k in (0, 1))
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile):
        return None
    return (done, (begin, end)) if piece.rows_file.is_file() else None


def join(cut: Cut) -> Outcome:
    """The rows of all pieces under the recording's name; it is estimated whole where they do not agree."""
    from midspan.recording.pieces import joined_seams

    _LAST.clear()
    pieces = pieces_of(cut)
    finished = [piece for piece in map(_finished, pieces) if piece is not None]
    if len(finished) < len(pieces) or not joined_seams([seams for _, seams in finished]):
        outcome = work_whole(cut)
    else:
        begun_s, done = time.monotonic() - cut.seconds, [part for part, _ in finished]
        # A notice of the whole stands in each piece.
        codes = sorted({code for part in done for code in part.warnings})
        most = {code: max(part.warnings.get(code, 0) for part in done) for code in codes}
        try:
            rmse_mm = _rmse_mm(cut, pieces)
        except MidspanError as error:
            # As of a reference that has no time in common.
            outcome = failed(cut.task, cut.key, error)
        else:
            rows = sum(part.rows for part in done)
            outcome = Outcome(cut.task.job.name, 0, rows, rmse_mm, most, key=cut.key)
            _publish(cut, pieces)
        outcome = record(cut.task, outcome, begun_s - sum(part.seconds for part in done))
    shutil.rmtree(cut.task.pieces_folder, ignore_errors=True)
    with suppress(OSError):
        # Of the last recording of all.
        cut.task.pieces_folder.parent.rmdir()
    return outcome


def _publish(cut: Cut, pieces: Sequence[Piece]) -> None:
    folder = cut.task.rows_folder
    with cannot_be_written(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with replacing_folder(folder) as partial:
            for piece in pieces:
                os.replace(piece.rows_file, partial / piece.rows_file.name)


def _rmse_mm(cut: Cut, pieces: Sequence[Piece]) -> float | None:
    """The error of all rows against the recording's reference, mm rms, None without one."""
    recording = opened(cut.task.job)
    if not recording.has("reference"):
        return None
    from midspan.evaluate import metrics
    from midspan.evaluate.result_file import read_result
    from midspan.records import TimeSeries

    parts = [read_result(piece.rows_file).series for piece in pieces]
    rows = TimeSeries(np.concatenate([part.time_ns for part in parts]), np.concatenate([part.value for part in parts]))
    return float(metrics.compare(rows, recording.reference).to_dict()["rmse_mm"])
