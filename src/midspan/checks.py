"""Checks of arguments: one function each, one message form.

Every message reads `NAME must be RULE; received VALUE. REMEDY`.
"""

import difflib
import reprlib
from collections.abc import Iterable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from midspan.errors import UsageError

Kind = TypeVar("Kind")
_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxdict, _SHORT.maxlist, _SHORT.maxtuple = 4, 8, 16, 16
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 80


@dataclass(frozen=True, slots=True)
class ValueRange:
    """The lowest and highest value that a quantity can have, in `unit`; NaN is outside."""

    low: float
    high: float
    unit: str = ""

    def __str__(self) -> str:
        return f"from {self.low:g} to {self.high:g} {self.unit}".rstrip()

    def __contains__(self, value: float) -> bool:
        return bool(self.low <= value <= self.high)


# The sum of two times is below 2^63 ns, and seconds since 1900, 1904, 1970 and 1980 are within.
TIME_S = ValueRange(-4.5e9, 4.5e9, "s")
# From a sample in eleven days to the shortest step of a clock that counts nanoseconds.
RATE_HZ = ValueRange(1e-6, 1e9, "Hz")
# The carrier of chirp and pulsed radars.
CARRIER_HZ = ValueRange(1e9, 1e12, "Hz")

# What other programs call a key or a tracker of midspan's.
SYNONYMS = {
    **dict.fromkeys(("fps", "frame-rate", "framerate", "sample-rate", "sampling-rate", "fs"), "rate_hz"),
    **dict.fromkeys(("lucas-kanade", "klt", "optical-flow", "dic", "ecc"), "registration"),
    **dict.fromkeys(("ncc", "zncc", "template-matching"), "template"),
    **dict.fromkeys(("surf", "sift", "orb", "akaze"), "features"),
    **dict.fromkeys(("pbm", "phase-based"), "phase"),
    **dict.fromkeys(("rts", "rauch-tung-striebel"), "smoother"),
    **dict.fromkeys(("amkf", "akf"), "adaptive-kalman"),
}


def shown(value: object) -> str:
    """A value as messages show it, long and deep ones shortened."""
    return _SHORT.repr(value)


def within(name: str, value: float, limits: ValueRange) -> float:
    """Return `value` if it is a number within `limits`."""
    if not isinstance(value, int | float | np.number) or value not in limits:
        raise refuse(name, str(limits), value)
    return value


def refuse(name: str, rule: str, received: object, remedy: str = "") -> UsageError:
    """The error for an argument `name` that breaks `rule`; the caller raises it."""
    text = f"{name} must be {rule}; received {shown(received)}."
    return UsageError(f"{text} {remedy}".rstrip())


def path_of(name: str, value: object) -> Path:
    """The path that a text or a path object names; UsageError for anything else and for an empty one."""
    if not isinstance(value, str | PathLike) or not str(value):
        raise refuse(name, "a path, as text or pathlib.Path", value)
    return Path(value)


def instance(name: str, value: object, kinds: type[Kind] | tuple[type[Kind], ...], rule: str, remedy: str = "") -> Kind:
    """Return `value` if it is an instance of one of `kinds`; `rule` says in words what it must be."""
    if not isinstance(value, kinds):
        raise refuse(name, rule, value, remedy)
    return value


def positive(name: str, value: float, unit: str = "") -> float:
    """Return `value` if it is finite and above zero."""
    if not (np.isfinite(value) and value > 0):
        raise refuse(name, f"a positive number{f' ({unit})' if unit else ''}", value)
    return float(value)


def finite(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return `values` as float64 if every one is finite."""
    array = np.asarray(values, dtype=np.float64)
    if not np.all(np.isfinite(array)):
        raise refuse(name, "finite", f"{np.count_nonzero(~np.isfinite(array))} values that are not")
    return array


def same_length(**arrays: NDArray[np.generic]) -> None:
    """Check that all arrays have the same length along their first axis."""
    lengths = {name: len(array) for name, array in arrays.items()}
    if len(set(lengths.values())) > 1:
        raise refuse(" and ".join(lengths), "of equal length", lengths)


def increasing(name: str, values: ArrayLike) -> NDArray[np.generic]:
    """Return `values` if each one is larger than the one before."""
    array = np.asarray(values)
    if array.size > 1 and not np.all(array[1:] > array[:-1]):
        first = int(np.argmax(array[1:] <= array[:-1])) + 1
        raise refuse(name, "strictly increasing", f"{array[first]} after {array[first - 1]} at index {first}")
    return array


def option(name: str, value: str, known: Iterable[str]) -> str:
    """Return `value` if it is one of `known`; the message names the nearest."""
    names = list(known)
    if value not in names:
        raise refuse(name, f"one of {', '.join(names)}", value, nearest(value, names) if isinstance(value, str) else "")
    return value


def nearest(value: str, known: Iterable[str]) -> str:
    """A sentence that names the known word that means `value` or is nearest to it, or an empty text."""
    names, meant = list(known), SYNONYMS.get(value.lower().replace("_", "-"))
    close = [meant] if meant in names else difflib.get_close_matches(value, names, n=1, cutoff=0.5)
    return f"Did you mean {close[0]!r}?" if close else ""
