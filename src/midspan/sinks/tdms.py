"""TDMS: one channel a column, in the group `midspan`."""

import io
from collections.abc import Iterator

from midspan.sinks.table import ResultTable, is_text, metadata_json, unit_of, words_or_numbers
from midspan.writing import WRITTEN_BY

GROUP = "midspan"


def encode(table: ResultTable) -> Iterator[bytes]:
    """Channels named like the columns with their `unit_string`; words as texts; JSON in the file's property `midspan`.

    The times are the channel `time_s`: the format's own even time would round stamps that are not even.
    """
    from nptdms import ChannelObject, RootObject, TdmsWriter

    channels = []
    for name, values in table.columns.items():
        data, unit = words_or_numbers(name, values), unit_of(name)
        data = data.tolist() if is_text(data) else data
        channels.append(ChannelObject(GROUP, name, data, {} if unit is None else {"unit_string": unit}))
    root = RootObject({"description": WRITTEN_BY, "midspan": metadata_json(table)})
    stream = io.BytesIO()
    with TdmsWriter(stream) as writer:
        writer.write_segment([root, *channels])
    yield stream.getvalue()
