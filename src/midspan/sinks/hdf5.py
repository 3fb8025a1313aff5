"""HDF5: one dataset a column."""

from collections.abc import Iterator

import numpy as np

from midspan.sinks.table import ResultTable, codes, is_text, metadata_json, unit_of, words_of, words_or_numbers


def encode(table: ResultTable) -> Iterator[bytes]:
    """Datasets named like the columns with their `unit`; words as fixed-length text; JSON in attribute `midspan`."""
    import h5py

    # In memory: the HDF5 library crashes where the disk is full when it closes a file.
    with h5py.File("result.h5", "w", driver="core", backing_store=False, track_order=True) as file:
        file.attrs["midspan"] = metadata_json(table)
        for name, values in table.columns.items():
            coded, array = codes(name, values), words_or_numbers(name, values)
            if coded is not None:
                # Text of fixed length: a hundred times quicker than HDF5's text of free length, and as readable.
                array = np.array(words_of(name), dtype=np.bytes_)[coded]
            elif is_text(array):
                array = np.char.encode(array.astype(str), "utf-8")
            options = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if array.size else {}
            dataset = file.create_dataset(name, data=array, **options)
            if (unit := unit_of(name)) is not None:
                dataset.attrs["unit"] = unit
        file.flush()
        image = file.id.get_file_image()
    yield image
