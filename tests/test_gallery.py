"""The gallery's pictures are those of its command, and its figures are measured."""

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TOOL = runpy.run_path(str(ROOT / "tools" / "gallery.py"))
PAGE = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")


def test_the_page_shows_what_the_command_makes():
    assert set(re.findall(r"images/gallery_(\w+)\.png", PAGE)) == set(TOOL["SCENES"])
    for name, scenario in TOOL["SCENES"].items():
        section = PAGE.split(f"images/gallery_{name}.png")[1].split("\n## ")[0]
        assert f"`{scenario}`" in section


@pytest.mark.slow
def test_the_command_draws_a_scenario_with_the_error_that_the_page_states(tmp_path):
    compared = TOOL["make"]("gnss", tmp_path)
    # Of the same seed: what differs between processors is below the page's two digits.
    stated = float(re.search(r"The error is ([\d.]+) mm", PAGE.split("## GNSS")[1])[1])
    assert compared.rmse_mm == pytest.approx(stated, rel=0.02)
    assert (tmp_path / "gallery_gnss.png").read_bytes().startswith(b"\x89PNG")
