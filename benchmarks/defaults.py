"""Our default against the method as printed: every scene of the papers, by the public command.

Each row is a scene and a seed: `simulate`, `estimate`, `estimate --paper`; the error as it is (plain) and without its
mean, and rows inside ±1.96 standard deviations. `--seeds N`, `--scenes NAME …`, `--csv FILE` (kept and gone on with).
"""

import argparse
import csv
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.table import goal, show
from midspan.cli.main import run
from midspan.papers.scenes import NOISY, PAPER_NAMES

HEAD = ("scene", "seed", "plain", "shape", "inside", "printed_plain", "printed_shape", "printed_inside")
Row = list[object]


def columns(path: Path, *names: str) -> list[np.ndarray]:
    """Columns of a table by the beginning of their names, NaN where empty."""
    with path.open() as file:
        rows = csv.reader(file)
        head = next(rows)
        places = [next(k for k, name in enumerate(head) if name.startswith(wanted)) for wanted in names]
        kept = [[float(row[k] or "nan") for k in places] for row in rows]
    return list(np.array(kept).T)


def errors(result: Path, truth: Path) -> list[float]:
    """RMSE in mm, RMSE without the mean, share inside; NaN where there is no result."""
    if not result.exists():
        return [np.nan] * 3
    true_s, true_mm = columns(truth, "time", "displacement")
    time_s, value_mm, std_mm = columns(result, "time_s", "displacement_mm", "displacement_std_mm")
    error = value_mm - np.interp(time_s, true_s, true_mm)
    return [float(np.sqrt(np.mean(error**2))), float(np.std(error)), float(np.mean(np.abs(error) <= 1.96 * std_mm))]


def measured(name: str, seed: int) -> Row:
    """The errors of both on one scene."""
    with tempfile.TemporaryDirectory() as place:
        recording = Path(place) / "recording"
        run(["simulate", name, "-o", str(recording), "--seed", str(seed), "--quiet"])
        both = []
        for more in ([], ["--paper", name[:3]]):
            result = recording / f"result{len(more)}.csv"
            run(["estimate", str(recording), "-o", str(result), "--quiet", *more])
            both += errors(result, recording / "truth.csv")
    return [name, seed, *both]


def rows_of(path: Path | None) -> list[Row]:
    """What an earlier run has kept."""
    if path is None or not path.exists():
        return []
    with path.open() as file:
        return [[row[0], int(row[1]), *map(float, row[2:])] for row in csv.reader(file) if row[0] != HEAD[0]]


def worse(row: Row) -> bool:
    """Whether the default has no result, or errs more than the printed method, which has one."""
    plain, shape, _, printed_plain, printed_shape, _ = (float(str(value)) for value in row[2:])
    return bool(np.isfinite(printed_plain) and not (plain <= printed_plain and shape <= printed_shape))


def main() -> None:
    """Run what is not kept yet, then show everything."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.defaults")
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--scenes", nargs="*", default=[name for name in PAPER_NAMES if not name.endswith(NOISY)])
    parser.add_argument("--csv", type=Path)
    args, _ = parser.parse_known_args()
    rows = rows_of(args.csv)
    done = {(row[0], row[1]) for row in rows}
    for seed in range(args.seeds):
        for name in args.scenes:
            if (name, seed) not in done:
                rows.append(measured(name, seed))
                if args.csv is not None:
                    with args.csv.open("a", newline="") as file:
                        csv.writer(file).writerow(rows[-1])
    show(HEAD, sorted(rows, key=str))
    goal("scenes and seeds in which the default errs more", float(sum(map(worse, rows))), 0.0)


if __name__ == "__main__":
    main()
