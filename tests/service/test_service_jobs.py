"""Work in processes of their own: what ends them."""

import asyncio
import time

import pytest

from midspan.errors import DataError
from midspan.service import calibrations as jobs

SLEEPS = "import os, sys, time; open(sys.argv[1], 'w').write(str(os.getpid())); time.sleep(60)"


async def _cancelled(file):
    task = asyncio.create_task(jobs._ran(SLEEPS, str(file)))
    while not file.exists() or not file.read_text():
        await asyncio.sleep(0.02)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    return int(file.read_text())


def test_work_that_is_cancelled_ends_at_once_and_is_no_refusal(tmp_path):
    begun_s = time.monotonic()
    pid = asyncio.run(_cancelled(tmp_path / "pid"))
    assert time.monotonic() - begun_s < 30.0
    with pytest.raises(ProcessLookupError):
        jobs.os.kill(pid, 0)


def test_work_that_lasts_too_long_is_ended_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(jobs, "LONGEST_S", 0.2)
    with pytest.raises(DataError, match=r"longer than 0\.2 s"):
        asyncio.run(jobs._ran(SLEEPS, str(tmp_path / "pid")))
