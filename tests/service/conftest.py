"""Servers on loopback for the tests of live sites: an MQTT broker and an RTSP server, where they are installed."""

import pytest
from benchmarks.live.servers import Mosquitto, RtspCamera


@pytest.fixture
def mosquitto(tmp_path):
    """An MQTT broker that runs, and can be stopped and started again."""
    pytest.importorskip("paho.mqtt.client")
    if Mosquitto.program() is None:
        pytest.skip("mosquitto is not installed")
    server = Mosquitto(tmp_path)
    server.start()
    yield server
    server.stop()


@pytest.fixture
def broker(mosquitto):
    """The port of an MQTT broker."""
    return mosquitto.port


@pytest.fixture
def rtsp(tmp_path):
    """A function that serves a film (frames, rows, columns) of grey levels at a rate; returns the camera."""
    started = []
    if not RtspCamera.is_installed():
        pytest.skip("GStreamer's RTSP server is not installed")

    def serve(film, rate_hz):
        started.append(RtspCamera(tmp_path, film, rate_hz))
        started[-1].start()
        return started[-1]

    yield serve
    for camera in started:
        camera.stop()
