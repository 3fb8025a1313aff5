"""The guide as a reader types it, and every command line of the documentation as far as its options go."""

import re
import shlex
import shutil
from pathlib import Path

import click
import pytest

from midspan.cli.console import commands
from midspan.cli.main import run

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"[-+−]?\d[\d.]*(e[-+]?\d+)?")


def command_lines():
    """What begins with `midspan` in a block of commands."""
    for page in PAGES:
        for kind, text in BLOCK.findall(page.read_text(encoding="utf-8")):
            for line in text.splitlines() if kind in ("sh", "console") else ():
                found = re.match(r"(?:\$ )?midspan (.*)", line)
                if found:
                    yield pytest.param(shlex.split(found[1], comments=True), id=f"{page.stem}: {found[1][:50]}")


@pytest.mark.parametrize("words", list(command_lines()))
def test_every_command_line_is_understood(words):
    command = commands.get_command(click.Context(commands), words[0])
    assert command is not None
    # Raises where an option or the number of arguments is wrong; nothing runs.
    command.make_context(words[0], words[1:])


def masked(text):
    """Lines without their figures and with single spaces: what does not depend on the machine."""
    return [NUMBER.sub("#", " ".join(line.split())) for line in text.splitlines() if line.strip()]


def test_the_guide_leads_from_two_files_to_a_comparison(tmp_path, monkeypatch, capsys):
    """Every command of the guide down to the natural frequencies, each with the output that stands below it."""
    text = (ROOT / "docs" / "guide.md").read_text(encoding="utf-8").split("## Several targets")[0]
    monkeypatch.chdir(tmp_path)
    for kind, block in BLOCK.findall(text):
        if kind == "toml" and "[accelerometer]" in block:
            Path("recording.toml").write_text(block, encoding="utf-8")
        elif kind == "sh":
            for line in block.splitlines():
                typed(line, monkeypatch)
        elif kind == "console":
            first, expected = block.split("\n", 1)
            capsys.readouterr()
            typed(first.removeprefix("$ "), monkeypatch)
            shown = capsys.readouterr()
            # The page may show less than the command does.
            missing = set(masked(expected)) - set(masked(shown.out + shown.err.replace("midspan: ", "")))
            assert not missing, first


def typed(line, monkeypatch):
    """What a shell does with the lines of the guide."""
    program, *words = shlex.split(line, comments=True)
    if program == "midspan":
        run(words)
    elif program == "mkdir":
        Path(*words).mkdir()
    elif program == "cp":
        shutil.copy(*words)
    elif program == "cd":
        monkeypatch.chdir(*words)
    elif program == "head":
        count, file = words
        print("\n".join(Path(file).read_text(encoding="utf-8").splitlines()[: int(count.removeprefix("-"))]))
    else:
        raise AssertionError(f"a program that the guide does not need: {line}")
