"""Campaigns of short recordings and a cluster of Ray."""

import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from campaign_runs import NAMES, Campaign

from midspan.simulate.scenarios.write import write


@pytest.fixture(scope="session")
def recording(tmp_path_factory) -> Path:
    """An accelerometer and a GNSS."""
    return write("gnss", tmp_path_factory.mktemp("gnss") / "recording", seed=3)


@pytest.fixture(scope="session")
def undisturbed(recording, tmp_path_factory) -> Campaign:
    """A campaign that nothing has disturbed."""
    import midspan

    campaign = Campaign(tmp_path_factory.mktemp("undisturbed"), recording)
    assert midspan.batch(campaign.folder, runner="local").exit_code == 0
    return campaign


@pytest.fixture
def short_campaign(recording, tmp_path) -> Campaign:
    """The same campaign, to be run."""
    return Campaign(tmp_path, recording)


@pytest.fixture
def campaign(recording, tmp_path) -> Path:
    """The folder of a campaign of three recordings in two folders."""
    for name in NAMES:
        shutil.copytree(recording, tmp_path / name)
    (tmp_path / "CAMPAIGN.toml").write_text('recordings = ["2026-*/*"]\noutput = "results"\nmethod = "kalman"\n')
    return tmp_path


@pytest.fixture(scope="session")
def ray_cluster():
    """Ray with two workers, as the runner starts it."""
    # Not imported before the runner does: Ray reads its settings then.
    if find_spec("ray") is None:
        pytest.skip("Ray is not installed")
    from midspan.scale.runners import RayRunner

    runner = RayRunner(2)
    yield sys.modules["ray"]
    runner.close()
