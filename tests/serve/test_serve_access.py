"""Who may do what: login, sessions, tokens, scopes, limits, and what every answer says to browsers."""

import json
import os
import shutil
import ssl
import stat
import subprocess
import sys

import httpx
import pytest
from benchmarks.live.servers import command

from midspan.cli.main import run
from midspan.errors import UsageError
from midspan.serve.access import Access, csrf_of, digest, made_admin
from midspan.serve.attempts import MAX_OF_ADDRESS, MAX_OF_USER, WINDOW_S, Attempts
from served import Served, logged_in, until

OF_P = ("", "/series", "/export", "/events", "/spectrum", "/calibrations")
READ = ["points", *(f"points/p{path}" for path in OF_P)]
READ += ["sources", "sources/p.camera/picture", "health", "session", "openapi.json"]
OPERATE = [f"points/p/{path}" for path in ("calibrate", "calibrations/2/accept", "calibrations/2/refuse")]
OPERATE += ["sources/p.camera/resume"]


@pytest.fixture(scope="module")
def password(store_folder):
    """Of the user `anna`, who operates."""
    done = subprocess.run(
        command("access", store_folder, "add-user", "anna", "--scope", "operate", "--json"),
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    return json.loads(done.stdout)["password"]


def test_without_a_login_there_is_health_alone(served):
    with served.client() as client:
        for path in READ + OPERATE:
            for send in (client.get, client.post):
                answer = send(f"/api/v1/{path}")
                assert answer.status_code in (401, 405), path
                assert answer.headers["content-type"] == "application/problem+json"
        assert client.get("/api/v1/settings").status_code == 401
        assert [client.get(path).status_code for path in ("/healthz", "/readyz", "/metrics")] == [200, 200, 200]
        assert client.get("/docs").status_code == client.get("/redoc").status_code == 404


def test_a_token_may_do_what_its_scope_says(reader, operator, admin, engine):
    for path in OPERATE:
        assert reader.post(f"/api/v1/{path}").status_code == 403
        assert operator.post(f"/api/v1/{path}").status_code in (200, 202)
        assert admin.post(f"/api/v1/{path}").status_code in (200, 202)
    assert {one["command"] for one in engine.commands} >= {"calibrate", "accept", "refuse", "resume"}
    for client in (reader, operator):
        assert client.get("/api/v1/settings").status_code == 403
        assert client.put("/api/v1/settings", content=b"").status_code == 403


def test_a_page_asks_whether_anybody_is_logged_in_without_a_fault(served):
    with served.client() as client:
        nobody = client.get("/api/v1/session", params={"optional": "true"})
        assert (nobody.status_code, nobody.json()["user"]) == (200, None)
        assert client.get("/api/v1/session").status_code == 401


def test_a_session_has_a_cookie_that_scripts_do_not_see_and_changes_need_its_token(served, password):
    with served.client() as client:
        answer = client.post("/api/v1/login", json={"user": "anna", "password": password})
        assert answer.status_code == 200
        cookie = answer.headers["set-cookie"].lower()
        assert "httponly" in cookie
        assert "samesite=strict" in cookie
        csrf = answer.json()["csrf"]
        assert client.get("/api/v1/points").status_code == 200
        expected = {"user": "anna", "scope": "operate", "csrf": csrf, "serves": "site"}
        assert client.get("/api/v1/session").json() == expected
        for headers in ({}, {"X-CSRF-Token": "wrong"}):
            answer = client.post("/api/v1/points/p/calibrate", headers=headers)
            assert answer.status_code == 403
            assert "X-CSRF-Token" in answer.json()["detail"]
        headers = {"X-CSRF-Token": csrf}
        assert client.post("/api/v1/points/p/calibrate", headers=headers).status_code == 202
        assert client.post("/api/v1/logout", headers=headers).status_code == 204
        client.cookies.set("midspan_session", cookie.split("=")[1].split(";")[0])
        assert client.get("/api/v1/points").status_code == 401


def test_what_is_removed_has_no_access_any_more(served, store_folder):
    token = logged_in(store_folder, "guest", "read")
    with served.client(token) as client:
        assert client.get("/api/v1/points").status_code == 200
        assert run(["access", str(store_folder), "remove", "guest", "--quiet"]) == 0
        assert client.get("/api/v1/points").status_code == 401


def test_wrong_passwords_are_limited(tmp_path, begin_ns):
    from served import made_store

    made_store(tmp_path, begin_ns)
    served = Served(tmp_path)
    try:
        (line,) = until(lambda: [line for line in served.log.splitlines() if "admin" in line])
        secret = line.split("password: ")[1].split()[0]
        with served.client() as client:
            codes = [
                client.post("/api/v1/login", json={"user": "admin", "password": f"wrong {k}"}).status_code
                for k in range(MAX_OF_USER)
            ]
            assert set(codes) == {401}
            # The right one has to wait as well.
            answer = client.post("/api/v1/login", json={"user": "admin", "password": secret})
            assert answer.status_code == 429
            assert 1 <= int(answer.headers["retry-after"]) <= WINDOW_S + 1
            assert client.get("/healthz").status_code == 200
        assert secret not in served.log.replace(line, "")
    finally:
        served.stop()
    # Once: the second start prints none.
    second = Served(tmp_path)
    second.stop()
    assert "password" not in second.log


def test_attempts_are_counted_by_user_and_by_address():
    now = [0.0]
    attempts = Attempts(lambda: now[0])
    for k in range(MAX_OF_USER):
        attempts.failed("admin", f"10.0.0.{k}")
    assert attempts.wait_s("admin", "10.0.1.1") == pytest.approx(WINDOW_S)
    assert attempts.wait_s("anna", "10.0.0.1") == 0.0
    for k in range(MAX_OF_ADDRESS):
        attempts.failed(f"user {k}", "10.0.2.1")
    assert attempts.wait_s("another", "10.0.2.1") > 0.0
    now[0] = WINDOW_S + 1.0
    assert attempts.wait_s("admin", "10.0.2.1") == 0.0
    attempts.failed("admin", "10.0.0.1")
    attempts.succeeded("admin", "10.0.0.1")
    assert attempts.wait_s("admin", "10.0.0.1") == 0.0


def test_secrets_are_kept_as_what_they_cannot_be_found_from(tmp_path):
    access = Access(tmp_path)
    password, token = made_admin(access), access.add_token("script", "read")
    session = access.begin_session("admin")
    content = (tmp_path / "access.sqlite").read_bytes()
    for secret in (password, token, session, csrf_of(session)):
        assert secret.encode() not in content
    assert b"$argon2id$" in content
    assert digest(token).encode() in content
    assert stat.S_IMODE(os.stat(tmp_path / "access.sqlite").st_mode) == 0o600
    assert made_admin(access) is None
    access.remove("admin")
    assert access.of_session(session) is None
    # Whoever removes the last user does not want another one.
    access.remove("script")
    assert made_admin(access) is None


def test_another_password_ends_the_sessions(tmp_path):
    access = Access(tmp_path)
    access.add_user("anna", "read")
    session = access.begin_session("anna")
    assert access.of_session(session).scope == "read"
    before = access.kept_password("anna")
    access.set_password("anna")
    assert access.of_session(session) is None
    assert access.kept_password("anna") != before
    with pytest.raises(UsageError, match="has access already"):
        access.add_user("anna", "read")
    with pytest.raises(UsageError, match="anna"):
        access.remove("ana")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["add-user", "x"], "--scope"),
        (["add-user", "--scope", "read"], "NAME"),
        (["remove", "x", "--scope", "read"], "--scope"),
        (["list", "x"], "NAME"),
        (["add-user", "a b", "--scope", "read"], "1 to 64"),
        (["add-user", "x", "--scope", "root"], "root"),
        (["set-password", "admin"], "is no user"),
    ],
)
def test_wrong_use_of_the_command_is_said(store_folder, arguments, words, capsys):
    assert run(["access", str(store_folder), *arguments]) == 2
    assert words in capsys.readouterr().err


def test_no_other_page_frames_it_and_nothing_is_loaded_from_elsewhere(served):
    with served.client() as client:
        for path in ("/healthz", "/api/v1/points", "/nothing"):
            headers = client.get(path).headers
            assert "default-src 'none'" in headers["content-security-policy"]
            assert "frame-ancestors 'none'" in headers["content-security-policy"]
            assert headers["x-content-type-options"] == "nosniff"
            assert headers["referrer-policy"] == "no-referrer"
            assert headers["cache-control"] == "no-store"
            assert "server" not in headers
            assert "access-control-allow-origin" not in headers


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--listen", "0.0.0.0:8080"], "without TLS"),
        (["--listen", "[::]:8080"], "without TLS"),
        (["--listen", "bridge.example:8080"], "without TLS"),
        (["--listen", "127.0.0.1.example:8080"], "without TLS"),
        (["--listen", "8080"], "a host and a port"),
        (["--listen", "127.0.0.1:0", "--tls-cert", sys.executable], "both"),
    ],
)
def test_other_addresses_than_loopback_need_tls(store_folder, options, words, capsys):
    assert run(["serve", str(store_folder), *options]) == 2
    assert words in capsys.readouterr().err


def test_a_folder_that_is_no_store_is_not_served(tmp_path, capsys):
    assert run(["serve", str(tmp_path)]) == 3
    assert "is not a store" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_over_tls_the_cookie_is_for_tls_alone(store_folder, password, tmp_path):
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("openssl is not installed")
    subject = ["-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1"]
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    made = [
        openssl,
        "req",
        "-x509",
        "-newkey",
        "rsa:2048",
        "-nodes",
        "-days",
        "2",
        "-out",
        cert,
        "-keyout",
        key,
        *subject,
    ]
    subprocess.run(made, check=True, capture_output=True)
    served = Served(store_folder, "--tls-cert", cert, "--tls-key", key)
    try:
        trusted = ssl.create_default_context(cafile=str(cert))
        with httpx.Client(base_url=f"https://127.0.0.1:{served.port}", verify=trusted, timeout=60.0) as client:
            assert client.get("/healthz").status_code == 200
            answer = client.post("/api/v1/login", json={"user": "anna", "password": password})
            assert "secure" in answer.headers["set-cookie"].lower()
            assert client.get("/api/v1/points").status_code == 200
        with served.client() as client, pytest.raises(httpx.TransportError):
            client.get("/healthz")
    finally:
        served.stop()
