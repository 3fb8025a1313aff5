"""Days of a store as Parquet: whole, once each, and readable by others while the store goes on."""

import numpy as np
import pandas as pd

from midspan.records import NANOSECONDS
from midspan.store.archive import archive
from midspan.store.chunk import Chunk
from midspan.store.days import DAY_NS
from midspan.store.store import Batch, open_store

FIRST_DAY = 20_700


def written(store, first_ns, seconds, calibration=1):
    """Rows every second and radar phasors every ten."""
    time_ns = first_ns + NANOSECONDS * np.arange(seconds)
    rows = Chunk("p", "rows", time_ns, {"displacement_m": np.arange(float(seconds))}, calibration, "displacement_m")
    phasors = np.arange(2.0 * len(time_ns[::10])).reshape(-1, 2).astype(np.complex64)
    radar = Chunk("p", "radar", time_ns[::10], {"phasors": phasors}, calibration)
    store.write(Batch([rows, radar]))


def test_each_whole_day_is_archived_once_with_all_its_streams(store_at, tmp_path):
    store, folder = open_store(store_at), tmp_path / "archive"
    # Two hours and a half over midnight, then another day that is not over.
    written(store, (FIRST_DAY + 1) * DAY_NS - 3600 * NANOSECONDS, 9000)
    now_ns = (FIRST_DAY + 2) * DAY_NS + 3600 * NANOSECONDS
    written(store, now_ns - 600 * NANOSECONDS, 600, calibration=2)
    days = [place.relative_to(folder).as_posix() for place in archive(store, folder, now_ns)]
    assert days == ["p/2026-09-04", "p/2026-09-05"]
    kept = [pd.read_parquet(folder / day / "rows.parquet") for day in days]
    assert [len(one) for one in kept] == [3600, 5400]
    both = pd.concat(kept)
    np.testing.assert_array_equal(both["displacement_m"], np.arange(9000.0))
    assert str(both["time"].dtype) == "datetime64[ns, UTC]"
    assert both["time"].iloc[0] == pd.Timestamp("2026-09-04T23:00:00Z")
    assert set(both["calibration"]) == {1}
    # What is there is not written again; what comes later is, once its day is over.
    assert list(archive(store, folder, now_ns)) == []
    assert len(list(archive(store, folder, now_ns + DAY_NS))) == 1
    store.close()


def test_a_day_that_was_broken_off_is_written_anew(tmp_path):
    store, folder = open_store(tmp_path / "store"), tmp_path / "archive"
    written(store, FIRST_DAY * DAY_NS, 60)
    broken = folder / "p" / "2026-09-04.part"
    broken.mkdir(parents=True)
    (broken / "rows.parquet").write_bytes(b"PAR1")
    (place,) = archive(store, folder, (FIRST_DAY + 1) * DAY_NS)
    assert not broken.exists()
    assert len(pd.read_parquet(place / "rows.parquet")) == 60
    store.close()


def test_neither_archiving_nor_removing_opens_the_days_that_it_does_not_concern(tmp_path):
    store = open_store(tmp_path / "store")
    for day in range(4):
        written(store, (FIRST_DAY + day) * DAY_NS, 60)
    now_ns = (FIRST_DAY + 4) * DAY_NS
    assert len(list(archive(store, tmp_path / "archive", now_ns))) == 4
    store.close()
    store = open_store(tmp_path / "store")
    assert list(archive(store, tmp_path / "archive", now_ns)) == []
    store.forget_before((FIRST_DAY + 2) * DAY_NS)
    assert store._days._open == {}
    assert store.days("p", "rows") == [FIRST_DAY + 2, FIRST_DAY + 3]
    assert store.newest_ns("p", "rows") == (FIRST_DAY + 3) * DAY_NS + 59 * NANOSECONDS
    assert list(store._days._open) == [FIRST_DAY + 3]
    store.close()
