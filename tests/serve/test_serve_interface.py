"""The interface is as its own description says, whatever comes."""

import re
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from served import Served, opened_recordings

SETTINGS = Path(__file__).with_name("schemathesis.toml")


@pytest.fixture
def own_server(store_folder, tokens, engine):
    """Another server on the store: its logins fail until the address has to wait."""
    served = Served(store_folder)
    yield served
    served.stop()


def tried(address, token, folder, *more):
    """schemathesis with all of its checks: of each operation the examples, the edges, some random values, sequences."""
    pytest.importorskip("schemathesis")
    done = subprocess.run(
        [
            sys.executable, "-m", "schemathesis.cli", "--config-file", str(SETTINGS), "run",
            f"{address}/api/v1/openapi.json", "-H", f"Authorization: Bearer {token}",
            "--checks", "all", "--seed", "1", "--continue-on-failure", "--no-color", *more,
        ],
        capture_output=True, text=True, check=False, timeout=900, cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-20_000:] + done.stderr[-2000:]


def test_every_answer_is_declared_whatever_is_sent(own_server, tokens, store_folder, tmp_path):
    (store_folder.parent / "SITE.toml").write_text("a wrong one\n")
    tried(f"http://127.0.0.1:{own_server.port}", tokens["admin"], tmp_path, "--max-examples", "5")
    assert "Traceback" not in own_server.log


@pytest.mark.slow
def test_over_recordings_as_well(footbridge_copy, tmp_path):
    """The interface of `midspan open`; each inspect and estimate that is asked for is a process of its own."""
    process, document = opened_recordings(footbridge_copy)
    try:
        address, _, link = document["address"].partition("/#")
        link = re.search(r"[\w-]{40,}", link)[0]
        token = httpx.post(f"{address}/api/v1/link", json={"link": link}, timeout=60.0).json()["token"]
        tried(address, token, tmp_path, "--max-examples", "3", "--phases", "examples,coverage,fuzzing")
    finally:
        process.terminate()
        _, errors = process.communicate(timeout=60)
    assert "Traceback" not in errors


def test_every_error_of_every_operation_is_declared(admin):
    paths = admin.get("/api/v1/openapi.json").json()["paths"]
    assert len(paths) >= 15
    for path, operations in paths.items():
        assert path.startswith("/api/v1/")
        for method, operation in operations.items():
            kinds = {code: set(found.get("content", {})) for code, found in operation["responses"].items()}
            wanted = {"400", "429", "503"} | (set() if path.endswith("/login") else {"401"})
            assert wanted <= set(kinds), (method, path)
            assert all(kinds[code] == {"application/problem+json"} for code in kinds if code >= "4"), (method, path)


def test_a_method_that_is_not_there_is_answered_with_those_that_are(admin, reader):
    answer = admin.delete("/api/v1/settings")
    assert (answer.status_code, answer.headers["allow"]) == (405, "GET, PUT")
    answer = reader.post("/api/v1/points/p/series")
    assert (answer.status_code, answer.headers["allow"]) == (405, "GET")
    assert reader.post("/healthz").status_code == 405
