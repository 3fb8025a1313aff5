"""Notices: one table of codes, in the documentation too; a notice is a text that keeps its code."""

import copy
import json
import pickle
import re
from pathlib import Path

import pytest

from midspan.engine.row_messages import EVENT_CODES
from midspan.notices import NOTICES, Notice, Severity, notice_trees, once

ROOT = Path(__file__).resolve().parents[1]


def test_the_documentation_has_the_same_codes_with_their_severity():
    text = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w-]+)` \| (note|warning|serious) \| .+? \|$", text, flags=re.MULTILINE)
    assert {code: Severity(severity) for code, severity in rows} == NOTICES


def test_every_code_of_the_table_is_given_out_somewhere():
    text = "".join(
        file.read_text(encoding="utf-8") for file in (ROOT / "src").rglob("*.py") if file.name != "notices.py"
    )
    # Rows of the result give out the word of their status.
    given = set(NOTICES) - {"coasting", "lost"}
    assert [code for code in sorted(given) if f'"{code}"' not in text] == []


def test_every_kind_of_event_that_is_reported_has_a_code():
    assert set(EVENT_CODES.values()) <= set(NOTICES)


def test_a_notice_is_a_text_that_keeps_its_code():
    notice = Notice("frozen", "camera: 3 frames only repeat the one before.")
    assert notice == "camera: 3 frames only repeat the one before."
    assert json.loads(json.dumps([notice])) == [str(notice)]
    for one in (copy.deepcopy(notice), pickle.loads(pickle.dumps(notice))):
        assert (one, one.code, one.severity) == (notice, "frozen", "warning")
    assert notice.worded("other words").code == "frozen"
    assert notice_trees([notice]) == [{"code": "frozen", "severity": "warning", "text": str(notice)}]
    with pytest.raises(ValueError, match="no code"):
        Notice("unknown", "text")


def test_a_cause_of_an_earlier_stage_is_reported_once_in_the_later_words():
    before = (
        Notice("video-compressed", "camera: compressed, by the calibration"),
        Notice("video-compressed", "camera-2: compressed"),
        Notice("tilt", "accelerometer: it tilts"),
    )
    later = (Notice("video-compressed", "camera: compressed, by the record"), Notice("lost", "lost"))
    assert once((*later, later[1]), before) == (before[1], before[2], *later)
