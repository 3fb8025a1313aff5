"""Is the error band honest, and are refusals right? Recordings that obey the model and recordings that break it."""

import argparse
import csv
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from benchmarks.honest.kinds import KINDS, Kind, Truth
from benchmarks.table import goal, show

PROCESSES = 2
METHODS = ("smoother", "kalman")
MIN_INSIDE, WORST_Z = 0.85, 8.0  # of a recording that is called ok
# What a result of a displacement sensor says of slow errors that its record cannot tell from motion.
UNSEEN = re.compile(r"A slow error,.* of up to ([\d.e+-]+) mm in 10 s would not show")
# A sensor without a zero of its own has one error common to all rows, often most of the band: one honest recording of
# twenty has it beyond 1.96 standard deviations, and with it every row. Up to the bound that one of a thousand exceeds
# the rows are judged without their mean as well.
WORST_ZERO_Z = 3.3
SCALES = {
    "camera": ("scale_mm_per_px", "scale_std_mm_per_px"),
    "infrared": ("scale_mm_per_px", "scale_std_mm_per_px"),
    "radar": ("conversion_factor", "conversion_factor_std"),
}


@dataclass(frozen=True)
class Outcome:
    """What one method made of one recording; worst is the largest |error| in standard deviations.

    refused: the message where there is no result; z_scale, z_offset, z_zero: error over stated deviation (NaN: none);
    the zero's error is the mean of all rows, which is right as far as the zero's deviation is most of the band;
    inside_moved: rows inside after that mean is taken off; stated: 1 where the result says that a slow error as large
    as the true one would not show and is not in its band; warnings are without that sentence, which others have too.
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
    warnings: str = ""
    refused: str = ""

    @property
    def held(self) -> bool:
        """Whether there is a result whose band holds the truth."""
        return not self.refused and self.least_inside >= MIN_INSIDE and self.worst <= WORST_Z

    @property
    def ok(self) -> bool:
        """Whether the band holds the truth, says by how much it cannot, or it was refused for its true cause."""
        return self.held or bool(self.stated) or rightly(self)

    @property
    def least_inside(self) -> float:
        """The share of rows inside that is held against the recording."""
        return max(self.inside, self.inside_moved) if abs(self.z_zero) <= WORST_ZERO_Z else self.inside

    @property
    def silent(self) -> bool:
        """Whether there is a result whose band does not hold the truth, without a warning."""
        return not self.refused and not self.held and not self.stated and not self.warnings


def measured(kind: Kind, seed: int, folder: Path) -> list[Outcome]:
    """Write one recording and estimate it with each method."""
    import midspan
    from midspan.errors import MidspanError

    truth, found = kind.write(seed, folder), []
    for method in METHODS:
        try:
            result = midspan.estimate(folder, method=method)
        except MidspanError as refusal:
            said = str(refusal).replace(str(folder) + "/recording.toml: ", "").replace("\n", " ")
            found.append(Outcome(kind.label, seed, method, refused=said))
            continue
        error, std = result.displacement_mm - truth.displacement_mm(result.time_s), result.displacement_std_mm
        known = np.isfinite(error)
        error, std = error[known], std[known]
        z, moved = np.abs(error / std), np.abs((error - np.mean(error)) / std)
        scale, offset = _calibrated(kind.family, truth, result.calibration.to_dict())
        zero = float(np.mean(error) / (result.metadata()["zero_std_mm"] or np.nan))
        shares = [float(np.mean(one < 1.96)) for one in (z, moved)]
        unseen = [UNSEEN.search(one) for one in result.warnings]
        stated = any(one is not None and 0.0 < truth.drift_mm <= float(one[1]) for one in unseen)
        figures = (len(z), shares[0], float(np.max(z)), scale, offset, zero, shares[1], int(stated))
        said = [text for text, one in zip(result.warnings, unseen, strict=True) if one is None]
        found.append(Outcome(kind.label, seed, method, *figures, warnings=" | ".join(said)))
    return found


def _calibrated(family: str, truth: Truth, tree: dict[str, dict[str, float]]) -> tuple[float, float]:
    """z of scale and offset."""
    section, names = ("accelerometer", ("scale", "scale_std")) if family == "displacement" else (family, SCALES[family])
    value, std = (tree[section].get(name) for name in names)
    scale = (value - truth.scale) / std if value is not None and std else np.nan
    value, std = (tree[family].get(name) for name in ("time_offset_s", "time_offset_std_s"))
    return scale, (value - truth.offset_s) / std if value is not None and std else np.nan


def run_here(kinds: Sequence[Kind], options: argparse.Namespace) -> None:
    """Measure every PROCESSES-th recording from number `options.part` on; each outcome is written as it comes."""
    tasks = [(kind, seed) for kind in kinds for seed in seeds(kind, options)]
    with open(options.table, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Outcome)])
        writer.writeheader()
        for kind, seed in tasks[options.part :: PROCESSES]:
            with tempfile.TemporaryDirectory() as name:
                folder = Path(options.keep or name) / f"{kind.label}-{seed}"
                folder.mkdir(parents=True, exist_ok=True)
                writer.writerows(asdict(one) for one in measured(kind, seed, folder))
            file.flush()


def seeds(kind: Kind, options: argparse.Namespace) -> Sequence[int]:
    """The seeds of a kind's recordings."""
    return options.seed or range(1 if options.quick else kind.count)


def run_apart(folder: Path) -> list[Outcome]:
    """Run the same command line in PROCESSES processes of one thread each, and read what they wrote."""
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    folder.mkdir(parents=True, exist_ok=True)
    tables = [folder / f"{part}.csv" for part in range(PROCESSES)]
    command = [sys.executable, "-m", "benchmarks.honesty", *(word for word in sys.argv[1:] if word != "honesty")]
    children = [
        subprocess.Popen([*command, "--part", str(part), "--table", str(table)], env=os.environ | one_thread)
        for part, table in enumerate(tables)
    ]
    codes = [child.wait() for child in children]
    if any(codes):
        raise SystemExit("a process of the benchmark ended with an error")
    found = [one for table in tables for one in read(table)]
    return sorted(found, key=lambda one: (one.kind, one.seed, one.method))


def read(table: Path) -> list[Outcome]:
    """The outcomes in a table."""
    makers = {"int": int, "float": float, "str": str, int: int, float: float, str: str}
    with open(table, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return [Outcome(**{field.name: makers[field.type](row[field.name]) for field in fields(Outcome)}) for row in rows]


def rightly(one: Outcome) -> bool:
    """Whether it was refused for its true cause."""
    cause = next(kind.cause for kind in KINDS if kind.label == one.kind)
    return bool(one.refused) and cause is not None and re.search(cause, one.refused, re.IGNORECASE) is not None


def _inside(found: Iterable[Outcome]) -> float:
    """Rows inside, all recordings together."""
    kept = [one for one in found if not one.refused]
    return float(np.average([one.inside for one in kept], weights=[one.rows for one in kept])) if kept else np.nan


def _rms(values: Iterable[float]) -> float:
    known = np.array([value for value in values if np.isfinite(value)])
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan


def recordings(found: Sequence[Outcome]) -> list[list[Outcome]]:
    """The outcomes of each recording together."""
    groups: dict[tuple[str, int], list[Outcome]] = {}
    for one in found:
        groups.setdefault((one.kind, one.seed), []).append(one)
    return list(groups.values())


def row_of(name: str, found: Sequence[Outcome]) -> list[object]:
    """One line of the table: a kind, or several kinds together."""
    whole = recordings(found)
    share = np.mean([all(one.ok for one in both) for both in whole])
    smooth = [one for one in found if one.method == METHODS[0]]
    return [
        name,
        len(whole),
        *(100 * _inside(one for one in found if one.method == method) for method in METHODS),
        100 * float(share),
        sum(any(one.silent for one in both) for both in whole),
        sum(any(one.stated and not one.held for one in both) for both in whole),
        max((one.worst for one in found if not one.refused), default=np.nan),
        sum(any(rightly(one) for one in both) for both in whole),
        sum(any(one.refused and not rightly(one) for one in both) for both in whole),
        _rms(one.z_scale for one in smooth),
        _rms(one.z_offset for one in smooth),
        _rms(one.z_zero for one in smooth),
    ]


HEAD = (
    "kind",
    "n",
    "inside %",
    "kalman %",
    "ok %",
    "silent",
    "stated",
    "worst z",
    "refused",
    "wrongly",
    "scale z",
    "offset z",
    "zero z",
)


def report(found: Sequence[Outcome]) -> None:
    """Print the table, what was not held, what was refused, and the goals."""
    breaking = {kind.label for kind in KINDS if kind.cause is not None}
    obeyed, broken = ([one for one in found if (one.kind in breaking) == side] for side in (False, True))
    rows = [
        row_of(label, [one for one in found if one.kind == label]) for label in dict.fromkeys(o.kind for o in obeyed)
    ]
    rows += [row_of(label, [o for o in broken if o.kind == label]) for label in dict.fromkeys(o.kind for o in broken)]
    rows += [row_of(name, part) for name, part in (("ALL OBEYING", obeyed), ("ALL BREAKING", broken)) if part]
    show(HEAD, rows)
    print("\nNot held (inside below 85 %, or a row beyond 8 standard deviations):")
    lost = [one for one in found if not one.refused and not one.held and not one.stated]
    show(
        ("kind", "seed", "method", "inside %", "worst z", "scale z", "warned"),
        [(o.kind, o.seed, o.method, 100 * o.inside, o.worst, o.z_scale, o.warnings[:70] or "no") for o in lost],
    )
    print("\nRefused:")
    for one in found:
        if one.refused and one.method == METHODS[0]:
            print(f"{one.kind} {one.seed} {'' if rightly(one) else '(cause not named) '}{one.refused[:200]}")
    print()
    if obeyed:
        _obeying_goals(obeyed)
    if broken:
        share = np.mean([all(one.ok for one in both) for both in recordings(broken)])
        goal("breaking: held, stated, or refused with its cause", 100 * float(share), 90, unit="%", at_least=True)
        goal("breaking: z of scale and offset, rms", _rms([z for o in broken for z in (o.z_scale, o.z_offset)]), 1.2)


def _obeying_goals(found: Sequence[Outcome]) -> None:
    for method in METHODS:
        inside = 100 * _inside(one for one in found if one.method == method)
        goal(f"obeying, {method}: inside", inside, 93, unit="%", at_least=True)
        goal(f"obeying, {method}: inside", inside, 97, unit="%")
    least = min((one.least_inside for one in found if not one.refused), default=np.nan)
    goal("obeying: least inside of a recording", 100 * least, 85, unit="%", at_least=True)
    goal("obeying: refused", 100 * float(np.mean([bool(one.refused) for one in found])), 1, unit="%")
    goal("obeying: z of scale and offset, rms", _rms([z for o in found for z in (o.z_scale, o.z_offset)]), 1.2)


def main() -> None:
    """`python -m benchmarks honesty [--quick]`; alone (`python -m benchmarks.honesty`) also with the other options."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.honesty", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one recording of each kind")
    parser.add_argument("--only", default="", help="kinds whose name holds this pattern")
    parser.add_argument("--seed", type=int, action="append", help="this seed alone; may be repeated")
    parser.add_argument("--table", help=argparse.SUPPRESS)
    parser.add_argument("--keep", help="folder in which recordings and outcomes stay")
    parser.add_argument("--part", type=int, help=argparse.SUPPRESS)
    options, _ = parser.parse_known_args()
    if options.part is not None:
        run_here([kind for kind in KINDS if re.search(options.only, kind.label)], options)
        return
    with tempfile.TemporaryDirectory() as name:
        found = run_apart(Path(options.keep or name))
    report(found)


if __name__ == "__main__":
    main()
