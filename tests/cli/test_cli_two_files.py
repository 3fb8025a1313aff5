"""From two files on a desk: `midspan init ACCEL FILE2` and `midspan estimate ACCEL FILE2`."""

import json
from dataclasses import replace

import av
import numpy as np
import pytest

import film_matrix
import midspan
from lively_recordings import Lively, write
from midspan.cli.main import run
from midspan.settings.camera import CameraSettings
from midspan.settings.load import load_settings
from repeats import slow

LIVELY = Lively(duration_s=24.0, band_hz=(1.0, 3.0), rms_m=2e-3)
GRAVITY_M_S2 = 9.80665


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A logger's file of three axes in g as a spreadsheet in German saves it, and a video without losses."""
    folder = tmp_path_factory.mktemp("desk")
    recording = write(folder, LIVELY, "camera")
    (recording / "recording.toml").unlink()
    film = np.load(recording / "camera.npy")
    with av.open(str(folder / "phone.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=10)
        stream.height, stream.width, stream.pix_fmt = *film.shape[1:], "gray"
        for picture in film:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="gray")))
        container.mux(stream.encode())
    time, value = np.loadtxt(recording / "accel.csv", delimiter=",", skiprows=1).T
    table(folder / "logger.csv", time, value)
    return folder


def table(path, time, value):
    rng = np.random.default_rng(0)
    across = rng.normal(0.0, 2e-4, (len(time), 2))
    lines = ["Zeit [s];Beschl X [g];Beschl Y [g];Beschl Z [g];Temp [°C]"]
    for at, (x, y), z in zip(time, across, 1.0 + value / GRAVITY_M_S2, strict=True):
        lines.append(f"{at:.4f};{x:.7f};{y:.7f};{z:.7f};21.3".replace(".", ","))
    path.write_text("\r\n".join(lines), encoding="latin-1")


def test_several_channels_are_named_with_their_unit(desk, capsys):
    assert run(["estimate", str(desk / "logger.csv"), str(desk / "phone.mkv")]) == 2
    text = capsys.readouterr().err
    assert "3 channels are possible: 'Beschl X', 'Beschl Y', 'Beschl Z' (all in g)" in text
    assert "--value 'Beschl Z'" in text


@pytest.mark.parametrize("apart_s", [7.0, *slow(0.0)])
def test_two_files_become_a_result_with_the_right_sign_and_scale(desk, tmp_path, capsys, apart_s):
    # The video's times begin at 0, its first frame is 1 s after the logger's first sample, which may begin later.
    logger = desk / "logger.csv"
    if apart_s:
        value = np.loadtxt(desk / "accel.csv", delimiter=",", skiprows=1)[:, 1]
        early = replace(LIVELY, first_s=0.0)
        more = np.arange(-apart_s, 0.0, 0.01)
        noise = np.random.default_rng(1).normal(0.0, LIVELY.noise_m_s2, len(more))
        value = np.concatenate((early.motion(more, 2) + LIVELY.bias_m_s2 + noise, value))
        logger = tmp_path / "early.csv"
        table(logger, 0.01 * np.arange(len(value)), value)
    output = tmp_path / "result.csv"
    assert run(["estimate", str(logger), str(desk / "phone.mkv"), "--value", "Beschl Z", "-o", str(output)]) == 0
    if apart_s:
        assert f"offset is +{apart_s + 1.0:.0f}" in capsys.readouterr().err
        assert "offset is +8" in json.loads(output.with_suffix(".json").read_text())["warnings"][0]
    camera = json.loads(output.with_suffix(".json").read_text())["calibration"]["camera"]
    # The logger's time is the video's plus the offset; the motion tells it to a fraction of a ms.
    assert camera["time_offset_s"] == pytest.approx(apart_s + 1.0, abs=2e-3)
    error = camera["scale_mm_per_px"] - LIVELY.mm_per_px
    assert abs(error) < 4.0 * camera["scale_std_mm_per_px"]
    rows = np.genfromtxt(output, delimiter=",", names=True, dtype=None, encoding="utf-8")
    expected = LIVELY.from_zero_mm(rows["time_s"] - apart_s)
    assert np.mean(np.abs(rows["displacement_mm"] - expected) < 1.96 * rows["displacement_std_mm"]) > 0.85


def test_two_files_from_python_give_what_the_command_gives(desk, tmp_path):
    files = desk / "logger.csv", desk / "phone.mkv"
    assert (
        run(["estimate", *map(str, files), "--value", "Beschl Z", "-o", str(tmp_path / "result.csv"), "--quiet"]) == 0
    )
    rows = np.genfromtxt(tmp_path / "result.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    found = midspan.estimate(*files, value="Beschl Z")
    # The file holds nine digits.
    np.testing.assert_allclose(found.displacement_mm, rows["displacement_mm"], rtol=1e-7, atol=1e-9)
    with pytest.raises(midspan.UsageError, match="3 channels are possible"):
        midspan.estimate(*map(str, files))
    with pytest.raises(midspan.UsageError, match="go with two files"):
        midspan.estimate(desk / "recording", value="Beschl Z")


def test_init_writes_a_recording_that_is_read(desk, tmp_path, capsys):
    assert run(["init", str(desk / "logger.csv"), str(desk / "phone.mkv"), "-o", str(tmp_path / "new")]) == 0
    found = load_settings(tmp_path / "new")
    assert found.accelerometer.value == "Beschl Z"
    assert found.accelerometer.unit == "g"
    assert (tmp_path / "new" / found.cameras[0].file).resolve() == desk / "phone.mkv"
    text = (tmp_path / "new" / "recording.toml").read_text()
    assert "or 'Beschl X', 'Beschl Y'" in text
    line = next(line for line in text.splitlines() if line.startswith("# exposure_s"))
    assert line.endswith(CameraSettings.model_fields["exposure_s"].description)
    assert run(["init", str(desk / "logger.csv"), str(desk / "phone.mkv"), "-o", str(tmp_path / "new")]) == 2
    assert "exists already" in capsys.readouterr().err


def test_init_leaves_open_what_the_files_do_not_say(desk, tmp_path, capsys):
    assert run(["init", str(desk / "accel.csv"), str(desk / "phone.mkv"), "-o", str(tmp_path)]) == 0
    assert "accelerometer.unit: not found in the files" in capsys.readouterr().out
    assert "# unit = " in (tmp_path / "recording.toml").read_text()
    assert run(["estimate", str(tmp_path)]) == 2
    assert "unit" in capsys.readouterr().err
    assert run(["estimate", str(desk / "accel.csv"), str(desk / "phone.mkv")]) == 2
    assert "Give --unit" in capsys.readouterr().err


def test_options_of_two_files_go_with_two_files(desk, capsys):
    assert run(["estimate", str(desk), "--unit", "g"]) == 2
    assert "--unit: needs two files" in capsys.readouterr().err
    assert run(["estimate", str(desk / "logger.csv"), str(desk / "phone.mkv"), "--point", "p"]) == 2
    assert "--point" in capsys.readouterr().err


def refusal(arguments, capsys, code=2):
    capsys.readouterr()
    assert run([*map(str, arguments)]) == code
    return capsys.readouterr().err


def test_a_refusal_of_two_files_says_where_their_keys_stand(desk, tmp_path, capsys):
    lines = (desk / "logger.csv").read_text(encoding="latin-1").splitlines()
    logger = tmp_path / "without time.csv"
    logger.write_text("\n".join(line.partition(";")[2] for line in lines), encoding="latin-1")
    text = refusal(["estimate", logger, desk / "phone.mkv", "--value", "Beschl Z"], capsys)
    assert "has no time" in text
    assert f"Set keys such as rate_hz in the recording.toml of `midspan init '{logger}' {desk / 'phone.mkv'}`." in text
    with pytest.raises(midspan.UsageError, match="of `midspan init"):
        midspan.estimate(logger, desk / "phone.mkv", value="Beschl Z")
    # An option of the command is no such key.
    assert "midspan init" not in refusal(["estimate", desk / "logger.csv", desk / "phone.mkv"], capsys)


def test_both_files_are_looked_for_before_a_channel_is_asked_for(desk, tmp_path, capsys):
    (tmp_path / "notes.mp4").write_text("no film")
    assert "film.mp4 does not exist" in refusal(["estimate", desk / "logger.csv", "film.mp4"], capsys, 3)
    assert "log.csv does not exist" in refusal(["estimate", "log.csv", "film.mp4"], capsys, 3)
    assert "notes.mp4" in refusal(["estimate", desk / "logger.csv", tmp_path / "notes.mp4"], capsys, 3)


def test_an_accelerometers_file_alone_is_led_to_two_files(desk, capsys):
    assert "put the video after it: `midspan estimate ACCEL" in refusal(["estimate", desk / "logger.csv"], capsys)


def test_an_option_that_is_a_key_is_led_to_the_recording(desk, capsys):
    text = refusal(["estimate", desk / "logger.csv", desk / "phone.mkv", "--roi", "1,2,3,4"], capsys)
    assert "No such option '--roi'. roi is a key of recording.toml ([camera], [infrared])" in text
    assert "`midspan help roi`" in text
    assert "--from" not in text
    assert "'--point'" in refusal(["estimate", desk / "logger.csv", "--pint", "1"], capsys)
    assert "is a key of" not in refusal(["export", "store", "--roi", "1"], capsys)


def test_halves_of_numbers_are_no_channels(desk, tmp_path, capsys):
    text = (desk / "logger.csv").read_text(encoding="latin-1")
    (tmp_path / "commas.csv").write_text(text.replace(";", ","), encoding="latin-1")
    for value in ([], ["--value", "column_8"]):
        said = refusal(["estimate", tmp_path / "commas.csv", desk / "phone.mkv", *value], capsys)
        assert "comma seems to separate both columns and decimals" in said
        assert "--value" not in said


@pytest.fixture(scope="module")
def portrait(desk):
    """The film of the desk as a phone held upright stores it: on its side, with or without the matrix that says so."""
    with av.open(str(desk / "phone.mkv")) as container:
        pictures = np.stack([frame.to_ndarray(format="gray") for frame in container.decode(video=0)])
    stored = film_matrix.stored_for(pictures, film_matrix.RIGHT)
    film_matrix.write(desk / "portrait.mp4", stored, matrix=film_matrix.RIGHT)
    film_matrix.write(desk / "sideways.mp4", stored)
    return desk


def camera_of(desk, film, tmp_path, *more):
    """What two files tell of the camera."""
    output = tmp_path / f"{film}.csv"
    files = [str(desk / "logger.csv"), str(desk / film), "--value", "Beschl Z"]
    assert run(["estimate", *files, *more, "-o", str(output)]) == 0
    return json.loads(output.with_suffix(".json").read_text())["calibration"]["camera"]


def test_a_portrait_film_gives_what_the_upright_one_gives(portrait, tmp_path, capsys):
    upright, turned = (camera_of(portrait, film, tmp_path) for film in ("phone.mkv", "portrait.mp4"))
    assert "[film-turned]" in capsys.readouterr().err
    # The same pixels at the same times, which mkv rounds to 1 ms and mp4 does not: far less than the deviation.
    assert abs(turned["scale_mm_per_px"] - upright["scale_mm_per_px"]) < 0.1 * upright["scale_std_mm_per_px"]


def test_a_direction_is_given_with_two_files(portrait, tmp_path, capsys):
    sideways = camera_of(portrait, "sideways.mp4", tmp_path, "--direction", "x")
    # Down in the upright picture is to the right in the stored one, which has to be turned right to be shown.
    assert sideways["direction"] == "x"
    assert abs(sideways["scale_mm_per_px"] - LIVELY.mm_per_px) < 4.0 * sideways["scale_std_mm_per_px"]
    files = [str(portrait / "logger.csv"), str(portrait / "sideways.mp4"), "--value", "Beschl Z"]
    assert run(["init", *files, "--direction", "x", "-o", str(tmp_path / "new")]) == 0
    assert load_settings(tmp_path / "new").cameras[0].direction == "x"
    capsys.readouterr()
    assert run(["estimate", *files]) == 4
    text = capsys.readouterr().err
    assert "check camera.direction (with two files: --direction)" in text
    # A figure that no camera has is none.
    assert "e+0" not in text
    assert run(["estimate", *files, "--direction", "z"]) == 2
    assert run(["estimate", str(tmp_path / "new"), "--direction", "x"]) == 2
    assert "--direction: needs two files" in capsys.readouterr().err


@pytest.fixture(scope="module")
def receiver(tmp_path_factory):
    """A logger's file and one of a GNSS receiver with its unit in the header and two columns that could be meant."""
    folder = tmp_path_factory.mktemp("receiver")
    case = replace(LIVELY, noise_m=0.2e-3)
    write(folder, case, "displacement")
    time, value = np.loadtxt(folder / "accel.csv", delimiter=",", skiprows=1).T
    table(folder / "logger.csv", time, value)
    height_m = case.met_m + np.random.default_rng(3).normal(0.0, case.noise_m, len(case.met_s))
    for name, heads, columns in (
        ("gnss.csv", "time_s,height [m],quality", (412.0 + height_m, 4.0 + 0.0 * height_m)),
        ("two.csv", "time_s,height_up,height_east", (1e3 * height_m, 0.0 * height_m)),
    ):
        np.savetxt(folder / name, np.column_stack((case.met_s, *columns)), "%.6f", ",", header=heads, comments="")
    (folder / "recording.toml").unlink()
    return folder


def test_a_table_is_a_displacement_sensor(receiver, tmp_path, capsys):
    files = [str(receiver / "logger.csv"), str(receiver / "gnss.csv"), "--value", "Beschl Z"]
    assert run(["estimate", *files, "-o", str(tmp_path / "r.csv")]) == 0
    rows = np.genfromtxt(tmp_path / "r.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    error = rows["displacement_mm"] - LIVELY.from_zero_mm(rows["time_s"])
    assert np.std(error) < 0.2
    found = midspan.estimate(*files[:2], value="Beschl Z")
    np.testing.assert_allclose(found.displacement_mm, rows["displacement_mm"], rtol=1e-7, atol=1e-9)
    assert run(["init", *files, "-o", str(tmp_path / "new")]) == 0
    (sensor,) = load_settings(tmp_path / "new").displacements
    assert (sensor.value, sensor.unit) == ("height", "m")
    assert "# receiver = " in (tmp_path / "new" / "recording.toml").read_text()
    capsys.readouterr()
    for more in (["--direction", "x"], ["--tracker", "template"]):
        assert run(["estimate", *files, *more]) == 2
        assert more[0] in capsys.readouterr().err


def test_a_column_and_a_unit_that_are_not_clear_are_asked_for(receiver, tmp_path, capsys):
    files = [str(receiver / "logger.csv"), str(receiver / "two.csv"), "--value", "Beschl Z"]
    assert run(["estimate", *files]) == 2
    assert "2 channels are possible: 'height_up', 'height_east'" in (said := capsys.readouterr().err)
    assert "--displacement-value 'height_east'" in said
    files += ["--displacement-value", "height_up"]
    assert run(["estimate", *files]) == 2
    assert "Give --displacement-unit" in capsys.readouterr().err
    assert run(["init", *files, "--displacement-unit", "mm", "-o", str(tmp_path)]) == 0
    assert load_settings(tmp_path).displacements[0].unit == "mm"


def test_frames_without_times_take_a_rate(desk, tmp_path, capsys):
    files = [str(desk / "logger.csv"), str(desk / "camera.npy"), "--value", "Beschl Z"]
    assert run(["estimate", *files]) == 2
    assert "camera.rate_hz is in neither file. Give --rate-hz (rate_hz)" in capsys.readouterr().err
    with pytest.raises(midspan.UsageError, match="rate_hz must be above zero"):
        midspan.estimate(*files[:2], value="Beschl Z", rate_hz=-1.0)
    assert run(["init", *files, "--rate-hz", "10", "-o", str(tmp_path / "new")]) == 0
    assert load_settings(tmp_path / "new").cameras[0].rate_hz == 10.0
    found = midspan.estimate(*files[:2], value="Beschl Z", rate_hz=10.0)
    assert abs(found.calibration.to_dict()["camera"]["scale_mm_per_px"] - LIVELY.mm_per_px) < 0.1


def test_a_part_of_a_channels_name_suggests_it(desk, capsys):
    assert run(["estimate", str(desk / "logger.csv"), str(desk / "phone.mkv"), "--value", "Z"]) == 2
    assert "Did you mean 'Beschl Z'?" in capsys.readouterr().err


def test_times_that_are_words_are_named(desk, tmp_path, capsys):
    rows = (desk / "logger.csv").read_text(encoding="latin-1").splitlines()
    words = [f"row {k};{row.split(';', 1)[1]}" for k, row in enumerate(rows[1:])]
    (tmp_path / "a.csv").write_text("\n".join([rows[0], *words]), encoding="latin-1")
    assert run(["estimate", str(tmp_path / "a.csv"), str(desk / "phone.mkv"), "--value", "Beschl Z"]) == 2
    assert "'Zeit' left out: it holds words" in capsys.readouterr().err


def test_the_result_of_another_film_is_kept_and_the_report_names_the_files(desk, tmp_path, capsys):
    for name in ("logger.csv", "phone.mkv"):
        (tmp_path / name).write_bytes((desk / name).read_bytes())
    (tmp_path / "other.mkv").write_bytes((desk / "phone.mkv").read_bytes())
    report = tmp_path / "report.html"
    for film, written in (("phone.mkv", "result.csv"), ("phone.mkv", "result.csv"), ("other.mkv", "other.csv")):
        files = [str(tmp_path / "logger.csv"), str(tmp_path / film)]
        assert run(["estimate", *files, "--value", "Beschl Z", "--report", str(report)]) == 0
        assert str(tmp_path / written) in capsys.readouterr().out
    assert "<h1>logger.csv and other.mkv</h1>" in report.read_text()
