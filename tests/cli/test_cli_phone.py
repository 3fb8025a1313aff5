"""A phone's own log, folder or zip, with a film in it or beside it: `inspect`, `init` and `estimate`."""

import gc
import json

import av
import numpy as np
import pytest

import midspan
from lively_recordings import Lively, write
from midspan.cli.main import run
from midspan.settings.load import load_settings
from phone_logs import BEGUN_NS, axes_of, folder_of, phyphox, sensor_logger, zip_of

LIVELY = Lively(duration_s=16.0, band_hz=(1.0, 3.0), rms_m=2e-3)
FILM = f"Camera/{BEGUN_NS // 1_000_000 + 1000}.mp4"


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """A film of 10 Hz that begins 1 s after the accelerometer, and what this reads."""
    folder = tmp_path_factory.mktemp("walk")
    recording = write(folder, LIVELY, "camera")
    film = np.load(recording / "camera.npy")
    with av.open(str(folder / "film.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"qp": "0"})
        stream.height, stream.width, stream.pix_fmt = *film.shape[1:], "gray"
        for picture in film:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="gray")))
        container.mux(stream.encode())
    time_s, value = np.loadtxt(folder / "accel.csv", delimiter=",", skiprows=1).T
    for name in ("recording.toml", "accel.csv", "camera.npy"):
        (folder / name).unlink()
    return folder, time_s, value


def refusal(arguments, capsys, code):
    capsys.readouterr()
    assert run([*map(str, arguments)]) == code
    text = capsys.readouterr().err.strip()
    assert "Traceback" not in text
    assert len(text.splitlines()) == 1, text
    return text


def check(output, begin_s=0.0, sign=1.0):
    """The result against the truth; begin_s: of the accelerometer's clock."""
    camera = json.loads(output.with_suffix(".json").read_text())["calibration"]["camera"]
    assert abs(sign * camera["scale_mm_per_px"] - LIVELY.mm_per_px) < 4.0 * camera["scale_std_mm_per_px"]
    rows = np.genfromtxt(output, delimiter=",", names=True, dtype=None, encoding="utf-8")
    expected = sign * LIVELY.from_zero_mm(rows["time_s"] - begin_s)
    assert np.mean(np.abs(rows["displacement_mm"] - expected) < 1.96 * rows["displacement_std_mm"]) > 0.85


def test_a_zip_with_its_film_is_a_result(walk, tmp_path, capsys, monkeypatch):
    folder, time_s, value = walk
    path = zip_of(tmp_path / "walk.zip", sensor_logger(time_s, axes_of(value)) | {FILM: folder / "film.mp4"})
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    assert run(["estimate", str(path)]) == 0
    text = capsys.readouterr().out
    assert "walk.zip (Sensor Logger): TotalAcceleration.csv, axis 'x': the vertical one by gravity (+9.8" in text
    assert "positive is up" in text
    check(tmp_path / "result.csv", BEGUN_NS * 1e-9)
    assert "temporary" not in (tmp_path / "result.json").read_text()
    # With its calibration, from Python.
    result = midspan.estimate(path)
    result.calibration.save(tmp_path / "calibration.json")
    again = midspan.estimate(path, tmp_path / "calibration.json")
    np.testing.assert_allclose(again.displacement_mm, result.displacement_mm, atol=0.05)
    assert run(["inspect", str(path)]) == 0
    text = capsys.readouterr().out
    for words in ("gyroscope", "Gyroscope.csv: x, y, z in rad/s, 1600 samples", "'x' (+9.8", "film: Camera/"):
        assert words in text
    # What refers to itself is let go of later.
    gc.collect()
    assert list((tmp_path / "temporary").iterdir()) == []


def test_what_init_writes_of_a_zip_is_read(walk, tmp_path, capsys):
    folder, time_s, value = walk
    # Of an iPhone: no gravity in the acceleration, and the sense of all axes turned round.
    files = sensor_logger(time_s, axes_of(value, "y", -1.0), linear=True, platform="ios")
    path = zip_of(tmp_path / "walk.zip", files | {FILM: folder / "film.mp4"})
    assert run(["init", str(path)]) == 0
    assert "axis 'y': the vertical one by gravity (-9.8" in (said := capsys.readouterr().out)
    assert "positive is down" in said
    found = load_settings(tmp_path)
    assert (found.accelerometer.file, found.accelerometer.value) == ("walk.zip/Accelerometer.csv", "y")
    assert found.cameras[0].start_s == pytest.approx(BEGUN_NS * 1e-9 + 1.0)
    assert run(["inspect", str(tmp_path)]) == 0
    assert "cannot be used" not in capsys.readouterr().out
    assert run(["estimate", str(tmp_path)]) == 0
    check(tmp_path / "result.csv", BEGUN_NS * 1e-9, -1.0)


def test_a_folder_with_a_film_beside_it_is_a_result(walk, tmp_path, capsys):
    folder, time_s, value = walk
    path = folder_of(tmp_path / "raw", phyphox(time_s, axes_of(value, "z"), ";", ",", pauses=1))
    output = tmp_path / "result.csv"
    assert run(["estimate", str(path), str(folder / "film.mp4"), "-o", str(output)]) == 0
    text = capsys.readouterr().out
    assert "raw (phyphox): Raw Data.csv, axis 'Acceleration z': the vertical one" in text
    assert "leaves out 1 pause, which" in text
    check(output)
    found = midspan.estimate(path, folder / "film.mp4", value="z")
    rows = np.genfromtxt(output, delimiter=",", names=True, dtype=None, encoding="utf-8")
    np.testing.assert_allclose(found.displacement_mm, rows["displacement_mm"], rtol=1e-7, atol=1e-9)


def test_the_axis_of_a_horizontal_motion(walk, tmp_path, capsys):
    folder, time_s, value = walk
    files = sensor_logger(time_s, axes_of(value)) | {FILM: folder / "film.mp4"}
    path = folder_of(tmp_path / "walk", files)
    assert run(["init", str(path), "--direction", "x"]) == 0
    assert "axis 'y': the horizontal one of the phone's picture" in capsys.readouterr().out
    assert load_settings(path).accelerometer.value == "y"
    flat = zip_of(tmp_path / "flat.zip", sensor_logger(time_s, axes_of(value, "z")) | {FILM: folder / "film.mp4"})
    assert "its camera looked up or down. Select" in refusal(["estimate", flat], capsys, 2)
    # A film of another camera does not show how the phone lay.
    other = zip_of(tmp_path / "walk.zip", sensor_logger(time_s, axes_of(value)))
    asked = ["estimate", other, folder / "film.mp4", "--direction", "x"]
    assert "Select the axis along the measured motion with --value: 'x', 'y', 'z'" in refusal(asked, capsys, 2)


def test_an_axis_that_is_given_wins(walk, tmp_path, capsys):
    folder, time_s, value = walk
    path = zip_of(tmp_path / "raw.zip", phyphox(time_s, axes_of(value)))
    files = [path, folder / "film.mp4"]
    assert run([*map(str, ("init", *files, "-o", tmp_path / "new", "--value", "Z", "--unit", "g"))]) == 0
    assert "'Acceleration z': as given by --value" in capsys.readouterr().out
    found = load_settings(tmp_path / "new").accelerometer
    assert (found.value, found.unit) == ("Acceleration z", "g")
    text = refusal(["estimate", *files, "--value", "Acceleration w"], capsys, 2)
    assert "Select one of 'Acceleration x'" in text


def test_a_table_in_a_zip_is_a_file(walk, tmp_path, capsys):
    folder, time_s, value = walk
    path = zip_of(tmp_path / "walk.zip", sensor_logger(time_s, axes_of(value))) / "TotalAcceleration.csv"
    assert run(["inspect", str(path)]) == 0
    assert "seconds_elapsed: 1600 samples" in capsys.readouterr().out
    files = [str(path), str(folder / "film.mp4")]
    assert run(["estimate", *files, "--value", "x", "--unit", "m/s^2"]) == 0
    check(tmp_path / "result.csv", BEGUN_NS * 1e-9)


def test_mistakes_with_archives_have_a_remedy(walk, tmp_path, capsys):
    folder, time_s, value = walk
    film, readings = folder / "film.mp4", axes_of(value)
    path = zip_of(tmp_path / "walk.zip", sensor_logger(time_s, readings))
    slanted = zip_of(
        tmp_path / "slanted.zip", {"Raw Data.csv": phyphox(time_s, readings - readings.mean(0))["Raw Data.csv"]}
    )
    gyroscope = zip_of(tmp_path / "g.zip", {"Gyroscope.csv": sensor_logger(time_s, readings)["Gyroscope.csv"]})
    two = zip_of(tmp_path / "two.zip", {"a.mp4": film, "b.mp4": film, **sensor_logger(time_s, readings)})
    outside = zip_of(tmp_path / "o.zip", {"../x.csv": "", **sensor_logger(time_s, readings)})
    cut = tmp_path / "cut.zip"
    cut.write_bytes(path.read_bytes()[:2000])
    for arguments, code, words in (
        ([path, path], 2, "are two archives of a phone. Give one, and the film after it."),
        ([film, path], 2, "Name the accelerometer's file first"),
        ([path], 2, "holds no film. Give the film after the archive: `midspan estimate"),
        ([two], 2, "holds 2 films: a.mp4, b.mp4. Give the film after the archive"),
        ([slanted, film], 2, "the log has no gravity, which shows the vertical axis. Select the axis"),
        ([gyroscope, film], 3, "export it as CSV"),
        ([outside, film], 3, "Export the archive again."),
        ([cut, film], 3, "Check that the file is whole."),
        ([path, tmp_path / "none.mp4"], 3, "none.mp4 does not exist"),
        ([path, film, "--displacement-unit", "mm"], 2, "Leave it out."),
        ([tmp_path / "none.zip", film], 3, "none.zip does not exist"),
    ):
        assert words in refusal(["estimate", *arguments], capsys, code)
    (tmp_path / "a.xls").write_bytes(b"\xd0\xcf\x11\xe0")
    assert "Save it as .xlsx or .csv." in refusal(["estimate", tmp_path / "a.xls", film], capsys, 2)
    assert "export it as CSV" in refusal(["inspect", gyroscope], capsys, 3)
    assert "--picture: needs" in capsys.readouterr().err or run(["inspect", str(path), "--picture", "a.png"]) == 2
    assert f"Make one with `midspan init {path} [VIDEO]`." in refusal(["calibrate", path], capsys, 3)
    # A recording whose file is not in the zip.
    (tmp_path / "recording.toml").write_text(f'[accelerometer]\nfile = "walk.zip/Acc.csv"\n[camera]\nfile = "{film}"\n')
    assert "walk.zip/Acc.csv" in refusal(["calibrate", tmp_path], capsys, 3)
