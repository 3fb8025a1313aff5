"""The boundary to the format libraries, and the memory that a header may declare."""

from pathlib import Path

import numpy as np
import pytest

from midspan.errors import DataError, UsageError
from midspan.sources.boundary import available_bytes, reading, require_memory

FILE = Path("some.file")


@pytest.mark.parametrize(
    ("raised", "said"),
    [
        (ValueError("bad magic"), "bad magic"),
        (OSError(13, "Permission denied"), "Permission denied"),
        (RecursionError("maximum recursion depth exceeded"), "nested too deeply"),
        (MemoryError(), "more memory than is available"),
        (RuntimeError("first line\nsecond line"), "first line"),
        (NotImplementedError(), "NotImplementedError"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_a_library_raises_becomes_one_sentence(raised: Exception, said: str) -> None:
    with pytest.raises(DataError) as caught, reading(FILE, "a format"):
        raise raised
    message = str(caught.value)
    assert message.startswith("some.file cannot be read as a format: ")
    assert said in message
    assert "\n" not in message


def test_errors_of_midspan_pass_unchanged() -> None:
    error = UsageError("own words")
    with pytest.raises(UsageError) as caught, reading(FILE, "a format"):
        raise error
    assert caught.value is error


def test_a_missing_library_is_wrong_use_not_wrong_data() -> None:
    with pytest.raises(UsageError, match="library that is not installed"), reading(FILE, "a format"):
        raise ImportError("No module named 'library'")


def test_a_size_that_fits_passes_and_one_that_does_not_is_named() -> None:
    require_memory(FILE, 1000, "array a")
    with pytest.raises(DataError, match=r"some\.file: array a must fit .* needs 931322\.6 GiB"):
        require_memory(FILE, 10**15, "array a")


def test_available_memory_is_what_an_array_may_take() -> None:
    # A machine that runs these tests has more than 50 MB left, and less than 100 TB.
    assert 5e7 < available_bytes() < 1e14
    assert np.zeros(10**6).nbytes < available_bytes()
