"""Damaged radar files: a sentence with the file's name, or what is whole of it; never an error of a library."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from radar_captures import echoes, settings, words_by_hand

from midspan.cli.main import run
from midspan.errors import DataError, MidspanError
from midspan.simulate.radar.setup import packets
from midspan.sources.radar.formats import open_radar
from midspan.sources.radar.radar_source import RadarRequest
from midspan.sources.radar.ti_config import read_settings

CUBE = echoes((5.0, 12.4))
WORDS = words_by_hand(CUBE, "IIQQ")
RNG = np.random.default_rng(1)
IQ = (RNG.normal(size=(60, 4)) + 1j * RNG.normal(size=(60, 4))).astype(np.complex64)


def slow_h5(folder: Path) -> Path:
    with h5py.File(folder / "slow.h5", "w") as file:
        file.create_dataset("iq", data=IQ, compression="gzip", chunks=(16, 4))
        file["time_s"] = np.arange(60) / 100.0
        file.attrs["carrier_hz"] = 77e9
    return folder / "slow.h5"


def slow_npy(folder: Path) -> Path:
    settings(folder)
    np.save(folder / "slow.npy", IQ)
    return folder / "slow.npy"


def acconeer(folder: Path) -> Path:
    """Sixty frames of two sweeps with three ranges, as the maker's recorder lays them out."""
    sweeps = np.zeros((60, 2, 3), dtype=[("real", "<i2"), ("imag", "<i2")])
    sweeps["real"], sweeps["imag"] = RNG.integers(-900, 900, (2, 60, 2, 3))
    own = {
        "sweep_rate": 1000.0,
        "frame_rate": 50.0,
        "subsweeps": [{"start_point": 80, "step_length": 4, "num_points": 3, "enable_tx": True}],
    }
    texts = {
        "session_config": {"groups": [{"1": own}]},
        "metadata": {"base_step_length_m": 0.0025, "subsweep_data_offset": [0], "subsweep_data_length": [3]},
        "server_info": {"ticks_per_second": 1000},
    }
    with h5py.File(folder / "acconeer.h5", "w") as file:
        entry = file.create_group("sessions/session_0/group_0/entry_0")
        entry.create_dataset("result/frame", data=sweeps, compression="gzip")
        entry["result/tick"] = np.arange(60) * 20
        entry["sensor_id"] = 1
        entry["metadata"] = json.dumps(texts["metadata"])
        file["sessions/session_0/session_config"] = json.dumps(texts["session_config"])
        file["server_info"] = json.dumps(texts["server_info"])
    return folder / "acconeer.h5"


def capture(folder: Path) -> Path:
    settings(folder)
    (folder / "adc.bin").write_bytes(b"".join(packets(WORDS)))
    return folder / "adc.bin"


def cfg(folder: Path) -> Path:
    (folder / "adc.bin").write_bytes(WORDS.tobytes())
    return settings(folder)


SEEDS: dict[str, Callable[[Path], Path]] = {
    "slow.h5": slow_h5,
    "slow.npy": slow_npy,
    "acconeer.h5": acconeer,
    "adc.bin": capture,
    "radar.cfg": cfg,
}


def damaged(data: bytes, seed: int) -> bytes:
    """One damage by chance: flipped bits, bytes put in, taken out or repeated, a number of 4 bytes set, an end cut."""
    rng = np.random.default_rng(seed)
    # Most of a file is data, most harm is done in its head.
    place = int(rng.integers(0, len(data) if seed % 2 else min(len(data), 3000)))
    some = data[place : place + int(rng.integers(1, 40))]
    kind = seed % 6
    if kind == 0:
        return data[:place]
    if kind == 1:
        return data[:place] + data[place + len(some) :]
    if kind == 2:
        return data[:place] + some + data[place:]
    if kind == 3:
        extreme = [b"\xff\xff\xff\xff", b"\0\0\0\0", b"\xff\xff\xff\x7f", b"1e999"][int(rng.integers(4))]
        return data[:place] + extreme + data[place + len(extreme) :]
    flipped = bytearray(data)
    for at in rng.integers(0, len(data), 1 + 7 * (kind == 5)):
        at = place if kind == 4 else at
        flipped[at] ^= 1 << int(rng.integers(8))
    return bytes(flipped)


def read_through(path: Path) -> None:
    config = path.with_name("radar.cfg")
    source = open_radar(path, RadarRequest(config if config.is_file() else None))
    for block in source.profiles():
        assert len(block.time_ns) == len(block.phasors)
    for _ in source.slow_time(np.array([1.0])):
        pass


@pytest.mark.parametrize("name", SEEDS)
def test_two_hundred_damaged_files_are_read_or_refused_with_a_sentence(tmp_path: Path, name: str) -> None:
    path = SEEDS[name](tmp_path)
    whole = path.read_bytes()
    capture_or_own = path if path.suffix != ".cfg" else tmp_path / "adc.bin"
    read_through(capture_or_own)
    said = []
    for seed in range(200):
        # Under a new name: HDF5 keeps a file that it could not read to its end open.
        path.unlink()
        path.write_bytes(damaged(whole, seed))
        try:
            read_through(capture_or_own)
        except MidspanError as error:
            said.append(str(error))
    assert [text for text in said if name not in text and capture_or_own.name not in text] == []
    assert all("\n" not in text for text in said)
    assert said or name == "adc.bin"


def test_the_command_says_what_is_wrong_with_a_damaged_file_and_ends_with_3(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = slow_h5(tmp_path)
    with h5py.File(path, "r") as file:
        begin = file["iq"].id.get_chunk_info(2).byte_offset
    data = bytearray(path.read_bytes())
    data[begin + 4 : begin + 60] = bytes(56)
    path.write_bytes(data)
    (tmp_path / "accel.csv").write_text("time_s,accel\n" + "".join(f"{k / 100},{k % 7}\n" for k in range(200)))
    (tmp_path / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n\n[radar]\nfile = "slow.h5"\n'
    )
    assert run(["inspect", str(tmp_path)]) == 3
    said = capsys.readouterr().err
    assert "slow.h5 cannot be read as radar data" in said
    assert "defect" not in said


def with_count(datagrams: list[bytes], number: int, count: int) -> bytes:
    changed = list(datagrams)
    changed[number] = changed[number][:4] + count.to_bytes(6, "little") + changed[number][10:]
    return b"".join(changed)


@pytest.mark.parametrize("number", [0, 1, 9, 28])
@pytest.mark.parametrize("count", [10**9, 2**46, 2**48 - 1])
def test_one_damaged_packet_count_loses_that_packet_and_is_a_warning(tmp_path: Path, number: int, count: int) -> None:
    datagrams = list(packets(WORDS))
    (tmp_path / "adc.bin").write_bytes(with_count(datagrams, number, count))
    source = open_radar(tmp_path / "adc.bin", RadarRequest(settings(tmp_path), "IIQQ"))
    frames = list(source.frames())
    assert f"radar: 1 of {len(datagrams)} packets in adc.bin have a damaged byte counter" in source.info.warnings[0]
    frame_bytes = WORDS.nbytes // 40
    first, last = number * 1456 // frame_bytes, ((number + 1) * 1456 - 1) // frame_bytes
    hurt = {frame.index for frame in frames if not frame.valid.all()}
    # At the end nothing says that there was more.
    assert hurt == set(range(first, min(last + 1, len(frames))))
    for frame in frames:
        np.testing.assert_array_equal(frame.samples[frame.valid], CUBE[frame.index][frame.valid])


def test_a_long_gap_between_packets_is_a_gap_and_no_damage(tmp_path: Path) -> None:
    datagrams = list(packets(np.tile(WORDS, 20)))
    kept = datagrams[:100] + datagrams[400:]
    (tmp_path / "adc.bin").write_bytes(b"".join(kept))
    source = open_radar(tmp_path / "adc.bin", RadarRequest(settings(tmp_path), "IIQQ"))
    frames = list(source.frames())
    assert source.info.warnings == ()
    assert len(frames) == 800
    lost = sum(not frame.valid.any() for frame in frames)
    assert lost == pytest.approx(300 * 1456 / (WORDS.nbytes / 40), abs=2)


def test_a_capture_of_which_next_to_nothing_was_received_is_refused(tmp_path: Path) -> None:
    datagrams = list(packets(WORDS))
    moved = [d[:4] + (10**12 + 1456 * k).to_bytes(6, "little") + d[10:] for k, d in enumerate(datagrams)]
    (tmp_path / "adc.bin").write_bytes(b"".join(datagrams[:15] + moved[15:]))
    with pytest.raises(DataError, match=r"were not received; at most 90 % may be missing"):
        open_radar(tmp_path / "adc.bin", RadarRequest(settings(tmp_path), "IIQQ"))


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ("adcCfg 2 1", "adcCfg inf 1", "line 4: adcCfg takes numbers"),
        ("adcCfg 2 1", "adcCfg 1e999 1", "line 4: adcCfg takes numbers"),
        ("frameCfg 0 0 1 0 10", "frameCfg 0 0 1e9 0 10", "from 1 to 255 loops"),
        ("frameCfg 0 0 1 0 10", "frameCfg 0 1e9 1 0 10", "chirps from 0 to 511"),
        ("frameCfg 0 0 1 0 10", "frameCfg 0 0 1 0 1e11", "the frame period must be from 0.001 to 1e+06 ms"),
        ("profileCfg 0 77", "profileCfg 0 1e11", "the start frequency must be from 1 to 1000 GHz"),
        ("6000 0 0 30", "1e11 0 0 30", "the sampling rate must be from 1 to 1e+06 ksps"),
    ],
)
def test_settings_of_a_radar_that_no_radar_has_are_named(tmp_path: Path, old: str, new: str, reported: str) -> None:
    path = settings(tmp_path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(DataError, match=r"radar\.cfg") as caught:
        read_settings(path)
    assert reported in str(caught.value)


@pytest.mark.parametrize(
    ("content", "reported"),
    [
        (900 * "[" + 900 * "]", "at most 64 levels"),
        (100_000 * "[" + 100_000 * "]", "at most 64 levels"),
        ('{"mmWaveDevices": [], "mmWaveDevices": []}', "is there twice"),
        ('{"configUsed": "radar.json"}', "names this file itself"),
        ('{"mmWaveDevices": ' + 5000 * "9" + "}", "thousands of digits"),
        ("7", "lacks settings of mmWave Studio"),
    ],
)
def test_json_of_a_radar_that_is_no_such_tree_is_refused(tmp_path: Path, content: str, reported: str) -> None:
    (tmp_path / "radar.json").write_text(content)
    with pytest.raises(DataError, match=r"radar\.json") as caught:
        read_settings(tmp_path / "radar.json")
    assert reported in str(caught.value)


def test_settings_in_utf_16_are_named(tmp_path: Path) -> None:
    path = settings(tmp_path)
    path.write_bytes(path.read_text().encode("utf-16"))
    with pytest.raises(DataError, match="this is UTF-16"):
        read_settings(path)


@pytest.mark.parametrize("kind", ["external storage", "external link", "link on the way", "virtual"])
def test_samples_that_lie_in_another_file_are_not_followed(tmp_path: Path, kind: str) -> None:
    (tmp_path / "secret").write_bytes(IQ.tobytes())
    path = tmp_path / "slow.h5"
    with h5py.File(path, "w") as file:
        file.attrs["carrier_hz"], file.attrs["rate_hz"] = 77e9, 100.0
        if kind == "external storage":
            file.create_dataset("iq", IQ.shape, IQ.dtype, external=[(str(tmp_path / "secret"), 0, IQ.nbytes)])
        elif kind == "external link":
            file["iq"] = h5py.ExternalLink("other.h5", "iq")
        elif kind == "link on the way":
            with h5py.File(tmp_path / "other.h5", "w") as other:
                other["iq"] = IQ
            file["way"] = h5py.ExternalLink("other.h5", "/")
            file["iq"] = h5py.SoftLink("/way/iq")
        else:
            layout = h5py.VirtualLayout(IQ.shape, IQ.dtype)
            layout[:] = h5py.VirtualSource("other.h5", "iq", IQ.shape)
            file.create_virtual_dataset("iq", layout)
    with pytest.raises(DataError, match=r"slow\.h5: iq cannot be read: it.* (another file|other datasets)"):
        open_radar(path, RadarRequest())


@pytest.mark.parametrize("name", ["iq", "time_s"])
def test_a_declared_size_beyond_memory_is_refused_before_it_is_allocated(tmp_path: Path, name: str) -> None:
    path = tmp_path / "slow.h5"
    with h5py.File(path, "w") as file:
        file.attrs["carrier_hz"], file.attrs["rate_hz"] = 77e9, 100.0
        shape = (10, 1 << 20, 1 << 20) if name == "iq" else (60, 4)
        file.create_dataset("iq", shape, "<c8", chunks=(1, *(min(n, 256) for n in shape[1:])))
        if name == "time_s":
            file.create_dataset("time_s", (1 << 40,), "<f8", chunks=(1024,))
    assert os.path.getsize(path) < 1 << 20
    with pytest.raises(DataError, match="must fit into the available memory"):
        open_radar(path, RadarRequest())


@pytest.mark.parametrize(
    ("companions", "reported"),
    [
        ({"rate_hz": 1e-300}, "must state its rate"),
        ({"rate_hz": np.inf}, "must state its rate"),
        ({"time_s": np.linspace(1e300, 2e300, 60)}, "the frames' times must be from"),
        ({"time_s": np.linspace(0.0, 1e-9, 60)}, "increase by 1 ns"),
        ({"rate_hz": 100.0, "wavelength_m": 0.0}, "does not state the carrier"),
        ({"rate_hz": np.array([1.0, 2.0])}, r"slow\.h5 cannot be read as radar data"),
    ],
)
def test_times_and_rates_that_no_radar_has_are_named(
    tmp_path: Path, companions: dict[str, object], reported: str
) -> None:
    path = tmp_path / "slow.h5"
    with h5py.File(path, "w") as file:
        file["iq"] = IQ
        if "wavelength_m" not in companions:
            file.attrs["carrier_hz"] = 77e9
        for key, value in companions.items():
            file[key] = value
    with pytest.raises(DataError, match=reported):
        open_radar(path, RadarRequest())
