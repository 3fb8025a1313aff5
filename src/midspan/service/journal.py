"""What is kept of a point: its raw records, what its sensors found in them, its rows and events, as chunks."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.engine.point import Output
from midspan.engine.sensors import Seen
from midspan.fusion.estimator import Rows
from midspan.records import (
    Arrival,
    Estimate,
    Event,
    Floats,
    Nanoseconds,
    PixelTranslation,
    RangeFrame,
    Readings,
)
from midspan.store.chunk import Chunk
from midspan.store.store import Batch

ROWS, SHOWN = "rows", "displacement_m"
# Deviations and velocities of rows are kept in steps of 0.12 nm (and nm/s), far below any noise: with all bits a
# store of rows would be half as large again.
STEP = 2.0**-33
TRANSLATION = (
    "x_px",
    "y_px",
    "variance_x_px2",
    "variance_y_px2",
    "quality",
    "status",
    "strength",
    "reference_variance_x_px2",
    "reference_variance_y_px2",
)


def rows_stream(axis: str = "") -> str:
    """The stream of the rows along the main axis, or along another one of the image."""
    return f"{ROWS}:{axis}" if axis else ROWS


def target_stream(sensor: str, target: int) -> str:
    """The stream of one of a camera's targets (from 0)."""
    return f"{sensor}:{target}"


class Journal:
    """Collects what came and what was given since it was last emptied.

    early_ns: what is taken from the common clock's stamps to get each sensor's own; axes: names of the image axes that
    rows are made for, the main one first (none: one axis without a name); calibration: its number in the store.
    """

    def __init__(
        self, point: str, early_ns: Mapping[str, int], *, axes: Sequence[str] = (), calibration: int = 0
    ) -> None:
        self.point, self.calibration = point, calibration
        self._early_ns, self._axes = dict(early_ns), ("", *axes[1:])
        self._raw: list[Arrival] = []
        self._found: dict[str, list[tuple[PixelTranslation, ...]]] = {}
        self._rows: list[Rows] = []
        # How many of them `fresh` has given.
        self._given = 0
        self._events: list[Event] = []
        # Variance of the zero along each axis, as last given.
        self._zero_m2: tuple[float, ...] = (0.0, 0.0)

    def arrived(self, record: object) -> None:
        """Keep a raw record, before the engine has judged it; frames are kept as what is found in them."""
        if isinstance(record, Arrival) and isinstance(record.record, Readings | RangeFrame):
            self._raw.append(record)

    def given(self, outputs: Iterable[Output]) -> None:
        """Keep what a push gave."""
        for output in outputs:
            if isinstance(output, Rows):
                self._rows.append(output)
                self._events += output.events
            elif isinstance(output, Event):
                self._events.append(output)
            elif isinstance(output, Seen):
                self._events += output.events
                found = tuple(one for one in output.found if isinstance(one, PixelTranslation))
                if found:
                    self._found.setdefault(output.sensor, []).append(found)

    def batch(self) -> Batch:
        """Everything since the last time, to be written at once."""
        chunks = [*self._raw_chunks(), *self._found_chunks(), *self._row_chunks()]
        events = [(self.point, event) for event in self._events]
        self._raw, self._found, self._rows, self._events, self._given = [], {}, [], [], 0
        return Batch(chunks, events)

    def fresh(self) -> Chunk | None:
        """The rows along the main axis since the last time, which are kept all the same; None without any."""
        new, self._given = self._rows[self._given :], len(self._rows)
        return self._rows_along(0, "", new)

    def _raw_chunks(self) -> list[Chunk]:
        streams: dict[str, list[Readings | RangeFrame]] = {}
        for arrival in self._raw:
            assert isinstance(arrival.record, Readings | RangeFrame)
            streams.setdefault(arrival.stream, []).append(arrival.record)
        return [self._chunk(stream, *raw_columns(records)) for stream, records in streams.items()]

    def _found_chunks(self) -> list[Chunk]:
        chunks = []
        for sensor, frames in self._found.items():
            for target in range(len(frames[0])):
                rows = [found[target].later(-self._early_ns.get(sensor, 0)) for found in frames]
                columns = {name: np.array([getattr(row, name) for row in rows]) for name in TRANSLATION}
                columns["status"] = columns["status"].astype(np.uint8)
                time_ns = np.array([row.time_ns for row in rows], dtype=np.int64)
                chunks.append(self._chunk(target_stream(sensor, target), time_ns, columns))
        return chunks

    def _row_chunks(self) -> list[Chunk]:
        found = [self._rows_along(number, axis, self._rows) for number, axis in enumerate(self._axes)]
        self._zero_m2 = next(
            (one.zero_variance_m2 for one in reversed(self._rows) if one.zero_variance_m2), self._zero_m2
        )
        return [one for one in found if one is not None]

    def _rows_along(self, number: int, axis: str, given: Sequence[Rows]) -> Chunk | None:
        """Rows along one axis as a chunk."""
        zero_m2, own = self._zero_m2, []
        for rows in given:
            zero_m2 = rows.zero_variance_m2 or zero_m2
            if rows.estimates and len(rows.estimates[number].time_ns):
                own.append((rows.estimates[number], zero_m2[number]))
        if not own:
            return None
        columns = [row_columns(estimate, zero_m2) for estimate, zero_m2 in own]
        together = {name: np.concatenate([one[name] for one in columns]) for name in columns[0]}
        time_ns = np.concatenate([estimate.time_ns for estimate, _ in own])
        return Chunk(self.point, rows_stream(axis), time_ns, together, self.calibration, SHOWN)

    def _chunk(self, stream: str, time_ns: Nanoseconds, columns: dict[str, NDArray[Any]]) -> Chunk:
        """Raw rows with increasing stamps: a clock that ran back is in the events, and what it repeated is not kept."""
        newest = np.maximum.accumulate(time_ns)
        new = np.concatenate(([True], time_ns[1:] > newest[:-1]))
        # The calibration chooses a radar's bins: before there is one, whole profiles come.
        calibration = self.calibration if "phasors" in columns else 0
        own = {name: value[new] for name, value in columns.items()}
        return Chunk(self.point, stream, time_ns[new], own, calibration)


def row_columns(estimate: Estimate, zero_m2: float) -> dict[str, NDArray[Any]]:
    """The columns that rows are kept as: displacement exactly, deviations and velocity in steps of STEP."""
    return {
        SHOWN: estimate.displacement_m,
        "std_m": _in_steps(np.sqrt(estimate.variance_m2)),
        "velocity_m_s": _in_steps(estimate.velocity_m_s),
        "source": estimate.source,
        "status": estimate.status,
        "zero_std_m": _in_steps(np.full(len(estimate.time_ns), np.sqrt(zero_m2))),
    }


def _in_steps(values: Floats) -> Floats:
    return np.asarray(STEP * np.rint(values / STEP))


def raw_columns(records: Sequence[Readings | RangeFrame]) -> tuple[Nanoseconds, dict[str, NDArray[Any]]]:
    """Stamps (n,) and columns of raw records of one stream."""
    if isinstance(records[0], Readings):
        blocks = [one for one in records if isinstance(one, Readings)]
        value = np.concatenate([one.value.reshape(len(one.time_ns), -1) for one in blocks])
        return np.concatenate([one.time_ns for one in blocks]), {"value": value[:, 0] if value.shape[1] == 1 else value}
    frames = [one for one in records if isinstance(one, RangeFrame)]
    time_ns = np.array([one.time_ns for one in frames], dtype=np.int64)
    phasors = np.stack([one.phasors.reshape(-1) for one in frames])
    return time_ns, {"phasors": phasors, "valid": np.stack([one.valid for one in frames])}
