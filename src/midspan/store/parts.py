"""Checkpoints in parts: what did not change since a point's last one (a template, a key frame) is not written again."""

import hashlib
import struct
from collections.abc import Sequence

from midspan.errors import DataError
from midspan.store.database import Database

PART_TABLE = (
    "CREATE TABLE IF NOT EXISTS part (point TEXT NOT NULL, digest {blob} NOT NULL, body {blob} NOT NULL, "
    "PRIMARY KEY (point, digest))"
)
# A checkpoint that begins so is a list of digests; those of schema 1 are whole.
MAGIC, DIGEST_BYTES = b"parts\0\0\2", 16
# Zstd's own default: a tenth smaller than pyarrow's, level 1; above it only time grows.
LEVEL = 3
# Length of a part before it was compressed.
LENGTH = struct.Struct("<Q")


def keep_checkpoint(site: Database, point: str, time_ns: int, parts: Sequence[bytes]) -> None:
    """Keep the newest checkpoint of a point, within a transaction."""
    order = [hashlib.blake2b(part, digest_size=DIGEST_BYTES).digest() for part in parts]
    digests = dict(zip(order, parts, strict=True))
    kept = {bytes(row[0]) for row in site.execute("SELECT digest FROM part WHERE point = ?", (point,))}
    for digest in sorted(set(digests) - kept):
        site.execute("INSERT INTO part VALUES (?, ?, ?)", (point, digest, _small(digests[digest])))
    site.execute(
        "INSERT INTO checkpoint VALUES (?, ?, ?) "
        "ON CONFLICT (point) DO UPDATE SET time_ns = excluded.time_ns, body = excluded.body",
        (point, time_ns, MAGIC + b"".join(order)),
    )
    for digest in sorted(kept - set(digests)):
        site.execute("DELETE FROM part WHERE point = ? AND digest = ?", (point, digest))


def kept_checkpoint(site: Database, point: str) -> tuple[int, bytes] | None:
    """A point's newest checkpoint and its instant (ns). Raises DataError for a damaged one."""
    rows = site.execute("SELECT time_ns, body FROM checkpoint WHERE point = ?", (point,))
    if not rows:
        return None
    time_ns, body = int(rows[0][0]), bytes(rows[0][1])
    if not body.startswith(MAGIC):
        return time_ns, body
    rows = site.execute("SELECT digest, body FROM part WHERE point = ?", (point,))
    kept = {bytes(digest): bytes(part) for digest, part in rows}
    digests = [body[k : k + DIGEST_BYTES] for k in range(len(MAGIC), len(body), DIGEST_BYTES)]
    if not set(digests) <= set(kept):
        raise DataError(f"The store's checkpoint of {point} is damaged; the point restarts.")
    return time_ns, b"".join(_whole(kept[digest], point) for digest in digests)


def _small(part: bytes) -> bytes:
    import pyarrow as pa

    return LENGTH.pack(len(part)) + bytes(pa.Codec("zstd", LEVEL).compress(part, asbytes=True))


def _whole(body: bytes, point: str) -> bytes:
    import pyarrow as pa

    try:
        (length,) = LENGTH.unpack_from(body)
        return bytes(pa.Codec("zstd").decompress(body[LENGTH.size :], decompressed_size=length, asbytes=True))
    except (struct.error, OSError, ValueError) as error:
        raise DataError(f"The store's checkpoint of {point} is damaged ({error}); the point restarts.") from None
