"""MATLAB 5: plain variables."""

import io
from collections.abc import Iterator
from typing import Any

import numpy as np

from midspan.sinks.table import ResultTable, codes, is_text, metadata_json, words_of
from midspan.writing import WRITTEN_BY

_TEXT_BYTES = 116  # of the header, for any text; source: MATLAB, MAT-file format, "MAT-file header"


def encode(table: ResultTable) -> Iterator[bytes]:
    """Column vectors named like the columns; words as character matrices; the metadata as JSON text in `midspan`."""
    from scipy.io import savemat

    variables: dict[str, Any] = {"midspan": metadata_json(table)}
    for name, values in table.columns.items():
        coded = codes(name, values)
        if coded is not None:
            variables[name] = np.array(words_of(name))[coded]
        elif is_text(values):
            variables[name] = np.asarray(values).astype(str)
        else:
            variables[name] = np.asarray(values)
    stream = io.BytesIO()
    savemat(stream, variables, oned_as="column", do_compression=True)
    stream.seek(0)
    stream.write(f"MATLAB 5.0 MAT-file, {WRITTEN_BY}".encode().ljust(_TEXT_BYTES))
    yield stream.getvalue()
