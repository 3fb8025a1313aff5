"""Columns of a table as Arrow arrays, for CSV and Parquet."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from midspan.sinks.table import Column, codes, is_text, words_of


def word_column(name: str, coded: NDArray[np.uint8]) -> Any:
    """Codes (n,) of `source` or `status` as a dictionary array of their words."""
    import pyarrow as pa

    return pa.DictionaryArray.from_arrays(pa.array(coded.astype(np.int8)), pa.array(list(words_of(name) or ())))


def arrow_column(name: str, values: Column) -> Any:
    """A whole column: words as a dictionary array, other text as text, numbers as they are."""
    import pyarrow as pa

    coded = codes(name, values)
    if coded is not None:
        return word_column(name, coded)
    if is_text(values):
        return pa.array(np.asarray(values).astype(str).tolist())
    return pa.array(np.asarray(values))
