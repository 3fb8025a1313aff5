"""What one method made of one recording, and whether its error band holds the truth."""

import csv
import re
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.honest.kinds import KINDS, Kind, Truth
from midspan.records import Floats

METHODS = ("smoother", "kalman")
MIN_INSIDE, WORST_Z = 0.85, 8.0  # of a recording that is called ok
MAX_WIDE = 3.0  # mean standard deviation over rms error, above which a true band is of little use
# What a result of a displacement sensor says of slow errors that its record cannot tell from motion.
UNSEEN_DRIFT = re.compile(r"a slow error .*of up to ([\d.e+-]+) mm in 10 s")
# A sensor without a zero of its own has one error common to all rows, often most of the band: one honest recording of
# twenty has it beyond 1.96 standard deviations, and with it every row. Up to the bound that one of a thousand exceeds
# the rows are judged without their mean as well.
WORST_ZERO_Z = 3.3
SCALES = {
    "camera": ("scale_mm_per_px", "scale_std_mm_per_px"),
    "infrared": ("scale_mm_per_px", "scale_std_mm_per_px"),
    "radar": ("conversion_factor", "conversion_factor_std"),
}
VERDICTS = ("held", "wide", "stated", "told", "silent", "refused", "wrongly")


@dataclass(frozen=True)
class Outcome:
    """What one method made of one recording; worst is the largest |error| in standard deviations.

    refused: the message where there is no result; z_scale, z_offset, z_zero: error over stated deviation (NaN: none);
    the zero's error is the mean of all rows, which is right as far as the zero's deviation is most of the band;
    inside_moved: rows inside after that mean is taken off; stated: 1 where the result says that a slow error as large
    as the true one would not show and is not in its band; warnings are without what others have too; error_mm: rms,
    std_mm: mean deviation; inside_stretch: rows inside while the trouble lasts (NaN: all the time); seconds: to
    estimate it.
    """

    kind: str
    seed: int
    method: str
    rows: int = 0
    inside: float = np.nan
    worst: float = np.nan
    z_scale: float = np.nan
    z_offset: float = np.nan
    z_zero: float = np.nan
    inside_moved: float = np.nan
    stated: int = 0
    error_mm: float = np.nan
    std_mm: float = np.nan
    inside_stretch: float = np.nan
    seconds: float = field(default=np.nan, compare=False)
    warnings: str = ""
    refused: str = ""

    @property
    def held(self) -> bool:
        """Whether there is a result whose band holds the truth."""
        return not self.refused and self.least_inside >= MIN_INSIDE and self.worst <= WORST_Z

    @property
    def ok(self) -> bool:
        """Whether the band holds the truth, says by how much it cannot, or it was refused for its true cause."""
        return self.verdict in ("held", "wide", "stated", "refused")

    @property
    def least_inside(self) -> float:
        """The share of rows inside that is held against the recording."""
        return max(self.inside, self.inside_moved) if abs(self.z_zero) <= WORST_ZERO_Z else self.inside

    @property
    def silent(self) -> bool:
        """Whether there is a result whose band does not hold the truth, without a warning."""
        return self.verdict == "silent"

    @property
    def verdict(self) -> str:
        """One of VERDICTS.

        wide: held, but the band is of little use; stated: not held, but the result says that such a slow error is not
        in it; told: not held, with a warning that recordings in which nothing is wrong do not have; refused: for its
        true cause; wrongly: for another, or by a crash.
        """
        if self.refused:
            return "refused" if rightly(self) else "wrongly"
        if self.held:
            return "wide" if self.std_mm > MAX_WIDE * self.error_mm else "held"
        if self.stated:
            return "stated"
        return "told" if self.warnings else "silent"


def rightly(one: Outcome) -> bool:
    """Whether it was refused for its true cause."""
    cause = next(kind.cause for kind in KINDS if kind.label == one.kind)
    return bool(one.refused) and cause is not None and re.search(cause, one.refused, re.IGNORECASE) is not None


def measured(kind: Kind, seed: int, folder: Path) -> list[Outcome]:
    """Write one recording and estimate it with each method."""
    truth = kind.write(seed, folder)
    return [_estimated(kind, seed, method, truth, folder) for method in METHODS]


def _estimated(kind: Kind, seed: int, method: str, truth: Truth, folder: Path) -> Outcome:
    import midspan
    from midspan.errors import MidspanError

    started = time.perf_counter()
    try:
        result = midspan.estimate(folder, method=method)
    except MidspanError as refusal:
        said = str(refusal).replace(str(folder) + "/recording.toml: ", "").replace("\n", " ")
        return Outcome(kind.label, seed, method, refused=said, seconds=time.perf_counter() - started)
    except Exception as crash:
        said = f"crash, {type(crash).__name__}: {crash}"
        return Outcome(kind.label, seed, method, refused=said, seconds=time.perf_counter() - started)
    seconds = time.perf_counter() - started
    shares = compared(result, truth)
    scale, offset = _calibrated(kind.family, truth, result.calibration.to_dict())
    unseen = [UNSEEN_DRIFT.search(one) for one in result.not_in_band]
    stated = any(one is not None and 0.0 < truth.drift_mm <= float(one[1]) for one in unseen)
    # Recordings in which nothing is wrong have that sentence, too: it is no warning.
    said = " | ".join(result.warnings)
    return Outcome(
        kind.label,
        seed,
        method,
        **shares,
        z_scale=scale,
        z_offset=offset,
        stated=int(stated),
        seconds=seconds,
        warnings=said,
    )


def compared(result: Any, truth: Truth) -> dict[str, Any]:
    """The fields of an Outcome that compare rows with the truth."""
    error, std = result.displacement_mm - truth.displacement_mm(result.time_s), result.displacement_std_mm
    known = np.isfinite(error)
    true_s, error, std = truth.true_s(result.time_s)[known], error[known], std[known]
    zero_z = float(np.mean(error) / (result.metadata()["zero_std_mm"] or np.nan))
    moved = error - np.mean(error)
    if truth.free_zero:
        error, zero_z = moved, np.nan
    z = np.abs(error / std)
    return {
        "rows": len(z),
        "inside": _share(z),
        "worst": float(np.max(z)),
        "z_zero": zero_z,
        "inside_moved": _share(np.abs(moved / std)),
        "error_mm": rms(error),
        "std_mm": float(np.mean(std)),
        "inside_stretch": _share(z[during(true_s, truth.stretch_s)]),
    }


def during(time_s: Floats, stretch_s: tuple[float, float] | None) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    """Which times (n,) are in a stretch; none where there is none."""
    start, end = stretch_s or (np.inf, np.inf)
    return np.asarray((time_s >= start) & (time_s < end))


def _share(z: Floats) -> float:
    return float(np.mean(z < 1.96)) if len(z) else np.nan


def rms(values: Iterable[float]) -> float:
    """Root of the mean square of those that are known."""
    known = np.array([value for value in values if np.isfinite(value)])
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan


def _calibrated(family: str, truth: Truth, tree: dict[str, dict[str, float]]) -> tuple[float, float]:
    """z of scale and offset."""
    section, names = ("accelerometer", ("scale", "scale_std")) if family == "displacement" else (family, SCALES[family])
    value, std = (tree[section].get(name) for name in names)
    scale = (value - truth.scale) / std if value is not None and std else np.nan
    value, std = (tree[family].get(name) for name in ("time_offset_s", "time_offset_std_s"))
    return scale, (value - truth.offset_s) / std if value is not None and std else np.nan


def write(table: Path, found: Sequence[Outcome]) -> None:
    """Write outcomes as CSV, one a row."""
    with open(table, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, ["verdict", *columns()])
        writer.writeheader()
        writer.writerows({"verdict": one.verdict, **{name: getattr(one, name) for name in columns()}} for one in found)


def read(table: Path) -> list[Outcome]:
    """The outcomes in a table."""
    makers = {"int": int, "float": float, "str": str, int: int, float: float, str: str}
    with open(table, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return [Outcome(**{field.name: makers[field.type](row[field.name]) for field in fields(Outcome)}) for row in rows]


def columns() -> list[str]:
    """Names of an outcome's fields."""
    return [field.name for field in fields(Outcome)]
