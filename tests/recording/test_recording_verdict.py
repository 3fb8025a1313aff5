"""The sentence on a result: how far, how surely, what to look at; never more certain than the band."""

import re

import numpy as np
import pytest

from midspan.notices import NOTICES, Notice, Severity
from midspan.recording.verdict import UNSETTLED, Motion, verdict
from midspan.records import Estimate, Status

COUNT = 1000


def rows(value_mm, std_mm=0.01, status=Status.TRACKING):
    """Rows at 100 Hz with these values, standard deviations and status, each a number or one a row."""
    full = np.full(COUNT, 1.0)
    codes = np.asarray(full * np.asarray(status), np.uint8)
    time_ns = np.arange(COUNT, dtype=np.int64) * 10_000_000
    return Estimate(time_ns, 1e-3 * value_mm, (1e-3 * std_mm * full) ** 2, 0.0 * full, np.ones(COUNT, np.uint8), codes)


def swing():
    """From -2 to 4 mm in whole turns, mm."""
    return 1.0 + 3.0 * np.sin(2 * np.pi * np.arange(COUNT) / 100.0)


def numbers(text):
    return [float(value) for value in re.findall(r"[-+]?\d+\.\d+", text)]


def test_a_clean_result_says_how_far_with_the_band_of_each_end():
    std = np.where(np.arange(COUNT) < 500, 0.01, 0.02)
    said = verdict([Motion(rows(swing(), std), 0.005)], [])
    moved, low, low_band, high, high_band = numbers(said)
    assert (moved, low, high) == (6.0, -2.0, 4.0)
    # The first of equal ends is meant; 1.96 standard deviations to two digits.
    assert (low_band, high_band) == (0.02, 0.02)
    assert said.endswith("no sensor contradicts it.")


def test_a_motion_below_its_own_standard_deviation_is_not_certain():
    """The zero's error does not make the rows differ, and is no reason for doubt; their own is."""
    quiet = 0.01 * np.sin(np.arange(COUNT))
    assert "no significant motion" in verdict([Motion(rows(quiet, 0.02), 0.0)], []).lower()
    assert "moved by" in verdict([Motion(rows(quiet, 0.02), 0.0199)], [])


def test_a_displacement_that_has_run_away_is_no_motion():
    value, std, status = swing(), np.full(COUNT, 0.01), np.zeros(COUNT)
    value[700:], std[700:], status[700:] = 5000.0, 3000.0, Status.LOST
    said = verdict([Motion(rows(value, std, status), 0.0)], [])
    assert numbers(said)[0] == 6.0
    assert "in the 70 % of the rows that are not lost" in said
    assert "no measurement supports any row" in verdict([Motion(rows(value, std, Status.LOST), 0.0)], []).lower()


@pytest.mark.parametrize("code", [code for code, severity in NOTICES.items() if severity is Severity.SERIOUS])
def test_with_a_serious_notice_it_says_not_to_use_it(code):
    said = verdict([Motion(rows(swing()), 0.0)], [Notice("lens", "camera: a."), Notice(code, "camera: b.")])
    assert said.startswith(f"Do not use this displacement before you have settled {UNSETTLED[code]}")


def test_warnings_are_counted_and_the_first_is_named_notes_are_not():
    motion = [Motion(rows(swing()), 0.0)]
    assert "contradicts" in verdict(motion, [Notice("tilt", "accelerometer: a.")])
    said = verdict(motion, [Notice("tilt", "a."), Notice("lens", "camera: b."), Notice("outliers", "c.")])
    assert said.endswith("look first at the warning on the camera (lens) and one more.")
    printed = [Notice("literal", "calibration.literal: d.")]
    assert verdict(motion, printed).endswith("look first at the warning on the calibration (literal).")
    # A text of an earlier version has no code.
    assert "(uncoded)" in verdict(motion, ["something."])


def test_a_wrong_unit_shows_in_the_acceleration():
    said = verdict([Motion(rows(swing()), 0.0)], [], 9.80665)
    assert "calibrated on accelerations of up to 1 g;" in said
    assert "calibrated" not in verdict([Motion(rows(swing()), 0.0)], [])


def test_two_axes_stand_in_one_sentence():
    said = verdict([Motion(rows(swing()), 0.0, "y"), Motion(rows(2.0 * swing()), 0.0, "x")], [])
    assert re.search(r"moved by 6\.\d+ mm along y, .* and by 12\.\d+ mm along x", said)
    assert said.count(". ") == 0
