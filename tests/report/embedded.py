"""What a report holds: its pictures and the columns behind its chart, read without the script of the page."""

import base64
import json
import re
import zlib
from html import unescape
from urllib.parse import unquote_to_bytes

import numpy as np


def picture_bytes(source):
    head, data = source.split(",", 1)
    assert head == "data:image/svg+xml"
    return unquote_to_bytes(data)


def without_pictures(text):
    """The page's text without what is drawn and without the chart's columns."""
    return re.sub(r'src="data:[^"]*"|data-rows="[^"]*"|data-chart="[^"]*"', "", text)


def chart(text, number=0):
    """Layout of the page's chart of this number, and its columns in their units."""
    layout = json.loads(unescape(re.findall(r'data-chart="([^"]*)"', text)[number]))
    data = zlib.decompress(base64.b64decode(re.findall(r'data-rows="([^"]*)"', text)[number]))
    columns, at = [], 0
    for known in layout["columns"]:
        count, code = known["count"], np.zeros(known["count"], dtype=np.int64)
        for place in range(known["width"]):
            code += np.frombuffer(data, dtype=np.uint8, count=count, offset=at).astype(np.int64) << (8 * place)
            at += count
        value = np.where(code % 2 == 1, -(code + 1) // 2, code // 2)
        for _ in range(known["order"]):
            value = np.cumsum(value)
        columns.append(value * known["quantum"])
    assert at == len(data)
    return layout, columns
