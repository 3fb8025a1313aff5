"""What the benchmark prints: its outcomes a kind, what was not held, what was refused, and the goals."""

from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from benchmarks.honest.judge import METHODS, VERDICTS, Outcome, rightly, rms
from benchmarks.honest.kinds import KINDS, UNSEEN
from benchmarks.table import goal, show

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
OWN_ERRORS = ("camera-mast", "camera-haze", "camera-breathe", "camera-grow", "infrared-reflection")


def report(found: Sequence[Outcome]) -> None:
    """Print the tables, what was not held, what was refused, and the goals."""
    breaking = {kind.label for kind in KINDS if kind.cause is not None}
    outdoors = {kind.label for kind in KINDS if kind.outdoors}
    obeyed = [one for one in found if one.kind not in breaking]
    broken = [one for one in found if one.kind in breaking and one.kind not in outdoors]
    outside = [one for one in found if one.kind in breaking and one.kind in outdoors]
    groups = (("ALL OBEYING", obeyed), ("ALL BREAKING", broken), ("ALL OUTDOORS", outside))
    rows = [row for _, part in groups for row in _rows(part)]
    show(HEAD, rows + [row_of(name, part) for name, part in groups if part])
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
    _verdicts(found)
    _own_errors(found)
    _totals(found)
    print()
    if obeyed:
        _obeying_goals(obeyed)
    if broken:
        share = np.mean([all(one.ok for one in both) for both in recordings(broken)])
        goal("breaking: held, stated, or refused with its cause", 100 * float(share), 90, unit="%", at_least=True)
        goal("breaking: z of scale and offset, rms", rms([z for o in broken for z in (o.z_scale, o.z_offset)]), 1.2)
    if outside:
        share = np.mean([all(one.ok for one in both) for both in recordings(outside)])
        goal("outdoors: held, stated, or refused with its cause", 100 * float(share), 90, unit="%", at_least=True)


def _rows(found: Sequence[Outcome]) -> list[list[object]]:
    return [
        row_of(label, [one for one in found if one.kind == label]) for label in dict.fromkeys(o.kind for o in found)
    ]


def _inside(found: Iterable[Outcome]) -> float:
    """Rows inside, all recordings together."""
    kept = [one for one in found if not one.refused]
    return float(np.average([one.inside for one in kept], weights=[one.rows for one in kept])) if kept else np.nan


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
        rms(one.z_scale for one in smooth),
        rms(one.z_offset for one in smooth),
        rms(one.z_zero for one in smooth),
    ]


def _verdicts(found: Sequence[Outcome]) -> None:
    """How each kind ended, a method at a time, with rms error and mean deviation of what gave rows."""
    print("\nVerdicts, smoother/kalman (error: rms of the recordings' errors; sigma: mean deviation):")
    rows = []
    for label in dict.fromkeys(one.kind for one in found):
        parts = [[one for one in found if one.kind == label and one.method == method] for method in METHODS]
        counts = [Counter(one.verdict for one in part) for part in parts]
        sizes = [f"{_short(rms(o.error_mm for o in p))}/{_short(_mean(o.std_mm for o in p))}" for p in parts]
        seconds = _mean(one.seconds for one in found if one.kind == label)
        rows.append((label, *("/".join(str(c[name]) for c in counts) for name in VERDICTS), *sizes, seconds))
    show(("kind", *VERDICTS, "smoother error/sigma mm", "kalman error/sigma mm", "s"), rows)


def _own_errors(found: Sequence[Outcome]) -> None:
    """Cameras with an error of their own, and GNSS while its solution converges: each recording."""
    chosen = [o for o in found if o.kind in OWN_ERRORS and not o.refused]
    if chosen:
        print("\nCameras with an error of their own:")
        head = ("kind", "seed", "method", "inside %", "worst z", "error mm", "sigma mm")
        show(head, [(o.kind, o.seed, o.method, 100 * o.inside, o.worst, o.error_mm, o.std_mm) for o in chosen])
    chosen = [o for o in found if np.isfinite(o.inside_stretch)]
    if chosen:
        print("\nRows inside while the solution converges:")
        show(
            ("kind", "seed", "method", "inside %"), [(o.kind, o.seed, o.method, 100 * o.inside_stretch) for o in chosen]
        )


def _totals(found: Sequence[Outcome]) -> None:
    """Counts of what must not be."""
    print("\nRecordings that (smoother/kalman):")
    seen = [one for one in found if one.kind not in UNSEEN]
    for text, part, verdicts in (
        ("have a false band, silently (without what no record shows)", seen, ("silent",)),
        ("have a false band and a warning", found, ("told",)),
        ("are refused without their cause, or crash", found, ("wrongly",)),
        ("have a true band that is more than 3 times too wide", found, ("wide",)),
    ):
        counts = [sum(one.verdict in verdicts for one in part if one.method == method) for method in METHODS]
        print(f"  {text}: {'/'.join(map(str, counts))} of {len(recordings(part))}")


def _mean(values: Iterable[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else np.nan


def _short(value: float) -> str:
    return f"{value:.3g}"


def _obeying_goals(found: Sequence[Outcome]) -> None:
    for method in METHODS:
        inside = 100 * _inside(one for one in found if one.method == method)
        goal(f"obeying, {method}: inside", inside, 93, unit="%", at_least=True)
        goal(f"obeying, {method}: inside", inside, 97, unit="%")
    least = min((one.least_inside for one in found if not one.refused), default=np.nan)
    goal("obeying: least inside of a recording", 100 * least, 85, unit="%", at_least=True)
    goal("obeying: refused", 100 * float(np.mean([bool(one.refused) for one in found])), 1, unit="%")
    goal("obeying: z of scale and offset, rms", rms([z for o in found for z in (o.z_scale, o.z_offset)]), 1.2)
