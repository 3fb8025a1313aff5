"""MATLAB 5: plain variables."""

from pathlib import Path
from typing import Any

import numpy as np

from midspan.sinks.table import ResultTable, codes, is_text, metadata_json, words_of


def write(path: Path, table: ResultTable) -> None:
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
    savemat(path, variables, oned_as="column", do_compression=True)
