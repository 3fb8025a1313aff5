"""What is kept of a point: its raw records, what its sensors found in them, its rows and events, as chunks.

Rows count from the zero in force, and a point that is lost gives none after a while: a gap is a gap.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.engine.point import Output
from midspan.engine.sensors import Seen
from midspan.fusion.blocks import Rows
from midspan.records import (
    NANOSECONDS,
    Arrival,
    Estimate,
    Event,
    Floats,
    Nanoseconds,
    PixelTranslation,
    RangeFrame,
    Readings,
    Status,
    joined,
    part,
)
from midspan.service.row_health import RowHealth
from midspan.service.zero import Zero
from midspan.store.chunk import Chunk
from midspan.store.store import Batch

ROWS, SHOWN = "rows", "displacement_m"
# Deviations and velocities of rows are kept in steps of 0.12 nm (and nm/s), far below any noise: with all bits a
# store of rows would be half as large again.
STEP = 2.0**-33
# A point that is lost gives rows for so long, and none whose deviation is beyond so many times the motion that its
# calibration saw.
LOST_ROWS_S, LOST_MOTIONS = 30.0, 10.0
# So long are the newest rows remembered, with which the next opening of the point is compared.
RECENT_S = 30.0
NEW_DATUM = "new_datum"
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


@dataclass(frozen=True, slots=True)
class KeptRows:
    """Rows of each axis, and the variance of each axis's zero in them."""

    estimates: tuple[Estimate, ...]
    zero_m2: tuple[float, ...]

    def since(self, after_ns: int) -> "KeptRows":
        """Those after an instant."""
        return KeptRows(tuple(part(one, one.time_ns > after_ns) for one in self.estimates), self.zero_m2)

    def counted_from(self, zero: Zero) -> "KeptRows":
        """The same with those of the main axis counted from an earlier zero."""
        main = zero.shift(self.estimates[0], self.zero_m2[0])
        return KeptRows((main, *self.estimates[1:]), (zero.variance_m2, *self.zero_m2[1:]))


class Journal:
    """Collects what came and what was given since it was last emptied.

    early_ns: what is taken from the common clock's stamps to get each sensor's own; axes: names of the image axes that
    rows are made for, the main one first (none: one axis without a name); calibration: its number in the store.
    motion_m: standard deviation of the displacement that the calibration saw; 0 where that is not known.
    """

    def __init__(
        self,
        point: str,
        early_ns: Mapping[str, int],
        *,
        axes: Sequence[str] = (),
        calibration: int = 0,
        motion_m: float = 0.0,
    ) -> None:
        self.point, self.calibration = point, calibration
        self._early_ns, self._axes = dict(early_ns), ("", *axes[1:])
        self._max_std_m = LOST_MOTIONS * motion_m if motion_m > 0.0 else math.inf
        self._raw: list[Arrival] = []
        self._found: dict[str, list[tuple[PixelTranslation, ...]]] = {}
        self._rows: list[KeptRows] = []
        # How many of them `fresh` has given.
        self._given = 0
        self._events: list[Event] = []
        # Variance of the zero along each axis, as last given.
        self._zero_m2: tuple[float, ...] = (0.0, 0.0)
        # The zero in force where it is another one than the estimator's.
        self._zero: Zero | None = None
        # Why the first row that comes counts from a new zero; nothing where it does not.
        self._new_datum = ""
        # The first of the newest rows that are lost.
        self._lost_ns: int | None = None
        self._recent: list[Estimate] = []
        # Rows up to here are another journal's.
        self._after_ns: int | None = None
        self.health = RowHealth()

    @property
    def memory(self) -> dict[str, Any]:
        """What a restart needs, as plain values."""
        zero = None if self._zero is None else [self._zero.offset_m, self._zero.variance_m2]
        usual = [self.health.usual_m, self.health.count] if self.health.count else None
        return {"zero": zero, "lost_ns": self._lost_ns, "usual": usual, "new_datum": self._new_datum}

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Go on from where `memory` was read."""
        zero, usual = memory.get("zero"), memory.get("usual")
        self._zero = None if zero is None else Zero(float(zero[0]), float(zero[1]))
        self._lost_ns, self._new_datum = memory.get("lost_ns"), memory.get("new_datum", "")
        if usual is not None:
            self.health = RowHealth(usual_m=float(usual[0]), count=int(usual[1]))

    @property
    def zero(self) -> Zero:
        """The zero in force: what is added to the estimator's rows, and its variance."""
        return self._zero or Zero(0.0, self._zero_m2[0])

    @property
    def recent(self) -> Estimate | None:
        """The newest rows along the main axis; None before the first."""
        return joined(self._recent) if self._recent else None

    def continue_after(self, last_ns: int, zero: Zero | None) -> None:
        """Keep only what is later than another journal's newest row, and count rows from that one's zero."""
        self._after_ns = last_ns
        later = [rows.since(last_ns) for rows in self._rows]
        self._rows = [
            rows if zero is None else rows.counted_from(zero) for rows in later if len(rows.estimates[0].time_ns)
        ]
        self._recent = [rows.estimates[0] for rows in self._rows]
        self._events = [event for event in self._events if event.time_ns > last_ns]
        self._zero = zero

    def announce_new_datum(self, why: str) -> None:
        """Let an event mark the first row that is still to be kept: it counts from a zero of its own."""
        self._new_datum = why
        if self._rows:
            self._mark(self._rows[0].estimates[0])

    def arrived(self, record: object) -> None:
        """Keep a raw record, before the engine has judged it; frames are kept as what is found in them."""
        if isinstance(record, Arrival) and isinstance(record.record, Readings | RangeFrame):
            self._raw.append(record)

    def given(self, outputs: Iterable[Output]) -> None:
        """Keep what a push gave."""
        for output in outputs:
            if isinstance(output, Rows):
                self._take(output)
                self._tell(output.events)
            elif isinstance(output, Event):
                self._tell([output])
            elif isinstance(output, Seen):
                self._tell(output.events)
                found = tuple(one for one in output.found if isinstance(one, PixelTranslation))
                if found:
                    self._found.setdefault(output.sensor, []).append(found)

    def _tell(self, events: Sequence[Event]) -> None:
        self._events += events
        self.health = self.health.after_events(events)

    def _take(self, rows: Rows) -> None:
        """Keep rows as they are given out: from the zero in force, and none of a point that is lost for long."""
        self._zero_m2 = rows.zero_variance_m2 or self._zero_m2
        if not rows.estimates or not len(rows.estimates[0].time_ns):
            return
        kept = KeptRows(rows.estimates, self._zero_m2)
        kept = kept if self._after_ns is None else kept.since(self._after_ns)
        kept = kept if self._zero is None else kept.counted_from(self._zero)
        shown, self._lost_ns = with_reason(kept.estimates[0], self._lost_ns, self._max_std_m)
        kept = kept if shown.all() else replace(kept, estimates=tuple(part(one, shown) for one in kept.estimates))
        main = kept.estimates[0]
        if not len(main.time_ns):
            return
        if self._new_datum:
            self._mark(main)
        self._rows.append(kept)
        self.health = self.health.after_rows(main)
        self._recent.append(main)
        old_ns = int(main.time_ns[-1]) - round(RECENT_S * NANOSECONDS)
        while self._recent[0].time_ns[-1] < old_ns:
            self._recent.pop(0)

    def _mark(self, rows: Estimate) -> None:
        text = f"The displacement counts from a new zero from here on: {self._new_datum}"
        self._tell([Event(int(rows.time_ns[0]), NEW_DATUM, text)])
        self._new_datum = ""

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
        return [one for one in found if one is not None]

    def _rows_along(self, number: int, axis: str, given: Sequence[KeptRows]) -> Chunk | None:
        """Rows along one axis as a chunk."""
        if not given:
            return None
        columns = [row_columns(rows.estimates[number], rows.zero_m2[number]) for rows in given]
        together = {name: np.concatenate([one[name] for one in columns]) for name in columns[0]}
        time_ns = np.concatenate([rows.estimates[number].time_ns for rows in given])
        return Chunk(self.point, rows_stream(axis), time_ns, together, self.calibration, SHOWN)

    def _chunk(self, stream: str, time_ns: Nanoseconds, columns: dict[str, NDArray[Any]]) -> Chunk:
        """Raw rows with increasing stamps: a clock that ran back is in the events, and what it repeated is not kept."""
        newest = np.maximum.accumulate(time_ns)
        new = np.concatenate(([True], time_ns[1:] > newest[:-1]))
        # The calibration chooses a radar's bins: before there is one, whole profiles come.
        calibration = self.calibration if "phasors" in columns else 0
        own = {name: value[new] for name, value in columns.items()}
        return Chunk(self.point, stream, time_ns[new], own, calibration)


def with_reason(rows: Estimate, lost_ns: int | None, max_std_m: float) -> tuple[NDArray[np.bool_], int | None]:
    """Which rows (n,) are given out: none that is lost for longer than LOST_ROWS_S, or lost and less certain than
    `max_std_m`; and the stamp of the first of the newest rows that are lost, None where they are not.

    lost_ns: the same before these rows.
    """
    lost = rows.status == Status.LOST
    if not lost.any():
        return np.ones(len(lost), dtype=np.bool_), lost_ns if not len(lost) else None
    begins = lost & ~np.concatenate(([lost_ns is not None], lost[:-1]))
    since_ns = np.maximum.accumulate(np.where(begins, rows.time_ns, lost_ns if lost_ns is not None else 0))
    lasting = rows.time_ns - since_ns > round(LOST_ROWS_S * NANOSECONDS)
    shown = ~(lost & (lasting | (rows.variance_m2 > max_std_m**2)))
    return shown, int(since_ns[-1]) if lost[-1] else None


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
