"""An RTSP server of a raw film, run by the system's Python: rtsp_server.py FILM WIDTH HEIGHT RATE PORT SECONDS PATH.

The film goes round and round; frame n is that of the instant n / RATE since 1970, so that a film of a periodic motion
shows where the structure is now. FILM = clock: each frame shows when it was made, as BITS stripes of black and white,
the first one the highest bit of the time in tenths of a millisecond.
"""

import sys
import time

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # noqa: E402

FILM, WIDTH, HEIGHT, RATE, PORT, SECONDS = sys.argv[1], *map(int, sys.argv[2:7])
BITS, PER_S = 24, 10_000
CLOCK = FILM == "clock"
LAUNCH = (
    f"( appsrc name=src is-live=true do-timestamp={str(CLOCK).lower()} format=time caps=video/x-raw,format=GRAY8,"
    f"width={WIDTH},height={HEIGHT},framerate={RATE}/1 ! videoconvert ! video/x-raw,format=I420 "
    f"! x264enc tune=zerolatency speed-preset=ultrafast pass=quant quantizer=8 key-int-max={RATE} "
    "! rtph264pay config-interval=1 name=pay0 pt=96 )"
)
Gst.init(None)
DATA = b""
if not CLOCK:
    with open(FILM, "rb") as file:
        DATA = file.read()


def now_drawn():
    """A frame that shows the time."""
    ticks = int(time.time() * PER_S) % 2**BITS
    row = b"".join((b"\xe0" if ticks >> bit & 1 else b"\x20") * (WIDTH // BITS) for bit in reversed(range(BITS)))
    return row.ljust(WIDTH, b"\x20") * HEIGHT


class Factory(GstRtspServer.RTSPMediaFactory):
    """Pushes the film at its rate, for each first client anew."""

    def __init__(self):
        super().__init__()
        self.set_launch(LAUNCH)
        self.set_shared(True)
        self.connect("media-configure", self.begin)

    def begin(self, _factory, media):
        """Push frames at their instants until the media ends."""
        source, size = media.get_element().get_child_by_name("src"), WIDTH * HEIGHT
        first = int(time.time() * RATE) + 1
        state = {"number": first}

        def push():
            number = state["number"]
            if CLOCK:
                buffer = Gst.Buffer.new_wrapped(now_drawn())
            else:
                at = number % (len(DATA) // size) * size
                buffer = Gst.Buffer.new_wrapped(DATA[at : at + size])
                buffer.pts = buffer.dts = (number - first) * Gst.SECOND // RATE
            buffer.duration = Gst.SECOND // RATE
            if source.emit("push-buffer", buffer) != Gst.FlowReturn.OK:
                return False
            state["number"] = number + 1
            due_s = state["number"] / RATE - time.time()
            GLib.timeout_add(max(int(1000 * due_s), 1), push)
            return False

        push()


server = GstRtspServer.RTSPServer()
server.set_address("127.0.0.1")
server.set_service(str(PORT))
server.get_mount_points().add_factory(sys.argv[7], Factory())
server.attach(None)
GLib.timeout_add_seconds(SECONDS, sys.exit)
GLib.MainLoop().run()
