"""A store of schema 1, written by the version before: read as it is, and carried forward by the first that writes."""

import sqlite3
import zipfile
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from midspan.records import NANOSECONDS, Event
from midspan.store.chunk import Chunk, join
from midspan.store.days import DAY_NS
from midspan.store.store import Batch, open_store

# 65 s from half a minute before midnight: rows and acceleration of 20 Hz, phasors, events, a calibration, a checkpoint.
BEGIN_NS, SECONDS, RATE_HZ = 20_700 * DAY_NS - 30 * NANOSECONDS, 65, 20
NUMBER = np.arange(SECONDS * RATE_HZ)
TIME_NS = BEGIN_NS + NUMBER * (NANOSECONDS // RATE_HZ)


@pytest.fixture
def old(tmp_path):
    with zipfile.ZipFile(Path(__file__).with_name("schema1.zip")) as kept:
        kept.extractall(tmp_path / "store")
    return tmp_path / "store"


def value(number):
    return 1e-3 * np.sin(0.01 * number)


def later(count=100):
    number = len(NUMBER) + np.arange(count)
    columns = {"displacement_m": value(number), "std_m": np.full(count, 2e-5), "status": np.zeros(count, np.uint8)}
    return Chunk("p", "rows", BEGIN_NS + number * (NANOSECONDS // RATE_HZ), columns, 1, "displacement_m")


def looked_at(store):
    """All that readers ask for."""
    rows = join(list(store.chunks("p", "rows", 0, 2**62)))
    np.testing.assert_array_equal(rows.time_ns[: len(TIME_NS)], TIME_NS)
    np.testing.assert_array_equal(rows.columns["displacement_m"][: len(NUMBER)], value(NUMBER))
    raw = join(list(store.chunks("p", "accelerometer", 0, 2**62)))
    np.testing.assert_array_equal(raw.columns["value"], np.sin(0.3 * NUMBER).astype("f4").astype("f8"))
    assert next(store.chunks("p", "radar", 0, 2**62)).columns["phasors"].dtype == np.complex64
    assert store.points == ["p"]
    assert store.streams("p") == ["accelerometer", "radar", "rows"]
    assert store.days("p", "rows") == [20_699, 20_700]
    assert store.events("p", 0, 2**62)[0] == Event(BEGIN_NS, "seen", "Number 0.")
    assert store.calibration("p").number == 1
    # Of two seconds each, the seconds' figures; of less, the rows.
    for length_ns in (2 * NANOSECONDS, NANOSECONDS // 2):
        edges = BEGIN_NS + length_ns * np.arange(1 + SECONDS * NANOSECONDS // length_ns)
        drawn = store.drawn("p", "rows", edges, "displacement_m")
        inside = np.searchsorted(TIME_NS, edges)
        high = [value(NUMBER[a:b]).max() for a, b in pairwise(inside)]
        np.testing.assert_allclose(drawn.high, high, rtol=1e-6)


def test_an_old_store_is_read_as_it_is(old):
    before = {file: file.read_bytes() for file in old.rglob("*.sqlite")}
    store = open_store(old, read_only=True)
    looked_at(store)
    assert store.newest_ns("p", "rows") == TIME_NS[-1]
    assert store.checkpoint("p") == (int(TIME_NS[61 * RATE_HZ - 1]), b'{"old": 1}\n state')
    store.close()
    assert {file: file.read_bytes() for file in old.rglob("*.sqlite")} == before


def test_an_old_store_is_carried_forward_and_goes_on(old):
    store = open_store(old)
    # What is pushed again is not doubled.
    store.write(Batch([later(), Chunk("p", "accelerometer", TIME_NS, {"value": np.ones(len(TIME_NS))})]))
    looked_at(store)
    store.close()
    with closing(sqlite3.connect(old / "site.sqlite")) as site:
        assert site.execute("SELECT value FROM meta").fetchall() == [("2",)]
    store = open_store(old, points=["p"])
    looked_at(store)
    assert len(join(list(store.chunks("p", "rows", 0, 2**62))).time_ns) == len(NUMBER) + 100
    store.write(Batch(checkpoints={"p": (int(TIME_NS[-1]), [b"new"])}))
    assert store.checkpoint("p") == (int(TIME_NS[-1]), b"new")
    # The peak of what both tables of a day have stands in one history.
    edges = np.array([BEGIN_NS, BEGIN_NS + 80 * NANOSECONDS])
    whole = value(np.arange(len(NUMBER) + 100))
    assert store.drawn("p", "rows", edges, "displacement_m").high[0] == pytest.approx(whole.max(), rel=1e-6)
    store.forget_since("p", int(TIME_NS[-10]), 1)
    assert store.newest_ns("p", "rows") == TIME_NS[-11]
    store.close()
