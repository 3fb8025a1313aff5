"""The papers' tests as scenarios: in time with their streams, named with what the papers do not print."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from midspan.cli.console import commands
from midspan.errors import UsageError
from midspan.papers.scenes import FILMS, PAPER_NAMES, PUBLISHED, chosen_here, write_scene
from midspan.simulate.scenarios.stage import stage
from midspan.simulate.scenarios.table import NAMES


def test_every_test_of_a_paper_is_named_after_its_key_and_says_what_is_chosen_here():
    assert set(PAPER_NAMES) == {*FILMS, *PUBLISHED}
    assert not set(PAPER_NAMES) & set(NAMES)
    for name in PAPER_NAMES:
        assert name[:4] in ("000-", "001-", "002-", "003-", "004-")
        assert chosen_here(name)
    assert not any(chosen_here(name) for name in NAMES)


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_test_begins_at_rest_and_moves(name):
    truth = stage(PUBLISHED[name], 3).truth_mm()
    # 0.2 s: the radar's wall begins at 1 s, the storey model's window at 0.5 s.
    assert np.abs(truth[truth[:, 0] < 0.2, 1]).max() < 1e-6
    assert np.std(truth[:, 1]) > 0.3


def test_a_recording_says_what_was_chosen_and_is_the_same_again(tmp_path):
    first, second = (write_scene("003-storey-2", tmp_path / name, seed=4) for name in "ab")
    known = json.loads((first / "known.json").read_text(encoding="utf-8"))
    assert known["chosen_here"] == PUBLISHED["003-storey-2"].free
    for file in ("accel.csv", "camera_times.csv", "truth.csv"):
        assert (first / file).read_bytes() == (second / file).read_bytes()


def test_the_command_lists_the_papers_tests_and_a_film_takes_no_break(tmp_path):
    listed = CliRunner().invoke(commands, ["simulate", "--list"])
    assert all(name in listed.output for name in PAPER_NAMES)
    with pytest.raises(UsageError, match="a paper's film"):
        write_scene("004-footbridge", tmp_path / "x", breaks=["gain"])
