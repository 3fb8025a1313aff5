"""Damage to the bytes of a file, drawn from a generator: what disks, cables, loggers and editors do to files."""

import re
import struct
from collections.abc import Callable
from random import Random

# Every second place lies this near to the start or the end of a file, bytes: headers and directories are there.
NEAR_AN_END = 512
INTEGERS = (
    0,
    1,
    -1,
    2,
    127,
    128,
    255,
    256,
    32767,
    32768,
    65535,
    65536,
    10**9,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**46,
    2**63 - 1,
)
NUMBERS = (
    "inf", "-inf", "nan", "1e308", "-1e308", "1e-320", "-1", "0", "-0.0", "1e200", "9223372036854775808",
    "123456789012345678901234567890", "1e999", "0.1", "3", "2147483648", "", "x", "null", "true", "[]", '""', "\ud800",
)  # fmt: skip
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
WORD = re.compile(r"[A-Za-z_][\w./]*")
Change = Callable[[bytes, Random], bytes]


def damaged(data: bytes, rng: Random, text: bool) -> tuple[str, bytes]:
    """The name of a kind of damage and the bytes with it; text: whether changes of numbers and words make sense."""
    kinds = {**BYTES, **TEXTS} if text else BYTES
    # Half of all damage to a text is to its numbers, which its reader understands and has to judge.
    kind = "number" if text and rng.random() < 0.5 else rng.choice(sorted(kinds))
    return kind, kinds[kind](data, rng)


def _place(size: int, rng: Random) -> int:
    """An offset in a file of this size, every second time near its start or end."""
    near = min(NEAR_AN_END, size)
    if rng.random() < 0.5:
        return rng.randrange(max(size, 1))
    return rng.randrange(max(near, 1)) if rng.random() < 0.7 else size - 1 - rng.randrange(max(near, 1))


def _chunk(size: int, rng: Random) -> tuple[int, int]:
    start = _place(size, rng)
    return start, min(start + rng.choice((1, 2, 4, 16, 64, 256, 1024, 4096)), size)


def _flip(data: bytes, rng: Random) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        out[_place(len(out), rng)] ^= 1 << rng.randrange(8)
    return bytes(out)


def _overwrite(data: bytes, rng: Random) -> bytes:
    start, end = _chunk(len(data), rng)
    count = min(end - start, 16)
    fill = rng.choice((bytes(count), b"\xff" * count, rng.randbytes(count)))
    return data[:start] + fill + data[start + count :]


def _integer(data: bytes, rng: Random) -> bytes:
    code, bits = rng.choice((("b", 8), ("h", 16), ("i", 32), ("i", 32), ("q", 64)))
    value = rng.choice(INTEGERS) % 2**bits
    word = struct.pack(rng.choice("<>") + code.upper(), value)
    start = _place(len(data), rng)
    return (data[:start] + word + data[start + len(word) :])[: len(data)]


def _truncate(data: bytes, rng: Random) -> bytes:
    return data[: rng.choice((_place(len(data), rng), len(data) - 1, len(data) - rng.randrange(1, 64)))]


def _delete(data: bytes, rng: Random) -> bytes:
    start, end = _chunk(len(data), rng)
    return data[:start] + data[end:]


def _duplicate(data: bytes, rng: Random) -> bytes:
    start, end = _chunk(len(data), rng)
    return data[:end] + data[start:end] + data[end:]


def _insert(data: bytes, rng: Random) -> bytes:
    start, end = _chunk(len(data), rng)
    count = end - start
    fill = rng.choice((bytes(count), rng.randbytes(count)))
    return data[:start] + fill + data[start:]


def _tokens(data: bytes, rng: Random, pattern: re.Pattern[str], values: tuple[str, ...]) -> bytes:
    """One token of the text, or now and then every one of a line, replaced by one of the values or by another token."""
    text = data.decode("utf-8", "surrogateescape")
    found = list(pattern.finditer(text))
    if not found:
        return _flip(data, rng)
    token = rng.choice(found[: rng.choice((40, len(found)))])
    new = rng.choice(values) if values and rng.random() < 0.8 else rng.choice(found).group()
    return (text[: token.start()] + new + text[token.end() :]).encode(
        "utf-8", "surrogatepass" if "\ud800" in new else "surrogateescape"
    )


def _number(data: bytes, rng: Random) -> bytes:
    return _tokens(data, rng, NUMBER, NUMBERS)


def _word(data: bytes, rng: Random) -> bytes:
    return _tokens(data, rng, WORD, ())


def _line(data: bytes, rng: Random) -> bytes:
    """A line left out, doubled, emptied or moved."""
    lines = data.split(b"\n")
    k = rng.randrange(min(len(lines), rng.choice((20, len(lines)))))
    line = lines.pop(k)
    again = rng.choice(([], [line, line], [b""], None))
    if again is None:
        k, again = rng.randrange(len(lines) + 1), [line]
    return b"\n".join([*lines[:k], *again, *lines[k:]])


BYTES: dict[str, Change] = {
    "flip": _flip, "overwrite": _overwrite, "integer": _integer, "truncate": _truncate, "delete": _delete,
    "duplicate": _duplicate, "insert": _insert,
}  # fmt: skip
TEXTS: dict[str, Change] = {"number": _number, "word": _word, "line": _line}
