"""An RTSP server of a raw film, run by the system's Python: rtsp_server.py FILM WIDTH HEIGHT RATE PORT."""

import sys
import time

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # noqa: E402

FILM, WIDTH, HEIGHT, RATE, PORT = sys.argv[1], *map(int, sys.argv[2:6])
LAUNCH = (
    "( appsrc name=src is-live=true format=time caps=video/x-raw,format=GRAY8,"
    f"width={WIDTH},height={HEIGHT},framerate={RATE}/1 ! videoconvert ! video/x-raw,format=I420 "
    f"! x264enc tune=zerolatency speed-preset=ultrafast pass=quant quantizer=8 key-int-max={RATE} "
    "! rtph264pay config-interval=1 name=pay0 pt=96 )"
)
Gst.init(None)
with open(FILM, "rb") as file:
    DATA = file.read()


class Factory(GstRtspServer.RTSPMediaFactory):
    """Pushes the film at its rate, from the beginning for the first client, over and over."""

    def __init__(self):
        super().__init__()
        self.set_launch(LAUNCH)
        self.set_shared(True)
        self.connect("media-configure", self.begin)

    def begin(self, _factory, media):
        source, size = media.get_element().get_child_by_name("src"), WIDTH * HEIGHT
        begun_s = time.monotonic()
        state = {"number": 0}

        def push():
            number = state["number"]
            at = number % (len(DATA) // size) * size
            buffer = Gst.Buffer.new_wrapped(DATA[at : at + size])
            buffer.pts = buffer.dts = number * Gst.SECOND // RATE
            buffer.duration = Gst.SECOND // RATE
            source.emit("push-buffer", buffer)
            state["number"] = number + 1
            due_s = begun_s + state["number"] / RATE
            GLib.timeout_add(max(int(1000 * (due_s - time.monotonic())), 1), push)
            return False

        push()


server = GstRtspServer.RTSPServer()
server.set_address("127.0.0.1")
server.set_service(str(PORT))
server.get_mount_points().add_factory("/cam", Factory())
server.attach(None)
GLib.timeout_add_seconds(300, sys.exit)
GLib.MainLoop().run()
