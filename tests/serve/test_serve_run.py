"""`midspan run` with its server: wrong settings, a store that is away, commands, and answers all the while."""

import json
import os
import signal
import subprocess
import time

import httpx
import numpy as np
import pytest
from benchmarks.live.servers import command, free_port

from midspan.errors import UsageError
from midspan.service.stored_recording import stored_table
from midspan.service.supervise import in_force_file, settings_of
from midspan.store.store import open_store
from served import logged_in, until

SITE = """name = "site"
[store]
{store}
[service]
listen = "127.0.0.1:{port}"
[[point]]
name = "p"
{calibration}
[point.accelerometer]
source = "{accelerometer}"
unit = "m/s^2"
[point.{kind}]
source = "{source}"
{more}
"""
NOTHING = {
    "store": 'path = "store"', "calibration": "", "accelerometer": "serial:/dev/none", "kind": "displacement",
    "source": "serial:/dev/nothing", "more": 'unit = "mm"',
}  # fmt: skip


class Run:
    """`midspan run` in a folder."""

    def __init__(self, folder, **changes):
        self.folder, self.port, self.process = folder, free_port(), None
        self.text = SITE.format(port=self.port, **{**NOTHING, **changes})
        self.write(self.text)
        self.state = {"XDG_STATE_HOME": str(folder / "state")}
        self.client = httpx.Client(base_url=f"http://127.0.0.1:{self.port}", timeout=30.0)

    def write(self, text):
        (self.folder / "SITE.toml").write_text(text)

    def start(self):
        with open(self.folder / "run.log", "ab") as log:
            asked = command("run", self.folder / "SITE.toml")
            self.process = subprocess.Popen(asked, stdout=log, stderr=log, env={**os.environ, **self.state})
        until(self.ready)

    def ready(self):
        try:
            return self.client.get("/readyz").json()
        except httpx.TransportError:
            return None

    def reasons(self):
        """The reasons of sources by their names."""
        return {one["source"]: one["reason"] for one in self.ready()["sources"]}

    @property
    def log(self):
        return (self.folder / "run.log").read_text()

    def stop(self):
        self.client.close()
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            assert self.process.wait(timeout=60) == 0

    def restart(self):
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(timeout=60) == 0
        self.start()


@pytest.fixture
def site(tmp_path):
    """A function that starts a site of changed settings."""
    started = []

    def start(**changes):
        started.append(Run(tmp_path, **changes))
        started[-1].start()
        return started[-1]

    yield start
    for run in started:
        run.stop()


def test_wrong_settings_leave_page_login_and_what_was_in_force(site, tmp_path):
    run = site()
    (line,) = [line for line in run.log.splitlines() if "password: " in line]
    password = line.split("password: ")[1].split()[0]
    csrf = run.client.post("/api/v1/login", json={"user": "admin", "password": password}).json()["csrf"]
    run.write(run.text.replace('unit = "mm"', 'unt = "mm"'))
    run.restart()
    # The login is kept, and so is the point.
    fault = run.client.get("/api/v1/health").json()["settings"]
    assert fault["key"] == "point 'p': displacement.unt"
    assert fault["file"].endswith("SITE.toml")
    assert "is not a known key. Did you mean 'unit'?" in fault["text"]
    assert run.ready()["ready"] is False
    assert run.reasons()["settings"] == "settings"
    assert [one["name"] for one in run.client.get("/api/v1/points").json()] == ["p"]
    answer = run.client.get("/api/v1/settings")
    assert 'unt = "mm"' in answer.text
    server = pid_of_server(run)
    headers = {"If-Match": answer.headers["etag"], "X-CSRF-Token": csrf}
    assert run.client.put("/api/v1/settings", content=run.text, headers=headers).status_code == 200
    until(lambda: run.client.get("/api/v1/health").json()["settings"] is None)
    until(lambda: run.reasons().get("displacement") == "not_found")
    # A right file may name what is not there: it is not written, and what ran before goes on.
    missing = run.text.replace('name = "p"', 'name = "p"\ncalibration = "none.json"')
    etag = run.client.get("/api/v1/settings").headers["etag"]
    headers["If-Match"] = etag
    refused = run.client.put("/api/v1/settings", content=missing, headers=headers)
    assert (refused.status_code, "none.json" in refused.json()["detail"]) == (422, True)
    assert run.client.get("/api/v1/settings").text == run.text
    assert run.client.get("/api/v1/health").json()["settings"] is None
    # The server went on.
    assert pid_of_server(run) == server
    run.write(missing)
    run.restart()
    fault = until(lambda: run.client.get("/api/v1/health").json()["settings"])
    assert "none.json" in fault["text"]
    until(lambda: run.reasons().get("displacement") == "not_found")
    assert run.log.count("password: ") == 1


def pid_of_server(run):
    found = subprocess.run(["pgrep", "-P", str(run.process.pid)], capture_output=True, text=True, check=False)
    return found.stdout.split()


def test_settings_that_nothing_ran_with_are_refused(tmp_path):
    file = tmp_path / "SITE.toml"
    wrong = SITE.format(port=8080, **{**NOTHING, "kind": "displacment"})
    file.write_text(wrong)
    with pytest.raises(UsageError, match="displacment"):
        settings_of(file)
    # What ran before holds, in whatever way the file is wrong now.
    in_force_file(file).write_text(SITE.format(port=8080, **NOTHING))
    for text in (wrong, "[store", "", wrong.replace("[store]", "[stor]")):
        file.write_text(text)
        found = settings_of(file)
        assert found.fault.text.startswith(str(file))
        assert found.site.points[0].name == "p"
    file.unlink()
    assert settings_of(file).site is not None
    in_force_file(file).unlink()
    # Without it the page needs a store that somebody has access to.
    file.write_text(wrong)
    (tmp_path / "store").mkdir()
    (tmp_path / "store" / "access.sqlite").touch()
    found = settings_of(file)
    assert (found.site, found.service.listen, found.where) == (None, "127.0.0.1:8080", str(tmp_path / "store"))


def test_a_server_that_ends_is_started_again(site):
    run = site()
    (server,) = pid_of_server(run)
    subprocess.run(["kill", "-9", server], check=True)
    until(lambda: pid_of_server(run) not in ([], [server]) and run.ready())
    assert run.process.poll() is None
    assert "ended with code" in run.log
    assert "is restarted" in run.log


def test_a_second_run_on_a_store_is_refused_and_takes_nothing_away(site, tmp_path):
    run = site()
    other = tmp_path / "other"
    other.mkdir()
    text = run.text.replace(f":{run.port}", f":{free_port()}").replace('"p"', '"r"').replace('"store"', '"../store"')
    (other / "SITE.toml").write_text(text)
    done = subprocess.run(
        command("run", other / "SITE.toml", "--for", "5"), capture_output=True, text=True, check=False, timeout=120
    )
    assert (done.returncode, "another `midspan run` uses this store" in done.stderr) == (2, True)
    until(lambda: run.reasons().get("displacement") == "not_found")


def test_a_database_that_is_not_up_is_a_reason_and_no_exit(site, postgres):
    address = postgres.database("late")
    postgres.stop()
    try:
        run = site(store=f'url = "{address}"')
        until(lambda: run.reasons().get("store") == "store_unavailable")
        (point,) = run.ready()["points"]
        assert point["reason"]
        # How points stand is said all the same.
        run.client.headers["Authorization"] = f"Bearer {logged_in(address, 'script', 'read', state=run.state)}"
        (point,) = run.client.get("/api/v1/points").json()
        assert (point["name"], point["displacement_mm"]) == ("p", None)
        assert run.client.get("/api/v1/points/p/series").status_code == 503
        begun_s = time.monotonic()
        assert run.client.get("/healthz").status_code == 200
        assert time.monotonic() - begun_s < 5.0
    finally:
        postgres.start()
    until(lambda: "store" not in run.reasons())
    until(lambda: run.reasons().get("displacement") == "not_found")
    assert run.client.get("/api/v1/points/p/calibrations").json() == []
    assert address not in run.log


def test_a_broker_that_is_not_up_is_a_reason_and_no_exit(site):
    mqtt = f'path = "store"\n[mqtt]\nport = {free_port()}'
    run = site(store=mqtt, accelerometer="mqtt:a", source="mqtt:d")
    until(lambda: run.reasons().get("mqtt") == "broker_gone")
    assert run.process.poll() is None


def test_rows_pictures_pauses_and_files_of_a_site_that_runs(site, footbridge, tmp_path):
    from midspan.cli.main import run as command_line

    assert command_line(["calibrate", str(footbridge), "-o", str(tmp_path / "p.json"), "--quiet"]) == 0
    replay = f"replay:{footbridge}"
    run = site(
        calibration='calibration = "p.json"', accelerometer=replay, kind="camera", source=replay, more='direction = "y"'
    )
    run.client.headers["Authorization"] = f"Bearer {logged_in(tmp_path / 'store', 'script', 'operate')}"
    assert {one["reason"] for one in run.ready()["points"]} <= {"calibrating", "opening", "no_rows"}
    # The state comes twice a second, rows five times.
    point = until(lambda: tracking(run))
    assert point["calibration"] == 1
    assert point["age_s"] < 5.0
    picture = run.client.get("/api/v1/sources/p.camera/picture")
    assert picture.content.startswith(b"\xff\xd8")
    assert (picture.headers["x-midspan-width"], picture.headers["x-midspan-height"]) == ("96", "96")
    assert run.client.get("/api/v1/sources/p.accelerometer/picture").status_code == 409
    paused = run.client.post("/api/v1/sources/p.camera/pause", json={"reason": "camera taken down"})
    assert paused.status_code == 200
    until(lambda: run.reasons()["camera"] == "paused")
    source = next(one for one in run.client.get("/api/v1/sources").json() if one["source"] == "camera")
    assert (source["name"], source["text"]) == ("p.camera", "camera taken down")
    assert json.loads((tmp_path / "store" / "paused.json").read_text()) == {"p.camera": "camera taken down"}
    assert run.client.post("/api/v1/sources/p.camera/resume").status_code == 200
    until(lambda: run.reasons()["camera"] != "paused")
    assert run.client.post("/api/v1/points/p/calibrations/1/accept").status_code == 409
    table = until(lambda: rows_of(run))
    assert set(table["status"]) <= {"tracking", "coasting", "lost"}


def tracking(run):
    """The point once its rows rest on measurements."""
    point = run.client.get("/api/v1/points/p").json()
    rests = (point["status"], point["reason"]) == ("tracking", "") and point["displacement_mm"] is not None
    return point if rests else None


def rows_of(run):
    answer = run.client.get("/api/v1/points/p/series")
    table = answer.json() if answer.status_code == 200 else {}
    return table if len(table.get("time", [])) > 100 else None


REPLAYED = """[[point]]
name = "{name}"
calibration = "p.json"
{more}
[point.accelerometer]
source = "replay:{recording}"
[point.camera]
source = "replay:{recording}"
direction = "y"
"""


def put(run, text, etag="*", **options):
    answer = run.client.put("/api/v1/settings", content=text, headers={"If-Match": etag}, **options)
    assert answer.status_code == 200, answer.text
    return answer.json()


def source_of(run, name):
    return next(one for one in run.client.get("/api/v1/sources").json() if one["name"] == name)


def test_points_that_new_settings_leave_as_they_are_lose_no_row(site, footbridge, tmp_path):
    """One point is added and one changed while a third runs: its rows, its counts and its camera's process go on."""
    from midspan.cli.main import run as command_line

    assert command_line(["calibrate", str(footbridge), "-o", str(tmp_path / "p.json"), "--quiet"]) == 0
    point = lambda name, more="": REPLAYED.format(name=name, more=more, recording=footbridge)  # noqa: E731
    replay = f"replay:{footbridge}"
    run = site(
        calibration='calibration = "p.json"', accelerometer=replay, kind="camera", source=replay,
        more='direction = "y"\n' + point("b"),
    )  # fmt: skip
    run.client.headers["Authorization"] = f"Bearer {logged_in(tmp_path / 'store', 'script', 'admin')}"
    until(lambda: tracking(run))
    before, cameras = source_of(run, "p.accelerometer"), processes_of(run)
    changed = run.text.replace(point("b"), point("b", 'method = "lag"') + point("c"))
    expected = {"restart": [], "added": ["c"], "changed": ["b"], "removed": []}
    # What would happen is said before it does.
    tried = put(run, changed, params={"dry_run": "true"})
    assert {key: tried[key] for key in expected} == expected
    assert "Not saved" in tried["text"]
    assert (tmp_path / "SITE.toml").read_text() == run.text
    done = put(run, changed)
    assert {key: done[key] for key in expected} == expected
    names = lambda: [one["name"] for one in run.client.get("/api/v1/points").json()]  # noqa: E731
    until(lambda: names() == ["p", "b", "c"])
    until(lambda: (tmp_path / ".SITE.toml.in-force").read_text() == changed)
    until(lambda: source_of(run, "c.camera")["records"] > 0)
    # The first point's camera is the process that it was.
    assert processes_of(run) & cameras
    after = source_of(run, "p.accelerometer")
    assert after["records"] >= before["records"]
    until(lambda: source_of(run, "p.camera")["reason"] == "replay_ended")
    # 25 s of 100 Hz; on a busy machine the camera's process begins late.
    until(lambda: len((rows_of(run) or {"time": []})["time"]) > 1000)
    # Removing one leaves the others, too.
    done = put(run, changed.replace(point("c"), ""))
    assert (done["removed"], done["added"], done["changed"]) == (["c"], [], [])
    until(lambda: names() == ["p", "b"])
    run.stop()
    store = open_store(tmp_path / "store", read_only=True)
    times = stored_table(store, "p", None, None).time_ns
    store.close()
    # Each once and without a gap.
    assert len(times) > 1000
    assert set(np.diff(times)) == {10**7}


def processes_of(run):
    """The processes of cameras."""
    found = subprocess.run(["pgrep", "-P", str(run.process.pid), "-f", "spawn_main"], capture_output=True, text=True)
    return set(found.stdout.split())
