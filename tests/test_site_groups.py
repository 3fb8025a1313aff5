"""[[group]] in SITE.toml: what it may say, and one clear message for everything else."""

import pytest

from midspan.errors import UsageError
from midspan.settings.group import groups_of, topics_of
from midspan.settings.site import load_site

HEAD = """
name = "river"
[store]
path = "store"
"""
MQTT = """
[mqtt]
prefix = "{PLACE}"
"""
GROUP = """
[[group]]
name = "north"
points = 1000
accelerometer = "mqtt:{PLACE}/{i}/acc"
displacement = "mqtt:north/gnss"
accelerometer_unit = "mg"
accelerometer_noise_std = 0.5
displacement_noise_std = 1.5
"""
POINT = """
[[point]]
name = "NAME"
[point.accelerometer]
source = "mqtt:acc"
unit = "g"
[point.displacement]
source = "mqtt:north/7/gnss"
unit = "mm"
"""


def loaded(tmp_path, monkeypatch, text):
    file = tmp_path / "SITE.toml"
    file.write_text(text)
    monkeypatch.setenv("PLACE", "midspan")
    return load_site(file)


def test_a_group_as_documented_without_any_point(tmp_path, monkeypatch):
    site = loaded(tmp_path, monkeypatch, HEAD + MQTT + GROUP)
    (group,) = site.groups
    assert site.points == ()
    assert site.names == ["north"]
    # {PLACE} is of the environment, {i} the point's number.
    assert topics_of(group)[:2] == ["midspan/0/acc", "midspan/1/acc"]
    assert topics_of(group)[999:] == ["midspan/999/acc", "north/gnss"]
    assert group.accelerometer_factor == pytest.approx(9.80665e-3)
    assert group.displacement_factor == 0.001
    assert [group.point(0), group.point(999)] == ["north-0", "north-999"]
    numbers = [group.number(name) for name in ("north-0", "north-999", "north-1000", "north-07", "north-", "south-1")]
    assert numbers == [0, 999, None, None, None, None]


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("points = 1000", "points = 0", "group 'north': points = 0: must be greater than or equal to 1"),
        ("points = 1000", "points = 100001", "less than or equal to 100000"),
        ("points = 1000", "", "group 'north': points: is missing. Add it."),
        ("displacement_noise_std = 1.5", "", "displacement_noise_std: is missing. Add it."),
        ('"mqtt:north/gnss"', '"north/gnss"', "must be mqtt: and a topic"),
        ('"mqtt:north/gnss"', '"mqtt:north/+/gnss"', "without the wildcards + and #"),
        ('"mqtt:north/gnss"', '"mqtt:midspan/v1/river/x"', "must not be a topic of the site's results"),
        (
            '"mqtt:north/gnss"',
            '"mqtt:midspan/5/acc"',
            "'midspan/5/acc' is that of the group 'north', accelerometer, too",
        ),
        ('"mg"', '"mm"', "must be a unit of acceleration"),
        ('"mg"', '"mg"\ndisplacement_unit = "m/s"', "must be a unit of length"),
        ('"mg"', '"mg"\nnoise = 1', "group 'north': noise: is not a known key"),
        ('"north"', '"north bridge"', "letters, digits, - and _"),
        ('"north"', f'"{"n" * 62}"', "at most 64 characters"),
        (MQTT, "", "[mqtt] is missing. Add [mqtt]."),
    ],
)
def test_what_a_group_may_not_say(tmp_path, monkeypatch, before, after, said):
    text = HEAD + MQTT + GROUP
    assert before in text
    with pytest.raises(UsageError) as refused:
        loaded(tmp_path, monkeypatch, text.replace(before, after))
    assert said in str(refused.value)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (POINT.replace("NAME", "North"), "group 'north': name: must be unique; the point 'North' has it too"),
        (POINT.replace("NAME", "north-999"), "its point north-999 has the name of the point 'north-999'"),
        (GROUP, "name: must be unique; the group 'north' has it too"),
        (GROUP.replace('"north"', '"north-3"'), "its point north-3 has the name of the group 'north-3'"),
        (GROUP.replace('"north"', '"south"'), "each topic belongs to one sensor"),
        (POINT.replace("NAME", "x").replace("north/7/gnss", "midspan/7/acc"), "is that of a [[point]] too"),
    ],
)
def test_names_and_topics_belong_to_one(tmp_path, monkeypatch, more, said):
    with pytest.raises(UsageError) as refused:
        loaded(tmp_path, monkeypatch, HEAD + MQTT + more + GROUP)
    assert said in str(refused.value)


def test_a_point_may_have_a_name_like_one_of_a_group(tmp_path, monkeypatch):
    site = loaded(tmp_path, monkeypatch, HEAD + MQTT + POINT.replace("NAME", "north-1000") + GROUP)
    assert site.names == ["north-1000", "north"]


def test_elsewhere_the_number_is_a_variable_like_others(tmp_path, monkeypatch):
    with pytest.raises(UsageError, match="environment variable i, which is not set"):
        loaded(tmp_path, monkeypatch, HEAD.replace("river", "{i}") + MQTT + GROUP)


def test_an_unknown_key_of_a_group_names_its_keys():
    tree = {"name": "n", "points": 1, "accelerometer": "mqtt:a/{i}", "displacement": "mqtt:b/{i}", "method": "kalman"}
    noise = {"accelerometer_noise_std": 1.0, "displacement_noise_std": 1.0}
    with pytest.raises(UsageError, match=r"method: is not a known key\. .*displacement_unit"):
        groups_of([{**tree, **noise}], "SITE.toml")
