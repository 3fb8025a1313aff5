"""The numbered examples run, shortened and as they are, in an empty folder, and print something."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

# Simulated recordings of 25 s and one draw are enough to see that everything is found and printed.
BRIEFLY = """
import sys
from dataclasses import replace
from pathlib import Path
from midspan.simulate.scenarios.table import SCENARIOS
for name, one in SCENARIOS.items():
    SCENARIOS[name] = replace(one, duration_s=min(one.duration_s, 25.0))
sys.argv = sys.argv[1:]
source = Path(sys.argv[0]).read_text(encoding="utf-8").replace("SEEDS = 5", "SEEDS = 1")
exec(compile(source, sys.argv[0], "exec"), {"__name__": "__main__"})
"""
EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("[0-9]*.py"))


def test_examples_are_numbered_without_gaps():
    assert [int(path.name[:2]) for path in EXAMPLES] == list(range(1, len(EXAMPLES) + 1))
    assert len(EXAMPLES) >= 3


@pytest.mark.parametrize("how", [("-c", BRIEFLY), pytest.param((), marks=pytest.mark.slow)], ids=["briefly", "whole"])
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_without_warnings_and_leaves_nothing_behind(path, how, tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "error", *how, str(path)],
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
