"""Arguments of any kind never take the interpreter down, and no panic of the core reaches Python."""

import subprocess
import sys
from pathlib import Path


def test_ten_thousand_random_calls_into_the_core_end_in_an_answer_or_an_error(tmp_path):
    last = tmp_path / "last.txt"
    command = [sys.executable, str(Path(__file__).with_name("core_calls.py")), "10000", "1", str(last)]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert ran.returncode == 0, f"{ran.stdout[-3000:]}\n{ran.stderr[-1500:]}\nlast call: {last.read_text()[:1000]}"
