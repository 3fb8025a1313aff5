"""Slow-time I/Q and recordings of Acconeer's A121 and A111."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from radar_captures import settings

from midspan.errors import DataError, UsageError
from midspan.sources.radar.formats import FORMATS, open_radar
from midspan.sources.radar.radar_source import RadarRequest

RNG = np.random.default_rng(3)
IQ = (RNG.normal(size=(50, 4, 3)) + 1j * RNG.normal(size=(50, 4, 3))).astype(np.complex64)


def read(path: Path, **request: object):
    source = open_radar(path, RadarRequest(**request))
    blocks = list(source.profiles())
    return source, np.concatenate([block.phasors for block in blocks])


@pytest.mark.parametrize("form", ["complex", "fields", "last axis", "two sets"])
def test_hdf5_in_every_form_gives_the_same_phasors(tmp_path: Path, form: str) -> None:
    path = tmp_path / "target.h5"
    with h5py.File(path, "w") as file:
        if form == "complex":
            file["iq"] = IQ
        elif form == "fields":
            data = np.zeros(IQ.shape, dtype=[("real", "<f4"), ("imag", "<f4")])
            data["real"], data["imag"] = IQ.real, IQ.imag
            file["iq"] = data
        elif form == "last axis":
            file["iq"] = np.stack((IQ.real, IQ.imag), axis=-1)
        else:
            file["i"], file["q"] = IQ.real, IQ.imag
        file.attrs["wavelength_m"], file["rate_hz"] = 299_792_458.0 / 78.77e9, 100.0
        file["range_m"] = np.array([1.0, 1.5, 2.0])
    source, phasors = read(path, start_s=2.0)
    np.testing.assert_allclose(phasors, IQ, rtol=1e-6)
    info = source.info
    assert (info.frame_count, info.channels, info.bins) == (50, 4, 3)
    np.testing.assert_array_equal(info.range_m, [1.0, 1.5, 2.0])
    assert info.carrier_hz == pytest.approx(78.77e9)
    np.testing.assert_allclose(source.times_ns() / 1e9, 2.0 + np.arange(50) / 100.0, atol=1e-9)


def test_npy_takes_carrier_and_rate_from_the_settings_and_nan_is_a_hole(tmp_path: Path) -> None:
    z = IQ[:, :, 0].copy()
    z[7, 2] = np.nan
    np.save(tmp_path / "z.npy", z)
    source, phasors = read(tmp_path / "z.npy", config=settings(tmp_path, samples=256))
    np.testing.assert_array_equal(phasors[..., 0], z)
    valid = np.concatenate([block.valid for block in source.profiles()])
    assert not valid[7, 2]
    assert np.count_nonzero(~valid) == 1
    assert source.info.carrier_hz == pytest.approx(78.7708e9, abs=1e5)
    assert source.info.frame_rate_hz == pytest.approx(100.0)
    with pytest.raises(DataError, match="carrier frequency"):
        open_radar(tmp_path / "z.npy", RadarRequest())


def test_a_single_target_of_one_channel_is_read_and_time_stamps_of_the_file_are_kept(tmp_path: Path) -> None:
    stamps = np.cumsum(RNG.uniform(0.005, 0.02, 50))
    with h5py.File(tmp_path / "z.h5", "w") as file:
        file["iq"], file["time_s"] = IQ[:, 0, 0], stamps
        file["iq"].attrs["carrier_hz"] = 77e9
    source, phasors = read(tmp_path / "z.h5")
    np.testing.assert_array_equal(phasors[:, 0, 0], IQ[:, 0, 0])
    np.testing.assert_allclose(source.times_ns() / 1e9, stamps, atol=1e-9)


@pytest.mark.parametrize(
    ("content", "reported"),
    [
        ({}, "must hold a dataset iq"),
        ({"iq": np.zeros((4, 5))}, "complex I/Q"),
        ({"iq": IQ}, "carrier frequency"),
        ({"iq": IQ, "carrier_hz": 77e9}, "rate_hz or time_s"),
        ({"iq": IQ, "carrier_hz": 77e9, "time_s": np.zeros(50)}, "increasing times"),
        ({"i": IQ.real, "q": IQ.imag[:, :2]}, "same shape"),
    ],
)
def test_files_without_what_is_needed_are_refused(tmp_path: Path, content: dict[str, object], reported: str) -> None:
    with h5py.File(tmp_path / "z.h5", "w") as file:
        for key, value in content.items():
            file[key] = value
    with pytest.raises(DataError, match=reported):
        open_radar(tmp_path / "z.h5", RadarRequest())


def test_broken_missing_and_foreign_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "z.h5").write_bytes(b"nothing")
    (tmp_path / "z.npy").write_bytes(b"nothing")
    (tmp_path / "z.dat").write_bytes(b"nothing")
    for name in ("z.h5", "z.npy"):
        with pytest.raises(DataError, match="cannot be read"):
            open_radar(tmp_path / name, RadarRequest())
    with pytest.raises(UsageError, match=r"known suffixes are \.bin"):
        open_radar(tmp_path / "z.dat", RadarRequest())
    with pytest.raises(DataError, match="not found"):
        open_radar(tmp_path / "absent.h5", RadarRequest())
    with pytest.raises(UsageError, match=r"one of auto, IIQQ"):
        open_radar(tmp_path / "z.h5", RadarRequest(iq_order="IQQI"))
    assert {suffix for _, suffixes, _ in FORMATS for suffix in suffixes} == {".bin", ".h5", ".hdf5", ".npy"}


@pytest.fixture
def acconeer(data_folder: Path) -> Path:
    folder = data_folder / "acconeer"
    if not folder.is_dir():
        pytest.skip(f"Acconeer recordings are absent: {folder}")
    return folder


def test_the_corner_reflector_lies_where_it_was_put_and_does_not_move(acconeer: Path) -> None:
    source, phasors = read(acconeer / "recorded_data_corner-reflector.h5")
    assert (phasors.shape, source.info.carrier_hz) == ((113, 1, 74), 60.5e9)
    amplitude = np.abs(phasors[:, 0]).mean(axis=0)
    peaks = source.info.range_m[[13 + int(np.argmax(amplitude[13:20])), 54]]
    # The subsweeps begin at 24 and 120 base steps of 2.50227 mm; the reflector's peak is at point 16 of 4 steps each.
    np.testing.assert_allclose(peaks, [(24 + 4 * 16) * 2.50227400101721e-3, 120 * 2.50227400101721e-3], atol=1e-6)
    phase = np.unwrap(np.angle(phasors[:, 0, 16]))
    assert np.std(phase) / source.info.axis.phase_per_m() < 0.1e-3
    # 50 frames a second by the recorder's ticks of 1 ms.
    assert np.median(np.diff(source.times_ns())) == pytest.approx(20e6, abs=1e6)


def test_the_vibration_of_the_recording_is_about_a_millimetre_and_the_loopback_steadies_it(acconeer: Path) -> None:
    source, phasors = read(acconeer / "recorded_data_vibration_low_frequency.h5")
    assert source.info.frame_rate_hz == pytest.approx(2000.0)
    assert any("loopback" in note for note in source.info.notes)
    assert phasors.shape == (145 * 20, 1, 1)
    assert source.info.range_m[0] == pytest.approx(80 * 2.50227e-3, abs=1e-5)
    moved = np.unwrap(np.angle(phasors[:, 0, 0])) / source.info.axis.phase_per_m()
    # 907 µm of standard deviation or range by the maker's own program; both lie in this span.
    assert 0.2e-3 < np.ptp(moved) < 4e-3
    with h5py.File(acconeer / "recorded_data_vibration_low_frequency.h5") as file:
        raw = file["sessions/session_0/group_0/entry_0/result/frame"][:]
    own = np.unwrap(np.angle(raw["real"][..., 0].ravel() + 1j * raw["imag"][..., 0].ravel()))
    plain = np.unwrap(np.angle(raw["real"][..., 1].ravel() + 1j * raw["imag"][..., 1].ravel()))
    # Taking the loopback's phase out is what turns one into the other.
    left = np.unwrap(np.angle(phasors[:, 0, 0])) - (plain - own)
    assert np.std(left - np.round((left - left[0]) / (2 * np.pi)) * 2 * np.pi) < 1e-3


def test_parts_of_an_acconeer_recording_equal_the_whole(acconeer: Path) -> None:
    source, phasors = read(acconeer / "recorded_data_vibration_low_frequency.h5")
    part = np.concatenate([block.phasors for block in source.slow_time(np.array([0.0]), 33, 471)])
    np.testing.assert_array_equal(part, phasors[33:471])


def write_a121(path: Path, z: np.ndarray, *, session: str = "sessions/session_0", **changed: object) -> Path:
    """A recording (frames, sweeps, points) as the maker's program stores it, at 10 frames a second."""
    metadata = {
        "frame_data_length": z[0].size,
        "subsweep_data_offset": [0],
        "subsweep_data_length": [z.shape[2]],
        "base_step_length_m": 0.0025,
        "max_sweep_rate": changed.get("max_sweep_rate", 1372.8),
    }
    sensor = {
        "sweep_rate": None,
        "frame_rate": changed.get("frame_rate", 10.0),
        "sweeps_per_frame": z.shape[1],
        "subsweeps": [{"start_point": 80, "step_length": 2, "enable_tx": True, "enable_loopback": False}],
    }
    frame = np.zeros(z.shape, dtype=[("real", "<i2"), ("imag", "<i2")])
    frame["real"], frame["imag"] = np.rint(z.real), np.rint(z.imag)
    with h5py.File(path, "w") as file:
        entry = file.create_group(f"{session}/group_0/entry_0")
        file[f"{session}/session_config"] = json.dumps({"groups": [{"1": sensor}]})
        file["server_info"] = json.dumps({"ticks_per_second": 1000})
        entry["metadata"], entry["sensor_id"] = json.dumps(metadata), 1
        entry["result/frame"], entry["result/tick"] = frame, 100 * np.arange(len(z))
    return path


def moving(time_s: np.ndarray, points: int) -> np.ndarray:
    """A target at the middle point that moves by 0.5 mm at 1 Hz: its phasors (…, points)."""
    phase = 4.0 * np.pi * 60.5e9 / 299_792_458.0 * 0.5e-3 * np.sin(2.0 * np.pi * time_s)
    lobe = np.exp(-0.5 * ((np.arange(points) - points // 2) / 1.5) ** 2)
    return 8000.0 * np.exp(1j * phase)[..., None] * lobe


def moved_mm(source, phasors: np.ndarray, point: int) -> np.ndarray:
    return 1e3 * np.unwrap(np.angle(phasors[:, 0, point])) / source.info.axis.phase_per_m()


@pytest.mark.parametrize("session", ["sessions/session_0", "session"])
def test_sweeps_without_a_rate_follow_each_other_at_the_sensors_largest(tmp_path: Path, session: str) -> None:
    time_s = np.add.outer(np.arange(40) / 10.0, np.arange(16) / 1372.8)
    source, phasors = read(write_a121(tmp_path / "a.h5", moving(time_s, 9), session=session))
    np.testing.assert_allclose(source.times_ns() / 1e9, time_s.ravel(), atol=2e-9)
    # Counts of 8000 are rounded to one: 1e-4 rad, which is 0.04 µm.
    np.testing.assert_allclose(moved_mm(source, phasors, 4), 0.5 * np.sin(2 * np.pi * time_s.ravel()), atol=1e-3)
    reported = "no sweep rate was set; the sweeps of a frame follow each other at the sensor's largest, 1372.8 Hz"
    assert reported in source.info.notes


@pytest.mark.parametrize("changed", [{"max_sweep_rate": None}, {"max_sweep_rate": 100.0, "frame_rate": None}])
def test_sweeps_whose_rate_is_not_known_are_averaged(tmp_path: Path, changed: dict[str, object]) -> None:
    # Each of 16 sweeps has noise of 0.1 rad; their mean 0.025 rad, which is 10 µm.
    time_s = np.repeat(np.arange(40)[:, None] / 10.0, 16, axis=1)
    z = moving(time_s, 9) + RNG.normal(0.0, 800.0, (40, 16, 9)) + 1j * RNG.normal(0.0, 800.0, (40, 16, 9))
    source, phasors = read(write_a121(tmp_path / "a.h5", z, **changed))
    assert (phasors.shape, source.info.frame_count) == ((40, 1, 9), 40)
    np.testing.assert_allclose(source.times_ns() / 1e9, np.arange(40) / 10.0, atol=2e-9)
    error = moved_mm(source, phasors, 4) - 0.5 * np.sin(2 * np.pi * time_s[:, 0])
    # Three standard deviations of the estimate of 10 µm from 40 frames: 10 · (1 + 3 / √80).
    assert np.std(error) < 0.0135
    assert "no sweep rate was set; the sweeps of a frame are averaged" in source.info.notes
    part = np.concatenate([block.phasors for block in source.slow_time(np.array([4.0]), 7, 21)])
    np.testing.assert_allclose(part[:, 0, 0], phasors[7:21, 0, 4], rtol=1e-6)


def write_a111(
    path: Path, z: np.ndarray, mode: str = "IQ", rate_hz: float | None = 80.0, clock_hz: float = 80.0
) -> Path:
    """A recording (frames, sensors, points) of the earlier radar as the maker's program stores it."""
    with h5py.File(path, "w") as file:
        file["mode"], file["data"] = mode, z
        file["session_info"] = json.dumps({"range_start_m": 0.3, "range_length_m": 0.3, "step_length_m": 0.03})
        file["sensor_config_dump"] = json.dumps({"update_rate": rate_hz, "range_interval": [0.3, 0.6], "sensor": [1]})
        file["sample_times"] = 1.7e9 + np.arange(len(z)) / clock_hz
        file["data_info"] = json.dumps([[{"missed_data": False}]] * len(z))
    return path


def test_an_a111_gives_phase_range_and_time(tmp_path: Path) -> None:
    time_s = np.arange(160) / 80.0
    source, phasors = read(write_a111(tmp_path / "a.h5", moving(time_s, 9)[:, None, :]), start_s=3.0)
    np.testing.assert_allclose(source.times_ns() / 1e9, 3.0 + time_s, atol=2e-9)
    np.testing.assert_allclose(source.info.range_m, 0.3 + 0.03 * np.arange(9), atol=1e-12)
    assert (source.info.carrier_hz, source.info.frame_rate_hz) == (60.5e9, pytest.approx(80.0))
    np.testing.assert_allclose(moved_mm(source, phasors, 4), 0.5 * np.sin(2 * np.pi * time_s), atol=1e-3)


def test_the_recorders_clock_counts_where_an_a111_did_not_reach_its_rate(tmp_path: Path) -> None:
    path = write_a111(tmp_path / "a.h5", moving(np.arange(160) / 62.0, 9)[:, None, :], clock_hz=62.0)
    source, _ = read(path)
    # Seconds since 1970 as float keep 0.2 µs.
    np.testing.assert_allclose(source.times_ns() / 1e9, np.arange(160) / 62.0, atol=1e-6)
    assert "times by the recorder's clock, 62 Hz; 80 Hz were set" in source.info.notes


def test_services_of_an_a111_without_phase_are_refused(tmp_path: Path) -> None:
    path = write_a111(tmp_path / "a.h5", np.ones((20, 1, 9)), mode="SPARSE")
    with pytest.raises(DataError, match="the phase of the service IQ; this recording of an Acconeer A111 has 'SPARSE'"):
        open_radar(path, RadarRequest())
