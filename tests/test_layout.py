"""The rules of style that a machine can check."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

import midspan

SOURCE = Path(midspan.__file__).parent
FILES = sorted(SOURCE.rglob("*.py"))
ROOMS = sorted(file for file in FILES if file.name == "__init__.py" and file.parent != SOURCE)
UNFINISHED = re.compile(r"\b(TODO|FIXME|XXX|HACK|WIP)\b")
NAMES_WITHOUT_A_ROLE = {"utils", "util", "helpers", "helper", "common", "core", "misc", "tools"}


@cache
def parsed(file):
    """A file's syntax tree."""
    return ast.parse(file.read_text(encoding="utf-8"))


def functions(file):
    """Name and number of lines of each function of a file, its decorators left out."""
    tree = parsed(file)
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    return [
        (f"{file.relative_to(SOURCE)}:{node.name}", node.end_lineno - node.lineno + 1)
        for node in ast.walk(tree)
        if isinstance(node, kinds)
    ]


@pytest.fixture(scope="module")
def lengths():
    """The number of lines of each function."""
    return dict(item for file in FILES for item in functions(file))


def test_no_function_is_longer_than_sixty_lines(lengths):
    assert {name: length for name, length in lengths.items() if length > 60} == {}


def test_nearly_all_functions_have_at_most_thirty_lines(lengths):
    longer = {name: length for name, length in lengths.items() if length > 30}
    assert len(longer) <= 0.05 * len(lengths), longer


def test_most_files_have_at_most_four_hundred_lines():
    longer = [file.name for file in FILES if len(file.read_text(encoding="utf-8").splitlines()) > 400]
    assert len(longer) <= 0.15 * len(FILES), longer


@pytest.mark.parametrize("file", ROOMS, ids=lambda file: str(file.parent.relative_to(SOURCE)))
def test_the_init_of_a_room_is_one_line_of_docstring(file):
    text = file.read_text(encoding="utf-8").strip()
    assert len(text.splitlines()) == 1
    assert ast.get_docstring(ast.parse(text))


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(SOURCE)))
def test_every_file_says_what_it_is_and_nothing_is_left_unfinished(file):
    text = file.read_text(encoding="utf-8")
    assert UNFINISHED.search(text) is None
    if file.name != "_version.py":
        assert ast.get_docstring(parsed(file))


def test_every_room_and_file_is_named_after_its_role():
    names = {part for file in FILES for part in file.relative_to(SOURCE).with_suffix("").parts}
    assert names & NAMES_WITHOUT_A_ROLE == set()


def test_every_folder_of_the_package_is_a_package():
    folders = {file.parent for file in FILES}
    assert [folder for folder in folders if not (folder / "__init__.py").is_file()] == []


# Words that the field does not use, with what it says instead.
BANNED = {
    r"told": "reported, stated",
    r"learnt": "estimated; learned, of a template",
    r"beside": "relative to, compared with, together with",
    r"by itself|by themselves": "on its own",
    r"stretch(es)?": "segment",
    r"wander(s|ed|ing)?": "drift",
    r"folded": "aliased",
    r"(stands?|stood|standing) still": "is static, frozen",
    r"eyes?": "camera",
    r"[Ss]o many": "this many",
    r"_?(MOST|LEAST|FEWEST)_\w+": "MAX_, MIN_",
}
ROOT = Path(__file__).parents[1]
TEXTS = [*FILES, *ROOT.glob("core/src/**/*.rs"), *ROOT.glob("docs/**/*.md"), ROOT / "README.md"]


@pytest.fixture(scope="module")
def texts():
    """What is written, by its file."""
    return {file: file.read_text() for file in TEXTS}


@pytest.mark.parametrize("word", BANNED)
def test_the_words_are_those_of_the_field(word, texts):
    banned = re.compile(rf"(?<!np\.)\b({word})\b|(?<![a-z])({word})(?=_)|(?<=_)({word})(?![a-z])")
    where = []
    for file, text in texts.items():
        for found in banned.finditer(text):
            number, line = text.count("\n", 0, found.start()) + 1, text[: found.end()].rpartition("\n")[2]
            where.append(f"{file.relative_to(ROOT)}:{number}: {line.strip()}")
    assert where == [], f"write {BANNED[word]}"
