"""Files under faults: whatever happens while they are written, the old or the new one is there, whole and alone."""

import os
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest

import midspan
from faults import in_child, killed_before, largest_file
from midspan.cli.main import run
from midspan.records import part

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="kills and limits of a POSIX system")

SUFFIXES = [".csv", ".parquet", ".h5", ".mat", ".xlsx", ".tdms", ".mseed", ".uff"]
FEW_BYTES = 1000  # less than any of the files
ROWS = 500


@pytest.fixture(scope="module")
def result(gnss):
    """Ten seconds of rows: what a kill meets are the steps of a write, not its length."""
    found = midspan.estimate(midspan.open_recording(gnss))
    return replace(found, estimate=part(found.estimate, np.arange(len(found.time_s)) < ROWS))


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_full_disk_is_one_error_that_names_the_file_and_the_old_one_stays(result, suffix, tmp_path):
    path = tmp_path / f"r{suffix}"
    path.write_bytes(b"old")
    with largest_file(FEW_BYTES), pytest.raises(midspan.UsageError) as caught:
        result.save(path)
    assert f"r{suffix} cannot be written: " in str(caught.value)
    assert contents(tmp_path) == {path.name: b"old"}


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", ["report.html", "calibration.json"])
def test_a_full_disk_stops_report_and_calibration_likewise(result, name, tmp_path):
    path = tmp_path / name
    path.write_bytes(b"old")
    from midspan.report.report import write_report

    write = result.calibration.save if name.endswith("json") else lambda path: write_report(result, path)
    with largest_file(100), pytest.raises(midspan.UsageError, match=name):
        write(path)
    assert contents(tmp_path) == {name: b"old"}


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_kill_at_any_step_leaves_the_old_or_the_new_file(result, suffix, tmp_path):
    whole, place = tmp_path / "whole", tmp_path / "place"
    whole.mkdir()
    result.save(whole / f"r{suffix}")
    new = contents(whole)
    step = 0
    while True:
        place.mkdir()
        old = dict.fromkeys(new, b"old")
        for name in old:
            (place / name).write_bytes(b"old")
        step += 1
        killed = killed_before(step, lambda: result.save(place / f"r{suffix}"))
        found = contents(place)
        assert all(found[name] in (b"old", new[name]) for name in new)
        if not killed:
            break
        # The next write works and takes away what the kill has left.
        result.save(place / f"r{suffix}")
        assert contents(place) == new
        for name in new:
            (place / name).unlink()
        place.rmdir()
    assert found == new
    assert step > 5


def test_what_another_process_is_still_writing_is_left_alone(result, tmp_path):
    ready, go = os.pipe(), os.pipe()
    ours, theirs = tmp_path / "ours.csv", tmp_path / "theirs.csv"

    def slow():
        real = os.fsync

        def wait(descriptor):
            os.write(ready[1], b".")
            os.read(go[0], 1)
            real(descriptor)

        os.fsync = wait
        result.save(theirs)

    # Two levels, so that this process goes on while the writer waits.
    child = os.fork()
    if child == 0:
        try:
            slow()
        finally:
            os._exit(0)
    os.read(ready[0], 1)
    result.save(ours)
    # One answer for each of its files and folders, and some to spare.
    os.write(go[1], b"." * 10)
    os.waitpid(child, 0)
    assert theirs.read_bytes() == ours.read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["ours.csv", "ours.json", "theirs.csv", "theirs.json"]


def test_remains_of_other_programs_stay(result, tmp_path):
    (tmp_path / ".r-abc.csv").write_text("not ours")
    result.save(tmp_path / "r.csv")
    assert (tmp_path / ".r-abc.csv").read_text() == "not ours"


def test_a_file_that_another_pair_belongs_to_is_reported_by_compare(result, gnss, tmp_path, capsys):
    result.save(tmp_path / "r.csv")
    assert run(["compare", str(tmp_path / "r.csv"), str(gnss)]) == 0
    assert "belong" not in capsys.readouterr().err
    with (tmp_path / "r.csv").open("a") as file:
        file.write("\n")
    assert run(["compare", str(tmp_path / "r.csv"), str(gnss)]) == 0
    said = capsys.readouterr().err
    assert "r.csv and r.json do not belong together" in said
    # Old results have no check sum.
    (tmp_path / "r.json").write_text('{"midspan": "0.0.1"}')
    assert run(["compare", str(tmp_path / "r.csv"), str(gnss)]) == 0
    assert "belong" not in capsys.readouterr().err


def simulate(folder, seed):
    return run(["simulate", "gnss", "-o", str(folder), "--seed", str(seed), "--quiet"])


def test_simulate_killed_between_its_renames_loses_neither_recording(tmp_path):
    for seed, name in ((1, "first"), (2, "second")):
        assert simulate(tmp_path / name, seed) == 0
    old, new = contents(tmp_path / "first"), contents(tmp_path / "second")
    step, put_back, place = 0, 0, tmp_path / "place"
    while True:
        step += 1
        shutil.copytree(tmp_path / "first", place / "g")
        killed = killed_before(step, lambda: simulate(place / "g", 2), ("rename", "rmdir"))
        if not killed:
            break
        if (place / "g").exists():
            assert contents(place / "g") in (old, new)
        else:
            put_back += 1
            # The next run fails on a full disk: what it finds in order is the old recording.
            with largest_file(FEW_BYTES):
                assert simulate(place / "g", 3) == 2
            assert contents(place / "g") == old
        assert simulate(place / "g", 2) == 0
        assert contents(place) == {f"g/{name}": content for name, content in new.items()}
        shutil.rmtree(place)
    assert contents(place / "g") == new
    assert put_back == 1


def test_simulate_on_a_full_disk_keeps_the_old_recording(tmp_path, capsys):
    assert simulate(tmp_path / "g", 1) == 0
    before = contents(tmp_path)
    with largest_file(FEW_BYTES):
        assert simulate(tmp_path / "g", 2) == 2
    assert "cannot be written" in capsys.readouterr().err
    assert contents(tmp_path) == before


def test_simulate_over_a_link_replaces_the_folder_that_it_names(tmp_path):
    assert simulate(tmp_path / "g", 1) == 0
    (tmp_path / "link").symlink_to(tmp_path / "g")
    assert simulate(tmp_path / "link", 2) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["g", "link"]
    assert (tmp_path / "link").is_symlink()
    assert simulate(tmp_path / "other", 2) == 0
    assert contents(tmp_path / "g") == contents(tmp_path / "other")


def test_a_child_reports_how_it_ended():
    assert in_child(lambda: None) == 0
    assert killed_before(1, lambda: os.open(os.devnull, os.O_RDONLY))
    assert not killed_before(2, lambda: os.open(os.devnull, os.O_RDONLY))
