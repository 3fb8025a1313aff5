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
from midspan.store.chunk import Chunk
from midspan.store.store import Batch

# The usual deviation is the geometric mean over about this many of the newest rows that rest on measurements.
USUAL_ROWS = 60_000


@dataclass(frozen=True, slots=True)
class RowHealth:
    """newest_ns: stamp of the newest row, None before the first; std_m: its standard deviation; usual_m: the usual one
    of rows that rest on measurements, NaN before the first; count: of these, up to USUAL_ROWS.
    """

    newest_ns: int | None = None
    std_m: float = math.nan
    usual_m: float = math.nan
    count: int = 0

    def after_rows(self, rows: Estimate) -> "RowHealth":
        """After rows (n,) of the main axis."""
        if not len(rows.time_ns):
            return self
        std_m = np.sqrt(rows.variance_m2)
        good = std_m[(rows.status == Status.TRACKING) & (std_m > 0.0) & np.isfinite(std_m)]
        newest_m = float(std_m[-1])
        now = replace(self, newest_ns=int(rows.time_ns[-1]), std_m=newest_m)
        if not len(good):
            return now
        count = self.count + len(good)
        usual = math.log(self.usual_m) if self.count else 0.0
        usual += (float(np.mean(np.log(good))) - usual) * len(good) / count
        return replace(now, usual_m=math.exp(usual), count=min(count, USUAL_ROWS))


# The mean's variance is that of the means of this many segments: errors of rows are correlated over the filter's
# memory, which is below an eighth of what is compared. Of so few it is Student's, whose variance is (n - 1)/(n - 3)
# times it.
SEGMENTS = 8
# Rows that both must have: a tenth of a second a segment at 100 Hz.
MIN_COMMON_ROWS = 10 * SEGMENTS


@dataclass(frozen=True, slots=True)
class Zero:
    """What is added to rows (m) so that they count from an earlier zero, and the variance (m²) of that zero in them."""

    offset_m: float
    variance_m2: float

    def shift(self, rows: Estimate, own_m2: float) -> Estimate:
        """Rows that count from this zero; own_m2: variance of the zero that they counted from, which is in theirs."""
        variance_m2 = np.maximum(rows.variance_m2 - own_m2, 0.0) + self.variance_m2
        return Estimate(
            rows.time_ns, rows.displacement_m + self.offset_m, variance_m2, rows.velocity_m_s, rows.source, rows.status
        )


def carried(older: Estimate, newer: Estimate, zero: Zero, scale_std: float) -> Zero | None:
    """The zero in force for the rows of the new opening; None where too few rows of both rest on measurements.

    Rows of both openings, before the change: a(t) counts from the zero in force, b(t) from the new one. Both have the
    same errors of the sensors, so that d = mean(a - b) over the common rows is the distance of the zeros. Then b(t) + d
    counts from the zero in force: the error of the new zero cancels, and what is left is that of the zero in force, of
    d, and of the scale in force over the way from its zero to where the structure is.

    older: rows that count from the zero in force; newer: of the new opening, as it counts them. zero: in force, with
    what was added to the older rows. scale_std: relative standard deviation of the scale in force.
    """
    before, after = supported(older), supported(newer)
    _, of_older, of_newer = np.intersect1d(before.time_ns, after.time_ns, assume_unique=True, return_indices=True)
    if len(of_older) < MIN_COMMON_ROWS:
        return None
    apart = before.displacement_m[of_older] - after.displacement_m[of_newer]
    # The first rows of an opening are less certain than those after them.
    weight = 1.0 / (before.variance_m2[of_older] + after.variance_m2[of_newer])
    offset_m, mean_m2 = weighted_mean(apart, weight)
    way_m = float(np.average(before.displacement_m[of_older], weights=weight)) - zero.offset_m
    return Zero(offset_m, zero.variance_m2 + mean_m2 + (scale_std * way_m) ** 2)


def weighted_mean(values: Floats, weight: Floats) -> tuple[float, float]:
    """The mean of correlated values (n,) by their weights (n,), and its variance."""
    mean, whole = float(np.average(values, weights=weight)), float(np.sum(weight))
    parts = zip(np.array_split(values, SEGMENTS), np.array_split(weight, SEGMENTS), strict=True)
    shares = [(float(np.sum(w)) / whole, float(np.average(v, weights=w))) for v, w in parts]
    scatter = sum(share * (of_part - mean) ** 2 for share, of_part in shares) / (SEGMENTS - 1)
    return mean, scatter * (SEGMENTS - 1) / (SEGMENTS - 3)


def supported(rows: Estimate) -> Estimate:
    """The rows that rest on measurements."""
    good = (rows.status == Status.TRACKING) & np.isfinite(rows.displacement_m)
    return Estimate(*[getattr(rows, name)[good] for name in Estimate.__slots__])


ROWS, SHOWN = "rows", "displacement_m"
# Rows are kept in steps: displacements of 0.12 nm and velocities of 0.93 nm/s, as float32 has them at 1 mm and 10 mm/s;
# deviations of 0.47 nm, rounded up, so that no band becomes narrower. With all bits a store would be twice as large.
STEP, VELOCITY_STEP, STD_STEP = 2.0**-33, 2.0**-30, 2.0**-31
# A point that is lost gives rows for so long, and none whose deviation is beyond this many times the motion that its
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
    "zoom",
    "variance_zoom",
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
        self._motion_m = motion_m
        self._raw: list[Arrival] = []
        self._found: dict[str, list[tuple[PixelTranslation, ...]]] = {}
        # What was found of each camera's targets in its newest frame.
        self.newest: dict[str, tuple[PixelTranslation, ...]] = {}
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
                    self.newest[output.sensor] = found
                    self._found.setdefault(output.sensor, []).append(found)

    def _tell(self, events: Sequence[Event]) -> None:
        self._events += events

    def _take(self, rows: Rows) -> None:
        """Keep rows as they are given out: from the zero in force, and none of a point that is lost for long."""
        self._zero_m2 = rows.zero_variance_m2 or self._zero_m2
        if not rows.estimates or not len(rows.estimates[0].time_ns):
            return
        kept = KeptRows(rows.estimates, self._zero_m2)
        kept = kept if self._after_ns is None else kept.since(self._after_ns)
        kept = kept if self._zero is None else kept.counted_from(self._zero)
        limits = std_limits(self._motion_m, self.health.usual_m)
        shown, self._lost_ns = with_reason(kept.estimates[0], self._lost_ns, *limits)
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
        text = f"The displacement has a new zero from here on: {self._new_datum}"
        self._tell([Event(int(rows.time_ns[0]), NEW_DATUM, text)])
        self._new_datum = ""

    def batch(self) -> Batch:
        """Everything since the last time, to be written at once."""
        streams: dict[str, list[Readings | RangeFrame]] = {}
        for arrival in self._raw:
            assert isinstance(arrival.record, Readings | RangeFrame)
            streams.setdefault(arrival.stream, []).append(arrival.record)
        chunks = [self._chunk(stream, *raw_columns(records)) for stream, records in streams.items()]
        rows = [self._rows_along(number, axis, self._rows) for number, axis in enumerate(self._axes)]
        chunks += [*self._found_chunks(), *(one for one in rows if one is not None)]
        events = [(self.point, event) for event in self._events]
        self._raw, self._found, self._rows, self._events, self._given = [], {}, [], [], 0
        return Batch(chunks, events)

    def fresh(self) -> Chunk | None:
        """The rows along the main axis since the last time, which are kept all the same; None without any."""
        new, self._given = self._rows[self._given :], len(self._rows)
        return self._rows_along(0, "", new)

    def provisional(self, row: Estimate) -> Chunk | None:
        """A row (1,) that is not given out yet as it would be kept, from the zero in force; None where it is lost."""
        if row.status[-1] == Status.LOST:
            return None
        kept = KeptRows((row,), self._zero_m2)
        return self._rows_along(0, "", [kept if self._zero is None else kept.counted_from(self._zero)])

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


def std_limits(motion_m: float, usual_m: float) -> tuple[float, float]:
    """Standard deviations (m) above which lost rows, and any rows, are not given out: ten times the motion that the
    calibration saw, and of others than lost ones ten times the usual deviation as well.

    Rows as uncertain as that come in the first tenths of a second after a gap, and tell nothing. A sensor that
    is always as coarse keeps its rows. Where motion or usual deviation (NaN) are not known all are given.
    """
    lost_m = LOST_MOTIONS * motion_m if motion_m > 0.0 else math.inf
    return lost_m, math.inf if math.isnan(usual_m) else max(lost_m, LOST_MOTIONS * usual_m)


def with_reason(
    rows: Estimate, lost_ns: int | None, lost_std_m: float, max_std_m: float
) -> tuple[NDArray[np.bool_], int | None]:
    """Which rows (n,) are given out: none that is lost for longer than LOST_ROWS_S, or lost and less certain than
    `lost_std_m`, or less certain than `max_std_m`; and the stamp of the first of the newest rows that are lost, None
    where they are not.

    lost_ns: the same before these rows.
    """
    lost, shown = rows.status == Status.LOST, rows.variance_m2 <= max_std_m**2
    if not lost.any():
        return shown, lost_ns if not len(lost) else None
    begins = lost & ~np.concatenate(([lost_ns is not None], lost[:-1]))
    since_ns = np.maximum.accumulate(np.where(begins, rows.time_ns, lost_ns if lost_ns is not None else 0))
    lasting = rows.time_ns - since_ns > round(LOST_ROWS_S * NANOSECONDS)
    shown &= ~(lost & (lasting | (rows.variance_m2 > lost_std_m**2)))
    return shown, int(since_ns[-1]) if lost[-1] else None


def row_columns(estimate: Estimate, zero_m2: float) -> dict[str, NDArray[Any]]:
    """The columns that rows are kept as, in whole steps."""
    zero_m = np.full(len(estimate.time_ns), np.sqrt(zero_m2))
    return {
        SHOWN: STEP * np.rint(estimate.displacement_m / STEP),
        "std_m": STD_STEP * np.ceil(np.sqrt(estimate.variance_m2) / STD_STEP),
        "velocity_m_s": VELOCITY_STEP * np.rint(estimate.velocity_m_s / VELOCITY_STEP),
        "source": estimate.source,
        "status": estimate.status,
        "zero_std_m": STD_STEP * np.ceil(zero_m / STD_STEP),
    }


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
