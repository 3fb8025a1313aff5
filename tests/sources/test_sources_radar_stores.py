"""Slow-time I/Q and recordings of an Acconeer A121."""

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
    ("content", "told"),
    [
        ({}, "must hold a dataset iq"),
        ({"iq": np.zeros((4, 5))}, "complex I/Q"),
        ({"iq": IQ}, "carrier frequency"),
        ({"iq": IQ, "carrier_hz": 77e9}, "rate_hz or time_s"),
        ({"iq": IQ, "carrier_hz": 77e9, "time_s": np.zeros(50)}, "increasing times"),
        ({"i": IQ.real, "q": IQ.imag[:, :2]}, "same shape"),
    ],
)
def test_files_without_what_is_needed_are_refused(tmp_path: Path, content: dict[str, object], told: str) -> None:
    with h5py.File(tmp_path / "z.h5", "w") as file:
        for key, value in content.items():
            file[key] = value
    with pytest.raises(DataError, match=told):
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
    assert source.has_loopback
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
