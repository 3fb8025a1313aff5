"""A store looked through, mended, saved: what can be read is not lost, and a copy made while it runs is whole."""

import json
import sqlite3
import tarfile
import threading
from contextlib import closing

import numpy as np
import pytest
from test_store_log import RATE_HZ, equals_seconds, kept, second

from midspan.cli.main import run
from midspan.errors import DataError, UsageError
from midspan.store import store as module
from midspan.store import upkeep
from midspan.store.store import Batch, open_store


@pytest.fixture(autouse=True)
def short_blocks(monkeypatch):
    monkeypatch.setattr(module, "BLOCK_S", 5.0)


@pytest.fixture
def written(tmp_path):
    """30 s in blocks of 5, with a checkpoint."""
    where = tmp_path / "store"
    store = open_store(where, points=["p"])
    for number in range(30):
        store.write(Batch([second(number)], checkpoints={"p": (number, [b"x" * 10_000])} if number == 20 else {}))
    store.close()
    return where


def day_of(where):
    (day,) = (where / "days").glob("*.sqlite")
    return day


def test_a_whole_store_has_no_faults(written):
    found = upkeep.check(str(written))
    assert found.faults == ()
    assert (found.chunks, found.rows) == (6, 30 * RATE_HZ)
    assert upkeep.repair(str(written)) == []


def test_a_chunk_whose_bytes_changed_is_named_and_taken_out(written, capsys):
    with closing(sqlite3.connect(day_of(written))) as day:
        (body,) = day.execute("SELECT body FROM block WHERE rowid = 3").fetchone()
        day.execute("UPDATE block SET body = ? WHERE rowid = 3", (body[:500] + b"?" + body[501:],))
        day.commit()
    assert run(["store", str(written), "check", "--json"]) == 3
    (fault,) = json.loads(capsys.readouterr().out)["faults"]
    assert fault["file"].startswith("days/")
    assert "damaged chunk of p, rows" in fault["fault"]
    assert run(["store", str(written), "repair", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["mended"]) == 1
    assert run(["store", str(written), "check", "--quiet"]) == 0
    # A gap is a gap; all others are as they were.
    assert len(kept(written).time_ns) == 25 * RATE_HZ


@pytest.mark.parametrize("name", ["day", "site.sqlite", "checkpoints.sqlite"])
def test_a_file_with_damaged_pages_is_made_anew_of_what_can_be_read(written, name):
    file = day_of(written) if name == "day" else written / name
    data = bytearray(file.read_bytes())
    # The card lost a block of 4 kB in the middle of it, or its first page.
    at = len(data) // 8192 * 4096 if name == "day" else 0
    data[at : at + 4096] = bytes(range(256)) * 16
    file.write_bytes(bytes(data))
    assert upkeep.check(str(written)).faults
    assert upkeep.repair(str(written))
    assert upkeep.check(str(written)).faults == ()
    assert file.with_name(file.name + ".damaged").read_bytes() == bytes(data)
    found = kept(written)
    assert len(found.time_ns) >= (10 if name == "day" else 30) * RATE_HZ
    store = open_store(written, points=["p"])
    assert store.points == ["p"]
    store.write(Batch([second(30)]))
    assert store.newest_ns("p", "rows") == second(30).time_ns[-1]
    store.close()


def test_a_log_that_a_power_cut_left_is_mended(written):
    store = open_store(written, points=["p"])
    for number in range(30, 33):
        store.write(Batch([second(number)]))
    (log,) = (written / "log").iterdir()
    data = log.read_bytes()
    # It is written still.
    assert upkeep.check(str(written)).faults == ()
    with pytest.raises(UsageError, match="another process writes"):
        upkeep.repair(str(written))
    store.close()
    log.write_bytes(data[:-100])
    assert "an incomplete record" in upkeep.check(str(written)).faults[0].text
    assert upkeep.repair(str(written))
    assert upkeep.check(str(written)).faults == ()
    equals_seconds(kept(written), 33)


@pytest.mark.parametrize("suffix", ["", ".tar"])
def test_a_copy_that_is_made_while_a_store_is_written_is_whole(written, tmp_path, suffix):
    store, ended = open_store(written, points=["p"]), threading.Event()

    def write():
        number = 30
        while not ended.is_set():
            store.write(Batch([second(number)], checkpoints={"p": (number, [b"%d" % number])}))
            number += 1

    writing = threading.Thread(target=write)
    writing.start()
    copies = [tmp_path / f"copy-{k}{suffix}" for k in range(3)]
    for copy in copies:
        upkeep.backup(str(written), copy)
    ended.set()
    writing.join()
    store.close()
    for number, copy in enumerate(copies):
        where = copy
        if suffix:
            with tarfile.open(copy) as archive:
                archive.extractall(tmp_path / "unpacked", filter="data")
            where = tmp_path / "unpacked" / f"copy-{number}"
        assert upkeep.check(str(where)).faults == ()
        found = kept(where)
        equals_seconds(found, len(found.time_ns) // RATE_HZ)
        # What the checkpoint rests on is there.
        store = open_store(where, points=["p"])
        assert second(store.checkpoint("p")[0]).time_ns[-1] <= store.newest_ns("p", "rows")
        store.close()
    assert not list(tmp_path.glob("*.part*"))
    with pytest.raises(UsageError, match="already exists"):
        upkeep.backup(str(written), copies[0])


def test_what_is_no_store_in_a_folder_is_said(tmp_path, capsys):
    with pytest.raises(DataError, match="is not a store"):
        upkeep.check(str(tmp_path))
    assert run(["store", "postgresql://nobody@host/db", "backup", str(tmp_path / "x")]) == 2
    assert "pg_dump" in capsys.readouterr().err
    assert run(["store", str(tmp_path), "backup"]) == 2
    assert "FILE: is missing; backup needs one" in capsys.readouterr().err


def test_figures_of_a_mended_store_are_those_of_its_rows(written):
    with closing(sqlite3.connect(written / "site.sqlite")) as site:
        site.execute("DELETE FROM pyramid")
        site.execute("DELETE FROM kept")
        site.commit()
    upkeep.repair(str(written))
    store = open_store(written, read_only=True)
    found = store.buckets("p", "rows", 0, 2**61, 10)
    assert np.nanmax(found.high) == kept(written).columns["displacement_m"].max()
    store.close()
