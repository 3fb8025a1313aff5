"""Files of seismic networks: K-NET, SAC, GSE2; miniSEED under archive names and in SEED volumes; COSMOS V1."""

import importlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pymseed
import pytest

from midspan.cli.main import run
from midspan.errors import DataError, UsageError
from midspan.sources.accelerometer.formats import FORMATS, list_channels
from midspan.sources.accelerometer.select import SeriesRequest, read_series

RATE_HZ, COUNT = 100.0, 1200
COUNTS = np.rint(4000.0 * np.sin(np.arange(COUNT) / 7.0) + 50.0 * np.cos(np.arange(COUNT))).astype(np.int32)
# 2011-03-11T05:46:23.5Z, the first sample.
START_NS = 1_299_822_383_500_000_000


def accelerations(path: Path, **keys: Any) -> Any:
    return read_series(path, SeriesRequest("acceleration", **keys))


def write_knet(path: Path) -> Path:
    """A K-NET file written by hand: the header's time is Japan's and 15 s late; 3920 gal are 6182761 counts."""
    lines = [
        ("Origin Time", "2011/03/11 14:46:00"),
        ("Lat.", "38.103"),
        ("Long.", "142.860"),
        ("Depth. (km)", "24"),
        ("Mag.", "9.0"),
        ("Station Code", "MYG004"),
        ("Station Lat.", "38.7292"),
        ("Station Long.", "141.0217"),
        ("Station Height(m)", "40"),
        ("Record Time", "2011/03/11 14:46:38"),
        ("Sampling Freq(Hz)", "100Hz"),
        ("Duration Time(s)", "12"),
        ("Dir.", "N-S"),
        ("Scale Factor", "3920(gal)/6182761"),
        ("Max. Acc. (gal)", "2.6"),
        ("Last Correction", "2011/03/11 14:46:00"),
        ("Memo.", ""),
    ]
    rows = ["".join(f"{v:9d}" for v in COUNTS[k : k + 8]) for k in range(0, COUNT, 8)]
    path.write_text("".join(f"{key:<18}{value}\n" for key, value in lines) + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("name", ["MYG0041103111446.NS", "MYG0041103111446.NS2", "a.knet", "renamed.1446"])
def test_knet_gives_acceleration_in_m_s2_and_utc_without_its_delay(tmp_path: Path, name: str) -> None:
    pytest.importorskip("obspy")
    series = accelerations(write_knet(tmp_path / name))
    # 3920 gal are 39.2 m/s².
    np.testing.assert_allclose(series.value, COUNTS * 39.2 / 6182761, rtol=1e-12)
    assert series.time_ns[0] == START_NS - 500_000_000
    np.testing.assert_array_equal(np.diff(series.time_ns), 10_000_000)


@pytest.mark.parametrize(
    ("kind", "name"), [("SAC", "a.sac"), ("SAC", "STA.BHZ.2011"), ("GSE2", "a.gse2"), ("GSE2", "a")]
)
def test_sac_and_gse2_give_their_numbers_and_times(tmp_path: Path, kind: str, name: str) -> None:
    obspy = pytest.importorskip("obspy")
    header = {"sampling_rate": RATE_HZ, "starttime": obspy.UTCDateTime(ns=START_NS), "station": "STA", "channel": "HNZ"}
    data = COUNTS.astype(np.float32) if kind == "SAC" else COUNTS
    obspy.Trace(data, header).write(str(tmp_path / name), format=kind)
    series = accelerations(tmp_path / name, unit="gal")
    np.testing.assert_allclose(series.value, COUNTS * 0.01, rtol=1e-6)
    assert series.time_ns[0] == START_NS
    # SAC's step is a 32-bit number: 0.01 s to 2e-10 s.
    assert np.abs(np.diff(series.time_ns) - 10_000_000).max() <= 2
    with pytest.raises(UsageError, match="unit"):
        accelerations(tmp_path / name)


def test_a_damaged_sac_number_is_a_missing_sample_without_a_warning(tmp_path: Path) -> None:
    obspy = pytest.importorskip("obspy")
    header = {"sampling_rate": RATE_HZ, "starttime": obspy.UTCDateTime(ns=START_NS)}
    obspy.Trace(COUNTS.astype(np.float32), header).write(str(tmp_path / "a.sac"), format="SAC")
    content = bytearray((tmp_path / "a.sac").read_bytes())
    # A NaN that signals; the numbers follow a header of 632 bytes.
    content[632 + 40 : 632 + 44] = np.uint32(0x7F800001).tobytes()
    (tmp_path / "a.sac").write_bytes(content)
    series = accelerations(tmp_path / "a.sac", unit="gal")
    assert np.isfinite(series.value).sum() == COUNT - 1


@pytest.mark.parametrize("sub_format", ["CM6", "INT"])
def test_gse2_gives_every_sample_and_a_damaged_block_is_a_gap(tmp_path: Path, sub_format: str) -> None:
    obspy = pytest.importorskip("obspy")
    # Values of all sizes up to 2^14: one to four characters a sample.
    rng = np.random.default_rng(17)
    values = [np.rint(2.0 ** rng.uniform(0, 14, 500) * rng.choice([-1, 1], 500)).astype(np.int32) for _ in range(3)]
    starts = [obspy.UTCDateTime(ns=START_NS + k * 10**10) for k in range(3)]
    path = tmp_path / "a.gse2"
    if sub_format == "CM6":
        header = {"sampling_rate": RATE_HZ, "station": "S", "channel": "HNZ"}
        traces = [obspy.Trace(part, {**header, "starttime": t}) for part, t in zip(values, starts, strict=True)]
        obspy.Stream(traces).write(str(path), format="GSE2")
    else:
        text = ""
        for part, start in zip(values, starts, strict=True):
            stamp = start.strftime("%Y/%m/%d %H:%M:%S.500")
            text += f"WID2 {stamp} S     HNZ      INT      500  100.000000   1.00e+00   1.000\nDAT2\n"
            text += " ".join(map(str, part)) + f"\nCHK2 {abs(int(part.sum()))}\n"
        path.write_text(text)
    found = list_channels(path)
    np.testing.assert_array_equal(found.channels[0].values, np.concatenate(values))
    assert found.channels[0].time_ns is not None
    np.testing.assert_array_equal(found.channels[0].time_ns[::500], START_NS + np.arange(3) * 10**10)
    # A changed character changes all samples that follow in CM6: the checksum tells.
    data = bytearray(path.read_bytes())
    place = data.index(b"DAT2", data.index(b"DAT2") + 4) + 60
    data[place] = ord("1") if data[place : place + 1] != b"1" else ord("2")
    path.write_bytes(data)
    found = list_channels(path)
    np.testing.assert_array_equal(found.channels[0].values, np.concatenate((values[0], values[2])))
    assert len(found.damage) == 1


def test_a_missing_library_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = importlib.import_module

    def without(name: str, package: str | None = None) -> Any:
        if name == "obspy":
            raise ImportError("No module named 'obspy'")
        return whole(name, package)

    monkeypatch.setattr(importlib, "import_module", without)
    assert run(["inspect", str(write_knet(tmp_path / "a.NS"))]) == 2
    assert "ObsPy, which is not installed. Run: pip install 'midspan[seismic]'" in capsys.readouterr().err


def write_mseed(path: Path, encoding: pymseed.DataEncoding = pymseed.DataEncoding.STEIM2) -> bytes:
    traces = pymseed.MS3TraceList()
    traces.add_data("FDSN:CH_BALST__H_N_Z", COUNTS, "i", RATE_HZ, starttime=START_NS)
    traces.to_file(str(path), overwrite=True, max_record_length=512, encoding=encoding, format_version=2)
    return path.read_bytes()


@pytest.mark.parametrize("name", ["CH.BALST..HNZ.D.2025.314", "CH.BALST..HNZ", "a.ms", "a.seed"])
def test_miniseed_is_known_by_what_it_begins_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    write_mseed(tmp_path / name)
    series = accelerations(tmp_path / name, unit="gal")
    np.testing.assert_allclose(series.value, COUNTS * 0.01, rtol=1e-12)
    assert series.time_ns[0] == START_NS
    assert run(["inspect", str(tmp_path / name), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["channels"][0]["samples"] == COUNT


@pytest.mark.parametrize("name", ["volume.mseed", "volume.2025"])
def test_a_full_seed_volume_gives_its_records_of_data(tmp_path: Path, name: str) -> None:
    data = write_mseed(tmp_path / name)
    # Control headers of a volume, a station and a time span, each of one record of 512 bytes; the last amid the data.
    volume, station, span = (
        f"{number:06d}{kind} 0100090 2.4".encode().ljust(512) for number, kind in ((1, "V"), (2, "S"), (3, "T"))
    )
    (tmp_path / name).write_bytes(volume + station + data[:1024] + span + data[1024:])
    found = list_channels(tmp_path / name)
    np.testing.assert_array_equal(found.channels[0].values, COUNTS)
    assert found.notes == ("1536 bytes are no records of data (control headers of a SEED volume) and are left out",)
    assert found.damage == ()
    (tmp_path / name).write_bytes(volume + station)
    with pytest.raises(DataError, match="cannot be read as miniSEED"):
        list_channels(tmp_path / name)


def test_other_bytes_before_and_between_records_are_left_out_and_reported(tmp_path: Path) -> None:
    data = write_mseed(tmp_path / "a.mseed")
    (tmp_path / "a.mseed").write_bytes(b"000001  ".ljust(512) + data[:512] + bytes(512) + data[512:])
    found = list_channels(tmp_path / "a.mseed")
    np.testing.assert_array_equal(found.channels[0].values, COUNTS)
    assert found.damage == ("1024 bytes are no records of data and are left out",)


@pytest.mark.parametrize(("unit", "factor"), [("cm/s^2 (4)", 0.01), ("cm/sec2(04)", 0.01), ("counts (50)", None)])
def test_cosmos_v1_is_read_as_v2_is(tmp_path: Path, unit: str, factor: float | None) -> None:
    reals = [-999.0] * 33 + [0.005] + [-999.0] * 66
    values = np.round(COUNTS[:20] / 100.0, 4)
    text = "Uncorrected acceleration    (Format v01.20 with 13 text lines)\nSta Chan   1:270 deg (Rcrdr Chan  1)\n"
    text += " 100 Real-header values follow on  17 lines, Format= (6F13.6)\n"
    text += "\n".join("".join(f"{v:13.6f}" for v in reals[k : k + 6]) for k in range(0, 100, 6)) + "\n"
    text += f"  20 acceleration pts, approx    0 secs, units={unit},Format=(8F10.4)\n"
    text += "\n".join("".join(f"{v:10.4f}" for v in values[k : k + 8]) for k in range(0, 20, 8)) + "\n"
    (tmp_path / "a.V1c").write_text(text + "End-of-data for Chan  1 acceleration\n")
    if factor is None:
        # Counts of a converter say nothing of m/s²: the unit is asked for.
        with pytest.raises(UsageError, match="the unit of 'channel_1_acceleration' is not in the file"):
            accelerations(tmp_path / "a.V1c")
        return
    series = accelerations(tmp_path / "a.V1c")
    np.testing.assert_allclose(series.value, values * factor, rtol=1e-12)
    np.testing.assert_array_equal(series.time_ns, np.arange(20) * 5_000_000)


def test_the_list_of_formats_names_the_extra(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["formats"]) == 0
    out = capsys.readouterr().out
    assert "K-NET and KiK-net (by ObsPy (extra seismic))" in out
    assert {"K-NET and KiK-net", "SAC", "GSE2"} <= {name for name, _, _ in FORMATS}
