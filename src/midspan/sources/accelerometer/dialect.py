"""How a text file of columns is written: encoding, delimiter, decimal sign, preamble, names and units."""

import csv
import re
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path

from midspan.errors import DataError
from midspan.sources.accelerometer.channel import distinct
from midspan.sources.accelerometer.clock import TIME_UNITS, is_clock, is_date, is_time_name, is_time_text
from midspan.sources.accelerometer.units import ACCELERATION_UNITS, LENGTH_UNITS, VOLTAGE_UNITS

SAMPLE_BYTES = 1 << 18
SAMPLE_LINES = 400
BLANKS = r"\s+"
# A run of fewer rows above a line of words is preamble.
_FEW_ROWS = 3
COMMENT_SIGNS = ("#", "%", "!", "//")

_CANDIDATES = tuple((delimiter, decimal) for decimal in ".," for delimiter in (";", "\t", "|", ",", BLANKS))
_NUMBER = {
    sign: re.compile(rf"^[+-]?(?:\d+(?:{re.escape(sign)}\d*)?|{re.escape(sign)}\d+)(?:[eEdD][+-]?\d+)?$")
    for sign in ".,"
}
_MISSING = frozenset(
    {"", "nan", "na", "n/a", "null", "none", "-", "--", "---", "inf", "-inf", "+inf", "#n/a", "1.#qnan"}
)
_OTHER_UNITS = (
    "m/s² mm/s² cm/s² m/s/s cm/s/s cm/sec/sec m/s mm/s cm/s hz °c degc c - deg ° rad rad/s deg/s °/s % counts count "
    "um/m µm/m n kn kg utc bar pa"
)
_KNOWN_UNITS = frozenset(
    [u.lower() for u in ACCELERATION_UNITS + LENGTH_UNITS + VOLTAGE_UNITS] + [*TIME_UNITS, *_OTHER_UNITS.split()]
)
# A line of the preamble with the unit of all channels.
_VALUE_UNITS = frozenset(u.lower() for u in (*ACCELERATION_UNITS, "m/s²", "mm/s²", "cm/s²", *LENGTH_UNITS))
_UNIT_LINE = re.compile(
    r'^\W*(?:units?|unité|unite|einheit|unidad)s?\s*"?\s*[:;=,\t]\s*"?(?P<unit>[^\s;,"]+)', re.IGNORECASE
)
# How a column of times says that it is written, such as hh:mm:ss or dd/mm/yyyy (jj, aaaa in French).
_TIME_FORM = re.compile(r"([djmyahsf])\1*([:/.,\-\s]+([djmyahsf])\3*)+", re.IGNORECASE)
_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]*)[\])]\s*$")
_SUFFIX_UNITS = {
    **{"m_s2": "m/s^2", "ms2": "m/s^2", "mm_s2": "mm/s^2", "cm_s2": "cm/s^2", "g": "g", "mg": "mg", "gal": "gal"},
    **{
        "m_s": "m/s",
        "mm_s": "mm/s",
        "cm_s": "cm/s",
        "mm": "mm",
        "cm": "cm",
        "um": "um",
        "m": "m",
        "v": "V",
        "mv": "mV",
    },
    **{"s": "s", "ms": "ms", "us": "us", "ns": "ns"},
}


@dataclass(frozen=True, slots=True)
class Dialect:
    """A text file's way of writing columns; `first_row` counts lines from 0, `units` has None where nothing is said.

    `words` are the columns without numbers. With `joined` the columns at that index and the next hold
    date and time of day of one time stamp.
    """

    encoding: str
    delimiter: str
    decimal: str
    comment: str | None
    first_row: int
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    words: tuple[int, ...]
    joined: int | None
    notes: tuple[str, ...]


def find_dialect(path: Path) -> Dialect:
    """The dialect of a text file from its first 400 lines; DataError if no columns of numbers are found."""
    with path.open("rb") as file:
        head = file.read(SAMPLE_BYTES)
    if _is_utf_32(head):
        raise DataError(f"{path} must be a text in UTF-8, UTF-16 or Latin-1; this is UTF-32. Save it as UTF-8.")
    encoding = _encoding(head)
    lines = re.split(r"\r\n|\n|\r", head.decode(encoding, errors="replace"))
    lines = (lines[:-1] if len(head) == SAMPLE_BYTES else lines)[:SAMPLE_LINES]
    guesses = _guesses(lines)
    is_whole = len(head) < SAMPLE_BYTES and len(lines) < SAMPLE_LINES
    if is_whole and (heading := _heading_at_end(lines, max((guess.rows for guess in guesses), default=0))):
        raise DataError(f"{path} has no data rows: nothing follows its heading {heading!r}. Export it again with data.")
    if not guesses:
        raise DataError(
            f"{path} has no columns of numbers in its first {len(lines)} lines. Text columns with comma, semicolon, "
            "tab, blanks or | between them are expected."
        )
    best = _tab_among_blanks(max(guesses, key=lambda guess: guess.score), guesses)
    best = _single_decimal_comma(lines, best, guesses)
    row = split(lines[best.first], best.delimiter)
    joined = next((k for k in range(len(row) - 1) if is_date(row[k]) and is_clock(row[k + 1])), None)
    names, units, notes = _headings(lines, best, joined)
    comment = next((sign for sign in ("#", "%") if any(line.startswith(sign) for line in lines)), None)
    return Dialect(encoding, best.delimiter, best.decimal, comment, best.first, names, units, best.words, joined, notes)


def _is_utf_32(head: bytes) -> bool:
    """Four bytes a character, of which two at least are zero."""
    if head.startswith((b"\xff\xfe\0\0", b"\0\0\xfe\xff")):
        return True
    quarters = [head[k:200:4] for k in range(4)]
    return len(head) >= 8 and any(
        not any(quarters[a]) and not any(quarters[b]) and all(quarters[c]) for a, b, c in ((3, 2, 0), (0, 1, 3))
    )


def _encoding(head: bytes) -> str:
    for mark, encoding in ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16")):
        if head.startswith(mark):
            return encoding
    for first, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        if head[first:200:2].count(0) > len(head[first:200:2]) // 2:
            return encoding
    try:
        # The cut may fall inside a character: its up to three bytes do not count.
        head[: max(len(head) - 3, 0)].decode("utf-8")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


@dataclass(frozen=True, slots=True)
class _Guess:
    delimiter: str
    decimal: str
    first: int
    score: int
    width: int
    words: tuple[int, ...]
    rows: int


def _heading_at_end(lines: list[str], rows: int) -> str:
    """The heading that a file ends with, of more columns than any line with a number has; empty where it does not.

    rows: the most that a guess makes of the lines; words end a file of few rows or none, or units do.
    """
    filled = [line.strip() for line in lines if line.strip() and not is_comment(line)]
    for delimiter in (";", "\t", "|", ","):
        *above, last = [split(line, delimiter) for line in filled] or [[]]
        numbered = [any(is_value(field, sign) for field in row for sign in ".,") for row in (*above, last)]
        width = max((len(row) for row, has_number in zip(above, numbered, strict=False) if has_number), default=1)
        if numbered[-1] or len(last) <= width:
            continue
        if above and len(above[-1]) == len(last) and _are_units(last):
            return filled[-2]
        if rows < _FEW_ROWS:
            return filled[-1]
    return ""


def _are_units(fields: list[str]) -> bool:
    """Whether these are units of columns, with how a time is written among them."""
    units = [unit for field in fields if (unit := _unit_text(field))]
    return bool(units) and all(unit.lower() in _KNOWN_UNITS or _TIME_FORM.fullmatch(unit) for unit in units)


def _tab_among_blanks(best: _Guess, guesses: list[_Guess]) -> _Guess:
    """Tabs, where these part the same numbers as blanks do: names may have blanks in them."""
    same = (best.decimal, best.first, best.width, best.rows)
    tabs = [one for one in guesses if one.delimiter == "\t" and same == (one.decimal, one.first, one.width, one.rows)]
    return tabs[0] if best.delimiter == BLANKS and tabs else best


def _single_decimal_comma(lines: list[str], best: _Guess, guesses: list[_Guess]) -> _Guess:
    """`0,01` is one number, not two, where the heading has one word or the second part a leading zero throughout."""
    if best.delimiter != "," or best.width != 2 or best.decimal != ".":
        return best
    one = next((g for g in guesses if g.width == 1 and g.decimal == ","), None)
    if one is None:
        return best
    heading = lines[best.first - 1] if best.first else ""
    rows = [split(line, ",") for line in lines[best.first : best.first + 50] if line.strip()]
    padded = all(len(r) == 2 and r[1].isdigit() for r in rows) and any(len(r[1]) > 1 and r[1][0] == "0" for r in rows)
    return one if padded or (heading.strip() and "," not in heading) else best


def split(line: str, delimiter: str) -> list[str]:
    """The fields of a line without the blanks around them; quotation marks keep a delimiter inside a field."""
    if delimiter == BLANKS:
        return line.split()
    if '"' in line:
        return [field.strip() for field in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]
    return [field.strip() for field in line.split(delimiter)]


def _guesses(lines: list[str]) -> list[_Guess]:
    """What each delimiter and decimal sign make of the lines. Delimiters that are in no line make the same of them."""
    text, guesses = "\n".join(lines), list[_Guess]()
    absent = [delimiter for delimiter, _ in _CANDIDATES if delimiter != BLANKS and delimiter not in text]
    whole = cache(lambda decimal: _try(lines, absent[0], decimal))
    for delimiter, decimal in _CANDIDATES:
        guess = whole(decimal) if delimiter in absent else _try(lines, delimiter, decimal)
        if guess is not None:
            guesses.append(replace(guess, delimiter=delimiter))
    return guesses


def _try(lines: list[str], delimiter: str, decimal: str) -> _Guess | None:
    """The rows that a delimiter and decimal sign make of the lines; None where they make no columns of numbers."""
    table = [[] if is_comment(line) else split(line, delimiter) for line in lines]
    values = [[is_value(field, decimal) for field in row] for row in table]
    filled = [k for k, row in enumerate(values) if any(row)]
    if not filled:
        return None
    if all(len(table[k]) > 1 and table[k][-1] == "" for k in filled):
        table = [row[:-1] if row and row[-1] == "" else row for row in table]
    widths = [len(table[k]) for k in filled]
    width = max(set(widths), key=lambda w: (widths.count(w), w))
    rows = _longest_run(table, values, width)
    # By how many the numbers and times of each column exceed its words.
    more = [
        sum(2 * values[k][column] - (table[k][column].lower() not in _MISSING) for k in rows) for column in range(width)
    ]
    numeric = tuple(column for column in range(width) if more[column] > 0)
    rows = [k for k in rows if numeric and values[k][numeric[0]]]
    if not rows:
        return None
    words = tuple(column for column in range(width) if more[column] < 0)
    # Numbers less fields that have digits and yet are none: a wrong delimiter leaves such pieces.
    score = sum(
        value - (not value and any(c.isdigit() for c in field))
        for row, row_values in zip(table, values, strict=True)
        for field, value in zip(row, row_values, strict=False)
        if len(row) == width
    )
    return _Guess(delimiter, decimal, rows[0], score, width, words, len(rows)) if score > 0 else None


def _longest_run(table: list[list[str]], values: list[list[bool]], width: int) -> list[int]:
    """The lines with numbers between two headings: those of the longest such run."""
    # A line without any number parts two runs if it has a word for every column; a lone `ERROR` among numbers does not.
    runs: list[list[int]] = [[]]
    for k, row in enumerate(table):
        if len(row) == width and any(values[k]):
            runs[-1].append(k)
        elif any(row) and not any(values[k]):
            heading = len(row) == width > 1 and all(field.lower() not in _MISSING for field in row)
            if heading or len(runs[-1]) < _FEW_ROWS:
                runs.append([])
    return max(reversed(runs), key=len)


def is_comment(line: str) -> bool:
    """Whether a line is a remark, not data."""
    return line.lstrip().startswith(COMMENT_SIGNS)


# Most delimiters leave a line whole.
@lru_cache(maxsize=4096)
def is_value(field: str, decimal: str) -> bool:
    """Whether a field is a number with this decimal sign, or a written time."""
    return bool(_NUMBER[decimal].match(field)) or is_time_text(field)


def is_missing_word(field: str) -> bool:
    """Whether a field is a word for a missing value, such as NaN, which no longer number begins with."""
    return field.lower() in _MISSING and any(sign.isalpha() for sign in field)


# How the note begins on a file with decimal commas and commas between the columns.
SPLIT = (
    "the comma seems to separate both columns and decimals, which cannot be read; export with ';' or tab between "
    "columns, or with a decimal point"
)


def _headings(
    lines: list[str], guess: _Guess, joined: int | None
) -> tuple[tuple[str, ...], tuple[str | None, ...], tuple[str, ...]]:
    """Names and units of the columns from the lines above the first row, and notes on where they stood."""
    above = [i for i in range(guess.first - 1, -1, -1) if lines[i].strip()][:2]
    rows = [_heading_fields(lines[i], guess) for i in above]
    wanted = {guess.width} | ({guess.width - 1} if joined is not None else set())
    delimiter = {"\t": "tab", BLANKS: "blanks"}.get(guess.delimiter, f"'{guess.delimiter}'")
    notes = [f"delimiter {delimiter}, decimal {'comma' if guess.decimal == ',' else 'point'}"]
    units: list[str | None] = [None] * guess.width
    if len(rows) == 2 and len(rows[1]) in wanted and len(rows[0]) == len(rows[1]) and _are_units(rows[0]):
        given = [_unit_text(field) for field in rows[0]]
        units = [unit if unit and unit.lower() in _KNOWN_UNITS else None for unit in given]
        notes.append(f"units in line {above[0] + 1}")
        above, rows = above[1:], rows[1:]
    if rows and len(rows[0]) in wanted and _is_name_row(rows[0], guess.decimal):
        names = rows[0]
        notes.append(f"header in line {above[0] + 1}")
    else:
        names = [f"column_{k + 1}" for k in range(guess.width)]
        notes.append("no header: columns are named column_1, column_2 …")
        pointed = any("." in line for line in lines[guess.first :])
        halved = bool(rows) and not pointed and guess.delimiter == "," and guess.width == 2 * len(rows[0])
        if halved and _is_name_row(rows[0], guess.decimal):
            notes.append(f"{SPLIT}: {len(rows[0])} names, but {guess.width} columns")
    if len(names) == guess.width - 1 and joined is not None:
        names = [*names[: joined + 1], f"{names[joined]} of day", *names[joined + 1 :]]
        units = [*units[: joined + 1], None, *units[joined + 1 :]]
    named = [named_unit(name) for name in names]
    found = tuple(row or bracket for row, (_, bracket) in zip(units[: len(named)], named, strict=True))
    bare = [name for name, _ in named]
    valued = [unit for unit in found if unit is not None and unit.lower() not in TIME_UNITS]
    if not valued and (stated := _stated_unit(lines[: guess.first])):
        found = tuple(unit or (None if is_time_name(name) else stated) for unit, name in zip(found, names, strict=True))
        notes.append(f"unit {stated} in the preamble")
    distinct_names: list[str] = []
    for k, (name, short) in enumerate(zip(names, bare, strict=True)):
        # Two columns that differ in the unit alone keep their whole heading.
        shown = short if bare.count(short) == 1 else name
        distinct_names.append(distinct(shown or f"column_{k + 1}", distinct_names))
    return tuple(distinct_names), found, tuple(notes)


def _stated_unit(preamble: list[str]) -> str | None:
    """The unit of all channels that a line such as `Unit: g` or `Unité;m/s²` gives; None without one."""
    for match in filter(None, map(_UNIT_LINE.match, preamble)):
        if (unit := _unit_text(match["unit"])) and unit.lower() in _VALUE_UNITS:
            return unit
    return None


def _heading_fields(line: str, guess: _Guess) -> list[str]:
    text = line.strip().lstrip("#%!/").strip() if is_comment(line) else line
    fields = split(text, guess.delimiter)
    if guess.delimiter == BLANKS and len(fields) != guess.width:
        # Blanks before a unit belong to the name: "time [s]  accel [m/s^2]".
        fields = re.sub(r"\s+(?=[\[(])", "", text).split()
    return fields[:-1] if len(fields) == guess.width + 1 and fields[-1] == "" else fields


def _is_name_row(fields: list[str], decimal: str) -> bool:
    return any(fields) and not any(is_value(field, decimal) for field in fields)


def _unit_text(field: str) -> str | None:
    text = field.strip().strip("[]()").strip()
    return None if text in ("", "-", "--") else text


def named_unit(heading: str) -> tuple[str, str | None]:
    """Name and unit of a heading: `accel [m/s^2]`, `Acc (g)` and `displacement_mm` tell their unit; else None.

    A name with its unit behind an underscore is kept whole; brackets are cut off if a known unit is in them.
    """
    match = _BRACKETS.match(heading.strip())
    if match and match["name"] and match["unit"].strip().lower() in _KNOWN_UNITS:
        return match["name"].strip(), _unit_text(match["unit"])
    parts = heading.strip().lower().split("_")
    for count in (2, 1):
        suffix = "_".join(parts[-count:])
        if len(parts) > count and suffix in _SUFFIX_UNITS:
            return heading.strip(), _SUFFIX_UNITS[suffix]
    return heading.strip(), None
