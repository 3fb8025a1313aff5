"""Radiometric JPEG of FLIR cameras are temperatures; damaged FLIR files are one sentence."""

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from flir_files import black_body, block, flir_jpeg

from midspan.cli.main import run
from midspan.errors import DataError, MidspanError
from midspan.sources.camera.frames import FrameRequest
from midspan.sources.thermal.formats import is_thermal, open_thermal
from midspan.sources.thermal.temperatures import ThermalRequest

AT_5 = ThermalRequest(FrameRequest(rate_hz=5.0))
# Half a count at 20 °C is 0.004 K with the constants of these files.
HALF_COUNT_K = 0.006


def scene(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(5.0, 35.0, (48, 64))


def jpeg(path: Path, seed: int = 0, **keys: object) -> Path:
    path.write_bytes(flir_jpeg(block(black_body(scene(seed)), **keys)))
    return path


@pytest.mark.parametrize("packed", ["plain", "PNG", "PNG with swapped bytes"])
def test_a_radiometric_jpeg_gives_the_temperatures_that_were_written(tmp_path: Path, packed: str) -> None:
    counts = black_body(scene())
    png = None
    if packed != "plain":
        ok, data = cv2.imencode(".png", counts.byteswap() if "swapped" in packed else counts)
        assert ok
        png = data.tobytes()
    (tmp_path / "IR_2412.jpg").write_bytes(flir_jpeg(block(counts, packed=png, header=">")))
    source = open_thermal(tmp_path / "IR_2412.jpg")
    (frame,) = source.frames()
    np.testing.assert_allclose(frame.pixels, scene(), atol=HALF_COUNT_K)
    assert source.times_ns().tolist() == [1_700_000_000_583_000_000]


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("noise_k", [0.0, 0.1, 3.0])
def test_the_bytes_of_a_png_are_ordered_by_the_picture_whatever_median_the_record_states(
    tmp_path: Path, swapped: bool, noise_k: float
) -> None:
    # A scene of 0 to 40 °C, smooth but for the sensor's noise; the median of the bytes in the wrong order is what the
    # camera's record states, as of another moment.
    across, down = np.meshgrid(np.linspace(0.0, 3.0, 64), np.linspace(0.0, 2.0, 48))
    celsius = 20.0 + 20.0 * np.sin(across) * np.cos(down)
    counts = black_body(celsius + noise_k * np.random.default_rng(1).standard_normal(celsius.shape))
    ok, data = cv2.imencode(".png", counts.byteswap() if swapped else counts)
    assert ok
    wrong = int(np.median(counts.byteswap()))
    (tmp_path / "IR_1.jpg").write_bytes(flir_jpeg(block(counts, packed=data.tobytes(), median=wrong)))
    (frame,) = open_thermal(tmp_path / "IR_1.jpg").frames()
    # Six standard deviations of the noise, and half a count.
    np.testing.assert_allclose(frame.pixels, celsius, atol=6.0 * noise_k + 2.0 * HALF_COUNT_K)


@pytest.mark.parametrize("pattern", ["", "IR_*.jpg"])
def test_a_folder_or_glob_of_them_is_a_sequence_with_the_cameras_stamps(tmp_path: Path, pattern: str) -> None:
    stamps = [1_700_000_000_000 + 200 * k for k in range(12)]
    for k, stamp in enumerate(stamps):
        jpeg(tmp_path / f"IR_{k}.jpg", k, stamp_ms=stamp)
        # The same camera's picture of light, without counts.
        cv2.imwrite(str(tmp_path / f"DC_{k}.jpg"), np.full((30, 40), 90, np.uint8))
    source = open_thermal(tmp_path / pattern)
    assert source.times_ns().tolist() == [stamp * 1_000_000 for stamp in stamps]
    for k, frame in enumerate(source.frames()):
        np.testing.assert_allclose(frame.pixels, scene(k), atol=HALF_COUNT_K)
    left_out = "12 pictures without raw counts are left out" in source.info.notes
    assert left_out is (pattern == "")


def test_inspect_says_what_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["inspect", str(jpeg(tmp_path / "IR_2412.jpg"))]) == 0
    out = capsys.readouterr().out
    assert "FLIR records, 16-bit counts" in out
    assert "Model 7" in out
    assert "64 × 48 px" in out


def test_what_a_camera_writes_behind_its_block_is_no_damage(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(flir_jpeg(block(black_body(scene())) + bytes(500)))
    assert open_thermal(tmp_path / "a.jpg").info.damage == ()


def test_a_flir_jpeg_without_counts_is_a_picture_and_that_is_reported(tmp_path: Path) -> None:
    records = block(black_body(scene()))
    # Its first record is of another kind than raw counts.
    (tmp_path / "DC_1.jpg").write_bytes(flir_jpeg(records[:64] + b"\x0e" + records[65:]))
    assert not is_thermal(tmp_path / "DC_1.jpg")
    assert "8-bit grey levels, not temperatures" in " ".join(open_thermal(tmp_path / "DC_1.jpg", AT_5).info.notes)


def dji_jpeg(path: Path, maker: bytes = b"DJI", count_bytes: int = 2 * 160 * 120) -> Path:
    """A picture to look at with a maker's name and segments APP3 of counts, of 60 000 bytes at most each."""
    ok, shown = cv2.imencode(".jpg", np.full((24, 32), 90, np.uint8))
    assert ok
    picture, counts = shown.tobytes(), bytes(count_bytes)
    exif = b"Exif\0\0MM\0*" + maker + b"\0H20T\0"
    parts = [counts[k : k + 60000] for k in range(0, len(counts), 60000)]
    segments = [(0xE1, exif), *((0xE3, part) for part in parts)]
    written = b"".join(bytes((0xFF, kind)) + struct.pack(">H", len(part) + 2) + part for kind, part in segments)
    path.write_bytes(picture[:2] + written + picture[2:])
    return path


@pytest.mark.parametrize("pattern", ["", "*.jpg", "a.jpg"])
def test_a_thermal_jpeg_of_dji_is_named_in_its_refusal(tmp_path: Path, pattern: str) -> None:
    dji_jpeg(tmp_path / "a.jpg")
    with pytest.raises(
        DataError, match=r"a\.jpg: a thermal JPEG of DJI\. Only DJI's Thermal SDK converts its 16-bit counts"
    ):
        open_thermal(tmp_path / pattern, AT_5)


@pytest.mark.parametrize("keys", [{"maker": b"Other"}, {"count_bytes": 500}])
def test_other_pictures_of_light_are_still_grey_levels(tmp_path: Path, keys: dict[str, object]) -> None:
    notes = open_thermal(dji_jpeg(tmp_path / "a.jpg", **keys), AT_5).info.notes
    assert "8-bit grey levels, not temperatures" in " ".join(notes)


def test_a_part_that_is_missing_is_named(tmp_path: Path) -> None:
    data = jpeg(tmp_path / "a.jpg").read_bytes()
    second = data.index(b"FLIR\0\x01\x01") - 4
    third = data.index(b"FLIR\0\x01\x02") - 4
    (tmp_path / "a.jpg").write_bytes(data[:second] + data[third:])
    with pytest.raises(DataError, match=r"a\.jpg: 1 of the 3 parts of its raw data are missing, the first is part 2"):
        open_thermal(tmp_path / "a.jpg")
    (tmp_path / "a.jpg").write_bytes(data[: second - 100])
    with pytest.raises(DataError, match=r"a\.jpg is cut off in part 1 of 3"):
        open_thermal(tmp_path / "a.jpg")


@pytest.mark.parametrize("name", ["a.jpg", "a.seq", "png.fff"])
def test_whatever_is_wrong_with_a_flir_file_it_is_an_error_of_midspan(tmp_path: Path, name: str) -> None:
    counts = black_body(scene())
    ok, png = cv2.imencode(".png", counts)
    assert ok
    one = block(counts, packed=png.tobytes() if "png" in name else None)
    whole = flir_jpeg(one) if name == "a.jpg" else one + block(counts, stamp_ms=1_700_000_000_783)
    rng = np.random.default_rng(3)
    for _ in range(60):
        data = bytearray(whole)
        top = len(data) if rng.random() < 0.3 else 2600
        for _ in range(int(rng.integers(1, 30))):
            data[int(rng.integers(top))] ^= 1 << int(rng.integers(8))
        (tmp_path / name).write_bytes(data if rng.random() < 0.7 else data[: int(rng.integers(1, top))])
        said = what_is_wrong(tmp_path / name)
        assert said is None or (name in said and len(said.splitlines()) == 1)


def what_is_wrong(path: Path) -> str | None:
    """What midspan says of a file; None where it reads it. Any other exception fails the test."""
    try:
        source = open_thermal(path, AT_5)
        assert all(np.isfinite(frame.pixels.astype(float)).all() for frame in source.frames())
    except MidspanError as error:
        return str(error)
    return None
