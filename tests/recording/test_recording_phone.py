"""A phone's log with the film of its own camera: its gyroscope and gravity take the phone's tilt off."""

import numpy as np
import pytest

import midspan
from midspan.cli.main import run
from midspan.errors import UntrustedError, UsageError
from midspan.recording.streams.recording import Recording
from midspan.settings.load import load_settings
from midspan.settings.two_files import Choices, draft, settings_of
from phone_logs import BEGUN_NS, folder_of, zip_of
from phone_walks import CAMERA, FOCAL_PX, RATE_HZ, Walk
from pinhole_tracks import MDEG, nothing, together, waves
from repeats import slow

# 10 mdeg of a clamp that nods and warms: 0.5 mm at 3 m.
TILT = together(waves(0.5, 4.0, 7.0 * MDEG, 3), waves(0.02, 0.08, 7.0 * MDEG, 4))


def walk(**changes):
    known = {"tilt": TILT, "duration_s": 30.0, "rate_hz": 15.0, "rms_m": 1e-3, "band_hz": (1.0, 3.0)}
    return Walk(**{**known, "mm_per_px": 3e3 / FOCAL_PX, **changes})


def recording_of(path, film=None, leave_out=(), **choices):
    found = draft(path, film, Choices(**choices))
    for section in leave_out:
        found.sections.pop(section)
    return Recording(*settings_of(found))


def error(case, result, up=True):
    """Error (mm, n) since the first frame, and 1.96 standard deviations; up: where a positive displacement goes."""
    true_mm = (1.0 if up else -1.0) * case.from_zero_mm(result.time_s - 1e-9 * BEGUN_NS)
    return result.displacement_mm - true_mm, 1.96 * result.displacement_std_mm


@pytest.mark.parametrize(
    ("held", "reversed_"),
    [("upright", False), ("top to the right", True), *slow(("top to the left", False), ("upside down", True))],
)
def test_the_phones_tilt_is_taken_off(tmp_path, held, reversed_):
    case = walk(held=held)
    path = zip_of(tmp_path / "walk.zip", case.files(tmp_path, reversed_))
    # What the target alone shows contradicts the accelerometer.
    with pytest.raises(UntrustedError):
        midspan.estimate(recording_of(path, leave_out=("gyroscope",)))
    result = midspan.estimate(path)
    off, allowed = error(case, result, up=(held in ("upright", "top to the left")) != reversed_)
    # Ignored, the tilt is 0.5 mm; gravity's own error of 2 mm/s² a sample over 4 s leaves 0.06 mm at 3 m.
    assert np.std(off) < 0.15
    assert np.mean(np.abs(off) < allowed) > 0.9
    known = result.calibration.helped_by("gyroscope")
    assert abs(known.focal_px - FOCAL_PX) < 3.0 * known.focal_std_px
    assert result.calibration.helped_by("gravity") is not None
    assert "part-left-out" not in [one.code for one in result.calibration.warnings]


def test_an_archive_is_the_recording_that_somebody_writes_by_hand(tmp_path):
    case = walk(held="top to the left")
    folder = folder_of(tmp_path / "walk", case.files(tmp_path))
    result = midspan.estimate(folder)
    (film,) = (folder / "Camera").iterdir()
    # The same readings turned into the camera's axes: of the phone's own ones x points up and y to the left.
    at = np.arange(round(case.duration_s * RATE_HZ)) / RATE_HZ
    force, rate = (one @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) for one in case.readings(at))
    lines = ["time,ax,ay,az,gx,gy,gz"]
    for time_s, row in zip(at, np.hstack((force @ CAMERA.T, rate @ CAMERA.T)), strict=True):
        lines.append(",".join((str(BEGUN_NS + round(1e9 * time_s)), *(f"{value:.9f}" for value in row))))
    (tmp_path / "box.csv").write_text("\n".join(lines))
    (tmp_path / "recording.toml").write_text(
        '[accelerometer]\nfile = "box.csv"\ntime = "time"\nvalue_y = "ay"\nvalue_z = "az"\nunit = "m/s^2"\n'
        f'[camera]\nfile = "walk/Camera/{film.name}"\nstart_s = {1e-9 * BEGUN_NS + case.first_s!r}\n'
        '[gyroscope]\nfile = "box.csv"\ntime = "time"\nvalue_x = "gx"\nvalue_y = "gy"\nvalue_z = "gz"\n'
        'unit = "rad/s"\n'
    )
    by_hand = midspan.estimate(tmp_path)
    # Positive is down there; minimisers stop at a millionth of their deviations.
    np.testing.assert_allclose(-by_hand.displacement_mm, result.displacement_mm, atol=1e-5)
    np.testing.assert_allclose(by_hand.displacement_std_mm, result.displacement_std_mm, rtol=1e-5)


@pytest.mark.parametrize("tilt", [nothing, *slow(waves(0.02, 0.08, 10.0 * MDEG, 4))])
def test_a_phone_that_hardly_nods_has_the_result_of_its_camera_alone(tmp_path, tilt):
    case = walk(tilt=tilt)
    path = zip_of(tmp_path / "walk.zip", case.files(tmp_path))
    result = midspan.estimate(path)
    alone = midspan.estimate(recording_of(path, leave_out=("gyroscope",)))
    np.testing.assert_allclose(result.displacement_mm, alone.displacement_mm, atol=1e-9)
    assert result.verdict == alone.verdict
    (said,) = set(result.calibration.warnings) - set(alone.calibration.warnings)
    assert said.code == "tilt"
    assert "rotates too little" in said


def test_the_gyroscope_of_another_box_is_not_taken(tmp_path):
    case = walk(tilt=nothing)
    folder = folder_of(tmp_path / "walk", case.files(tmp_path))
    (film,) = (folder / "Camera").iterdir()
    at = np.arange(100) / RATE_HZ
    accel = tmp_path / "accel.csv"
    np.savetxt(accel, np.column_stack((at, case.motion(at, 2))), delimiter=",", header="time_s,accel", comments="")
    # A phone on a tripod, of which the film alone is used; and an accelerometer's phone beside another camera.
    assert set(draft(accel, film, Choices(unit="m/s^2")).sections) == {"accelerometer", "camera"}
    other = film.rename(tmp_path / film.name)
    sections = draft(folder, other, Choices()).sections
    assert set(sections) == {"accelerometer", "camera"}
    assert sections["accelerometer"]["value"] == "y"
    other.rename(film)
    with pytest.raises(UsageError, match=f"or give its film alone: `midspan estimate {accel} {film}`"):
        draft(accel, folder, Choices())
    # An axis across the image's.
    assert set(draft(folder, None, Choices(value="x")).sections) == {"accelerometer", "camera"}


def test_init_and_inspect_name_the_gyroscope(tmp_path, capsys):
    case = walk(duration_s=4.0)
    path = zip_of(tmp_path / "walk.zip", case.of_phyphox(tmp_path))
    assert run(["init", str(path)]) == 0
    assert "Gyroscope.csv: the phone's own tilt." in capsys.readouterr().out
    found = load_settings(tmp_path)
    assert (found.accelerometer.value_y, found.accelerometer.value_z) == ("Y", "Z")
    assert found.gyroscope.file == "walk.zip/Gyroscope.csv"
    assert [getattr(found.gyroscope, f"value_{axis}") for axis in "xyz"] == ["X", "-Y", "-Z"]
    assert found.gyroscope.unit == "rad/s"
    assert run(["inspect", str(path)]) == 0
    assert "x (right) 'X', y (down) '-Y', z (view) '-Z'" in capsys.readouterr().out
    # Motion to the side: gravity tells nothing of a turn about the vertical.
    aside = draft(path, None, Choices(direction="x")).sections
    assert (aside["accelerometer"]["value"], aside["gyroscope"]["value_y"]) == ("X", "-Y")
    assert run(["inspect", str(tmp_path)]) == 0
    assert "channel" in capsys.readouterr().out


def test_a_method_as_printed_does_without_the_gyroscope(tmp_path, capsys):
    path = zip_of(tmp_path / "walk.zip", walk(tilt=nothing).files(tmp_path))
    assert run(["estimate", str(path), "--method", "adaptive-kalman", "--literal"]) == 0, capsys.readouterr().err
