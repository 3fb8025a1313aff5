"""The reason codes: one table, and nothing says a code that is not in it."""

import re
from pathlib import Path

from midspan.service.reasons import REASONS, sentence

ROOT = Path(__file__).resolve().parents[2]
# Where codes are given out: of sources, of the store, of points.
PLACES = ("service", "sources/live", "store", "engine", "serve")
GIVEN = re.compile(r'(?:SourceFault|Failed|StoreFault)\(\s*"(\w+)"|reason(?:, [\w.]+)* = "(\w+)"|else "(store_\w+)"')


def test_every_code_that_is_given_out_stands_in_the_table():
    given = set()
    for place in PLACES:
        for file in (ROOT / "src" / "midspan" / place).glob("*.py"):
            for found in GIVEN.findall(file.read_text(encoding="utf-8")):
                given |= {code for code in found if code}
    assert {"refused", "payload", "process_ended"} <= given
    assert given <= set(REASONS)


def test_every_code_of_the_table_is_given_out_somewhere():
    text = "".join(
        file.read_text(encoding="utf-8")
        for place in PLACES
        for file in (ROOT / "src" / "midspan" / place).glob("*.py")
        if file.name != "reasons.py"
    )
    assert [code for code in REASONS if f'"{code}"' not in text] == []


def test_the_documentation_has_the_same_codes():
    text = (ROOT / "docs" / "live.md").read_text(encoding="utf-8")
    section = text.split("## Faults\n", 1)[1].split("### Events", 1)[0]
    rows = "".join(line.split("|")[2] for line in section.splitlines() if line.startswith("| "))
    assert set(re.findall(r"`(\w+)`", rows)) == set(REASONS)


def test_a_sentence_says_what_and_what_to_do():
    assert sentence("refused") == (
        "The connection was refused: nothing listens at this address: check the address, and that the camera is on."
    )
