"""The unit of systemd that the documentation shows is one that systemd takes, with the limits that it names."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

LIVE = Path(__file__).parents[2] / "docs" / "live.md"


def test_systemd_finds_nothing_wrong_with_the_unit(tmp_path):
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd is not installed")
    (unit,) = re.findall(r"```ini\n(.*?)```", LIVE.read_text(), re.DOTALL)
    for limit in ("LimitNOFILE=", "TimeoutStartSec=", "TimeoutStopSec=", "MemoryMax="):
        assert f"\n{limit}" in unit
    # The program is not where the documentation installs it, and other services need not be here.
    unit = unit.replace("/opt/midspan/bin/midspan", sys.executable).replace(" mosquitto.service postgresql.service", "")
    file = tmp_path / "midspan.service"
    file.write_text(unit)
    done = subprocess.run([analyze, "verify", "--man=no", file], capture_output=True, text=True, timeout=60)
    of_unit = [line for line in done.stderr.splitlines() if "midspan.service" in line]
    assert (done.returncode, of_unit) == (0, [])
