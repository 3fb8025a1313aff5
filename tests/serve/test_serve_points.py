"""What the interface says of points: the newest row, series at every zoom, files, events, calibrations."""

import asyncio
import io
import json

import numpy as np
import pytest

from midspan.records import NANOSECONDS
from midspan.serve import points
from midspan.serve.reading import first_of_groups, iso
from midspan.serve.serving import Serving
from served import GAP_S, LOST_S, PEAK_MM, PEAK_S, RATE, SECONDS, rows, until


def at(begin_ns, seconds):
    return begin_ns + round(seconds * NANOSECONDS)


def test_points_have_their_newest_row(reader, engine, begin_ns):
    one = reader.get("/api/v1/points/p").json()
    assert (one["name"], one["status"], one["reason"], one["calibration"]) == ("p", "tracking", "", 1)
    assert set(one) >= {"displacement_mm", "displacement_std_mm", "time", "age_s"}
    newest = rows(at(begin_ns, SECONDS), 0.5)
    engine.give(newest)
    until(lambda: reader.get("/api/v1/points/p").json()["time"] == iso(int(newest.time_ns[-1])))
    one = reader.get("/api/v1/points").json()[0]
    assert one["displacement_mm"] == pytest.approx(1e3 * newest.columns["displacement_m"][-1])
    assert one["displacement_std_mm"] == pytest.approx(0.01)
    assert reader.get("/api/v1/points/nobody").status_code == 404


def test_a_few_seconds_of_rows_start_no_process(store_folder, begin_ns):
    """One takes a second to start, and the page's first trace would wait for it."""
    serving = Serving(str(store_folder))
    answer = asyncio.run(points.series("p", serving, str(begin_ns), str(at(begin_ns, 3.0))))
    assert len(json.loads(answer.body)["time"]) == 3 * RATE
    assert serving.long._executor is None
    serving.close()


@pytest.mark.parametrize("count", [60, 600, 4999])
def test_a_peak_keeps_its_height_and_its_bucket_and_a_gap_is_a_gap(reader, begin_ns, count):
    span = {"from": begin_ns, "to": at(begin_ns, SECONDS), "buckets": count}
    found = reader.get("/api/v1/points/p/series", params=span).json()
    assert {len(values) for values in found.values()} == {count}
    begins = np.array(found["time"])
    np.testing.assert_allclose(np.diff(begins), SECONDS * NANOSECONDS / count, atol=1.0)
    high = np.array([np.nan if one is None else one for one in found["displacement_mm_max"]])
    peak = int(np.searchsorted(begins, at(begin_ns, PEAK_S), side="right")) - 1
    assert np.nanargmax(high) == peak
    assert high[peak] == pytest.approx(PEAK_MM)
    middle_s = (begins - begin_ns) / NANOSECONDS + SECONDS / count / 2
    gap = (middle_s > GAP_S[0] + 10) & (middle_s < GAP_S[1] - 10)
    for name in ("displacement_mm_min", "displacement_mm_max", "displacement_mm_mean", "displacement_std_mm", "status"):
        assert {found[name][k] for k in np.flatnonzero(gap)} == {None}
    assert {found["rows"][k] for k in np.flatnonzero(gap)} == {0}
    every, mean = np.array(found["rows"]), np.array(found["displacement_mm_mean"], dtype=float)
    rows = reader.get("/api/v1/points/p/series", params={key: span[key] for key in ("from", "to")}).json()
    kept = [mm for mm, is_lost in zip(rows["displacement_mm"], rows["status"], strict=True) if is_lost != "lost"]
    assert np.nansum(every * mean) / every.sum() == pytest.approx(np.mean(kept), abs=1e-5)
    lost = (middle_s > LOST_S[0] + 1) & (middle_s < LOST_S[1] - 1)
    # What is lost is said, and rules no axis.
    assert {found["status"][k] for k in np.flatnonzero(lost)} <= {"lost"}
    assert np.nanmax(high) < 100.0


def test_rows_come_at_full_rate_as_json_and_as_arrow(reader, begin_ns):
    import pyarrow as pa

    span = {"from": begin_ns, "to": at(begin_ns, 10.0)}
    found = reader.get("/api/v1/points/p/series", params=span).json()
    assert len(found["time"]) == 10 * RATE
    assert found["time"][0] == begin_ns
    assert {"time_s", "displacement_mm", "displacement_std_mm", "velocity_mm_s", "source", "status"} <= set(found)
    assert (found["source"][0], found["status"][0]) == ("camera", "tracking")
    answer = reader.get("/api/v1/points/p/series", params={**span, "format": "arrow"})
    table = pa.ipc.open_stream(answer.content).read_all()
    assert table.column("time").cast(pa.int64()).to_pylist() == found["time"]
    assert table.column("displacement_mm").to_pylist() == pytest.approx(found["displacement_mm"])
    assert table.column("status").to_pylist() == found["status"]
    nothing = {"from": at(begin_ns, GAP_S[0] + 1), "to": at(begin_ns, GAP_S[0] + 2)}
    assert reader.get("/api/v1/points/p/series", params=nothing).json()["time"] == []


def test_times_are_iso_or_whole_nanoseconds(reader, begin_ns):
    by_number = {"from": at(begin_ns, 1.0), "to": at(begin_ns, 2.0)}
    second = np.datetime64(at(begin_ns, 1.0), "ns").astype("datetime64[s]")
    zone = str(second + np.timedelta64(2, "h")) + "+02:00"
    for begin in (f"{second}Z", str(second), f"{second}.000000000Z", zone):
        found = reader.get("/api/v1/points/p/series", params={**by_number, "from": begin}).json()
        assert found["time"][0] == at(begin_ns, 1.0), begin


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"from": "2026-01-02T00:00:00Z", "to": "2026-01-01T00:00:00Z"}, "`to` must be after `from`"),
        ({"from": "2026-01-01", "to": "2026-01-01"}, "`to` must be after `from`"),
        ({"from": "yesterday"}, "from"),
        ({"from": "2026-13-01"}, "from"),
        ({"from": "9" * 19}, "1970"),
        ({"buckets": 5001}, "5000"),
        ({"buckets": 0}, "buckets"),
        ({"buckets": 5, "format": "arrow"}, "format"),
        ({"format": "exe"}, "format"),
    ],
)
def test_wrong_arguments_are_said(reader, given, words):
    answer = reader.get("/api/v1/points/p/series", params=given)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert words in answer.json()["detail"]


def test_too_many_rows_for_json_are_said(store_folder, begin_ns, monkeypatch):
    from midspan.errors import DataError
    from midspan.serve import reading

    monkeypatch.setattr(reading, "MAX_ROWS", 100)
    with pytest.raises(DataError, match="at most 100 rows"):
        reading.series_json(str(store_folder), "p", begin_ns, at(begin_ns, 10.0))


def test_too_many_rows_for_a_file_are_said(store_folder, begin_ns, monkeypatch, tmp_path):
    from midspan.errors import DataError
    from midspan.serve import reading

    monkeypatch.setattr(reading, "MAX_FILE_ROWS", 100)
    with pytest.raises(DataError, match="at most 100 rows"):
        reading.export(str(store_folder), "p", (begin_ns, at(begin_ns, 10.0)), str(tmp_path / "p.csv"))


def test_a_file_has_every_row(reader, begin_ns, store_folder):
    import pandas as pd

    span = {"from": begin_ns, "to": at(begin_ns, SECONDS)}
    answer = reader.get("/api/v1/points/p/export", params=span)
    assert answer.headers["content-disposition"].startswith("attachment")
    table = pd.read_csv(io.BytesIO(answer.content), comment="#")
    assert len(table) == (SECONDS - (GAP_S[1] - GAP_S[0])) * RATE
    assert list(table.columns[:4]) == ["time_s", "displacement_mm", "displacement_std_mm", "velocity_mm_s"]
    parquet = reader.get("/api/v1/points/p/export", params={**span, "format": "parquet"})
    assert len(pd.read_parquet(io.BytesIO(parquet.content))) == len(table)
    for wrong in ("exe", "../../etc/passwd"):
        assert reader.get("/api/v1/points/p/export", params={"format": wrong}).status_code == 422
    empty = {"from": at(begin_ns, GAP_S[0] + 1), "to": at(begin_ns, GAP_S[0] + 2)}
    assert "no rows" in reader.get("/api/v1/points/p/export", params=empty).json()["detail"]


def test_spans_of_calibrations_are_read_once_for_all_who_ask(monkeypatch, tmp_path):
    reads = []
    monkeypatch.setattr("midspan.serve.reading.calibrated_rows", lambda _where, point: reads.append(point) or {1: []})
    serving = Serving(str(tmp_path))

    async def ask():
        return [await serving.calibrated_rows(name) for name in ("p", "q", "p", "q")]

    assert asyncio.run(ask()) == [{1: []}] * 4
    assert reads == ["p", "q"]
    serving.close()


def test_events_spectrum_and_calibrations_are_as_stored(reader, begin_ns):
    span = {"from": begin_ns, "to": at(begin_ns, SECONDS)}
    (event,) = reader.get("/api/v1/points/p/events", params=span).json()
    assert (event["kind"], event["text"], event["time_ns"]) == ("gap", "<b>a</b> gap", at(begin_ns, 1.0))
    found = reader.get("/api/v1/points/p/spectrum", params={"from": begin_ns, "to": at(begin_ns, 120.0)}).json()
    peak = found["frequency_hz"][int(np.argmax(found["density_mm2_hz"]))]
    assert peak == pytest.approx(0.8, abs=0.05)
    short = {"from": begin_ns, "to": at(begin_ns, 0.1)}
    assert "longer" in reader.get("/api/v1/points/p/spectrum", params=short).json()["reason"]
    kept = reader.get("/api/v1/points/p/calibrations").json()
    assert [(one["id"], one["state"]) for one in kept] == [(1, "in force"), (2, "offered")]
    # The gap of a minute is shorter than what an index of blocks tells.
    assert kept[0]["rows"][0]["from"] == iso(begin_ns)
    assert kept[0]["rows"][-1]["to"] >= iso(at(begin_ns, SECONDS - 0.01))
    assert kept[1]["rows"] == []
    assert reader.get("/api/v1/points/q/calibrations").json() == []


@pytest.mark.parametrize("path", ["..%2f..%2fetc%2fpasswd", "%2e%2e/x", "p%00", "a/../../p", "<script>"])
def test_names_lead_nowhere_else(reader, path):
    answer = reader.get(f"/api/v1/points/{path}/export")
    assert answer.status_code in (404, 422)
    assert json.loads(answer.content)["status"] == answer.status_code


def test_of_each_group_the_first_points_are_listed():
    points = ["deck", *(f"north-{k}" for k in range(5)), "pier-1", "pier-2", "pier-3"]
    assert first_of_groups(points, ["north"], 2) == ["deck", "north-0", "north-1", "pier-1", "pier-2", "pier-3"]
    assert first_of_groups(points, ["north"], None) == points
