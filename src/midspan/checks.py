"""Checks of arguments: one function each, one message form.

Every message reads `NAME must be RULE; received VALUE. REMEDY`.
"""

import difflib
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from midspan.errors import UsageError


def refuse(name: str, rule: str, received: object, remedy: str = "") -> UsageError:
    """The error for an argument `name` that breaks `rule`; the caller raises it."""
    text = f"{name} must be {rule}; received {received!r}."
    return UsageError(f"{text} {remedy}".rstrip())


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
        raise refuse(name, f"one of {', '.join(names)}", value, nearest(value, names))
    return value


def nearest(value: str, known: Iterable[str]) -> str:
    """A sentence that names the known word nearest to `value`, or an empty text."""
    close = difflib.get_close_matches(value, list(known), n=1, cutoff=0.5)
    return f"Did you mean {close[0]!r}?" if close else ""
