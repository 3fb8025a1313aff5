import importlib

import numpy as np
import pytest

from midspan.errors import DataError, UsageError
from midspan.records import Region
from midspan.vision.tracker import DEFAULT_TRACKER, TRACKERS, open_tracker, tracker_settings


@pytest.mark.parametrize("name", TRACKERS)
def test_every_row_of_the_table_names_classes_that_exist_and_says_when_to_use_them(name):
    entry = TRACKERS[name]
    module = importlib.import_module(entry.module)
    settings = getattr(module, entry.settings)
    assert tracker_settings(name) == settings()
    assert {"push", "restore", "state", "region", "region_now", "reference"} <= set(dir(getattr(module, entry.tracker)))
    assert len(entry.use) > 20


def test_the_default_is_in_the_table():
    assert DEFAULT_TRACKER in TRACKERS


def test_wrong_names_are_refused_with_the_nearest_right_one(make_frame):
    with pytest.raises(UsageError, match="'template'"):
        open_tracker("templat", make_frame(np.zeros((100, 100))), Region(20, 20, 40, 40))
    with pytest.raises(UsageError, match="smoothing_px"):
        tracker_settings("template", smooting_px=1.0)


def test_settings_of_another_class_are_refused(make_frame):
    with pytest.raises(UsageError, match="TemplateSettings"):
        open_tracker("template", make_frame(np.zeros((100, 100))), Region(20, 20, 40, 40), {"smoothing_px": 1.0})


def test_a_region_outside_the_image_is_refused_with_both_sizes(make_frame):
    with pytest.raises(UsageError, match=r"camera\.roi must lie inside the image \(100x80 px\); received x=70, y=20"):
        open_tracker("template", make_frame(np.zeros((80, 100))), Region(70, 20, 40, 40))


def test_a_colour_image_is_refused(make_frame):
    with pytest.raises(DataError, match="one image plane"):
        open_tracker("template", make_frame(np.zeros((80, 100, 3))), Region(10, 20, 40, 40))
