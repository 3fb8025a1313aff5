"""Radiometric sequences: FLIR records, 16-bit pictures and stacks come back as the temperatures that were written."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from flir_files import black_body, block

from midspan.errors import DataError, UsageError
from midspan.sources.camera.frames import FrameRequest
from midspan.sources.thermal.flir import wrong_stamps
from midspan.sources.thermal.formats import open_thermal
from midspan.sources.thermal.temperatures import ThermalRequest

AT_30 = ThermalRequest(FrameRequest(rate_hz=30.0))
# Half a count at 20 °C is 0.004 K with these constants; float32 and look-up add nothing to speak of.
HALF_COUNT_K = 0.006


def scene(seed: int = 0, shape: tuple[int, int] = (12, 16)) -> np.ndarray:
    return np.random.default_rng(seed).uniform(5.0, 35.0, shape)


@pytest.mark.parametrize("header", ["<", ">"], ids=["little header", "big header"])
@pytest.mark.parametrize("inner", ["<", ">"], ids=["little records", "big records"])
def test_temperatures_come_back_whatever_the_byte_orders(tmp_path: Path, header: str, inner: str) -> None:
    truth = scene()
    (tmp_path / "a.fff").write_bytes(block(black_body(truth), header=header, inner=inner))
    source = open_thermal(tmp_path / "a.fff")
    (frame,) = source.frames()
    assert frame.pixels.dtype == np.float32
    np.testing.assert_allclose(frame.pixels, truth, atol=HALF_COUNT_K)
    assert "Model 7" in " ".join(source.info.notes)
    assert source.info.radiometric


def test_a_sequence_keeps_the_cameras_own_milliseconds(tmp_path: Path) -> None:
    stamps = [1_700_000_000_583, 1_700_000_000_617, 1_700_000_000_650, 1_700_000_001_003]
    data = b"".join(block(black_body(scene(k)), stamp_ms=s) for k, s in enumerate(stamps))
    (tmp_path / "a.seq").write_bytes(data)
    source = open_thermal(tmp_path / "a.seq", ThermalRequest(FrameRequest(every=2, start_s=0.5)))
    assert source.times_ns().tolist() == [(s + 500) * 1_000_000 for s in stamps[::2]]
    frames = list(source.frames(1))
    assert [f.index for f in frames] == [1]
    np.testing.assert_allclose(frames[0].pixels, scene(2), atol=HALF_COUNT_K)


def test_the_letters_of_a_block_among_the_pixels_begin_no_block(tmp_path: Path) -> None:
    counts = black_body(scene())
    counts[3, 2:4] = np.frombuffer(b"FFF\0", dtype="<u2")
    (tmp_path / "a.seq").write_bytes(block(counts, stamp_ms=1000) + block(counts, stamp_ms=1033))
    assert open_thermal(tmp_path / "a.seq").info.frame_count == 2


def test_a_tail_four_bytes_short_is_whole_and_a_frame_cut_in_half_is_reported(tmp_path: Path) -> None:
    one = block(black_body(scene()), stamp_ms=1000)
    (tmp_path / "a.seq").write_bytes(one + block(black_body(scene()), stamp_ms=1033)[:-4])
    (tmp_path / "b.seq").write_bytes(one + one[: len(one) // 2])
    assert open_thermal(tmp_path / "a.seq").info.frame_count == 2
    cut = open_thermal(tmp_path / "b.seq").info
    assert cut.frame_count == 1
    assert f"the last {len(one) // 2} bytes" in " ".join(cut.damage)


def test_stamps_that_stand_still_give_way_to_the_rate(tmp_path: Path) -> None:
    (tmp_path / "a.seq").write_bytes(block(black_body(scene())) * 3)
    source = open_thermal(tmp_path / "a.seq")
    assert np.diff(source.times_ns()).tolist() == [33_333_333, 33_333_334]
    assert "30 frames a second" in " ".join(source.info.notes)


def test_frames_behind_bytes_that_are_none_are_found_again_and_that_is_reported(tmp_path: Path) -> None:
    frames = [block(black_body(scene(k)), stamp_ms=1000 + 33 * k) for k in range(4)]
    broken = b"FFF\0" * 3 + bytes(len(frames[1]) - 12)
    (tmp_path / "a.seq").write_bytes(frames[0] + broken + frames[2] + frames[3])
    source = open_thermal(tmp_path / "a.seq")
    assert source.times_ns().tolist() == [1_000_000_000, 1_066_000_000, 1_099_000_000]
    np.testing.assert_allclose(list(source.frames())[1].pixels, scene(2), atol=HALF_COUNT_K)
    assert source.info.damage == (
        f"{len(frames[1])} bytes of a.seq before frame 1 are not a complete frame and were skipped",
    )


def test_a_stamp_out_of_order_costs_its_frame_and_not_the_others_stamps(tmp_path: Path) -> None:
    stamps = [1000 + 40 * k for k in range(40)]
    stamps[20] = stamps[12]
    (tmp_path / "a.seq").write_bytes(b"".join(block(black_body(scene(k)), stamp_ms=s) for k, s in enumerate(stamps)))
    source = open_thermal(tmp_path / "a.seq")
    assert source.times_ns().tolist() == [1_000_000 * s for k, s in enumerate(stamps) if k != 20]
    np.testing.assert_allclose(list(source.frames())[20].pixels, scene(21), atol=HALF_COUNT_K)
    assert "1 frames (20) have stamps out of order" in " ".join(source.info.damage)


def test_a_clock_that_was_set_back_is_not_taken_for_a_slip() -> None:
    stamps = np.arange(200) * 40
    back = np.where(np.arange(200) >= 100, stamps - 5 * 40, stamps)
    assert len(wrong_stamps(back)) == 0
    assert wrong_stamps(np.where(np.isin(np.arange(200), [50, 51]), 7, stamps)).tolist() == [50, 51]


def test_a_folder_of_frames_is_a_sequence_in_natural_order(tmp_path: Path) -> None:
    for k in (1, 2, 10):
        (tmp_path / f"f{k}.fff").write_bytes(block(black_body(scene(k)), stamp_ms=1000 * k))
    source = open_thermal(tmp_path)
    assert source.times_ns().tolist() == [1_000_000_000, 2_000_000_000, 10_000_000_000]
    np.testing.assert_allclose(list(source.frames())[2].pixels, scene(10), atol=HALF_COUNT_K)


def test_a_sequence_that_mixes_sizes_is_refused_with_both_sizes(tmp_path: Path) -> None:
    (tmp_path / "a.seq").write_bytes(block(black_body(scene())) + block(black_body(scene(1, (10, 16)))))
    with pytest.raises(DataError, match=r"frame 1 must have the size of the first, 16x12 px; received 16x10"):
        open_thermal(tmp_path / "a.seq")


def test_a_calibration_of_zeros_is_refused_with_a_remedy(tmp_path: Path) -> None:
    whole = bytearray(block(black_body(scene())))
    place = whole.index(b"Model 7") - 0xD4
    whole[place + 0x58 : place + 0x64] = bytes(12)
    (tmp_path / "a.seq").write_bytes(whole)
    with pytest.raises(DataError, match=r"frame 0 has an invalid record of the camera's calibration.*Export"):
        open_thermal(tmp_path / "a.seq")


def test_a_block_without_calibration_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.fff").write_bytes(block(black_body(scene()), calibrated=False))
    with pytest.raises(DataError, match="calibration"):
        open_thermal(tmp_path / "a.fff")


@pytest.mark.parametrize("swapped", [False, True], ids=["as a PNG should be", "bytes swapped"])
def test_counts_in_a_png_are_read_in_either_byte_order(tmp_path: Path, swapped: bool) -> None:
    counts = black_body(scene())
    ok, png = cv2.imencode(".png", counts.byteswap() if swapped else counts)
    assert ok
    (tmp_path / "a.fff").write_bytes(block(counts, packed=png.tobytes()))
    (frame,) = open_thermal(tmp_path / "a.fff").frames()
    np.testing.assert_allclose(frame.pixels, scene(), atol=HALF_COUNT_K)


def test_compressed_counts_come_back_bit_for_bit(tmp_path: Path) -> None:
    library = pytest.importorskip("jpeg_ls", reason="the extra midspan[csq] is not installed")
    counts = black_body(scene())
    data = b"".join(
        block(counts + k, stamp_ms=1000 + 33 * k, packed=bytes(library.encode_array(counts + np.uint16(k))))
        for k in range(3)
    )
    (tmp_path / "a.csq").write_bytes(data)
    (tmp_path / "plain.seq").write_bytes(block(counts + 2, stamp_ms=1000))
    found = list(open_thermal(tmp_path / "a.csq").frames())[2]
    (plain,) = open_thermal(tmp_path / "plain.seq").frames()
    np.testing.assert_array_equal(found.pixels, plain.pixels)


def test_without_the_decoder_the_error_names_the_line_that_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "jpeg_ls", None)
    (tmp_path / "a.csq").write_bytes(block(black_body(scene()), packed=b"\xff\xd8\xff\xf7" + bytes(50)))
    with pytest.raises(UsageError, match=r"pip install 'midspan\[csq\]'"):
        open_thermal(tmp_path / "a.csq")


def test_the_real_files_have_the_temperatures_that_were_stated(data_folder: Path) -> None:
    stated = {
        # The TIFF's range is stated with the data; the two others were computed once with another program's formula.
        "example_radiometric.tiff": (-3.4, 9.9, (512, 640)),
        "frame_000000.fff": (9.6, 12.6, (512, 640)),
        "frame_000000_le.fff": (22.9, 29.5, (240, 320)),
    }
    for name, (low, high, shape) in stated.items():
        file = data_folder / "flirpy" / name
        if not file.is_file():
            pytest.skip(f"{file} is absent")
        (frame,) = open_thermal(file, AT_30).frames()
        assert frame.pixels.shape == shape
        assert (frame.pixels.min(), frame.pixels.max()) == pytest.approx((low, high), abs=0.06)


def test_a_stack_in_celsius_comes_back_as_it_is(tmp_path: Path) -> None:
    truth = np.stack([scene(k) for k in range(3)])
    np.savez(tmp_path / "a.npz", celsius=truth, time_s=np.array([0.0, 0.04, 0.09]))
    source = open_thermal(tmp_path / "a.npz")
    for frame, expected in zip(source.frames(), truth, strict=True):
        np.testing.assert_allclose(frame.pixels, expected, rtol=1e-6)
    assert source.times_ns().tolist() == [0, 40_000_000, 90_000_000]


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        (lambda c: c + 273.15, "which are kelvin"),
        (lambda c: 100 * (c + 273.15), "which look like counts"),
        (lambda c: c * np.nan, "all its values are missing"),
    ],
    ids=["kelvin", "counts", "nothing"],
)
def test_a_stack_in_another_unit_is_refused_with_what_was_received(tmp_path: Path, change, reported: str) -> None:
    np.save(tmp_path / "a.npy", change(np.stack([scene(k) for k in range(2)])))
    with pytest.raises(DataError, match=reported):
        open_thermal(tmp_path / "a.npy", AT_30)


def test_missing_values_are_filled_and_frames_without_most_of_theirs_are_passed_over(tmp_path: Path) -> None:
    y, x = np.mgrid[:20, :24]
    stack = np.stack([10.0 + 0.1 * x + 0.2 * y + 0.01 * k for k in range(6)])
    given = stack.copy()
    given[:, 5, 7] = np.nan
    given[3] = np.nan
    given[4, :, :6] = np.inf
    np.save(tmp_path / "a.npy", given)
    source = open_thermal(tmp_path / "a.npy", AT_30)
    frames = list(source.frames())
    assert [frame.index for frame in frames] == [0, 1, 2, 5]
    # A plane is filled with itself, but for float32.
    np.testing.assert_allclose([frame.pixels for frame in frames], stack[[0, 1, 2, 5]], atol=1e-5)
    reported = " ".join(source.info.damage)
    assert "4 frames have missing values (NaN), at most 1 a frame" in reported
    assert "2 frames (3, 4) have more than 20 % of their values missing" in reported


def test_a_sequence_that_begins_with_an_empty_frame_is_opened(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.stack([scene(0) * np.nan, scene(1), scene(2)]))
    assert [frame.index for frame in open_thermal(tmp_path / "a.npy", AT_30).frames()] == [1, 2]


def test_a_unit_that_changes_on_the_way_is_refused_with_its_frame(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.stack([scene(0), scene(1), scene(2) + 273.15]))
    with pytest.raises(DataError, match="frame 2 must hold temperatures in °C"):
        list(open_thermal(tmp_path / "a.npy", AT_30).frames())


@pytest.mark.parametrize("first", [0, 2], ids=["to °F", "to °C"])
def test_a_change_between_celsius_and_fahrenheit_is_refused_with_its_frame(tmp_path: Path, first: int) -> None:
    noise = np.random.default_rng(3).normal(0.0, 0.05, (4, 12, 16))
    stack = scene(0) + noise
    stack[first : first + 2] = 1.8 * stack[first : first + 2] + 32.0
    np.save(tmp_path / "a.npy", stack)
    with pytest.raises(DataError, match="frame 2 must be in the unit of the frames before"):
        list(open_thermal(tmp_path / "a.npy", AT_30).frames())


def test_a_level_that_jumps_by_as_much_is_no_change_of_unit(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.stack([scene(0), scene(0) + 48.0, scene(0)]))
    assert len(list(open_thermal(tmp_path / "a.npy", AT_30).frames())) == 3


def test_a_wall_as_hot_as_fahrenheit_would_make_it_is_reported(tmp_path: Path) -> None:
    for name, stack in (("f.npy", 1.8 * scene() + 32.0), ("c.npy", scene())):
        np.save(tmp_path / name, stack[None])
        reported = " ".join(open_thermal(tmp_path / name, AT_30).info.damage)
        assert ("if the numbers are °F" in reported) == (name == "f.npy")


def test_counts_whose_scale_changes_on_the_way_are_refused_and_blank_frames_are_not(tmp_path: Path) -> None:
    kelvin = scene() + 273.15
    for k, counts in enumerate((kelvin / 0.01, 0.0 * kelvin)):
        cv2.imwrite(str(tmp_path / f"p{k}.png"), np.rint(counts).astype(np.uint16))
    assert len(list(open_thermal(tmp_path, AT_30).frames())) == 2
    cv2.imwrite(str(tmp_path / "p2.png"), np.rint(kelvin / 0.04).astype(np.uint16))
    with pytest.raises(DataError, match=r"frame 2 must hold counts of 0.01 K"):
        list(open_thermal(tmp_path, AT_30).frames())


@pytest.mark.parametrize("scale", [0.01, 0.04, 0.1])
def test_usual_scales_of_16_bit_pictures_are_reported_from_each_other(tmp_path: Path, scale: float) -> None:
    truth = scene()
    cv2.imwrite(str(tmp_path / "a.tiff"), np.rint((truth + 273.15) / scale).astype(np.uint16))
    source = open_thermal(tmp_path / "a.tiff", AT_30)
    (frame,) = source.frames()
    # Half a count, and float32 near 20.
    np.testing.assert_allclose(frame.pixels, truth, atol=0.5 * scale + 1e-5)
    assert f"counts of {scale:g} K" in " ".join(source.info.notes)
    assert source.info.radiometric


def test_a_stated_scale_wins_and_one_that_cannot_be_is_refused(tmp_path: Path) -> None:
    truth = scene()
    cv2.imwrite(str(tmp_path / "a.tiff"), np.rint((truth + 40.0) / 0.002).astype(np.uint16))
    request = ThermalRequest(FrameRequest(rate_hz=30.0), kelvin_per_count=0.002, zero_k=233.15)
    (frame,) = open_thermal(tmp_path / "a.tiff", request).frames()
    np.testing.assert_allclose(frame.pixels, truth, atol=0.00102)
    with pytest.raises(DataError, match="Give kelvin_per_count"):
        open_thermal(tmp_path / "a.tiff", ThermalRequest(FrameRequest(rate_hz=30.0), kelvin_per_count=0.1))


def test_pictures_of_8_bits_are_taken_as_grey_levels_and_that_is_reported(tmp_path: Path) -> None:
    for k in range(2):
        cv2.imwrite(str(tmp_path / f"p{k}.png"), scene(k).astype(np.uint8))
    source = open_thermal(tmp_path, AT_30)
    assert [f.pixels.dtype for f in source.frames()] == [np.uint8, np.uint8]
    assert "not temperatures" in " ".join(source.info.notes)
    assert not source.info.radiometric


def test_another_emissivity_than_the_files_can_be_given(tmp_path: Path) -> None:
    (tmp_path / "a.fff").write_bytes(block(black_body(np.full((12, 16), 40.0))))
    (frame,) = open_thermal(tmp_path / "a.fff", ThermalRequest(emissivity=0.9)).frames()
    # 90 % from the object and 10 % reflected at 20 °C must make the black body's radiance at 40 °C.
    t = 273.15 + np.float64(frame.pixels[0, 0])
    whole = 0.9 / (np.exp(1430.0 / t) - 1) + 0.1 / (np.exp(1430.0 / 293.15) - 1)
    assert whole == pytest.approx(1 / (np.exp(1430.0 / 313.15) - 1), rel=2e-4)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"gone\.csq does not exist"):
        open_thermal(tmp_path / "gone.csq")
