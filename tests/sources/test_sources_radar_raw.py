"""Raw ADC captures: every order of I and Q, holes, cut ends, split files, headers kept, and files that do not fit."""

import json
from pathlib import Path

import numpy as np
import pytest
from radar_captures import STUDIO, echoes, settings, words_by_hand

from midspan.errors import DataError, UsageError
from midspan.radar.chirp import ChirpProfile
from midspan.radar.layout import ORDERS, Layout, pack, unpack
from midspan.simulate.motion.motion import Sines
from midspan.simulate.radar.setup import Capture, demo_settings, packets, write_capture
from midspan.simulate.radar.signal import LONG_RANGE, RadarModel, Reflector
from midspan.sources.radar.dca1000 import RawCapture
from midspan.sources.radar.formats import open_radar
from midspan.sources.radar.radar_source import RadarRequest
from midspan.sources.radar.ti_config import read_settings

FRAME_BYTES = 4 * 64 * 2 * 2  # of `settings` as it stands


def opened(folder: Path, words: np.ndarray, *, order: str = "auto", name: str = "adc_data.bin", **changed: object):
    (folder / name).write_bytes(words.astype("<i2").tobytes())
    return RawCapture(folder / name, RadarRequest(settings(folder, **changed), order))


def cube_of(source: RawCapture) -> np.ndarray:
    return np.array([frame.samples for frame in source.frames()])


@pytest.mark.parametrize("order", ORDERS)
def test_a_capture_written_by_hand_in_any_order_comes_back_sample_by_sample(tmp_path: Path, order: str) -> None:
    cube = echoes((7.0,))
    source = opened(tmp_path, words_by_hand(cube, order), order=order)
    np.testing.assert_array_equal(cube_of(source), cube)
    np.testing.assert_array_equal(pack(cube, source.layout), words_by_hand(cube, order))


@pytest.mark.parametrize("order", ORDERS)
def test_auto_finds_the_order_of_near_targets_by_the_sign_of_the_beat_energy(tmp_path: Path, order: str) -> None:
    cube = echoes((5.0, 12.4))
    path = settings(tmp_path)
    path.write_text(path.read_text().replace("adcbufCfg", "% adcbufCfg"))  # settings that do not say it
    (tmp_path / "adc.bin").write_bytes(words_by_hand(cube, order).tobytes())
    source = RawCapture(tmp_path / "adc.bin", RadarRequest(path))
    assert source.info.iq_order == order
    np.testing.assert_array_equal(cube_of(source), cube)
    # Against the default of the capture software (Q first) it is reported as a warning.
    assert bool(source.info.warnings) == order.startswith("I")


@pytest.mark.parametrize("order", ORDERS)
def test_auto_takes_the_pairing_from_the_samples_and_the_sign_from_the_settings(tmp_path: Path, order: str) -> None:
    cube = echoes((5.0, 12.4))
    words = words_by_hand(cube, order)
    right = opened(tmp_path, words, swap=int(order.startswith("Q")))
    assert (right.info.iq_order, right.info.warnings) == (order, ())
    np.testing.assert_array_equal(cube_of(right), cube)
    mirrored = opened(tmp_path, words, swap=int(order.startswith("I")))
    assert f"set radar.iq_order = {order!r}" in mirrored.info.warnings[0]


@pytest.mark.parametrize("order", ORDERS)
def test_targets_beyond_half_the_range_cannot_decide_the_sign_and_the_settings_are_believed(
    tmp_path: Path, order: str
) -> None:
    cube = echoes((38.0,))
    source = opened(tmp_path, words_by_hand(cube, order), swap=int(order.startswith("Q")))
    assert source.info.iq_order == order
    assert "cannot decide" in source.info.warnings[0]


@pytest.mark.parametrize("order", ["QQII", "IQIQ", "QIQI"])
def test_a_wrong_given_order_is_refused_with_the_right_one(tmp_path: Path, order: str) -> None:
    with pytest.raises(DataError, match=r"Set radar\.iq_order to 'IIQQ'"):
        opened(tmp_path, words_by_hand(echoes((5.0,)), "IIQQ"), order=order)


def test_four_lanes_interleave_the_receivers_sample_by_sample() -> None:
    profile = ChirpProfile(77e9, 60e12, 6e6, 16, 0.01, receivers=3)
    layout = Layout(profile, "IIQQ", 4)
    words = np.arange(2 * layout.frame_words, dtype=np.int16)
    cube = unpack(words, layout)
    # Word 8 n + r is I, word 8 n + 4 + r is Q of sample n at receiver r, four receivers being stored always.
    for r in range(3):
        for n in range(16):
            assert cube[0, 0, r, n] == (8 * n + r) + 1j * (8 * n + 4 + r)
    swapped = unpack(words, Layout(profile, "QQII", 4))
    np.testing.assert_array_equal(swapped, cube.imag + 1j * cube.real)


@pytest.mark.parametrize("bits", [12, 14, 16])
def test_words_of_any_depth_keep_their_sign(tmp_path: Path, bits: int) -> None:
    cube = echoes((7.0,))
    words = words_by_hand(cube, "IIQQ")
    stored = (words.astype(np.int64) % 2**bits).astype(np.uint16).view(np.int16)  # upper bits cleared
    source = opened(tmp_path, stored, order="IIQQ", bits={12: 0, 14: 1, 16: 2}[bits])
    np.testing.assert_array_equal(cube_of(source), cube)


def test_real_samples_have_half_the_bins_and_the_same_sign_of_phase(tmp_path: Path) -> None:
    profile = ChirpProfile(77e9, 64.985e12, 6e6, 64, 0.01, receivers=4, complex_samples=False)
    away = Sines(np.array([0.3e-3]), np.array([1.0]))
    model = RadarModel((Reflector(2.0, 1000.0),), profile, noise_std=2.0)
    rng = np.random.default_rng(0)
    write_capture(tmp_path / "adc.bin", model.blocks(away, 100, rng=rng), Capture(Layout(profile)))
    (tmp_path / "radar.cfg").write_text(demo_settings(profile))
    source = RawCapture(tmp_path / "adc.bin", RadarRequest(tmp_path / "radar.cfg"))
    assert source.info.bins == 32
    z = next(source.slow_time(np.array([2.0 / profile.bin_m]))).phasors[:, 0, 0]
    moved = away.displacement(source.times_ns() / 1e9)
    phase = np.unwrap(np.angle(z)) / profile.phase_per_m(2.0)
    # The mirrored image of a real signal leaves about 1 % in the bin.
    np.testing.assert_allclose(phase - phase.mean(), moved - moved.mean(), atol=1e-5)


def test_lost_packets_are_marked_in_the_receivers_that_they_hit(tmp_path: Path) -> None:
    cube = echoes((7.0,))
    words = words_by_hand(cube, "IIQQ")
    data = bytearray(words.tobytes())
    data[5 * 1456 : 6 * 1456] = bytes(1456)
    data[11 * 1456 : 12 * 1456] = bytes(1456)
    source = opened(tmp_path, np.frombuffer(bytes(data), dtype="<i2"))
    valid = np.array([frame.valid for frame in source.frames()])
    hit = np.zeros(valid.shape, dtype=bool).reshape(-1)
    for packet in (5, 11):
        # Every block of 256 bytes that the packet overlaps by more than 60 words must be marked.
        for block in range(packet * 1456 // 256, -(-(packet + 1) * 1456 // 256)):
            overlap = min((block + 1) * 256, (packet + 1) * 1456) - max(block * 256, packet * 1456)
            hit[block] |= overlap > 16
    np.testing.assert_array_equal(~valid.reshape(-1)[hit], True)
    assert np.count_nonzero(~valid) <= np.count_nonzero(hit) + 4
    assert source.info.missing_frames == np.count_nonzero(~valid.all(axis=(1, 2)))
    block = next(source.slow_time(np.array([7.0])))
    np.testing.assert_array_equal(block.valid, valid[:, 0])


def test_a_cut_end_leaves_the_whole_frames_and_is_reported(tmp_path: Path) -> None:
    words = words_by_hand(echoes((7.0,)), "IIQQ")
    source = opened(tmp_path, words[:-100], frames=40)
    assert source.info.frame_count == 39
    assert "39 of 40 frames" in " ".join(source.info.notes)
    assert f"{FRAME_BYTES - 200} of {FRAME_BYTES} bytes" in " ".join(source.info.notes)


def test_split_files_are_read_as_one_also_where_a_frame_lies_across_them(tmp_path: Path) -> None:
    cube = echoes((7.0,))
    words = words_by_hand(cube, "IIQQ")
    (tmp_path / "adc_data_Raw_1.bin").write_bytes(words[10_001:15_000].tobytes())
    (tmp_path / "adc_data_Raw_2.bin").write_bytes(words[15_000:].tobytes())
    source = opened(tmp_path, words[:10_001], name="adc_data_Raw_0.bin")
    np.testing.assert_array_equal(cube_of(source), cube)
    assert "3 files" in source.info.notes[0]


def test_a_missing_file_of_a_split_capture_and_a_missing_half_are_warned_of(tmp_path: Path) -> None:
    words = words_by_hand(echoes((5.0,)), "IIQQ")
    whole = opened(tmp_path, words, name="adc_Raw_0.bin", frames=40)
    assert whole.info.warnings == ()
    # 10 of 40 frames in the first file, 10 in the third; a file with a date is none of them.
    for number, name in enumerate(("adc_Raw_0.bin", "", "adc_Raw_2.bin", "adc_Raw_20251121.bin")):
        if name:
            words[len(words) * number // 4 : len(words) * (number + 1) // 4].tofile(tmp_path / name)
    source = opened(tmp_path, words[: len(words) // 4], name="adc_Raw_0.bin", frames=40)
    split, short = source.info.warnings
    assert split.startswith("radar: adc_Raw_1.bin is missing")
    assert "has 10 of the 40 frames" in short


def test_samples_without_any_noise_are_no_capture(tmp_path: Path) -> None:
    # The same frame again and again: what a test pattern or a stuck interface gives.
    one = words_by_hand(echoes((5.0,), frames=1), "IIQQ")
    with pytest.raises(DataError, match="the same samples in all 40 frames"):
        opened(tmp_path, np.tile(one, 40), frames=40)


@pytest.mark.parametrize("head", [10, 14])
def test_packets_with_their_headers_are_put_in_order_and_holes_are_known(tmp_path: Path, head: int) -> None:
    cube = echoes((7.0,))
    datagrams = list(packets(words_by_hand(cube, "IIQQ")))
    if head == 14:
        datagrams = [d[:4] + (1456).to_bytes(4, "little") + d[4:] for d in datagrams]
    del datagrams[9]
    datagrams[3], datagrams[4] = datagrams[4], datagrams[3]
    (tmp_path / "adc_data.bin").write_bytes(b"".join(datagrams))
    source = RawCapture(tmp_path / "adc_data.bin", RadarRequest(settings(tmp_path)))
    frames = list(source.frames())
    assert len(frames) == 40
    for frame in frames:
        np.testing.assert_array_equal(frame.samples[frame.valid], cube[frame.index][frame.valid])
    lost = np.array([~frame.valid for frame in frames]).reshape(-1)
    expected = np.zeros(len(lost), dtype=bool)
    expected[9 * 1456 // 256 : -(-10 * 1456 // 256)] = True
    np.testing.assert_array_equal(lost, expected)
    assert "1456 of" in " ".join(source.info.notes)


def test_headers_before_each_chirp_are_refused(tmp_path: Path) -> None:
    words = words_by_hand(echoes((7.0,)), "IIQQ")
    head = np.frombuffer(bytes.fromhex("dc0ada0cdc0ada0c"), dtype="<i2")
    with pytest.raises(DataError, match="enableHeader = 0"):
        opened(tmp_path, np.concatenate((head, words)))
    with pytest.raises(DataError, match="enableHeader = 1"):
        opened(tmp_path, words, header=1)


@pytest.mark.parametrize(
    ("changed", "reported"),
    [
        (
            {"samples": 128, "frames": 40},
            rf"= {2 * FRAME_BYTES} bytes a frame, .* found are .*, {FRAME_BYTES} bytes a frame",
        ),
        ({"mask": 3, "frames": 39}, rf"= {FRAME_BYTES // 2} bytes a frame.* found are {40 * FRAME_BYTES} "),
        ({"loops": 200}, "less than one frame"),
    ],
)
def test_settings_that_do_not_fit_the_size_are_refused_with_the_arithmetic(
    tmp_path: Path, changed: dict[str, object], reported: str
) -> None:
    with pytest.raises(DataError, match=reported):
        opened(tmp_path, words_by_hand(echoes((7.0,)), "IIQQ"), **changed)


def test_zeros_after_the_last_frame_are_left_out(tmp_path: Path) -> None:
    words = words_by_hand(echoes((7.0,)), "IIQQ")
    source = opened(tmp_path, np.concatenate((words, np.zeros(5000, dtype=np.int16))), frames=40)
    assert source.info.frame_count == 40
    assert "10000 bytes of zeros" in " ".join(source.info.notes)


def test_all_zeros_and_a_saturated_converter_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="only zeros"):
        opened(tmp_path, np.zeros(20 * FRAME_BYTES // 2, dtype=np.int16))
    loud = np.clip(60 * echoes((7.0,)).real, -32768, 32767) + 1j * np.clip(60 * echoes((7.0,)).imag, -32768, 32767)
    with pytest.raises(DataError, match="saturated"):
        opened(tmp_path, words_by_hand(loud, "IIQQ"))


def test_raw_data_without_settings_are_refused(tmp_path: Path) -> None:
    (tmp_path / "adc.bin").write_bytes(bytes(100))
    with pytest.raises(UsageError, match=r"needs radar\.config"):
        open_radar(tmp_path / "adc.bin", RadarRequest())


def test_profiles_and_slow_time_agree_and_stamps_are_the_middle_of_the_chirps(tmp_path: Path) -> None:
    cube = echoes((7.3,))
    source = opened(tmp_path, words_by_hand(cube, "IIQQ"))
    profiles = next(source.profiles()).phasors
    block = next(source.slow_time(np.array([7.0, 7.5])))
    # Single precision of 1000 counts over 64 products.
    np.testing.assert_allclose(profiles[..., 7], block.phasors[..., 0], atol=1e-2)
    assert np.argmax(np.abs(profiles).mean(axis=(0, 1))) == 7
    np.testing.assert_allclose(np.angle(block.phasors[..., 1] * block.phasors[..., 0].conj()), 0, atol=0.03)
    first = 6e-6 + 63 / (2 * 6e6)
    np.testing.assert_allclose(source.times_ns()[:2] / 1e9, [first, first + 0.01], atol=1e-9)
    parts = [b.phasors for k in range(0, 40, 7) for b in source.profiles(k, min(k + 7, 40))]
    np.testing.assert_array_equal(np.concatenate(parts), profiles)


def test_chirps_of_one_transmitter_are_averaged_and_two_transmitters_are_channels_apart(tmp_path: Path) -> None:
    profile = ChirpProfile(77e9, 60e12, 6e6, 64, 0.05, receivers=2, transmitters=(1, 2, 1, 2))
    rng = np.random.default_rng(1)
    cube = np.rint(rng.normal(0, 300, (3, 4, 2, 64))) + 1j * np.rint(rng.normal(0, 300, (3, 4, 2, 64)))
    (tmp_path / "adc.bin").write_bytes(pack(cube, Layout(profile)).tobytes())
    (tmp_path / "radar.cfg").write_text(demo_settings(profile, order="IIQQ"))
    source = RawCapture(tmp_path / "adc.bin", RadarRequest(tmp_path / "radar.cfg", "IIQQ"))
    assert source.info.channels == 4
    got = next(source.slow_time(np.array([5.0]))).phasors[..., 0]
    n = np.arange(64)
    window = np.sin(np.pi * (n + 0.5) / 64) ** 2
    kernel = window / window.sum() * np.exp(-2j * np.pi * 5 * (n - 31.5) / 64)
    one = (cube @ kernel).reshape(3, 2, 2, 2).mean(axis=1).reshape(3, 4)
    np.testing.assert_allclose(got, one, atol=1e-2)


def test_the_printed_settings_of_the_papers_radar_give_its_carrier_and_ranges(tmp_path: Path) -> None:
    path = settings(tmp_path, samples=256)
    found = read_settings(path)
    profile = found.profile
    assert (found.lanes, profile.receivers, profile.chirps) == (2, 4, 1)
    # 77 GHz + 64.985 MHz/µs · (6 µs + 127.5 / 6 MHz) = 78.7708 GHz, 2.3 % above the start frequency.
    assert profile.carrier_hz == pytest.approx(78.7708e9, abs=1e5)
    assert profile.bin_m == pytest.approx(0.05406, abs=1e-5)
    assert profile.limit_speed_m_s == pytest.approx(0.0951, abs=1e-4)


def test_studio_and_demo_settings_of_one_profile_agree(tmp_path: Path) -> None:
    profile = ChirpProfile(60.25e9, 65e12, 4e6, 200, 0.05, 6e-6, receivers=3, transmitters=(1, 4, 1, 4), bits=14)
    (tmp_path / "radar.cfg").write_text(demo_settings(profile, frames=7, order="QQII", device="xWR6843"))
    (tmp_path / "radar.mmwave.json").write_text(json.dumps(STUDIO))
    demo, studio = read_settings(tmp_path / "radar.cfg"), read_settings(tmp_path / "radar.mmwave.json")
    for found in (demo, studio):
        assert (found.frames, found.order, found.order_said, found.lanes) == (7, "QQII", True, 2)
        assert found.profile.transmitters == profile.transmitters
        for name in (
            "start_frequency_hz",
            "slope_hz_s",
            "sample_rate_hz",
            "adc_start_s",
            "frame_period_s",
            "chirp_period_s",
        ):
            assert getattr(found.profile, name) == pytest.approx(getattr(profile, name), rel=1e-5), name
        assert (found.profile.samples, found.profile.receivers, found.profile.bits) == (200, 3, 14)


def test_old_firmware_settings_without_a_subframe_are_read(tmp_path: Path) -> None:
    (tmp_path / "old.cfg").write_text(
        "channelCfg 15 3 0\nadcCfg 2 1\nadcbufCfg 0 1 1 1\nprofileCfg 0 60.25 7 6 57 0 0 65 1 200 4000 0 0 40\n"
        "chirpCfg 0 0 0 0 0 0 0 1\nframeCfg 0 0 2 0 50 1 0\n"
    )
    found = read_settings(tmp_path / "old.cfg")
    assert (found.order, found.profile.chirps, found.profile.frame_rate_hz) == ("QQII", 2, pytest.approx(20.0))
    assert "two lanes are assumed" in found.notes[0]


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ("xWR16xx", "xWR9943", "xWR9943, whose byte layout is not known"),
        ("frameCfg 0 0 1 0 10 1 0", "", "frameCfg is missing"),
        ("chirpCfg 0 0 0", "chirpCfg 3 3 0", "chirp 0 is not defined"),
        ("profileCfg 0 77", "profileCfg 0 fast", "line 6: profileCfg takes numbers"),
        ("profileCfg 0", "profileCfg 2", "profileCfg 0, which the frame uses"),
        ("64.985", "0", "the slope must be from 0.001 to 10000 MHz"),
        ("chirpCfg 0 0 0 0", "chirpCfg 0 0 0 5", "varies its profile"),
        ("frameCfg", "advFrameCfg", "advanced frames"),
    ],
)
def test_settings_that_cannot_be_used_are_refused_with_their_command(
    tmp_path: Path, old: str, new: str, reported: str
) -> None:
    path = settings(tmp_path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(DataError, match=reported):
        read_settings(path)


def test_a_broken_or_foreign_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(DataError, match="is not JSON"):
        read_settings(tmp_path / "a.json")
    (tmp_path / "b.json").write_text(json.dumps({"mmWaveDevices": [{"rfConfig": {}}]}))
    with pytest.raises(DataError, match="lacks settings of mmWave Studio"):
        read_settings(tmp_path / "b.json")
    (tmp_path / "c.txt").write_text("")
    with pytest.raises(UsageError, match="must be a"):
        read_settings(tmp_path / "c.txt")


def test_a_simulated_capture_of_the_long_range_reads_back_at_its_range(tmp_path: Path) -> None:
    model = RadarModel((Reflector(48.0, 800.0),), LONG_RANGE, noise_std=80.0)
    capture = Capture(Layout(LONG_RANGE, "QQII"), lost=(20,), cut_bytes=10)
    still = Sines(np.array([0.0]), np.array([1.0]))
    size = write_capture(tmp_path / "adc.bin", model.blocks(still, 100, rng=np.random.default_rng(0)), capture)
    assert size == 100 * 4096 - 10
    (tmp_path / "radar.cfg").write_text(demo_settings(LONG_RANGE, frames=100))
    source = RawCapture(tmp_path / "adc.bin", RadarRequest(tmp_path / "radar.cfg"))
    # 48 m lies in the farther half of the range, so the sign cannot decide; the settings say QQII.
    assert source.info.iq_order == "QQII"
    assert "cannot decide" in source.info.warnings[0]
    power = (np.abs(next(source.profiles()).phasors) ** 2).mean(axis=(0, 1))
    assert source.info.range_m[np.argmax(power)] == pytest.approx(48.0, abs=LONG_RANGE.bin_m / 2)
