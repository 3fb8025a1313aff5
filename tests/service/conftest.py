"""Servers on loopback for the tests of live sites: an MQTT broker and an RTSP server, where they are installed."""

import shutil
import subprocess
from pathlib import Path

import pytest
from live_servers import free_port, wait_for


@pytest.fixture
def broker(tmp_path):
    """The port of an MQTT broker."""
    pytest.importorskip("paho.mqtt.client")
    program = shutil.which("mosquitto") or shutil.which("/usr/sbin/mosquitto")
    if program is None:
        pytest.skip("mosquitto is not installed")
    port = free_port()
    (tmp_path / "mosquitto.conf").write_text(
        f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\nmax_queued_messages 0\n"
    )
    process = subprocess.Popen([program, "-c", str(tmp_path / "mosquitto.conf")], stderr=subprocess.DEVNULL)
    wait_for(port)
    yield port
    process.terminate()
    process.wait(timeout=10)


@pytest.fixture
def rtsp(tmp_path):
    """A function that serves a film (frames, rows, columns) of grey levels at a rate; returns its address."""
    started = []
    python = "/usr/bin/python3"
    ready = "import gi; gi.require_version('GstRtspServer', '1.0')"
    if not Path(python).exists() or subprocess.run([python, "-c", ready], capture_output=True).returncode:
        pytest.skip("GStreamer's RTSP server is not installed")

    def serve(film, rate_hz):
        port, file = free_port(), tmp_path / "film.raw"
        film.tofile(file)
        script = Path(__file__).with_name("rtsp_server.py")
        size = [str(film.shape[2]), str(film.shape[1]), str(rate_hz), str(port)]
        started.append(subprocess.Popen([python, str(script), str(file), *size], stderr=subprocess.DEVNULL))
        wait_for(port)
        return f"rtsp://127.0.0.1:{port}/cam"

    yield serve
    for process in started:
        process.kill()
        process.wait(timeout=10)
