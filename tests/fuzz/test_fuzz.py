"""Damaged files, settings and results never end in a traceback, a crash, a hang, gigabytes or growth.

The same machinery as `make fuzz`, with 200 inputs for each reader; its limits are of processor time, not of wall time.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

INPUTS = 200
TESTS = Path(__file__).parents[1]


@pytest.mark.parametrize("group", ["tables", "cameras", "infrared", "radar", "settings", "results"])
def test_damaged_inputs_end_in_a_message_and_an_exit_code(group: str, tmp_path: Path) -> None:
    given = ["--groups", group, "--inputs", str(INPUTS), "--workers", "1", "--folder", str(tmp_path / "fuzz")]
    places = [str(TESTS), str(TESTS / "sources"), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [sys.executable, "-m", "fuzz", *given],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, places))},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr[-2000:]}"
