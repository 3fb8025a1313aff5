"""What the compiled core may know: no file, clock, thread or network, and no text for people."""

import re
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1] / "core" / "src"
FILES = sorted(SOURCE.rglob("*.rs"))
CALLS = r"\b(?:print|println|eprintln|dbg|todo|unimplemented)!"
FORBIDDEN = re.compile(rf"std::(?:fs|net|time|thread|process|env|io)\b|{CALLS}")
COMMENT = re.compile(r"//[^\n]*")
STRING = re.compile(r'"(?:[^"\\]|\\.)*"')
# Attributes and the names of features are no text for people.
ATTRIBUTE = re.compile(r"#!?\[[^\]]*\]|is_x86_feature_detected!\([^)]*\)")


def code(file: Path) -> str:
    """A file's code without comments and without its tests, which stand below it."""
    return COMMENT.sub("", file.read_text(encoding="utf-8")).split("#[cfg(test)]\nmod tests")[0]


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(SOURCE)))
def test_the_core_does_no_input_output_or_waiting(file):
    assert FORBIDDEN.findall(code(file)) == []


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(SOURCE)))
def test_the_core_holds_no_text_for_people(file):
    if file.parent.name == "py" or file.name == "lib.rs":
        # Where Python's errors are made: technical words for what a wrapper should have checked.
        return
    assert STRING.findall(ATTRIBUTE.sub("", code(file))) == []


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(SOURCE)))
def test_every_file_of_the_core_opens_with_what_it_computes(file):
    text = file.read_text(encoding="utf-8")
    assert text.startswith("//! ")
    assert len(text.splitlines()) <= 500
    for reasonless in re.finditer(r"unsafe \{", COMMENT.sub("", text)):
        assert "SAFETY:" in text, reasonless
