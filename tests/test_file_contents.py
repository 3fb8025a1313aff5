"""Settings, calibration and lens files with contents that nobody means: one sentence and an exit code, never more."""

import copy
import json
from pathlib import Path

import numpy as np
import pytest

from midspan.cli.main import run
from midspan.errors import DataError
from midspan.settings.stored.calibration import load_calibration

RATE_HZ, EVERY = 50.0, 10


def exact(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (mm) and acceleration (m/s²) of two sines."""
    waves = [(5.0, 2 * np.pi * 0.7), (2.0, 2 * np.pi * 0.31)]
    moved = sum(size * np.sin(w * time_s) for size, w in waves)
    return np.asarray(moved), np.asarray(sum(-1e-3 * size * w * w * np.sin(w * time_s) for size, w in waves))


def write(folder: Path, noise_mm: float = 0.5, noise_m_s2: float = 0.003) -> Path:
    """A recording of 20 s: an accelerometer at 50 Hz and a displacement at 5 Hz, with white noise."""
    rng = np.random.default_rng(0)
    time_s = np.arange(0.0, 20.0, 1.0 / RATE_HZ)
    moved, value = exact(time_s)
    tables = {
        "accel": (time_s, value + rng.normal(0.0, noise_m_s2, len(time_s))),
        "height": (time_s[::EVERY], moved[::EVERY] + rng.normal(0.0, noise_mm, len(time_s[::EVERY]))),
    }
    for name, columns in tables.items():
        table = np.column_stack(columns)
        np.savetxt(folder / f"{name}.csv", table, delimiter=",", header=f"time_s,{name}", comments="")
    (folder / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n\n[displacement]\nfile = "height.csv"\nunit = "mm"\n'
    )
    return folder


def message(capsys: pytest.CaptureFixture[str], code: int, *arguments: object) -> str:
    """What the command says that ends with `code`: one sentence or more, no defect, no warning of a library."""
    found = run([str(argument) for argument in arguments])
    said = capsys.readouterr().err
    assert found == code, said
    assert "internal error" not in said
    assert "Traceback" not in said
    assert len(said) < 1500
    return said


@pytest.mark.parametrize(
    ("section", "line", "reported"),
    [
        ("accelerometer", "start_s = 1e300", "accelerometer.start_s = 1e+300: must be from -4.5e+09 to 4.5e+09 s"),
        ("accelerometer", "start_s = nan", "accelerometer.start_s = nan: must be from"),
        ("accelerometer", "rate_hz = 1e-12", "accelerometer.rate_hz = 1e-12: must be from 1e-06 to 1e+09 Hz"),
        ("accelerometer", "rate_hz = inf", "accelerometer.rate_hz = inf: must be from 1e-06 to 1e+09 Hz"),
        ("accelerometer", "noise_std = 1e-300", "accelerometer.noise_std = 1e-300: must be from"),
        ("accelerometer", f"rate_hz = {10**30}", "at most 64 bits"),
        ("displacement", "start_s = -1e200", "displacement.start_s = -1e+200: must be from"),
        ("calibration", "window_s = [0.0, 1e300]", "calibration.window_s[2] = 1e+300: must be from"),
        ("calibration", "band_hz = [0.1, 1e300]", "calibration.band_hz[2] = 1e+300: must be from 0 to 1e+09 Hz"),
        ("fusion", "lag_s = 1e-300", "fusion.lag_s = 1e-300: must be from 1e-06 to 3600 s"),
        ("camera", "exposure_s = 1e200", "camera.exposure_s = 1e+200: must be from 0 to 3600 s"),
        ("camera", "readout_s = 1e300", "camera.readout_s = 1e+300: must be from 0 to 3600 s"),
        ("camera", "start_s = 1e200", "camera.start_s = 1e+200: must be from -4.5e+09 to 4.5e+09 s"),
        ("camera", "roi = [0, 0, 4000000000, 5]", "must be numbers up to 1000000 px"),
        ("camera", "tracker_settings = {pyramid = 1e300}", "must be a number up to 1e+09"),
        ("infrared", "kelvin_per_count = 1e-300", "must be from 1e-09 to 1000 K a count"),
        ("radar", "carrier_hz = 1e300", "radar.carrier_hz = 1e+300: must be from 1e+09 to 1e+12 Hz"),
    ],
)
def test_a_number_out_of_its_range_is_named_with_rule_unit_and_value(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], section: str, line: str, reported: str
) -> None:
    text = (write(tmp_path) / "recording.toml").read_text()
    if f"[{section}]" not in text:
        text += f"\n[{section}]\n" + ('file = "no.npy"\n' if section in ("camera", "infrared", "radar") else "")
    (tmp_path / "recording.toml").write_text(text.replace(f"[{section}]", f"[{section}]\n{line}", 1))
    said = message(capsys, 2, "check-config", tmp_path)
    assert reported in said
    assert "recording.toml" in said
    assert said == message(capsys, 2, "estimate", tmp_path, "-o", tmp_path / "result.csv")


@pytest.mark.parametrize(
    ("name", "reported"),
    [
        ('"accel.csv\\u0000"', "without NUL characters"),
        ('"' + 300 * "a" + '.csv"', "each name in it of at most 255 bytes"),
        ('"' + "/".join(50 * [90 * "ü"]) + '.csv"', "at most 4095 bytes"),
        ('"/no/such/folder/accel.csv"', "no such file"),
        ('"../../../accel.csv"', "no such file"),
        ('"."', "the suffix must be one of"),
    ],
)
def test_a_file_name_that_no_file_can_have_is_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, reported: str
) -> None:
    text = (write(tmp_path) / "recording.toml").read_text()
    (tmp_path / "recording.toml").write_text(text.replace('"accel.csv"', name))
    found = run(["estimate", str(tmp_path), "-o", str(tmp_path / "result.csv")])
    said = capsys.readouterr().err
    assert found in (2, 3), said
    assert reported in said


@pytest.mark.parametrize("command", ["inspect", "check-config", "calibrate", "estimate", "compare"])
def test_an_argument_longer_than_any_name_is_a_sentence(capsys: pytest.CaptureFixture[str], command: str) -> None:
    assert "at most 255 bytes" in message(capsys, 2, command, 300 * "a", 300 * "b")


TEXT = '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n\n[displacement]\nfile = "height.csv"\nunit = "mm"\n'
DEEP = 900


@pytest.mark.parametrize(
    ("content", "reported"),
    [
        (TEXT.encode("utf-16"), "this is UTF-16"),
        (TEXT.encode("utf-16-le"), "this is UTF-16, or no text"),
        (TEXT.encode("utf-32"), "this is UTF-32"),
        (TEXT.encode() + "# Brücke\n".encode("latin-1"), "received byte 0xfc in line 8"),
        (f"{TEXT}x = {DEEP * '['}1{DEEP * ']'}\n".encode(), "at most 64 levels"),
        (f"{TEXT}x = {100 * '['}1{100 * ']'}\n".encode(), "at most 64 levels"),
        (f"{TEXT}[{'.'.join(DEEP * 'a')}]\n".encode(), "at most 64 levels"),
        (f"{TEXT}x = {5000 * '9'}\n".encode(), "thousands of digits"),
        (f"{TEXT}x = 0x{5000 * 'f'}\n".encode(), "at most 64 bits"),
        (f"{TEXT}x = {list(range(3000))}\n".encode(), "displacement.x: is not a known key"),
    ],
)
def test_settings_in_another_encoding_or_too_deep_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes, reported: str
) -> None:
    (write(tmp_path) / "recording.toml").write_bytes(content)
    assert reported in message(capsys, 2, "check-config", tmp_path)


def test_settings_with_a_byte_order_mark_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (write(tmp_path) / "recording.toml").write_bytes(b"\xef\xbb\xbf" + TEXT.encode())
    message(capsys, 0, "check-config", tmp_path)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with its calibration.json; not to be changed."""
    folder = write(tmp_path_factory.mktemp("calibrated"))
    assert run(["calibrate", str(folder), "-q"]) == 0
    return folder


@pytest.mark.parametrize(
    ("content", "reported"),
    [
        (f"{DEEP * '['}{DEEP * ']'}", "at most 64 levels"),
        (f"{100_000 * '['}{100_000 * ']'}", "at most 64 levels"),
        (f'{DEEP * chr(123) + chr(34)}a": 1', "is not JSON"),
        ('{"accelerometer": {"noise_std_m_s2": 1, "noise_std_m_s2": 2}}', "'noise_std_m_s2' is there twice"),
        (f'{{"accelerometer": {{"noise_std_m_s2": {5000 * "9"}}}}}', "thousands of digits"),
        (f'{{"accelerometer": {{"noise_std_m_s2": {400 * "9"}}}}}', "at most 64 bits"),
        (
            '{"accelerometer": {"noise_std_m_s2": 1e400}}',
            "accelerometer.noise_std_m_s2 = inf: must be from 1e-15 to 1e+06 m/s²",
        ),
        (
            '{"accelerometer": {"noise_std_m_s2": 1}, "displacement": []}',
            "displacement = []: must be a section with keys",
        ),
        ("[]", "accelerometer: is missing."),
        ("7", "accelerometer: is missing."),
        ("{'a': 1}", "is not JSON"),
        ("", "is not JSON"),
    ],
)
def test_a_calibration_that_is_no_such_tree_is_refused(
    tmp_path: Path, calibrated: Path, capsys: pytest.CaptureFixture[str], content: str, reported: str
) -> None:
    (tmp_path / "c.json").write_text(content)
    said = message(capsys, 3, "estimate", calibrated, "-c", tmp_path / "c.json", "-o", tmp_path / "o.csv")
    assert reported in said
    assert "c.json" in said


def test_a_calibration_in_utf_16_is_named_and_one_with_a_byte_order_mark_is_read(
    tmp_path: Path, calibrated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (calibrated / "calibration.json").read_text()
    (tmp_path / "c.json").write_text(text, encoding="utf-16")
    assert "this is UTF-16" in message(capsys, 3, "estimate", calibrated, "-c", tmp_path / "c.json", "-o", "o.csv")
    (tmp_path / "c.json").write_text(text, encoding="utf-8-sig")
    assert load_calibration(tmp_path / "c.json") == load_calibration(calibrated)


RADAR_TARGET = {
    "place_bin": 12.5,
    "range_m": 2.1,
    "amplitude": 900.0,
    "snr_db": 20.0,
    "weights": [[1.0, 0.0], [0.0, 1.0]],
    "conversion_factor": 1.2,
    "conversion_factor_std": 0.01,
    "coherence": 0.99,
    "noise_std_mm": 0.01,
}
WHOLE = {
    "accelerometer": {"noise_std_m_s2": 0.003, "bias_m_s2": 0.05},
    "camera": {
        "scale_mm_per_px": -1.5,
        "scale_std_mm_per_px": 0.01,
        "time_offset_s": 0.02,
        "time_offset_std_s": 0.001,
        "roi": [10, 10, 40, 40],
        "noise_std_px": 0.02,
        "variance_factor": 1.1,
        "phase_scale_mm_per_rad": 0.4,
        "relative_scale_std": 0.01,
        "lens": {
            "model": "pinhole",
            "matrix": [800.0, 800.0, 320.0, 240.0],
            "distortion": [0.1, 0.0, 0.0, 0.0],
            "size": [640, 480],
        },
    },
    "displacement": {"noise_std_mm": 0.5, "time_offset_s": 0.0, "scale": 1.0, "scale_std": 0.01},
    "radar": {
        "conversion_factor": 1.2,
        "carrier_hz": 78e9,
        "channels": 2,
        "time_offset_s": 0.1,
        "targets": [RADAR_TARGET],
    },
}


def leaves(tree: object, place: tuple[object, ...] = ()) -> list[tuple[object, ...]]:
    if isinstance(tree, dict):
        return [leaf for key, value in tree.items() for leaf in leaves(value, (*place, key))]
    if isinstance(tree, list):
        return [leaf for k, value in enumerate(tree) for leaf in leaves(value, (*place, k))]
    return [place]


def changed(place: tuple[object, ...], value: object) -> dict[str, object]:
    tree = branch = copy.deepcopy(WHOLE)
    for key in place[:-1]:
        branch = branch[key]
    branch[place[-1]] = value
    return tree


@pytest.mark.parametrize("place", leaves(WHOLE), ids=lambda place: ".".join(map(str, place)))
def test_no_value_of_a_calibration_raises_anything_but_a_sentence(tmp_path: Path, place: tuple[object, ...]) -> None:
    file, said = tmp_path / "c.json", []
    for value in (1e308, -1e308, 1e-320, 2**63 - 1, float("nan"), float("inf"), "x", [], {}, True):
        file.write_text(json.dumps(changed(place, value)))
        try:
            load_calibration(file)
        except DataError as error:
            said.append(str(error))
    assert all("c.json" in text and text.endswith("Run `midspan calibrate` again.") for text in said)


@pytest.mark.parametrize(
    ("place", "value", "rule"),
    [
        (("displacement", "time_offset_s"), 9223372036854775807, "from -4.5e+09 to 4.5e+09 s"),
        (("displacement", "time_offset_s"), -1e308, "from -4.5e+09 to 4.5e+09 s"),
        (("displacement", "noise_std_mm"), 1e-320, "from 1e-15 to 1e+06 (px or mm)"),
        (("accelerometer", "noise_std_m_s2"), 1e308, "from 1e-15 to 1e+06 m/s²"),
        (("accelerometer", "noise_std_m_s2"), 2147483648, "from 1e-15 to 1e+06 m/s²"),
        (("accelerometer", "bias_m_s2"), 2147483648, "from -10000 to 10000 m/s²"),
        (("camera", "scale_mm_per_px"), 1e-320, "must not be 0, its size from 1e-09 to 1e+09"),
        (("camera", "roi", 2), 2**40, "numbers up to 1000000 px"),
        (("camera", "lens", "matrix", 0), 1e308, "from -1e+07 to 1e+07 px"),
        (("radar", "carrier_hz"), 1.0, "from 1e+09 to 1e+12 Hz"),
        (("radar", "targets", 0, "snr_db"), 1e6, "from -300 to 300 dB"),
    ],
)
def test_values_of_a_calibration_out_of_range_are_named_with_rule_and_unit(
    tmp_path: Path, place: tuple[object, ...], value: object, rule: str
) -> None:
    (tmp_path / "c.json").write_text(json.dumps(changed(place, value)))
    key = next(key for key in reversed(place) if isinstance(key, str) and key not in ("matrix",))
    with pytest.raises(DataError) as caught:
        load_calibration(tmp_path / "c.json")
    assert rule in str(caught.value)
    assert key in str(caught.value)


@pytest.mark.parametrize("key", ["noise_std_mm", "time_offset_std_s"])
@pytest.mark.parametrize("value", [1e-9, 1e-6, 1e6])
def test_values_at_the_ends_of_their_range_give_a_result_or_a_refusal(
    tmp_path: Path, calibrated: Path, capsys: pytest.CaptureFixture[str], key: str, value: float
) -> None:
    tree = json.loads((calibrated / "calibration.json").read_text())
    tree["displacement"][key] = value
    (tmp_path / "c.json").write_text(json.dumps(tree))
    arguments = ["estimate", calibrated, "-c", tmp_path / "c.json", "-o", tmp_path / "o.csv", "-q"]
    assert run([str(argument) for argument in arguments]) in (0, 4), capsys.readouterr().err


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_sensors_without_noise_give_the_motion_itself(tmp_path: Path, noise: float) -> None:
    folder = write(tmp_path, noise_mm=noise, noise_m_s2=noise)
    assert run(["estimate", str(folder), "-o", str(tmp_path / "o.csv"), "-q"]) == 0
    found = np.genfromtxt(tmp_path / "o.csv", delimiter=",", names=True, usecols=(0, 1))
    # A cubic through samples 20 ms apart follows 0.7 Hz to 1e-6 of its 5 mm; the rest is rounding in the files.
    np.testing.assert_allclose(found["displacement_mm"], exact(found["time_s"])[0], atol=1e-3)


@pytest.mark.parametrize(
    ("content", "reported"),
    [
        (f"{DEEP * '['}{DEEP * ']'}", "at most 64 levels"),
        ('{"model": "pinhole", "model": "fisheye"}', "is there twice"),
        (
            '{"model": "pinhole", "matrix": [1e400, 8, 8, 8], "distortion": [0, 0, 0, 0], "size": [640, 480]}',
            "is no lens file",
        ),
        (
            '{"model": "pinhole", "matrix": [800, 800, 8, 8], "distortion": [0, 0, 0, 0], "size": [1e400, 480]}',
            "is no lens file",
        ),
    ],
)
def test_a_lens_file_of_nonsense_is_a_sentence(tmp_path: Path, content: str, reported: str) -> None:
    from midspan.sources.camera.lens import load_lens

    (tmp_path / "lens.json").write_text(content)
    with pytest.raises(DataError, match=r"lens\.json") as caught:
        load_lens(tmp_path / "lens.json")
    assert reported in str(caught.value)
