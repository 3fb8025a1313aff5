"""Whether a record is plain data: arrays, numbers, texts and records of such, all the way down."""

import copy
import pickle
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cached_property
from pathlib import PurePath
from typing import Any

import numpy as np
from pydantic import BaseModel

VALUES = (bool, int, float, complex, str, bytes, type(None), np.generic, PurePath, Enum)


def leaves(thing: Any, place: str = "result") -> Iterator[tuple[str, Any]]:
    """All values of a record with the places where they stand; AssertionError for what is no plain data."""
    if isinstance(thing, (*VALUES, np.ndarray)):
        assert not isinstance(thing, np.ndarray) or thing.dtype != object, f"{place}: an array of objects"
        yield place, thing
    elif isinstance(thing, tuple | list):
        for number, part in enumerate(thing):
            yield from leaves(part, f"{place}[{number}]")
    elif isinstance(thing, dict):
        for key, part in thing.items():
            yield from leaves(part, f"{place}[{key!r}]")
    else:
        assert is_dataclass(thing) or isinstance(thing, BaseModel), f"{place}: {type(thing).__name__} is no plain data"
        names = [one.name for one in fields(thing)] if is_dataclass(thing) else list(type(thing).model_fields)
        derived = {
            name for kind in type(thing).__mro__ for name, one in vars(kind).items() if isinstance(one, cached_property)
        }
        assert set(getattr(thing, "__dict__", {})) <= set(names) | derived, f"{place}: more than its fields"
        for name in names:
            yield from leaves(getattr(thing, name), f"{place}.{name}")


def assert_plain(thing: Any) -> None:
    """Plain data, which pickling and copying keep to the last bit."""
    known = dict(leaves(thing))
    for again in (pickle.loads(pickle.dumps(thing)), copy.deepcopy(thing)):
        found = dict(leaves(again))
        assert found.keys() == known.keys()
        for place, value in known.items():
            np.testing.assert_array_equal(found[place], value, err_msg=place)
