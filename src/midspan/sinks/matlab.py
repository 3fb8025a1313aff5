"""MATLAB 5: plain variables."""

import io
from collections.abc import Iterator
from typing import Any

from midspan.sinks.table import ResultTable, metadata_json, words_or_numbers
from midspan.writing import WRITTEN_BY

_TEXT_BYTES = 116  # of the header, for any text; source: MATLAB, MAT-file format, "MAT-file header"


def encode(table: ResultTable) -> Iterator[bytes]:
    """Column vectors named like the columns; words as character matrices; the metadata as JSON text in `midspan`."""
    from scipy.io import savemat

    variables: dict[str, Any] = {name: words_or_numbers(name, values) for name, values in table.columns.items()}
    variables = {"midspan": metadata_json(table)} | variables
    stream = io.BytesIO()
    savemat(stream, variables, oned_as="column", do_compression=True)
    stream.seek(0)
    stream.write(f"MATLAB 5.0 MAT-file, {WRITTEN_BY}".encode().ljust(_TEXT_BYTES))
    yield stream.getvalue()
