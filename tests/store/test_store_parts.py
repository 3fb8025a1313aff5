"""Checkpoints in parts: what did not change is not written again, and what is damaged is said."""

import sqlite3
from contextlib import closing

import numpy as np
import pytest

from midspan.errors import DataError
from midspan.store.store import Batch, open_store


def parts_in(where):
    with closing(sqlite3.connect(where / "checkpoints.sqlite")) as file:
        return dict(file.execute("SELECT digest, rowid FROM part"))


def test_a_part_that_stays_is_kept_as_it_is_and_others_go(tmp_path):
    template = np.random.default_rng(0).bytes(100_000)
    store = open_store(tmp_path, points=["p"])
    seen = []
    for number in range(3):
        parts = [b"head %d" % number, template, bytes([number]) * 50_000]
        store.write(Batch(checkpoints={"p": (number, parts)}))
        assert store.checkpoint("p") == (number, b"".join(parts))
        seen.append(parts_in(tmp_path))
    # Three parts at a time, of which one is the same row throughout.
    assert [len(one) for one in seen] == [3, 3, 3]
    assert len(set.intersection(*(set(one.items()) for one in seen))) == 1
    store.close()


def test_parts_that_are_gone_or_changed_are_a_clear_error(tmp_path):
    store = open_store(tmp_path, points=["p"])
    store.write(Batch(checkpoints={"p": (1, [b"a" * 5000, b"b" * 5000])}))
    with closing(sqlite3.connect(tmp_path / "checkpoints.sqlite")) as file:
        file.execute("UPDATE part SET body = substr(body, 1, 12) WHERE rowid = 1")
        file.commit()
        with pytest.raises(DataError, match="checkpoint of p is damaged"):
            store.checkpoint("p")
        file.execute("DELETE FROM part WHERE rowid = 1")
        file.commit()
        with pytest.raises(DataError, match="checkpoint of p is damaged"):
            store.checkpoint("p")
    store.close()
