"""Campaigns: what a worker writes is what `estimate` gives; what is done is not done again; nothing stops the rest."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from campaign_runs import NAMES, rows_of

import midspan
from midspan.errors import UsageError
from midspan.scale.runners import Died, LocalRunner, ProcessRunner


def test_a_campaign_gives_the_rows_of_each_estimate(campaign, recording):
    result = midspan.batch(campaign, runner="local")
    assert [one.recording for one in result.outcomes] == list(NAMES)
    assert result.exit_code == 0
    alone = midspan.estimate(recording, method="kalman")
    rows = rows_of(campaign)
    assert sorted(rows["recording"].unique()) == sorted(NAMES)
    for name in NAMES:
        own = rows[rows["recording"] == name]
        assert np.array_equal(own["displacement_mm"], alone.displacement_mm)
        assert np.array_equal(own["displacement_std_mm"], alone.displacement_std_mm)
    summary = pd.read_csv(campaign / "results" / "summary.csv", keep_default_na=False)
    assert list(summary["rows"]) == [len(alone.time_s)] * 3
    expected = midspan.compare(alone, recording).to_dict()["rmse_mm"]
    assert summary["rmse_mm"].to_numpy() == pytest.approx(expected)
    pd.testing.assert_frame_equal(summary, pd.read_parquet(campaign / "results" / "summary.parquet"), check_dtype=False)
    assert "2026-02/a" in (campaign / "results" / "summary.html").read_text()


def test_what_is_done_is_not_done_again_until_a_file_changes(campaign):
    midspan.batch(campaign, runner="local")
    parts = sorted((campaign / "results" / "rows").glob("*/part.parquet"))
    before = [part.stat().st_mtime_ns for part in parts]
    changed = campaign / NAMES[1] / "recording.toml"
    changed.write_text(changed.read_text() + "\n# another noise\n")
    midspan.batch(campaign, runner="local")
    after = [part.stat().st_mtime_ns for part in parts]
    assert [one != other for one, other in zip(before, after, strict=True)] == [False, True, False]


def test_one_that_fails_does_not_stop_the_rest(campaign):
    (campaign / NAMES[0] / "recording.toml").write_text("[accelerometer]\nfil = 'a.csv'\n")
    result = midspan.batch(campaign, runner="process", workers=2)
    assert [one.exit_code for one in result.outcomes] == [2, 0, 0]
    assert result.exit_code == 3
    assert "fil" in result.outcomes[0].message
    assert "fil" in (campaign / "results" / "summary.html").read_text()
    # Mended, it alone is estimated.
    shutil.copy(campaign / NAMES[1] / "recording.toml", campaign / NAMES[0] / "recording.toml")
    assert midspan.batch(campaign, runner="process").exit_code == 0
    # What is refused later has no rows of before.
    (campaign / NAMES[0] / "recording.toml").write_text("[accelerometer]\nfil = 'a.csv'\n")
    assert midspan.batch(campaign, runner="local").exit_code == 3
    assert sorted(rows_of(campaign)["recording"].unique()) == sorted(NAMES[1:])


def test_processes_give_what_one_process_gives(campaign):
    midspan.batch(campaign, runner="local")
    alone = rows_of(campaign)
    shutil.rmtree(campaign / "results")
    midspan.batch(campaign, runner="process", workers=2)
    pd.testing.assert_frame_equal(alone, rows_of(campaign))


def test_a_table_names_pairs_of_files(recording, tmp_path):
    names = {one.name for one in recording.iterdir()}
    accel, gnss = next(n for n in names if n.startswith("accel")), next(n for n in names if "gnss" in n or "disp" in n)
    shutil.copy(recording / accel, tmp_path / "a.csv")
    shutil.copy(recording / gnss, tmp_path / "g.csv")
    (tmp_path / "pairs.csv").write_text("accelerometer,video,unit,displacement_unit\na.csv,g.csv,m/s^2,mm\n")
    (tmp_path / "CAMPAIGN.toml").write_text('table = "pairs.csv"\noutput = "results"\n')
    (outcome,) = midspan.batch(tmp_path, runner="local").outcomes
    assert (outcome.recording, outcome.exit_code) == ("g", 0), outcome.message


@pytest.mark.parametrize("wrong", ['file = "/etc/passwd"', 'file = "../a/accel.csv"'])
def test_a_recording_reads_nothing_outside_its_folder(wrong, campaign):
    file = campaign / NAMES[0] / "recording.toml"
    lines = file.read_text().splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("file"))
    file.write_text("\n".join([*lines[:first], wrong, *lines[first + 1 :]]))
    outcomes = midspan.batch(campaign, runner="local").outcomes
    assert [one.exit_code for one in outcomes] == [3, 0, 0]
    assert "leads out of the recording's folder" in outcomes[0].message


@pytest.mark.skipif(sys.platform == "win32", reason="needs symbolic links")
def test_links_that_lead_out_are_not_followed(campaign):
    file = next(one for one in (campaign / NAMES[0]).iterdir() if one.name.startswith("accel"))
    target = campaign / NAMES[1] / file.name
    file.unlink()
    file.symlink_to(target)
    assert midspan.batch(campaign, runner="local").outcomes[0].exit_code == 3


def test_hdf5_with_a_link_to_another_file_is_not_read(campaign):
    folder = campaign / NAMES[0]
    file = next(one for one in folder.iterdir() if one.name.startswith("accel"))
    with h5py.File(folder / "accel.h5", "w") as inside:
        inside["accel"] = h5py.ExternalLink(str(campaign / "secret.h5"), "/accel")
    text = (folder / "recording.toml").read_text().replace(f'"{file.name}"', '"accel.h5"')
    (folder / "recording.toml").write_text(text)
    outcome = midspan.batch(campaign, runner="local").outcomes[0]
    assert outcome.exit_code == 3
    assert "link to another file" in outcome.message


def test_a_table_says_which_of_its_files_is_missing(recording, tmp_path):
    (tmp_path / "pairs.csv").write_text("accelerometer,video\na.csv,none.csv\n")
    (tmp_path / "CAMPAIGN.toml").write_text('table = "pairs.csv"\noutput = "results"\n')
    (outcome,) = midspan.batch(tmp_path, runner="local").outcomes
    assert outcome.exit_code == 3
    assert "a.csv: no such file" in outcome.message


def test_a_tracker_of_all_is_that_of_those_with_a_camera(campaign):
    file = campaign / "CAMPAIGN.toml"
    file.write_text(file.read_text() + 'tracker = "phase"\n')
    assert midspan.batch(campaign, runner="local").exit_code == 0


def test_wrong_campaigns_are_refused_in_words(tmp_path):
    (tmp_path / "CAMPAIGN.toml").write_text('output = "results"\n')
    with pytest.raises(UsageError, match="must name recordings or a table"):
        midspan.batch(tmp_path)
    (tmp_path / "CAMPAIGN.toml").write_text('recordings = ["*", "none"]\noutput = "results"\n')
    with pytest.raises(UsageError, match=r"none: has no recording\.toml"):
        midspan.batch(tmp_path)
    (tmp_path / "CAMPAIGN.toml").write_text('recordings = ["none*"]\noutput = "results"\nmethod = "magic"\n')
    with pytest.raises(UsageError, match="must be one of smoother"):
        midspan.batch(tmp_path)


@dataclass
class Fragile:
    """A task; its worker dies in the first so many attempts, of which a file keeps the number."""

    marks: str
    deaths: int


def attempt(task):
    path = task.marks
    with open(path, "a") as file:
        file.write("x")
    if os.path.getsize(path) <= task.deaths:
        os._exit(9)
    return os.path.getsize(path)


def test_a_task_whose_worker_died_is_begun_once_more(tmp_path):
    tasks = [Fragile(str(tmp_path / str(k)), deaths) for k, deaths in enumerate((0, 1, 5, 0))]
    found = dict(ProcessRunner(2).run(attempt, tasks))
    assert [found[k] for k in (0, 1, 3)] == [1, 2, 1]
    assert isinstance(found[2], Died)
    assert (tmp_path / "2").read_text() == "xx"


def test_a_script_needs_no_guard(campaign):
    script = campaign / "script.py"
    script.write_text('import midspan\nprint(midspan.batch("CAMPAIGN.toml", workers=2).exit_code)\n')
    found = subprocess.run([sys.executable, str(script)], check=True, capture_output=True, text=True, cwd=campaign)
    assert (found.stdout, found.stderr) == ("0\n", "")


def test_the_local_runner_goes_in_order():
    assert list(LocalRunner().run(json.dumps, [1, 2])) == [(0, "1"), (1, "2")]


def test_recordings_of_a_store_are_fetched_by_the_worker(recording, tmp_path):
    fsspec = pytest.importorskip("fsspec")
    memory = fsspec.filesystem("memory")
    for name in ("a", "b"):
        memory.put(str(recording) + "/", f"/bridge/{name}/", recursive=True)
    (tmp_path / "CAMPAIGN.toml").write_text('recordings = ["memory://bridge/*"]\noutput = "results"\n')
    outcomes = midspan.batch(tmp_path, runner="local").outcomes
    assert [(one.recording, one.exit_code) for one in outcomes] == [
        ("memory:///bridge/a", 0),
        ("memory:///bridge/b", 0),
    ]
    rows = rows_of(tmp_path)
    own = rows[rows["recording"] == "memory:///bridge/a"]
    assert np.array_equal(own["displacement_mm"], midspan.estimate(recording).displacement_mm)
    parts = sorted((tmp_path / "results" / "rows").glob("*/part.parquet"))
    before = [part.stat().st_mtime_ns for part in parts]
    midspan.batch(tmp_path, runner="local")
    assert [part.stat().st_mtime_ns for part in parts] == before


def test_a_cluster_gives_the_same_and_begins_again_what_a_lost_worker_had(ray_cluster, campaign, tmp_path):
    from midspan.scale.runners import RayRunner

    ray_cluster.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    tasks = [Fragile(str(tmp_path / str(k)), deaths) for k, deaths in enumerate((0, 1, 5))]
    found = dict(RayRunner(2).run(attempt, tasks))
    assert (found[0], found[1]) == (1, 2)
    assert isinstance(found[2], Died)
    midspan.batch(campaign, runner="local")
    alone = rows_of(campaign)
    shutil.rmtree(campaign / "results")
    midspan.batch(campaign, runner="ray", workers=2)
    pd.testing.assert_frame_equal(alone, rows_of(campaign))


def test_a_cluster_of_this_machine_listens_on_loopback_alone(ray_cluster):
    (node,) = ray_cluster.nodes()
    assert node["NodeManagerAddress"] == "127.0.0.1"
    ports = {node["NodeManagerPort"], node["ObjectManagerPort"]}
    assert {address for address, port in listening() if port in ports} <= {LOOPBACK, LOOPBACK_6}
    assert node["Resources"]["object_store_memory"] <= 1e8


LOOPBACK, LOOPBACK_6 = "0100007F", "0000000000000000FFFF00000100007F"


def listening():
    """Address, as the kernel writes it, and port of each socket that waits for connections."""
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            _, own, _, state = line.split()[:4]
            if state == "0A":
                yield own.split(":")[0], int(own.split(":")[1], 16)


NOTHING_OF_RAY = """
import sys
import midspan, midspan.scale.batch, midspan.scale.runners
from midspan.cli.main import main
try:
    main(["batch", "--help"])
except SystemExit:
    pass
midspan.batch(sys.argv[1], runner="process", workers=1)
assert not [name for name in sys.modules if name.partition(".")[0] == "ray"]
"""


def test_nothing_of_ray_is_imported_without_its_runner(campaign):
    subprocess.run([sys.executable, "-c", NOTHING_OF_RAY, str(campaign)], check=True, stdout=subprocess.DEVNULL)


def test_a_full_disk_ends_a_campaign_with_a_sentence_and_loses_nothing(campaign):
    midspan.batch(campaign, runner="local")
    done = campaign / "results" / "done"
    before = {one.name: one.read_bytes() for one in done.iterdir()}
    changed = campaign / NAMES[2] / "recording.toml"
    changed.write_text(changed.read_text() + "\n# again\n")
    rows = next((campaign / "results" / "rows").glob("*2026-02*"))
    shutil.rmtree(rows)
    # A file in the place of the folder: as little can be written as on a full disk.
    rows.write_text("")
    for runner in ("local", "process"):
        with pytest.raises(UsageError, match="cannot be written"):
            midspan.batch(campaign, runner=runner, workers=1)
    assert {one.name: one.read_bytes() for one in done.iterdir()} == before
    rows.unlink()
    assert midspan.batch(campaign, runner="local").exit_code == 0
    assert {one.name for one in done.iterdir()} == {*before}
