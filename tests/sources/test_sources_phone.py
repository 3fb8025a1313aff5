"""What is found in a phone's log: which tables count, their units and times, and which axis is vertical."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import phone_logs
from midspan.errors import DataError
from midspan.sources import zipped
from midspan.sources.accelerometer.formats import list_channels
from midspan.sources.accelerometer.phone import is_phone_log, open_phone_log
from midspan.sources.accelerometer.select import SeriesRequest, read_series
from phone_logs import BEGUN_NS, GRAVITY_M_S2, axes_of, folder_of, phyphox, phyphox_sensors, sensor_logger, zip_of
from phone_walks import CAMERA, HELD

TIME_S = 0.01 * np.arange(400)
VALUE = 0.05 * np.sin(2.0 * np.pi * 2.0 * TIME_S)
READINGS = axes_of(VALUE)


@pytest.fixture(params=["folder", "zip", "zip of a folder"])
def kept(request, tmp_path):
    """How the files of an app are kept: a function of these files."""
    if request.param == "folder":
        return lambda files: folder_of(tmp_path / "walk", files)
    before = "walk-1/" if request.param == "zip of a folder" else ""
    return lambda files: zip_of(tmp_path / "walk.zip", {f"{before}{name}": one for name, one in files.items()})


def test_the_tables_of_sensor_logger_are_found_by_their_names(kept):
    path = kept(sensor_logger(TIME_S, READINGS) | {"__MACOSX/._Gravity.csv": b"\0\1", "Camera/1.mp4": b"film"})
    assert is_phone_log(path)
    log = open_phone_log(path)
    assert (log.app, log.acceleration.path.name, log.acceleration.unit) == (
        "Sensor Logger",
        "TotalAcceleration.csv",
        "m/s^2",
    )
    # The file has z first.
    assert log.acceleration.columns == ("x", "y", "z")
    np.testing.assert_allclose(log.acceleration.channels[1].values, READINGS[:, 0], atol=1e-8)
    np.testing.assert_array_equal(log.acceleration.time_ns, BEGUN_NS + np.rint(1e9 * TIME_S).astype(np.int64))
    assert (log.gyroscope.path.name, log.gyroscope.unit, log.gyroscope.time) == ("Gyroscope.csv", "rad/s", "time")
    np.testing.assert_allclose(list_channels(log.gyroscope.path).channels[4].values, 1e-3 * READINGS[:, 0], atol=1e-8)
    assert [film.name for film in log.films] == ["1.mp4"]
    assert log.vertical.axis == 0
    assert log.vertical.gravity_m_s2 == pytest.approx(GRAVITY_M_S2, abs=1e-3)


@pytest.mark.parametrize(("delimiter", "decimal"), [(",", "."), (";", ","), ("\t", ","), (";", ".")])
def test_the_tables_of_phyphox_are_found_by_their_units(kept, delimiter, decimal):
    log = open_phone_log(kept(phyphox(TIME_S, READINGS, delimiter, decimal)))
    assert (log.app, log.acceleration.time, log.acceleration.unit) == ("phyphox", "Time", "m/s^2")
    assert log.acceleration.columns == tuple(f"Acceleration {axis}" for axis in "xyz")
    np.testing.assert_allclose(log.acceleration.channels[1].values, READINGS[:, 0], rtol=1e-9)
    assert (log.gyroscope, log.gravity, log.films, log.pauses) == (None, None, (), 0)


def test_phyphox_files_that_are_called_as_those_of_the_other_app(kept):
    log = open_phone_log(kept(phyphox_sensors(TIME_S, READINGS)))
    assert (log.app, log.acceleration.path.name, log.gyroscope.path.name) == (
        "phyphox",
        "Accelerometer.csv",
        "Gyroscope.csv",
    )
    assert (log.acceleration.unit, log.gyroscope.unit) == ("m/s^2", "rad/s")


def test_pauses_are_counted(kept):
    assert open_phone_log(kept(phyphox(TIME_S, READINGS, pauses=2))).pauses == 2


def test_gravity_shows_the_vertical_axis_of_an_acceleration_without_it(kept):
    # An iPhone reads -g along an axis that points up.
    log = open_phone_log(kept(sensor_logger(TIME_S, axes_of(VALUE, "y", -1.0), linear=True, platform="ios")))
    assert log.acceleration.path.name == "Accelerometer.csv"
    assert (log.vertical.axis, log.vertical.gravity_m_s2 < 0.0) == (1, True)
    assert np.abs(log.acceleration.mean).max() < 1e-6


def test_raw_readings_in_g_are_known_by_gravity(tmp_path):
    table = phone_logs.sensor_table(TIME_S, READINGS / GRAVITY_M_S2)
    log = open_phone_log(folder_of(tmp_path, {"AccelerometerUncalibrated.csv": table}))
    assert (log.acceleration.unit, log.vertical.axis) == ("g", 0)
    assert log.vertical.gravity_m_s2 == pytest.approx(GRAVITY_M_S2, abs=1e-3)


def test_an_empty_table_gives_way_to_the_next_one(tmp_path):
    files = sensor_logger(TIME_S, READINGS)
    files |= {"TotalAcceleration.csv": "time,seconds_elapsed,z,y,x\n", "Gyroscope.csv": ""}
    log = open_phone_log(folder_of(tmp_path, files))
    assert (log.acceleration.path.name, log.gyroscope) == ("Accelerometer.csv", None)
    assert log.vertical.axis == 0


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"Accelerometer.csv": "time,seconds_elapsed,z,y,x\n"}, "Accelerometer.csv has no data rows"),
        ({"Accelerometer.csv": ""}, "Accelerometer.csv is empty"),
        (
            {"Gyroscope.csv": phone_logs.sensor_table(TIME_S, READINGS)},
            "of its tables (Gyroscope.csv) none has x, y and",
        ),
        ({"walk.xls": b"\xd0\xcf\x11\xe0"}, "walk.xls is a workbook"),
        ({"notes.txt": "x"}, "it has no table"),
        (
            {f"{k}/Accelerometer.csv": phone_logs.sensor_table(TIME_S, READINGS) for k in "ab"},
            "holds 2 recordings, in a, b",
        ),
    ],
)
def test_a_log_without_acceleration_is_refused_with_a_remedy(tmp_path, files, words):
    with pytest.raises(DataError) as refused:
        open_phone_log(zip_of(tmp_path / "walk.zip", files))
    assert words in str(refused.value)
    assert "export it as CSV." in str(refused.value) or "give one of these folders" in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "name", ["../Accelerometer.csv", "/etc/Accelerometer.csv", "C:\\Accelerometer.csv", "a\\..\\..\\b"]
)
def test_a_name_that_leads_out_of_a_zip_is_refused(tmp_path, name):
    files = sensor_logger(TIME_S, READINGS) | {name: "x"}
    with pytest.raises(DataError, match="leads out of it"):
        open_phone_log(zip_of(tmp_path / "walk.zip", files))


def test_a_damaged_zip_is_refused(tmp_path):
    path = zip_of(tmp_path / "walk.zip", sensor_logger(TIME_S, READINGS))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DataError, match="cannot be read as a zip archive"):
        open_phone_log(path)
    # Bytes in the middle of a table: its checksum is wrong.
    path.write_bytes(whole[:3000] + bytes(40) + whole[3040:])
    with pytest.raises(DataError, match=r"walk\.zip"):
        list_channels(path / "Accelerometer.csv")


def test_a_file_that_swells_is_not_unpacked(tmp_path, monkeypatch):
    path = zip_of(tmp_path / "walk.zip", {"Accelerometer.csv": bytes(80 << 20)})
    with pytest.raises(DataError, match=r"walk\.zip/Accelerometer\.csv grows from .* Unpack the archive"):
        list_channels(path / "Accelerometer.csv")
    monkeypatch.setattr(zipped, "MAX_MEMBERS", 1)
    with pytest.raises(DataError, match="has 2 files, 1 at most"):
        open_phone_log(zip_of(tmp_path / "many.zip", {"a.csv": "", "b.csv": ""}))


def test_nothing_stays_of_what_was_unpacked(tmp_path, monkeypatch):
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    path = zip_of(tmp_path / "walk.zip", sensor_logger(TIME_S, READINGS))
    assert open_phone_log(path).acceleration.channels[1].size == 400
    with pytest.raises(DataError, match=r"has no file 'b\.csv'"):
        list_channels(path / "b.csv")
    assert list((tmp_path / "temporary").iterdir()) == []


def test_other_folders_are_no_logs(tmp_path):
    assert not is_phone_log(folder_of(tmp_path / "a", {"accel.csv": "t,a\n0,1\n", "film.mp4": b""}))
    assert not is_phone_log(folder_of(tmp_path / "b", {"recording.toml": "", "Accelerometer.csv": ""}))
    assert not is_phone_log(tmp_path / "none.zip")
    assert not is_phone_log("a\0b")
    assert not is_phone_log(None)


@pytest.mark.parametrize("reversed_", [False, True])
@pytest.mark.parametrize("held", HELD)
def test_the_axes_of_the_camera_are_those_of_the_phone_turned(tmp_path, held, reversed_):
    # A rotation about any axis of the world, in the axes of the phone and of its camera.
    rate = np.random.default_rng(1).normal(0.0, 1.0, (len(TIME_S), 3))
    of_phone = Rotation.from_euler("z", HELD[held], degrees=True).inv()
    force = of_phone.apply(np.tile([0.1, GRAVITY_M_S2, -0.2], (len(TIME_S), 1)))
    platform = "ios,false" if reversed_ else "ios,true"
    files = {
        "Metadata.csv": f"version,platform,standardisation\n3,{platform}\n",
        "TotalAcceleration.csv": phone_logs.sensor_table(TIME_S, -force if reversed_ else force),
        "Gyroscope.csv": phone_logs.sensor_table(TIME_S, of_phone.apply(rate)),
    }
    log = open_phone_log(folder_of(tmp_path, files))
    assert (log.reversed, log.vertical.up) == (reversed_, held in ("upright", "top to the left"))
    for axis, wanted in zip(log.camera_axes, (rate @ CAMERA.T).T, strict=True):
        found = read_series(
            log.gyroscope.path,
            SeriesRequest("rotation rate", log.gyroscope.time, log.gyroscope.along(axis), log.gyroscope.unit),
        )
        # The table has nine digits after the point.
        np.testing.assert_allclose(found.value, wanted, atol=1e-8)


def test_a_phone_that_lies_flat_or_askew_shows_no_axes_of_its_picture(tmp_path):
    flat = open_phone_log(folder_of(tmp_path / "flat", sensor_logger(TIME_S, axes_of(VALUE, "z"))))
    askew = READINGS @ Rotation.from_euler("zx", [45.0, 40.0], degrees=True).as_matrix().T
    assert flat.camera_axes is None
    assert open_phone_log(folder_of(tmp_path / "askew", sensor_logger(TIME_S, askew))).camera_axes is None
