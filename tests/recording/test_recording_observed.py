"""What `inspect` and the report say before a run of what a camera's targets can tell of its tilt."""

import json

import pytest

import midspan
from lively_recordings import Lively, write
from midspan.cli.main import run
from recording_edits import set_keys

CASE = Lively(duration_s=20.0, rms_m=2e-3)
NEAR, BELOW, LOW, ASIDE = [18, 6, 34, 34], [18, 44, 34, 34], [18, 48, 34, 34], [40, 6, 34, 34]
NOT_OBSERVED = "slow tilt is not observed: add a target at least three times as far away or as near, stacked along y"
THIRD = "A third distinguishes it from a moving target"


def target(roi, name, distance_m=None, **more):
    return {"name": name, "roi": roi, **({} if distance_m is None else {"distance_m": distance_m}), **more}


@pytest.fixture
def folder(tmp_path):
    return write(tmp_path / "recording", CASE, "camera")


@pytest.mark.parametrize(
    ("targets", "said", "not_said"),
    [
        ((), [f"with one target {NOT_OBSERVED}"], ["third"]),
        ((target(NEAR, "a", 3.0), target(BELOW, "b", 10.0)), ["tilt along y is removed", THIRD], ["apart", "not"]),
        (
            (target(NEAR, "a", 3.0), target(BELOW, "b", 10.0), target(LOW, "c", 5.0)),
            ["tilt along y is removed."],
            [THIRD],
        ),
        ((target(NEAR, "a", 3.0), target(BELOW, "b", "far")), ["tilt along y is removed"], []),
        (
            (target(NEAR, "a", 10.0), target(BELOW, "b", 12.0, distance_std_m=2.0)),
            [f"all targets are at one distance, {NOT_OBSERVED}"],
            ["removed"],
        ),
        ((target(NEAR, "a"), target(BELOW, "b")), ["at one distance they do not (distance_m declares it)"], []),
        # 22 px across, 0.00038 px a millidegree.
        ((target(NEAR, "a", 3.0), target(ASIDE, "b", 10.0)), ["22 px apart across y", "0.00038 px", "Stack them"], []),
    ],
    ids=["one", "two", "three", "far", "one distance", "unknown", "aside"],
)
def test_what_the_targets_can_tell_is_said(targets, said, not_said, folder, capsys):
    if targets:
        set_keys(folder, "camera", roi=None, target=list(targets))
    assert run(["inspect", str(folder), "--json"]) == 0
    notes = json.loads(capsys.readouterr().out)["camera"]["notes"]
    (note,) = [one for one in notes if "tilt" in one]
    assert all(one in note for one in said)
    assert not any(one in note for one in not_said)


def test_a_declared_deviation_and_the_report_are_named(folder, tmp_path):
    set_keys(folder, "camera", tilt_std_mdeg=0.5, distance_m=12.0)
    result = midspan.estimate(folder)
    page = result.report(tmp_path / "report.html").read_text()
    assert page.count("with one target slow tilt is not observed beyond the 0.5 mdeg of tilt_std_mdeg") == 1
