"""What systemd is reported."""

import socket

import pytest

from midspan.service.notify import notify


@pytest.mark.parametrize("abstract", [False, True])
def test_a_line_arrives_where_it_is_asked_for(abstract, tmp_path, monkeypatch):
    name = f"midspan-{tmp_path.name}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind(f"\0{name}" if abstract else name)
        server.settimeout(60.0)
        monkeypatch.setenv("NOTIFY_SOCKET", f"@{name}" if abstract else name)
        notify("READY=1")
        assert server.recv(100) == b"READY=1"


def test_nothing_happens_where_nobody_asks(tmp_path, monkeypatch):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    notify("READY=1")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    notify("READY=1")
