"""recording.toml: every key of the public face is taken, everything else is refused with a message that helps."""

import pytest

from midspan.errors import DataError, UsageError
from midspan.settings.load import load_settings, settings_file, validate

ACCELEROMETER = {"file": "accel.csv", "time": "time_s", "value": "accel", "unit": "m/s^2"}
CAMERA = {"file": "camera.mkv"}

# The keys as users have them in their files, section by section, with a value for each.
KEYS = {
    "accelerometer": {
        "file": "accel.csv",
        "time": "time_s",
        "value": "accel",
        "unit": "V",
        "sensitivity": 0.051,
        "rate_hz": 100.0,
        "start_s": 0.5,
        "noise_std": 0.005,
    },
    "camera": {
        "file": "camera.mkv",
        "times": "camera_times.csv",
        "rate_hz": 29.97,
        "start_s": 1_700_000_000.25,
        "every": 3,
        "roi": [820, 340, 128, 128],
        "direction": "x",
        "exposure_s": 0.008,
        "readout_s": 0.01,
        "tracker": "template",
    },
    "displacement": {"file": "gnss.csv", "time": "time_s", "value": "height", "unit": "mm", "noise_std": 1.5},
    "calibration": {"window_s": [0.0, 50.0], "band_hz": [0.3, 3.0], "max_offset_s": 0.5},
    "fusion": {"method": "smoother", "lag_s": 0.5},
    "reference": {"file": "laser.csv", "time": "time_s", "value": "displacement_mm", "unit": "mm"},
}


def tree_with(**sections):
    return {"accelerometer": ACCELEROMETER, "camera": CAMERA} | sections


def message_of(tree):
    with pytest.raises(UsageError) as caught:
        validate(tree, "site/recording.toml")
    return str(caught.value)


def test_all_keys_together_are_accepted_and_kept():
    settings = validate({"name": "footbridge, quarter span", **KEYS}, "recording.toml")
    assert settings.name == "footbridge, quarter span"
    for section, keys in KEYS.items():
        for key, value in keys.items():
            kept = getattr(getattr(settings, section), key)
            assert kept == (tuple(value) if isinstance(value, list) else value), f"{section}.{key}"


def test_what_is_left_out_has_the_documented_default():
    settings = validate(tree_with(), "recording.toml")
    assert (settings.camera.every, settings.camera.direction, settings.camera.readout_s) == (1, "y", 0.0)
    assert settings.camera.roi is None
    assert settings.calibration.max_offset_s == 0.5
    assert settings.calibration.window_s is None
    assert (settings.fusion.method, settings.fusion.lag_s) == ("smoother", 0.5)


def test_a_displacement_sensor_needs_no_camera():
    settings = validate({"accelerometer": ACCELEROMETER, "displacement": KEYS["displacement"]}, "recording.toml")
    assert settings.camera is None


@pytest.mark.parametrize(
    ("tree", "words"),
    [
        (tree_with(camera=CAMERA | {"rio": [0, 0, 9, 9]}), ["camera.rio", "'roi'"]),
        (tree_with(accelerometer=ACCELEROMETER | {"senstivity": 1.0}), ["accelerometer.senstivity", "'sensitivity'"]),
        (tree_with(calibration={"window": [0, 1]}), ["calibration.window", "'window_s'"]),
        (tree_with(fusion={"metod": "kalman"}), ["fusion.metod", "'method'"]),
        (tree_with(calibraton={"max_offset_s": 1.0}), ["calibraton", "section", "'calibration'"]),
        (tree_with(nmae="x"), ["nmae", "'name'"]),
    ],
)
def test_an_unknown_key_or_section_names_the_nearest_known_one(tree, words):
    message = message_of(tree)
    for word in ["site/recording.toml", *words]:
        assert word in message


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("camera", "rate_hz", "ten"),
        ("camera", "rate_hz", 0),
        ("camera", "rate_hz", float("nan")),
        ("camera", "start_s", float("inf")),
        ("camera", "every", 0),
        ("camera", "every", 2.5),
        ("camera", "roi", [1, 2, 3]),
        ("camera", "roi", [1, 2, 30, 30, 5]),
        ("camera", "roi", [1.5, 2, 30, 30]),
        ("camera", "roi", [-1, 2, 30, 30]),
        ("camera", "roi", [1, 2, 0, 30]),
        ("camera", "direction", "z"),
        ("camera", "exposure_s", -0.001),
        ("camera", "readout_s", -0.001),
        ("camera", "tracker", "nonsense"),
        ("accelerometer", "sensitivity", -1.0),
        ("accelerometer", "noise_std", -0.1),
        ("accelerometer", "noise_std", 0.0),
        ("accelerometer", "file", ""),
        ("calibration", "window_s", [20.0, 10.0]),
        ("calibration", "window_s", [20.0]),
        ("calibration", "band_hz", [3.0, 1.0]),
        ("calibration", "band_hz", [-1.0, 1.0]),
        ("calibration", "max_offset_s", -0.5),
        ("fusion", "method", "smother"),
        ("fusion", "lag_s", 0.0),
        ("fusion", "transition_hz", [1.0, 0.5]),
        ("fusion", "transition_hz", [0.0, 1.0]),
        ("fusion", "taps", 500),
        ("fusion", "anti_alias_taps", 3),
        ("fusion", "anti_alias_taps", 2001),
        ("fusion", "spline_frames", 5),
    ],
)
def test_a_value_outside_its_rule_is_refused_with_file_key_and_value(section, key, value):
    base = {"accelerometer": ACCELEROMETER, "camera": CAMERA}.get(section, {})
    message = message_of(tree_with(**{section: base | {key: value}}))
    assert "site/recording.toml" in message
    assert f"{section}.{key}" in message
    # The value received, or the part of it that breaks the rule.
    parts = value if isinstance(value, list) else [value]
    assert any(repr(part) in message for part in parts)


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("accelerometer", "noise_std", True),
        ("camera", "every", True),
        ("camera", "rate_hz", "10"),
        ("camera", "every", "3"),
        ("camera", "file", 3),
    ],
)
def test_a_value_of_another_type_is_refused_not_converted(section, key, value):
    base = {"accelerometer": ACCELEROMETER, "camera": CAMERA}[section]
    assert f"{section}.{key}" in message_of(tree_with(**{section: base | {key: value}}))


def test_whole_numbers_are_taken_where_a_number_is_asked_for():
    settings = validate(tree_with(camera=CAMERA | {"rate_hz": 30}, calibration={"window_s": [0, 50]}), "recording.toml")
    assert settings.camera.rate_hz == 30.0
    assert settings.calibration.window_s == (0.0, 50.0)


def test_no_message_shows_the_words_of_the_validation_library():
    trees = [
        tree_with(camera=3),
        tree_with(camera=[3]),
        tree_with(camera=[]),
        tree_with(accelerometer=ACCELEROMETER | {"unit": ""}),
        tree_with(calibration={"window_s": [20, 10]}),
        tree_with(camera=CAMERA | {"roi": [1, 2]}),
        {},
    ]
    for tree in trees:
        message = message_of(tree)
        for word in ("Settings", "dictionary", "instance", "Value error", "Input", "pydantic", "String should"):
            assert word not in message, message


def test_several_mistakes_are_reported_at_once():
    message = message_of(tree_with(camera=CAMERA | {"every": 0, "direction": "z"}, fusion={"method": "x"}))
    assert "camera.every" in message
    assert "camera.direction" in message
    assert "fusion.method" in message


def test_a_recording_is_a_folder_or_its_file(tmp_path):
    file = tmp_path / "recording.toml"
    file.write_text('[accelerometer]\nfile = "a.csv"\n[camera]\nfile = "c.mkv"\n', encoding="utf-8")
    assert settings_file(tmp_path) == settings_file(file) == file
    assert load_settings(tmp_path) == load_settings(file)
    with pytest.raises(DataError, match="nowhere"):
        settings_file(tmp_path / "nowhere")


def test_the_updating_rule_takes_its_settings_by_name():
    rule = {"literal": True, "threshold_frames": 20, "average_frames": 5}
    camera = CAMERA | {"reference": "updating", "reference_settings": rule}
    assert validate(tree_with(camera=camera), "recording.toml").camera.reference_settings == rule
    for wrong, words in (
        (camera | {"reference": "first"}, 'reference = "updating"'),
        (camera | {"reference_settings": {"treshold_frames": 20}}, "threshold_frames"),
        (camera | {"reference_settings": {"tracker": "template"}}, "tracker"),
        (camera | {"reference_settings": {"threshold_frames": 1}}, "2 and 1 or more"),
        (camera | {"reference_settings": {"literal": 1}}, "true or false"),
    ):
        assert words in message_of(tree_with(camera=wrong))


def test_overrides_win_over_the_file(tmp_path):
    text = '[accelerometer]\nfile = "a.csv"\n[camera]\nfile = "c.mkv"\nevery = 2\n[fusion]\nmethod = "smoother"\n'
    (tmp_path / "recording.toml").write_text(text, encoding="utf-8")
    settings = load_settings(tmp_path, {"camera": {"every": 5}, "fusion": {"method": "kalman"}})
    assert settings.camera.every == 5
    assert settings.fusion.method == "kalman"
    assert settings.camera.file == "c.mkv"


@pytest.mark.parametrize(
    ("section", "keys"),
    [
        ("radar", {"nonsense": 3}),
        ("site", {"latitude_deg": 48.0}),
        ("infrared", {"tracker": "template"}),
        ("name", {"first": "footbridge"}),
    ],
)
def test_an_override_of_a_section_that_the_file_lacks_is_refused_and_names_it(section, keys, tmp_path):
    (tmp_path / "recording.toml").write_text('[accelerometer]\nfile = "a.csv"\n[camera]\nfile = "c.mkv"\n')
    with pytest.raises(UsageError, match=section):
        load_settings(tmp_path, {section: keys})


def test_sections_that_need_not_be_written_may_be_overridden(tmp_path):
    (tmp_path / "recording.toml").write_text('[accelerometer]\nfile = "a.csv"\n[camera]\nfile = "c.mkv"\n')
    assert load_settings(tmp_path, {"calibration": {"max_offset_s": 0.2}}).calibration.max_offset_s == 0.2


@pytest.mark.parametrize("content", [b"[accelerometer\n", b"unit = m/s^2\n", b'name = "\xe4"\n'])
def test_a_file_that_is_no_toml_is_named(content, tmp_path):
    (tmp_path / "recording.toml").write_bytes(content)
    with pytest.raises(UsageError, match=r"recording\.toml"):
        load_settings(tmp_path)


def test_both_axes_are_accepted_with_one_or_two_columns_and_the_main_axis_is_the_first_fused_one():
    both = {"file": "camera.mkv", "direction": "xy"}
    columns = {"file": "accel.csv", "value_x": "ax", "value_y": "ay"}
    assert validate({"accelerometer": columns, "camera": both}, "r").axes == ("y", "x")
    assert validate({"accelerometer": {"file": "a.csv", "value_x": "ax"}, "camera": both}, "r").axes == ("x", "y")
    assert validate({"accelerometer": {"file": "a.csv", "value_y": "ay"}, "camera": both}, "r").axes == ("y", "x")
    assert validate(tree_with(), "r").axes == ("y",)


def test_columns_of_axes_and_direction_must_fit_each_other():
    both = {"file": "camera.mkv", "direction": "xy"}
    assert "accelerometer.value_x" in message_of(tree_with(camera=both))
    named = {"file": "accel.csv", "value_x": "ax"}
    text = message_of({"accelerometer": named, "camera": CAMERA})
    assert "accelerometer.value_y" in text
    assert "Add it, or correct camera.direction" in text
    assert "not both" in message_of({"accelerometer": {**named, "value": "az"}, "camera": both})


THREE = {"file": "accel.csv", "value_x": "ax", "value_y": "ay", "value_z": "az"}


def test_three_axes_go_with_any_direction_and_the_axis_names_the_main_columns():
    def found(sensor, direction, **more):
        settings = validate({"accelerometer": sensor, "camera": {**CAMERA, "direction": direction}, **more}, "r")
        return settings.axes, settings.acceleration_column

    assert found(THREE, "y") == (("y",), "ay")
    assert found(THREE, "x") == (("x",), "ax")
    assert found({**THREE, "axis": "y"}, "y") == (("y",), "ay")
    assert found(THREE, "xy") == (("y", "x"), "ay")
    assert found({**THREE, "axis": "x"}, "xy") == (("x", "y"), "ax")
    without_camera = {"accelerometer": {**THREE, "axis": "z"}, "radar": {"file": "r.npy"}}
    assert validate(without_camera, "r").acceleration_column == "az"
    one = {"accelerometer": {"file": "accel.csv", "value_z": "az"}, "radar": {"file": "r.npy"}}
    assert validate(one, "r").acceleration_column == "az"


@pytest.mark.parametrize(
    ("sensor", "camera", "words"),
    [
        ({**THREE, "axis": "w"}, "y", ("accelerometer.axis = 'w'", "'x', 'y' or 'z'")),
        (
            {**THREE, "axis": "x"},
            "y",
            ('accelerometer.axis = "x"', 'camera.direction = "y"', 'use camera.direction = "x"'),
        ),
        ({**THREE, "axis": "z"}, "xy", ('accelerometer.axis = "z"', "Remove axis")),
        ({"file": "a.csv", "value_y": "ay", "axis": "x"}, "xy", ("must have value_x", "axis = 'x'")),
        ({"file": "a.csv", "value": "ay", "axis": "y"}, "y", ("must have value_y",)),
        ({"file": "a.csv", "value_x": "ax", "value_z": "az"}, "y", ("must have accelerometer.value_y", "Add it")),
        ({"file": "a.csv", "value": "a", "value_z": "az"}, "y", ("not both",)),
        ({**THREE, "value_z": "ax"}, "y", ("value_x, value_y and value_z that differ",)),
        (THREE, None, ("must have accelerometer.axis", "accelerometer.value_x")),
    ],
)
def test_an_axis_that_does_not_fit_is_refused_with_what_to_do(sensor, camera, words):
    other = {"radar": {"file": "r.npy"}} if camera is None else {"camera": {**CAMERA, "direction": camera}}
    text = message_of({"accelerometer": sensor, **other})
    assert "\n" not in text
    for word in words:
        assert word in text


def test_several_targets_are_accepted_and_numbered_where_they_have_no_name():
    camera = {"file": "c.mkv", "target": [{"roi": [0, 0, 64, 64], "name": "sign"}, {"roi": [80, 0, 64, 64]}]}
    assert validate(tree_with(camera=camera), "r").camera.target_names == ("sign", "2")


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"roi": [0, 0, 64, 64], "target": [{"roi": [0, 0, 64, 64]}]}, ("roi", "[[camera.target]]", "not both")),
        ({"roi": [0, 0, 64, 64], "automatic_targets": 2}, ("automatic_targets",)),
        ({"automatic_targets": 7}, ("camera.automatic_targets", "7")),
        ({"target": [{"roi": [0, 0, 64, 64]}, {"roi": [0, 0, 64, 64]}]}, ("its own roi",)),
        (
            {"target": [{"roi": [0, 0, 9, 9], "name": "a"}, {"roi": [1, 0, 9, 9], "name": "a"}]},
            ("its own name", "a, a"),
        ),
        ({"target": [{"name": "a"}]}, ("camera.target[1].roi", "missing")),
        ({"target": [{"roi": [0, 0, 64]}]}, ("camera.target[1].roi", "4 numbers")),
        ({"target": [{"roi": [0, 0, 64, 64], "nam": "a"}]}, ("camera.target[1].nam", "'name'")),
        ({"target": [{"roi": [0, 0, 64, 64], "name": "a b"}]}, ("camera.target[1].name", "'a b'", "letters")),
        ({"target": {"roi": [0, 0, 64, 64]}}, ("camera.target", "[[camera.target]]")),
    ],
)
def test_wrong_targets_are_refused_by_their_number(keys, words):
    text = message_of(tree_with(camera={**CAMERA, **keys}))
    for word in words:
        assert word in text


def test_settings_of_the_tracker_are_checked_by_its_own_rules():
    camera = {**CAMERA, "tracker": "features", "tracker_settings": {"technique": "existing", "ratio": 0.7}}
    tree = {"accelerometer": ACCELEROMETER, "camera": camera}
    assert validate(tree, "file").camera.tracker_settings == {"technique": "existing", "ratio": 0.7}


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"rato": 0.7}, "Did you mean 'ratio'"),
        ({"ratio": "0.7"}, "a number"),
        ({"ratio": 7}, "above 0, up to 1"),
        ({"upright": 1}, "true or false"),
        ({"max_features": 30.5}, "a whole number"),
        ({"technique": "new"}, "proposed"),
    ],
)
def test_wrong_settings_of_the_tracker_are_refused(keys, words):
    tree = {"accelerometer": ACCELEROMETER, "camera": {**CAMERA, "tracker": "features", "tracker_settings": keys}}
    with pytest.raises(UsageError, match=words):
        validate(tree, "file")


def test_another_tracker_on_the_command_line_leaves_the_settings_of_the_files_tracker(tmp_path):
    (tmp_path / "recording.toml").write_text(
        '[accelerometer]\nfile = "a.csv"\n[camera]\nfile = "c.mkv"\ntracker = "features"\n'
        'tracker_settings = { technique = "existing" }\n'
    )
    assert load_settings(tmp_path, {"camera": {"tracker": "features"}}).camera.tracker_settings
    assert not load_settings(tmp_path, {"camera": {"tracker": "template"}}).camera.tracker_settings


TWO = [{"name": "left", "file": "l.mkv"}, {"name": "right", "file": "r.mkv", "roi": [0, 0, 64, 64]}]


def test_several_sensors_of_a_kind_are_kept_in_order_with_their_names():
    tree = tree_with(
        camera=TWO,
        displacement=[{"name": "gnss", "file": "g.csv"}, {"name": "level-1", "file": "n.csv"}],
        radar={"file": "r.npy"},
        infrared=[{"file": "i.npz"}],
    )
    settings = validate(tree, "r")
    named = [(sensor.name, sensor.kind) for sensor in settings.sensors]
    assert named == [
        ("left", "camera"), ("right", "camera"), ("infrared", "infrared"), ("radar", "radar"),
        ("gnss", "displacement"), ("level-1", "displacement"),
    ]  # fmt: skip
    assert settings.sensors[1].settings.roi == (0, 0, 64, 64)
    # What takes one of each kind gets the first.
    assert (settings.camera.file, settings.displacement.file, settings.radar.file) == ("l.mkv", "g.csv", "r.npy")


def test_a_single_sensor_is_the_same_as_a_section_and_as_a_list_of_one():
    section, listed = (validate(tree_with(camera=camera), "r") for camera in (CAMERA, [CAMERA]))
    assert section == listed
    assert section.sensors[0].name == "camera"
    assert validate(tree_with(camera={**CAMERA, "name": "deck"}), "r").sensors[0].name == "deck"


@pytest.mark.parametrize("camera", [CAMERA, {**CAMERA, "name": "deck"}, TWO])
def test_settings_are_reported_as_the_file_has_them(camera):
    settings = validate(tree_with(camera=camera), "r")
    reported = settings.model_dump(mode="json", exclude_none=True)
    assert isinstance(reported["camera"], list) == isinstance(camera, list)
    assert "infrared" not in reported
    assert validate(reported, "r") == settings
    assert settings.model_dump(mode="json")["infrared"] is None


@pytest.mark.parametrize(
    ("tree", "words"),
    [
        (tree_with(camera=[TWO[0], {"file": "r.mkv"}]), ("[[camera]]", "a unique name", "camera[2] has none")),
        (tree_with(camera=[TWO[0], TWO[0]]), ("each sensor a unique name", "'left'")),
        (tree_with(camera=TWO, radar={"file": "r.npy", "name": "left"}), ("2 have the name 'left'",)),
        (tree_with(camera={**CAMERA, "name": "radar"}), ("camera[1]", "'radar'", "is reserved")),
        (tree_with(camera=[TWO[0], {**TWO[1], "name": "a.b"}]), ("camera[2].name = 'a.b'", "letters")),
        (tree_with(camera=[TWO[0], {**TWO[1], "every": 0}]), ("camera[2].every = 0",)),
        (tree_with(camera=[TWO[0], {**TWO[1], "rio": 0}]), ("camera[2].rio", "'roi'")),
        (tree_with(camera=[TWO[0], {**TWO[1], "direction": "xy"}]), ('direction = "x" or "y"', "several")),
        (tree_with(camera=[TWO[0], {"name": "right"}]), ("camera[2].file", "missing")),
        (tree_with(cameras=TWO), ("cameras", "section", "'camera'")),
        (tree_with(accelerometer=[ACCELEROMETER]), ("accelerometer: must be one section",)),
        (tree_with(camera=[]), ("camera = []", "a list of named sections")),
        (tree_with(reference=[KEYS["reference"]]), ("reference: must be one section",)),
    ],
)
def test_wrong_lists_of_sensors_are_refused_with_their_place(tree, words):
    message = message_of(tree)
    for word in words:
        assert word in message


def test_overrides_of_a_kind_win_in_each_of_its_sections(tmp_path):
    (tmp_path / "recording.toml").write_text(
        '[accelerometer]\nfile = "a.csv"\n[[camera]]\nname = "left"\nfile = "l.mkv"\ntracker = "features"\n'
        'tracker_settings = { technique = "existing" }\n[[camera]]\nname = "right"\nfile = "r.mkv"\n'
        '[[camera.target]]\nroi = [1, 2, 30, 40]\n[camera.lens]\nfile = "lens.json"\n'
    )
    left, right = load_settings(tmp_path, {"camera": {"tracker": "template"}}).cameras
    assert (left.tracker, right.tracker) == ("template", "template")
    assert not left.tracker_settings
    # Subsections belong to the section above them.
    assert (left.target, left.lens) == ((), None)
    assert (right.target[0].roi, right.lens.file) == ((1, 2, 30, 40), "lens.json")


@pytest.mark.parametrize("kind", ["camera", "infrared", "radar", "displacement"])
@pytest.mark.parametrize("value", [None, True, 3, "x", [], [1], [[]], [{}], [{}, {}], [None, {}], {"file": []}, [[{}]]])
def test_nonsense_in_place_of_a_sensor_is_a_sentence(kind, value):
    tree = {"accelerometer": ACCELEROMETER, kind: value}
    message = message_of(tree)
    assert kind in message
    for word in ("Settings", "dictionary", "instance", "Value error", "Input", "pydantic"):
        assert word not in message, message
