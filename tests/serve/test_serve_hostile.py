"""Hostile input: each operation asks for its scope and its CSRF token, no path leads out, nobody who sends much or
takes little holds anything up.
"""

import http.client
import re
import secrets
import socket
import threading
import time
from contextlib import ExitStack
from urllib.parse import quote

import pytest

from midspan.serve.access import Access, csrf_of
from served import until

# What changes something, by the scope that it needs; all else is for looking.
SCOPES = {
    ("POST", "/api/v1/points/{name}/calibrate"): "operate",
    ("POST", "/api/v1/points/{name}/calibrations/{number}/accept"): "operate",
    ("POST", "/api/v1/points/{name}/calibrations/{number}/refuse"): "operate",
    ("POST", "/api/v1/sources/{name}/pause"): "operate",
    ("POST", "/api/v1/sources/{name}/resume"): "operate",
    ("POST", "/api/v1/alarms/test"): "operate",
    ("POST", "/api/v1/alarms/{number}/acknowledge"): "operate",
    ("POST", "/api/v1/alarms/{number}/silence"): "operate",
    ("POST", "/api/v1/alarms/{number}/unsilence"): "operate",
    ("DELETE", "/api/v1/alarms/silences/{number}"): "operate",
    ("GET", "/api/v1/settings"): "admin",
    ("PUT", "/api/v1/settings"): "admin",
    ("POST", "/api/v1/logout"): "read",
}
LOGIN = ("POST", "/api/v1/login")
ORDER = ("read", "operate", "admin")


@pytest.fixture(scope="module")
def operations(served, tokens):
    """Method and path of all operations but the login."""
    with served.client(tokens["admin"]) as client:
        paths = client.get("/api/v1/openapi.json").json()["paths"]
    found = {(method.upper(), path) for path, methods in paths.items() for method in methods}
    assert LOGIN in found
    return sorted(found - {LOGIN})


def nowhere(path):
    """An address of an operation, of things that there are not."""
    return re.sub(r"\{number\}", "999", re.sub(r"\{name\}", "nobody", path))


@pytest.mark.parametrize("scope", ORDER)
def test_every_operation_asks_for_its_scope(served, tokens, operations, scope):
    assert {one for one in operations if one[0] != "GET"} <= set(SCOPES)
    with served.client(tokens[scope]) as client:
        for method, path in operations:
            code = client.request(method, nowhere(path), json={}).status_code
            allowed = ORDER.index(scope) >= ORDER.index(SCOPES.get((method, path), "read"))
            assert (code != 403) == allowed, (method, path, code)
            assert code != 401


def test_every_operation_that_changes_something_asks_for_the_csrf_token(served, store_folder, operations):
    """A form of another page is sent with the session's cookie, and without what only this page knows."""
    access = Access(store_folder)
    access.add_user("eve", "admin")
    session = access.begin_session("eve")
    wrong = ({}, {"X-CSRF-Token": ""}, {"X-CSRF-Token": csrf_of("another")}, {"X-CSRF-Token": session})
    changing = [one for one in operations if one[0] != "GET"]
    assert len(changing) >= 10
    with served.client() as client:
        client.cookies.set("midspan_session", session)
        for method, path in changing:
            for headers in wrong:
                answer = client.request(method, nowhere(path), headers=headers)
                assert (answer.status_code, "X-CSRF-Token" in answer.json()["detail"]) == (403, True), (method, path)
        assert client.get("/api/v1/session").status_code == 200
    access.remove("eve")


@pytest.mark.parametrize("scheme", ["Bearer {}", "bearer {}", "Basic {}", "Token {}", "{}"])
def test_a_token_is_read_as_a_token_alone(served, tokens, scheme):
    with served.client() as client:
        headers = {"Authorization": scheme.format(tokens["read"])}
        assert client.get("/api/v1/points", headers=headers).status_code == (200 if "earer" in scheme else 401)
        assert client.get("/api/v1/points", params={"token": tokens["read"]}).status_code == 401
        client.cookies.set("midspan_session", tokens["read"])
        assert client.get("/api/v1/points").status_code == 401


UP = ("..", "%2e%2e", "..%2f..", "%2e%2e%2f%2e%2e%2f", "..%5c..", "....//", "..;", "%00", "%c0%ae%c0%ae", "~root")
PLACES = (
    "/{}/access.sqlite", "/assets/{}/{}/access.sqlite", "/assets/{}/index.html", "/api/v1/points/{}/export",
    "/api/v1/points/p/{}/{}/settings", "/api/v1/sources/{}/picture", "/api/v1/sources/p.camera%2f{}/picture",
    "/api/v1/points/p/export?format={}", "/api/v1/points/p%2f{}/series",
)  # fmt: skip


def test_no_path_leads_out_of_what_is_served(served, tokens, store_folder):
    secret = secrets.token_hex(16)
    (store_folder / "access.sqlite.copy").write_text(secret)
    for place in (
        *PLACES,
        "//etc/passwd",
        "/assets//etc/passwd",
        f"/assets/{quote(str(store_folder))}/access.sqlite.copy",
    ):
        for up in UP:
            connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=30.0)
            # As it stands: clients would put it in order.
            connection.putrequest("GET", place.replace("{}", up), skip_host=False)
            connection.putheader("Authorization", f"Bearer {tokens['admin']}")
            connection.endheaders()
            answer = connection.getresponse()
            body = answer.read()
            connection.close()
            assert answer.status in (400, 404, 405, 422), (place, up, answer.status)
            assert secret.encode() not in body
            assert b"root:x:" not in body
            assert answer.getheader("content-type") == "application/problem+json", (place, up)


MARKUP = "<img src=x onerror=alert(1)>"


def test_what_was_wrong_is_never_sent_as_a_page(reader, operator):
    """Whatever comes back of what was sent is JSON, which browsers neither show nor guess to be a page."""
    asked = [
        reader.get(f"/api/v1/points/{MARKUP}"), reader.get(f"/api/v1/sources/{MARKUP}/picture"),
        reader.get("/api/v1/points/p/series", params={"from": MARKUP}), reader.get(f"/{MARKUP}"),
        reader.get("/api/v1/points/p/export", params={"format": MARKUP}),
        reader.get("/api/v1/alarms", params={"state": MARKUP}), operator.post(f"/api/v1/alarms/{MARKUP}/acknowledge"),
        operator.post("/api/v1/sources/p.camera/pause", json={MARKUP: MARKUP}),
        operator.request("DELETE", "/api/v1/points/p"), reader.post("/api/v1/login", json={"user": MARKUP}),
    ]  # fmt: skip
    for answer in asked:
        assert answer.status_code >= 400
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.json()["status"] == answer.status_code


def memory_mb(served):
    """What the server's process holds but for mapped files."""
    with open(f"/proc/{served.process.pid}/status") as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("RssAnon"))


def upgraded(served, token, stack):
    """A connection that is a websocket."""
    raw = stack.enter_context(socket.create_connection(("127.0.0.1", served.port), timeout=20.0))
    raw.sendall(
        f"GET /api/v1/live HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {token}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
        "Sec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    assert b"101" in raw.recv(12)
    return raw


def sent_until_ended(raw, head, most=1 << 30):
    """How many bytes of a frame a websocket takes before it is ended."""
    block, count = b"\0" * (1 << 20), 0
    try:
        raw.sendall(head)
        while count < most:
            raw.sendall(block)
            count += len(block)
    except OSError:
        pass
    return count


def test_a_frame_of_a_gigabyte_is_ended_at_its_first_bytes(served, tokens, reader):
    """Masked text, binary, a ping, and a message in pieces without an end: none is kept until it is whole."""
    before_mb = memory_mb(served)
    large = (1 << 30).to_bytes(8, "big") + b"\1\2\3\4"
    pieces = b"\x01\xfe\x10\x00\0\0\0\0" + b"a" * 4096 + b"\x00\xfe\x10\x00\0\0\0\0" + b"a" * 4096
    for head in (b"\x81\xff" + large, b"\x82\xff" + large, b"\x89\xff" + large, pieces):
        with ExitStack() as stack:
            # What the kernels of both ends hold is a few megabytes.
            assert sent_until_ended(upgraded(served, tokens["read"], stack), head) < 64 << 20
    assert memory_mb(served) - before_mb < 10.0
    assert reader.get("/api/v1/points").status_code == 200


def test_clients_that_send_or_take_a_byte_now_and_then_hold_nobody_up(served, tokens, reader):
    """Twenty of each: half requests, half frames, and answers of megabytes that are not taken."""
    asked = f"GET /api/v1/points/p/export HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {tokens['read']}\r\n"
    with ExitStack() as stack:
        dripping = []
        for _ in range(20):
            for text in ("GET /api/v1/points HTTP/1.1\r\nHost: x\r\nX-Slow: ", asked.replace("export", "series")):
                raw = stack.enter_context(socket.socket())
                raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                raw.connect(("127.0.0.1", served.port))
                raw.sendall(text.encode() + (b"" if "Slow" in text else b"\r\n"))
                dripping.append(raw)
            upgraded(served, tokens["read"], stack).sendall(b"\x81")
        ending = threading.Event()

        def drip():
            while not ending.wait(0.2):
                for raw in dripping[::2]:
                    raw.sendall(b"x")

        thread = threading.Thread(target=drip)
        thread.start()
        try:
            longest_s = 0.0
            for _ in range(20):
                begun_s = time.monotonic()
                assert reader.get("/readyz").status_code == 200
                assert reader.get("/api/v1/points").status_code == 200
                longest_s = max(longest_s, time.monotonic() - begun_s)
        finally:
            ending.set()
            thread.join(10.0)
    # Milliseconds each; the rest is what a busy machine may take.
    assert longest_s < 2.0
    until(lambda: reader.get("/api/v1/points/p/export").status_code == 200)


@pytest.mark.parametrize(
    "listen", ["0:8080", "127.1:8080", "2130706433:8080", "[::ffff:127.0.0.1]:8080", "*:8080", ":8080", "::1:8080x",
               "localhost.:8080", "0x7f000001:8080", "[::1%eth0]:8080"],
)  # fmt: skip
def test_other_ways_to_write_an_address_are_no_loopback(store_folder, listen, capsys):
    from midspan.cli.main import run

    assert run(["serve", str(store_folder), "--listen", listen]) == 2
    assert listen in capsys.readouterr().err


def test_a_site_on_all_addresses_is_not_run_without_tls(tmp_path, capsys):
    from midspan.cli.main import run

    site = '[service]\nlisten = "0.0.0.0:8080"\n[[point]]\nname = "p"\n[point.accelerometer]\nsource = "mqtt:a"\n'
    (tmp_path / "SITE.toml").write_text('name = "x"\n[store]\npath = "store"\n' + site)
    assert run(["run", str(tmp_path / "SITE.toml")]) == 2
    assert "without TLS" in capsys.readouterr().err
    assert not (tmp_path / "store").exists()
