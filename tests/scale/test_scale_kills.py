"""A campaign that is disturbed: after the same command again all results are those of an undisturbed run."""

import os
import resource
import signal
import sys
from importlib.util import find_spec

import pytest
from campaign_runs import descendants, killed_with_all

from midspan.errors import UsageError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
# Bytes of a file: less than the rows of a recording need.
SMALL = 8192


def test_a_worker_that_is_killed_costs_no_result(short_campaign, undisturbed):
    command = short_campaign.started("process")
    short_campaign.until_done(1)
    forked = [line for line in descendants(command.pid).values() if "forkserver" in line]
    workers = [child for child, line in descendants(command.pid).items() if line == forked[0]]
    # The newest is a worker; the oldest is the server that makes them.
    os.kill(max(workers), signal.SIGKILL)
    _, errors = command.communicate()
    assert command.returncode == 0, errors
    short_campaign.same_as(undisturbed)


def test_a_command_that_is_killed_leaves_no_worker_and_goes_on_where_it_was(short_campaign, undisturbed):
    command = short_campaign.started("process")
    short_campaign.until_done(2)
    killed_with_all(command)
    done = short_campaign.whole_files()
    assert 2 <= done < 6
    kept = {path: path.stat().st_ino for path in short_campaign.results.glob("rows/*/part.parquet")}
    again = short_campaign.started("process")
    _, errors = again.communicate()
    assert again.returncode == 0, errors
    short_campaign.same_as(undisturbed)
    # At most those whose outcome had not been written are estimated again.
    assert sum(path.stat().st_ino == number for path, number in kept.items()) >= done - 2


@pytest.mark.parametrize("runner", ["local", "process"])
def test_a_disk_that_is_full_ends_the_command_with_a_sentence(runner, short_campaign, undisturbed):
    def little() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (SMALL, SMALL))

    command = short_campaign.started(runner, preexec_fn=little)
    _, errors = command.communicate()
    assert command.returncode == UsageError.exit_code
    assert "cannot be written" in errors
    assert "Traceback" not in errors
    assert short_campaign.whole_files() == 0
    again = short_campaign.started(runner)
    _, errors = again.communicate()
    assert again.returncode == 0, errors
    short_campaign.same_as(undisturbed)


def test_a_cluster_whose_worker_and_then_whose_command_is_killed_goes_on(short_campaign, undisturbed):
    if find_spec("ray") is None:
        pytest.skip("Ray is not installed")
    command = short_campaign.started("ray")
    short_campaign.until_done(1)
    workers = [child for child, line in descendants(command.pid).items() if line.startswith("ray::work")]
    os.kill(workers[0], signal.SIGKILL)
    short_campaign.until_done(2)
    killed_with_all(command)
    short_campaign.whole_files()
    again = short_campaign.started("ray")
    _, errors = again.communicate()
    assert again.returncode == 0, errors
    short_campaign.same_as(undisturbed)
