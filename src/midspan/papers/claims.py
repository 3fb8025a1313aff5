"""What a repeated table or figure of a paper is: measured numbers, the claims about them, and whether they hold."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from midspan.records import Floats

Values = Mapping[str, float | Sequence[float] | Floats]


class Verdict(Enum):
    """What became of a claim."""

    HOLDS = "holds"
    FAILS = "does not hold"
    UNTRIED = "cannot be tried"


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is spent: the seed of everything random, and whether records are short and points few."""

    seed: int = 0
    quick: bool = False


@dataclass(frozen=True, slots=True)
class Curve:
    """A figure like the paper's own: named lines (x, y) in the same axes; dots: drawn as points; log: the y axis."""

    figure: str
    x: str
    y: str
    lines: Mapping[str, tuple[Floats, Floats]]
    log: bool = False
    dots: bool = False


@dataclass(frozen=True, slots=True)
class Measured:
    """What an experiment gave once: numbers by name, each one or one for each case, and its figures."""

    values: Values
    curves: tuple[Curve, ...] = ()


@dataclass(frozen=True, slots=True)
class Claim:
    """An inequality that holds in every case: left < factor · right; above: left > factor · right.

    left, right: names of measured numbers; without `right` the factor itself is the limit.
    """

    text: str
    left: str
    factor: float
    right: str = ""
    above: bool = False

    @classmethod
    def of(cls, text: str, inequality: str) -> "Claim":
        """From an inequality of measured names: "a < b", "a > 0.5 · b" or, with a limit, "a < 0.3"."""
        left, sign, limit = re.split(r" ([<>]) ", inequality)
        factor, _, right = limit.rpartition(" · ")
        if re.fullmatch(r"[\d.]+", right):
            factor, right = right, ""
        return cls(text, left, float(factor or 1.0), right, above=sign == ">")

    def holds(self, values: Mapping[str, Floats]) -> bool:
        """Whether the numbers, each an array over the cases, satisfy it; a number that is missing does not."""
        limit = self.factor * (values[self.right] if self.right else 1.0)
        return bool(np.all(values[self.left] > limit if self.above else values[self.left] < limit))


@dataclass(frozen=True, slots=True)
class Entry:
    """A table or figure of a paper: what it prints, the measured names to show for it, and its claims.

    where: "Fig. 14"; paper: the paper's own figure; printed, ours: names of measured numbers of the method as printed
    and of our default; a name that ends in "(…)" has a unit of its own. claims: words → inequality, as `Claim.of` takes
    them. errors: both are errors, those with a unit of their own excepted, so that the factor between their least can
    be given. because: why the claim does not hold here, or, without claims, why it cannot be tried;
    its first sentence, of at most eight words, stands in the table.
    """

    where: str
    what: str
    paper: str
    printed: tuple[str, ...] = ()
    ours: tuple[str, ...] = ()
    claims: Mapping[str, str] = field(default_factory=dict)
    unit: str = "mm"
    errors: bool = False
    because: str = ""


@dataclass(frozen=True, slots=True)
class Experiment:
    """Entries that one measurement gives. free: what the paper does not print, and what is chosen here.

    cleaner: the same measured with the noise of today's cameras, where `measure` has that of the paper's own errors.
    """

    paper: str
    name: str
    measure: Callable[[Effort], Measured]
    entries: tuple[Entry, ...]
    free: str = ""
    cleaner: Callable[[Effort], Measured] | None = None


@dataclass(frozen=True, slots=True)
class Row:
    """An entry with what was measured, mean over the seeds: texts to show, the verdict and the numbers themselves.

    factor: least error as printed over ours, below 1 where ours is worse; NaN where there are not both. cleaner: the
    same with less noise, where that was measured too.
    """

    paper: str
    entry: Entry
    printed: str
    ours: str
    verdict: Verdict
    why: str
    values: Mapping[str, Floats]
    factor: float = float("nan")
    cleaner: "Row | None" = None

    @property
    def with_less_noise(self) -> str:
        """What was measured with less noise, as printed and by default, and its verdict; empty where nothing was."""
        one = self.cleaner
        return "" if one is None else "; ".join((*filter(None, (one.printed, f"ours {one.ours}")), one.verdict.value))

    @property
    def brief(self) -> str:
        """The verdict in a few words, with that for less noise where it is another one."""
        if self.verdict is Verdict.HOLDS:
            less = self.cleaner is not None and self.cleaner.verdict is Verdict.FAILS
            return "yes; with less noise no" if less else "yes"
        reason = self.entry.because.split(". ")[0].rstrip(".")
        return f"{'no' if self.verdict is Verdict.FAILS else 'not tried'}: {reason}".rstrip(": ")

    @property
    def worse(self) -> bool:
        """Whether our default errs more than the best method as printed."""
        return self.factor < 1.0

    @property
    def compared(self) -> str:
        """Our error over the least one as printed, in words; empty where there are not both."""
        if np.isnan(self.factor):
            return ""
        if self.factor == 0.0:
            return "WORSE: lost"
        return f"WORSE: {1.0 / self.factor:.3g} times more" if self.worse else f"{self.factor:.3g} times less"

    def to_dict(self) -> dict[str, object]:
        """For scripts."""
        return {
            "paper": self.paper,
            "where": self.entry.where,
            "what": self.entry.what,
            "published": self.entry.paper,
            "as_printed": self.printed,
            "our_default": self.ours,
            "verdict": self.verdict.value,
            "why": self.why,
            "factor": self.factor,
            "worse": self.worse,
            "with_less_noise": self.with_less_noise,
            "values": {name: value.tolist() for name, value in self.values.items()},
            "claims": {claim.text: claim.holds(self.values) for claim in _claims(self.entry)},
        }


def mean_of(found: Sequence[Measured]) -> dict[str, Floats]:
    """Each number's mean over the seeds, as arrays over the cases."""
    return {
        name: np.mean([np.atleast_1d(np.asarray(one.values[name], dtype=np.float64)) for one in found], axis=0)
        for name in (found[0].values if found else ())
    }


def judged(experiment: Experiment, found: Sequence[Measured], cleaner: Sequence[Measured] = ()) -> list[Row]:
    """The experiment's rows; an experiment that was not run has entries that cannot be tried."""
    values, less = mean_of(found), mean_of(cleaner)
    return [
        replace(
            _row(experiment.paper, entry, values),
            cleaner=_row(experiment.paper, entry, less) if less else None,
        )
        for entry in experiment.entries
    ]


def _claims(entry: Entry) -> list[Claim]:
    return [Claim.of(*item) for item in entry.claims.items()]


def _row(paper: str, entry: Entry, values: dict[str, Floats]) -> Row:
    claims = _claims(entry)
    names = {*entry.printed, *entry.ours} | {name for claim in claims for name in (claim.left, claim.right)}
    own = {name: value for name, value in values.items() if name in names}
    shown, ours = (_shown(part, own, entry) for part in (entry.printed, entry.ours))
    if not claims:
        return Row(paper, entry, shown, ours, Verdict.UNTRIED, entry.because, own)
    failed = [claim.text for claim in claims if not claim.holds(own)]
    why = f"not that {'; '.join(failed)}. {entry.because}".rstrip() if failed else "; ".join(entry.claims)
    verdict = Verdict.FAILS if failed else Verdict.HOLDS
    return Row(paper, entry, shown, ours, verdict, why, own, _factor(entry, own))


def _factor(entry: Entry, values: Mapping[str, Floats]) -> float:
    """Least error as printed over ours; 0 where ours is no number in any case, though a printed one is."""
    if not (entry.errors and entry.printed and entry.ours):
        return float("nan")
    printed, ours = (
        [float(np.mean(values[name])) for name in part if not _own_unit(name)] for part in (entry.printed, entry.ours)
    )
    if np.isfinite(printed).any() and not np.isfinite(ours).any():
        return 0.0
    return float(np.nanmin(printed) / np.nanmin(ours)) if np.isfinite(printed).any() else float("nan")


def _own_unit(name: str) -> str:
    """The unit in a name like "share (%)"; empty where there is none."""
    found = re.search(r" \(([^()]+)\)$", name)
    return found.group(1) if found else ""


def _without_unit(name: str) -> str:
    return name.removesuffix(f" ({_own_unit(name)})")


def _shown(names: Sequence[str], values: Mapping[str, Floats], entry: Entry) -> str:
    """ "existing 0.13 / 0.12; proposed 0.03 / 0.02 mm"; what all names of the entry end with is left out."""
    tail = _common_tail([_without_unit(name) for name in (*entry.printed, *entry.ours)])
    units = [_own_unit(name) or entry.unit for name in names]
    parts = []
    for k, name in enumerate(names):
        label = _without_unit(name).removesuffix(tail)
        numbers = " / ".join(f"{value:.3g}" for value in values[name])
        # A unit stands behind the last number that it belongs to.
        parts.append(f"{label} {numbers} {'' if units[k : k + 2] == 2 * [units[k]] else units[k]}".rstrip())
    return "; ".join(parts)


def _common_tail(names: Sequence[str]) -> str:
    """What all names end with, from a comma or a preposition on."""
    parts = [re.split(r"(?=, | at | in )", name, maxsplit=1) for name in names]
    tails = {part[1] if len(part) > 1 else "" for part in parts}
    return tails.pop() if len(tails) == 1 else ""
