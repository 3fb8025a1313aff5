"""Where captured recordings go, and that they do not fill the disk."""

import pytest

from midspan.errors import UsageError
from midspan.service.capture import capture_settings
from midspan.service.point import forget
from midspan.settings.site import captures_of, load_site, require_folders

POINT = """
[[point]]
name = "p"
[point.accelerometer]
source = "mqtt:a"
[point.displacement]
source = "mqtt:d"
[mqtt]
host = "127.0.0.1"
"""


@pytest.mark.parametrize(
    ("store", "folder"),
    [
        ('path = "rows"', "rows/captures"),
        ('url = "postgresql://somebody@127.0.0.1/db"', "bridge-captures"),
        ('url = "postgresql://somebody@127.0.0.1/db"\ncaptures = "state/c"', "state/c"),
        ('path = "rows"\ncaptures = "elsewhere"', "elsewhere"),
    ],
)
def test_captured_recordings_stand_beside_the_rows_or_where_the_settings_say(store, folder, tmp_path):
    file = tmp_path / "SITE.toml"
    file.write_text(f'name = "bridge"\n[store]\n{store}\n{POINT}')
    assert captures_of(load_site(file)) == tmp_path / folder


def test_a_clock_is_not_looked_for_beyond_the_range_though_none_is_stated(tmp_path):
    file = tmp_path / "SITE.toml"
    file.write_text(f'name = "bridge"\n[store]\npath = "rows"\n{POINT}')
    (plan,) = load_site(file).points
    written = capture_settings(plan.recording, {"displacement": 1.0}).model_dump(mode="json", exclude_unset=True)
    assert written["calibration"]["max_offset_s"] == 0.5
    # Whether the sensor's clock is the accelerometer's is not said where SITE.toml leaves it open.
    assert "estimate_offset" not in written["displacement"]


def test_a_folder_that_cannot_be_made_is_refused_with_the_key(tmp_path):
    (tmp_path / "file").write_text("in the way")
    site = tmp_path / "SITE.toml"
    site.write_text(f'name = "bridge"\n[store]\npath = "rows"\ncaptures = "file/c"\n{POINT}')
    with pytest.raises(UsageError, match=r"store\.captures"):
        require_folders(load_site(site))


def test_what_nothing_needs_any_more_is_removed(tmp_path):
    for name in (
        "opening-10",
        "opening-30",
        "opening-50",
        "calibration-05",
        "calibration-08",
        "calibration-20",
        "calibration-60",
    ):
        (tmp_path / name).mkdir()
    forget(tmp_path, tmp_path / "opening-30")
    # The opening in use, what came after it, and the two newest calibrations before it are left.
    left = {one.name for one in tmp_path.iterdir()}
    assert left == {"opening-30", "opening-50", "calibration-08", "calibration-20", "calibration-60"}
