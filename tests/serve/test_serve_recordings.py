"""`midspan open`: who may come in, what is shown of recordings, and what is done with them."""

import asyncio
import itertools
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import httpx
import numpy as np
import pytest
from scipy.io import loadmat

from midspan.cli.console import Console
from midspan.errors import DataError, UsageError
from midspan.records import NANOSECONDS
from midspan.serve.recordings.access import LinkAccess
from midspan.serve.recordings.desk import Desk
from midspan.serve.recordings.reading import bucketed, recordings_at
from midspan.serve.recordings.server import application, opened
from midspan.serve.recordings.tickets import Ticket, Tickets
from midspan.sinks.table import ResultTable
from midspan.sinks.write import write_result
from served import opened_recordings, until

API = "/api/v1/recordings"
RATE, SECONDS, PEAK_MM = 100, 120, 77.0


def made_result(folder):
    """A result as `midspan estimate` writes it: a slow motion with one peak, two seconds that are lost."""
    time_ns = np.arange(RATE * SECONDS) * (NANOSECONDS // RATE)
    value = np.sin(2 * np.pi * 0.1 * time_ns / NANOSECONDS)
    status = np.zeros(len(value), dtype=np.int8)
    status[5000:5200], value[5000:5200], value[7000] = 2, 500.0, PEAK_MM
    columns = {
        "time_s": time_ns / NANOSECONDS, "displacement_mm": value, "displacement_std_mm": np.full(len(value), 0.1),
        "velocity_mm_s": np.zeros(len(value)), "source": np.ones(len(value), dtype=np.int8), "status": status,
    }  # fmt: skip
    metadata = {
        "midspan": "0.1.0",
        "verdict": "It moved.",
        "method": "smoother",
        "not_in_band": ["tilt"],
        "notices": [],
        "events": [],
    }
    write_result(folder / "result.csv", ResultTable(columns, time_ns, metadata))


@pytest.fixture
def desk(footbridge_copy, tmp_path):
    work = tmp_path / "work"
    work.mkdir()
    return Desk(recordings_at(footbridge_copy), work)


@pytest.fixture
def visitor(desk):
    """A client without a token, by this machine's own name."""
    loop, ending, ready = asyncio.new_event_loop(), asyncio.Event(), threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        served = opened(desk, listener, ending, ready.set)
        serving = threading.Thread(target=loop.run_until_complete, args=[served])
        serving.start()
        assert ready.wait(30.0)
        with httpx.Client(base_url=f"http://127.0.0.1:{listener.getsockname()[1]}", timeout=60.0) as client:
            yield client
        loop.call_soon_threadsafe(ending.set)
        serving.join(30.0)
        loop.close()


@pytest.fixture
def client(visitor, desk):
    token = visitor.post("/api/v1/link", json={"link": desk.access.link()}).json()["token"]
    visitor.headers["Authorization"] = f"Bearer {token}"
    return visitor


def test_a_link_works_once_and_nothing_is_shown_without_one(visitor, desk):
    link = desk.access.link()
    assert visitor.post("/api/v1/link", json={"link": "another"}).status_code == 401
    token = visitor.post("/api/v1/link", json={"link": link}).json()["token"]
    again = visitor.post("/api/v1/link", json={"link": link})
    assert (again.status_code, again.json()["code"]) == (401, "link")
    assert token != link
    for wrong in ({}, {"Authorization": f"Bearer {link}"}, {"Cookie": f"midspan_session={token}"}):
        assert visitor.get(API, headers=wrong).status_code == 401
    assert visitor.get(API, headers={"Authorization": f"Bearer {token}"}).status_code == 200


def test_every_part_of_the_interface_needs_the_token(visitor, desk):
    paths = application(desk)._app._app.openapi()["paths"]
    asked = [(method, path) for path, methods in paths.items() for method in methods if not path.endswith("/link")]
    assert len(asked) >= 16
    for method, path in asked:
        answer = visitor.request(method, re.sub(r"\{\w+\}", "0", path))
        assert answer.status_code == 401, path
        assert answer.headers["content-type"] == "application/problem+json"


def test_a_page_of_another_host_whose_name_leads_here_gets_nothing(client):
    for host in ("evil.example", "evil.example:8123", "127.0.0.1.evil.example", "[::2]:8123"):
        assert client.get("/", headers={"Host": host}).status_code == 403, host
        assert client.get(API, headers={"Host": host}).status_code == 403, host
    for host in ("localhost:9000", "127.0.0.1:1", "[::1]:8123", "LOCALHOST"):
        assert client.get(API, headers={"Host": host}).status_code == 200, host
    # No other origin may read an answer, nor ask with a token.
    answer = client.options(API, headers={"Origin": "http://evil.example", "Access-Control-Request-Method": "GET"})
    assert answer.status_code == 405
    assert not [name for name in answer.headers if name.startswith("access-control")]


@pytest.mark.slow
def test_every_answer_is_declared_whatever_is_sent(visitor, desk, tmp_path):
    """schemathesis with all of its checks, as of the interface over a store."""
    pytest.importorskip("schemathesis")
    token = visitor.post("/api/v1/link", json={"link": desk.access.link()}).json()["token"]
    made_result(desk.files[0].parent)
    settings = Path(__file__).with_name("schemathesis.toml")
    done = subprocess.run(
        [
            sys.executable, "-m", "schemathesis.cli", "--config-file", str(settings), "run",
            f"{visitor.base_url}/api/v1/openapi.json", "-H", f"Authorization: Bearer {token}",
            "--checks", "all", "--max-examples", "5", "--seed", "1", "--continue-on-failure", "--no-color",
        ],
        capture_output=True, text=True, check=False, timeout=900, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-20_000:] + done.stderr[-2000:]


def test_links_and_tickets_are_forgotten_once_they_are_used(monkeypatch, tmp_path):
    access, tickets = LinkAccess(), Tickets()
    first, second = access.link(), access.link()
    assert access.of_token(access.changed(second)).scope == "admin"
    assert access.changed(first) is not None
    assert access.changed(first) is None
    assert access.of_token("") is None
    number = tickets.put(Ticket(tmp_path, "text/plain"))
    assert tickets.take(number).file == tmp_path
    assert tickets.take(number) is None
    late = tickets.put(Ticket(tmp_path, "text/plain"))
    now_s = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now_s + 61.0)
    assert tickets.take(late) is None


def test_a_recording_is_listed_with_what_lies_in_its_folder(client, footbridge_copy):
    (one,) = client.get(API).json()["recordings"]
    assert (one["number"], one["folder"], one["fault"]) == (0, str(footbridge_copy), "")
    assert [stream["name"] for stream in one["streams"]] == ["accelerometer", "camera", "reference"]
    assert one["cameras"] == [{"name": "camera", "kind": "camera", "regions": []}]
    assert one["result_s"] is None
    made_result(footbridge_copy)
    assert client.get(API).json()["recordings"][0]["result_s"] is not None
    assert client.get(f"{API}/1/result").status_code == 404
    settings = footbridge_copy / "recording.toml"
    settings.write_text(settings.read_text().replace("direction", "drection"))
    assert "Did you mean 'direction'?" in client.get(API).json()["recordings"][0]["fault"]


def test_its_first_frame_has_its_size(client):
    answer = client.get(f"{API}/0/cameras/camera/picture")
    assert answer.content[:2] == b"\xff\xd8"
    assert (answer.headers["x-midspan-width"], answer.headers["x-midspan-height"]) == ("96", "96")
    assert client.get(f"{API}/0/cameras/other/picture").status_code == 422


def test_settings_are_checked_with_their_region_before_they_are_written(client, footbridge_copy):
    before = client.get(f"{API}/0/settings")
    tag, file = before.headers["etag"], footbridge_copy / "recording.toml"

    def put(text, tag=tag):
        return client.put(f"{API}/0/settings", content=text.encode(), headers={"If-Match": tag})

    for wrong, says in (("roi = [0, 0, 9000, 20]", "must lie inside the image"), ("roy = 1", "Did you mean 'roi'?")):
        answer = put(before.text.replace("[camera]", f"[camera]\n{wrong}"))
        assert answer.status_code == 422
        assert says in answer.json()["detail"]
    assert client.put(f"{API}/0/settings", content=b"x").status_code == 428
    assert file.read_text() == before.text
    changed = before.text.replace("[camera]", "[camera]\nroi = [10, 20, 64, 48]")
    assert put(changed).status_code == 200
    assert file.read_text() == changed
    assert client.get(API).json()["recordings"][0]["cameras"][0]["regions"] == [[10, 20, 64, 48]]
    assert put(before.text).status_code == 412
    assert sorted(one.name for one in footbridge_copy.iterdir() if one.name.startswith(".")) == []


def test_a_peak_keeps_its_height_and_what_is_lost_has_no_value(client, footbridge_copy):
    assert "Estimate the recording first" in client.get(f"{API}/0/result").json()["detail"]
    made_result(footbridge_copy)
    found = client.get(f"{API}/0/result").json()
    assert (found["method"], found["not_in_band"], found["rows"]) == ("smoother", ["tilt"], RATE * SECONDS)
    assert found["verdict"] == "It moved."
    assert (found["from_s"], found["to_s"]) == (0.0, SECONDS - 0.01)
    for count in (1, 7, 1000):
        asked = {"from_s": 0, "to_s": SECONDS, "buckets": count}
        series = client.get(f"{API}/0/series", params=asked).json()
        assert len(series["time"]) == count
        assert max(value for value in series["displacement_mm_max"] if value is not None) == PEAK_MM
    rows = client.get(f"{API}/0/series", params={"from_s": 49.98, "to_s": 50.02}).json()
    assert rows["status"] == ["tracking", "tracking", "lost", "lost"]
    assert rows["displacement_mm"][2:] == [None, None]
    # Against the reference, where there is one: a value less that at its instant.
    asked = {"from_s": 10, "to_s": 10.005}
    of = [client.get(f"{API}/0/series", params={**asked, "of": one}).json() for one in ("result", "reference", "error")]
    result, reference, error = (one["displacement_mm"][0] for one in of)
    assert error == pytest.approx(result - reference, abs=1e-9)
    late = client.get(f"{API}/0/series", params={"from_s": 100, "to_s": 100.005, "of": "error"}).json()
    assert late["displacement_mm"] == [None]
    assert "one axis only" in client.get(f"{API}/0/series", params={**asked, "of": "across"}).json()["detail"]
    for wrong in ({"from_s": 5, "to_s": 5}, {"from_s": "nan", "to_s": 5}, {"from_s": 0, "to_s": 1, "of": "x"}):
        assert client.get(f"{API}/0/series", params=wrong).status_code == 422
    assert client.get(f"{API}/0/spectrum", params={"from_s": 60, "to_s": 110}).json()["frequency_hz"]


def test_a_second_axis_is_read_from_its_own_columns(client, footbridge_copy):
    header = "time_s,displacement_mm,displacement_std_mm,status,displacement_x_mm,displacement_std_x_mm,status_x\n"
    (footbridge_copy / "result.csv").write_text(
        f"{header}0,1,0.1,tracking,5,0.5,tracking\n1,2,0.2,lost,6,0.6,coasting\n"
    )
    rows = client.get(f"{API}/0/series", params={"from_s": 0, "to_s": 2, "of": "across"}).json()
    assert (rows["displacement_mm"], rows["displacement_std_mm"]) == ([5.0, 6.0], [0.5, 0.6])
    assert rows["status"] == ["tracking", "coasting"]


def test_buckets_are_those_of_a_loop():
    generator = np.random.default_rng(3)
    time_ns = np.cumsum(generator.integers(1, 50, 500))
    value, std = generator.normal(size=500), generator.uniform(size=500)
    value[100:160] = np.nan
    edges = np.linspace(-400.0, float(time_ns[-1]) - 900.0, 60)
    found = bucketed(edges, time_ns, value, std)
    for at, (begin, end) in enumerate(itertools.pairwise(edges)):
        inside = (time_ns >= begin) & (time_ns < end)
        known = value[inside & np.isfinite(value)]
        values = [found[f"displacement_mm_{name}"][at] for name in ("min", "max", "mean")]
        if len(known):
            # Sums in another order differ in their last digits.
            assert values == pytest.approx([known.min(), known.max(), known.mean()], abs=1e-12)
        else:
            assert values == [None, None, None]
        assert found["rows"][at] == len(known)
        assert found["displacement_std_mm"][at] == (std[inside].max() if inside.any() else None)


def test_a_file_is_made_and_given_once(client, footbridge_copy, desk):
    def wanted(kind):
        return client.post(f"{API}/0/files", json={"format": kind})

    assert wanted("report").status_code == 409
    made_result(footbridge_copy)
    path = wanted("mat").json()["path"]
    # A browser sends no token with it.
    got = client.get(path, headers={"Authorization": ""})
    assert got.headers["content-disposition"].startswith("attachment")
    file = footbridge_copy / "got.mat"
    file.write_bytes(got.content)
    assert loadmat(file)["displacement_mm"].max() == 500.0
    assert client.get(path).status_code == 404
    # It is removed once it was sent.
    until(lambda: not any(one.is_file() for one in desk.folder.rglob("*")))
    (footbridge_copy / "report.html").write_text("<script>alert(1)</script>")
    policy = client.get(wanted("report").json()["path"]).headers["content-security-policy"]
    # Of an origin of its own: what a report holds has no access to the page's token.
    assert policy.startswith("sandbox allow-scripts")
    assert "allow-same-origin" not in policy
    assert wanted("exe").status_code == 422


def test_one_calculation_runs_at_a_time_and_can_be_cancelled(client, footbridge_copy):
    before = sorted(footbridge_copy.iterdir())
    assert client.get(f"{API}/0/job").json() == {}
    for wrong in ({"method": "x"}, {"tracker": "--help"}, {"output": "x"}):
        assert client.post(f"{API}/0/estimate", json=wrong).status_code == 422
    assert client.post(f"{API}/0/estimate", json={"method": "kalman"}).status_code == 202
    assert client.post(f"{API}/0/calibrate").status_code == 409
    job = until(lambda: (found := client.get(f"{API}/0/job").json())["total"] and found)
    assert "--method kalman" in job["command"]
    assert client.post(f"{API}/0/cancel").status_code == 200
    assert client.get(f"{API}/0/job").json()["state"] == "cancelled"
    assert client.post(f"{API}/0/cancel").status_code == 409
    assert sorted(footbridge_copy.iterdir()) == before
    # What a command refuses is said.
    (footbridge_copy / "accel.csv").write_text("nothing")
    client.post(f"{API}/0/calibrate")
    job = until(lambda: (found := client.get(f"{API}/0/job").json())["state"] != "running" and found)
    assert job["state"] == "failed"
    assert "accel.csv" in job["text"]


def test_recordings_are_found_below_a_folder(tmp_path):
    for name in ("b", "a/x"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "recording.toml").touch()
    assert [file.parent.name for file in recordings_at(tmp_path)] == ["x", "b"]
    assert recordings_at(tmp_path / "b") == recordings_at(tmp_path / "b" / "recording.toml")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="midspan init"):
        recordings_at(tmp_path / "empty")
    (tmp_path / "accel.csv").touch()
    with pytest.raises(UsageError, match="midspan init"):
        recordings_at(tmp_path / "accel.csv")


def test_progress_comes_as_lines_for_a_program(monkeypatch, capsys):
    monkeypatch.setenv("MIDSPAN_PROGRESS", "json")
    console = Console(quiet=False, as_json=True)
    for done in range(100):
        console.progress(done, 100, "tracking")
    console.progress(100, 100, "tracking")
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    # The first, the last, and few between: this took no fifth of a second.
    assert lines[0] == {"done": 0, "total": 100, "what": "tracking"}
    assert lines[-1]["done"] == 100
    assert len(lines) <= 10


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_the_command_ends_with_all_that_it_began(footbridge_copy):
    process, document = opened_recordings(footbridge_copy)
    try:
        assert document["recordings"] == [str(footbridge_copy)]
        base, link = re.fullmatch(r"(http://127\.0\.0\.1:\d+)/#/link/([\w-]{43})", document["address"]).groups()
        with httpx.Client(base_url=base, timeout=60.0) as client:
            token = client.post("/api/v1/link", json={"link": link}).json()["token"]
            client.headers["Authorization"] = f"Bearer {token}"
            client.post(f"{API}/0/estimate", json={})
            until(lambda: client.get(f"{API}/0/job").json()["total"])
        (child,) = children(process.pid)
        process.send_signal(signal.SIGINT)
        assert process.wait(30.0) == 0
        assert "Traceback" not in process.stderr.read()
        until(lambda: not os.path.exists(f"/proc/{child}"), 10.0)
    finally:
        process.kill()
        process.communicate()


def children(parent):
    """The processes of `midspan estimate` that a process started."""
    found = []
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            status = Path(f"/proc/{name}/status").read_text()
            command = Path(f"/proc/{name}/cmdline").read_text()
        except OSError:
            continue
        if f"PPid:\t{parent}\n" in status and "estimate" in command:
            found.append(int(name))
    return found


def test_the_browser_is_led_by_a_file_that_only_this_user_reads(tmp_path, monkeypatch):
    import webbrowser

    from midspan.cli.open import _browse

    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    _browse("http://127.0.0.1:1/#/link/secret", tmp_path, Console(quiet=True, as_json=False))
    until(lambda: opened)
    # What a program is started with all users may read.
    assert "secret" not in opened[0]
    file = tmp_path / "open.html"
    assert "secret" in file.read_text()
    assert file.stat().st_mode & 0o077 == 0
    shutil.rmtree(tmp_path)
