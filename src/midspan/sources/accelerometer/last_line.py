"""A text file whose last line was cut off, as by a logger that lost its power.

A line with its line end is whole. One without is whole where nothing can be missing: it has all fields of the lines
above it, its last number is written as far as theirs, and its time goes on as theirs does. Else it is cut: `-0.` of
`-0.113` reads as a number, too.
"""

import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import BinaryIO

from midspan.checks import shown
from midspan.sources.accelerometer.dialect import is_comment, is_missing_word, is_value, split

# Bytes from the end that are looked at, and lines above the last one that it is compared with.
_TAIL_BYTES = 1 << 20
_NEIGHBOURS = 50
# Nine digits tell every number of single precision (IEEE 754): what may be missing after them is below any sensor.
_ENOUGH_DIGITS = 9
# A column that rises in this many lines or more counts as a clock; one whose steps differ from the middle one by this
# share at most has an even step, which the last line must keep to the same share.
_CLOCK_LINES, _EVEN_SHARE = 10, 0.5
# What DOS programs write behind a text (Ctrl-Z).
_DOS_END = "\x1a"
_NUMBER = re.compile(r"^[+-]?(?P<mantissa>\d*(?:[.,](?P<decimals>\d*))?)(?:[eEdD][+-]?(?P<exponent>\d*))?$")


def cut_last_line(path: Path, *, encoding: str, delimiter: str, decimal: str) -> tuple[int, str] | None:
    """Up to which byte a file is sound, and a sentence on what follows; None for a file that ends as it should.

    The sentence is empty where an end mark of DOS follows: such a file was written to its end.

    encoding, delimiter, decimal: how its columns are written, as in `Dialect`.
    """
    with path.open("rb") as file:
        head = file.read(2)
        size = file.seek(0, 2)
        behind = _behind_written(file, size)
        # Characters of UTF-16 stand at even places.
        begin = max(0, behind - _TAIL_BYTES) // 2 * 2
        file.seek(begin)
        tail = file.read(behind - begin)
    # A piece from the middle has no byte order mark, and is decoded so that no byte is lost.
    if encoding == "utf-16":
        encoding = "utf-16-be" if head == b"\xfe\xff" else "utf-16-le"
    encoding, errors = encoding.removesuffix("-sig"), "replace" if encoding.startswith("utf-16") else "surrogateescape"
    text = tail.decode(encoding, errors)
    # A disk that lost power before it held the data leaves zeros at a file's end.
    written = text.rstrip("\0")
    is_full = behind == size and written == text
    unmarked = written.rstrip(_DOS_END)
    if is_full and unmarked != written:
        return begin + len(unmarked.encode(encoding, errors)), ""
    lines = re.split(r"\r\n|\n|\r", written)
    if is_full and (is_comment(lines[-1]) or _is_whole(lines, delimiter, decimal)):
        return None
    sound = written[: len(written) - len(lines[-1])]
    end = begin + len(sound.encode(encoding, errors))
    if not is_full:
        return end, f"it ends in {size - end} bytes that were never written (zeros), as after a loss of power"
    return end, f"its last line has no line end and is cut off: {shown(lines[-1].strip())} is left out"


def _behind_written(file: BinaryIO, size: int) -> int:
    """Where the zeros at a file's end begin, or one byte later: half a character of UTF-16 can be zero."""
    while size:
        begin = max(0, size - _TAIL_BYTES)
        file.seek(begin)
        kept = len(file.read(size - begin).rstrip(b"\0"))
        if kept:
            return min((begin + kept + 1) // 2 * 2, size)
        size = begin
    return 0


def _is_whole(lines: Sequence[str], delimiter: str, decimal: str) -> bool:
    """Whether the last of the lines cannot be the beginning of a longer one."""
    last = lines[-1]
    rows = [split(line, delimiter) for line in lines[-_NEIGHBOURS - 1 : -1] if not is_comment(line)]
    widths = [len(row) for row in rows if any(row)]
    if not last.strip() or not widths:
        return True
    if last.count('"') % 2:
        return False
    width = max(set(widths), key=widths.count)
    fields = split(last, delimiter)
    if len(fields) < width:
        return False
    even = [row for row in rows if len(row) == width]
    above = [row[-1] for row in even if is_value(row[-1], decimal)]
    if not all(_goes_on([row[k] for row in even], fields[k], decimal) for k in range(width)):
        return False
    return not above or is_missing_word(fields[-1]) or _is_written_out(fields[-1], above)


def _goes_on(above: Sequence[str], field: str, decimal: str) -> bool:
    """Whether a field follows those above it, where these rise as a clock does: it rises, and keeps an even step."""
    known = [number for text in above if (number := _number(text, decimal)) is not None]
    last = _number(field, decimal)
    if last is None or len(known) < max(len(above), _CLOCK_LINES):
        return True
    steps = [after - before for before, after in pairwise(known)]
    if min(steps) <= 0.0:
        return True
    step, middle = last - known[-1], median(steps)
    is_even = max(abs(one - middle) for one in steps) <= _EVEN_SHARE * middle
    return abs(step - middle) <= _EVEN_SHARE * middle if is_even else step > 0.0


def _number(field: str, decimal: str) -> float | None:
    try:
        return float(field.replace(decimal, "."))
    except ValueError:
        return None


def _is_written_out(field: str, above: Sequence[str]) -> bool:
    """Whether a field cannot be the beginning of a longer one of the kind of those above it."""
    number, numbers = _form(field), [_form(other) for other in above]
    lengths = {len(other.lstrip("+-")) for other in above}
    as_long = len(field.lstrip("+-")) >= max(lengths)
    if number is None or None in numbers:
        return as_long
    forms = {(decimals, exponent) for decimals, _, exponent in filter(None, numbers)}
    decimals, digits, exponent = number
    if decimals and forms == {(decimals, exponent)}:
        return True
    if forms == {(0, None)}:
        # A whole number may lack digits however long it is, unless all have as many.
        return lengths == {len(field.lstrip("+-"))}
    is_exact = decimals > 0 and digits >= _ENOUGH_DIGITS and exponent is None
    return as_long or (is_exact and {other for _, other in forms} == {None})


def _form(field: str) -> tuple[int, int, int | None] | None:
    """A number's decimals, its digits that count, and the digits of its exponent (None: it has none)."""
    match = _NUMBER.match(field)
    if match is None or not any(sign.isdigit() for sign in field):
        return None
    exponent, digits = match["exponent"], re.sub(r"[.,]", "", match["mantissa"]).lstrip("0")
    return len(match["decimals"] or ""), len(digits), None if exponent is None else len(exponent)
