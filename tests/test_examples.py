"""The numbered examples run, shortened and as they are, in an empty folder, and print something."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from brief import shorten
from repeats import slow

# Short simulated recordings and one draw are enough to see that everything is found and printed.
BRIEF_S = 14.0
FEW_DRAWS = (
    (r"^SEEDS = 5$", "SEEDS = 1"),
    (r"^SEEDS(.*) = \((\d+)(?:, \d+)+\)", r"SEEDS\1 = (\2,)"),
    (r"^for times in \(2, .*\):", "for times in (2, 100):"),
)
EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("[0-9]*.py"))


def test_examples_are_numbered_without_gaps():
    assert [int(path.name[:2]) for path in EXAMPLES] == list(range(1, len(EXAMPLES) + 1))
    assert len(EXAMPLES) >= 3


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_briefly_without_warnings_and_leaves_nothing_behind(path, tmp_path, monkeypatch, capfd):
    shorten(monkeypatch, BRIEF_S)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(path)])
    source = path.read_text(encoding="utf-8")
    for long, short in FEW_DRAWS:
        source = re.sub(long, short, source, flags=re.MULTILINE)
    # A warning is an error, as in all tests.
    exec(compile(source, str(path), "exec"), {"__name__": "__main__", "__file__": str(path)})
    printed = capfd.readouterr()
    assert printed.err == ""
    assert len(printed.out.splitlines()) >= 3
    assert list(tmp_path.iterdir()) == []


# In a process of its own an example finds what it needs without the tests' imports.
@pytest.mark.parametrize("path", [EXAMPLES[1], *slow(EXAMPLES[0], *EXAMPLES[2:])], ids=lambda path: path.stem)
def test_example_runs_as_a_script(path, tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "error", str(path)],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg", "PYTHONIOENCODING": "utf-8"},
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert len(done.stdout.splitlines()) >= 3
    assert list(tmp_path.iterdir()) == []
