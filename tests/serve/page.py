"""A site whose rows come at real time, and a wire to its server that can be cut, for the page's tests."""

import contextlib
import re
import socket
import threading
import time
from pathlib import Path

import cv2
import numpy as np
from benchmarks.live.servers import free_port

from midspan.alarms.book import Book
from midspan.alarms.watch import Watch
from midspan.records import NANOSECONDS
from midspan.settings.alarms import AlarmSettings
from midspan.store.store import Batch, open_store
from served import SECONDS, Engine, Served, logged_in, made_store, rows, state, until

# Rows are given so often, s.
STEP_S = 0.2
WIDTH, HEIGHT = 320, 240
SITE = """name = "site"
[store]
path = "store"
[[point]]
name = "p"
[point.accelerometer]
source = "serial:/dev/a"
unit = "m/s^2"
[point.camera]
source = "rtsp://camera/x"
roi = [10, 20, 64, 48]  # the bolt
"""
HOSTILE = "<img src=x onerror=alert(1)>"


WIDE, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 800}
AXE = Path(__file__).parents[2] / "web" / "node_modules" / "axe-core" / "axe.min.js"


def violations(page):
    """Where a page is not accessible (WCAG 2.1, A and AA)."""
    page.evaluate(AXE.read_text())
    found = page.evaluate("axe.run(document, {runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa']})")
    return [(one["id"], one["nodes"][0]["html"]) for one in found["violations"]]


# What the browser itself says of answers that are expected (a wrong login, a cut), and of a canvas that a test reads.
EXPECTED = re.compile(r"Failed to load resource|WebSocket connection to|willReadFrequently")


def address(site):
    """Where a site's page logs in."""
    return f"http://127.0.0.1:{site.served.port}/api/v1/login"


def traced(page, part=(0.0, 1.0)):
    """Which columns of the plot, in a part of its width, hold anything of the trace's colour."""
    return page.evaluate(
        """([from, to]) => {
            const canvas = document.querySelector(".chart canvas"), over = document.querySelector(".u-over");
            const scale = canvas.width / canvas.clientWidth, left = over.offsetLeft * scale;
            const width = over.clientWidth * scale, begin = Math.round(left + from * width);
            const size = Math.round((to - from) * width);
            const top = over.offsetTop * scale, height = over.clientHeight * scale;
            const data = canvas.getContext("2d").getImageData(begin, top, size, height).data;
            const found = [];
            for (let x = 0; x < size; x++) {
                let hit = false;
                for (let y = 0; y < height; y++) {
                    const at = 4 * (y * size + x);
                    hit ||= data[at + 3] > 0 && data[at + 2] - data[at] > 60;
                }
                found.push(hit);
            }
            return found;
        }""",
        list(part),
    )


class LiveSite:
    """A store whose rows end now, an engine that goes on with them, and the server's process."""

    def __init__(self, folder):
        self.store, self.file = folder / "store", folder / "SITE.toml"
        self.begin_ns = (time.time_ns() // NANOSECONDS - SECONDS) * NANOSECONDS
        made_store(self.store, self.begin_ns)
        self.file.write_text(SITE)
        self.password = logged_in(self.store, "anna", "admin", kind="user")
        self.engine = Engine(self.store)
        self.engine.site_file = str(self.file)
        self.engine.picture = picture(), WIDTH, HEIGHT
        self.engine.state = state()
        self.alarms = Alarms(self.store, self.engine)
        self.amplitude_mm = 1.0
        self.engine.start()
        self.served = Served(self.store)
        self._ending = threading.Event()
        self._feeding = threading.Thread(target=self._feed, daemon=True)
        self._feeding.start()
        token = logged_in(self.store, "reader", "read")
        with self.served.client(token) as client:
            until(lambda: len(client.get("/api/v1/points").json()) == 2)

    def _feed(self):
        count = 0
        with contextlib.closing(open_store(self.store)) as store:
            while not self._ending.wait(0.01):
                at_ns = self.begin_ns + round((SECONDS + count * STEP_S) * NANOSECONDS)
                if at_ns + STEP_S * NANOSECONDS > time.time_ns():
                    continue
                chunks = [swinging(at_ns, point, self.amplitude_mm if point == "p" else 1.0) for point in ("p", "q")]
                store.write(Batch(chunks=chunks))
                for chunk in chunks:
                    self.engine.give(chunk)
                    self.alarms.rows(chunk)
                count += 1

    def stop(self):
        """End it all."""
        self._ending.set()
        self._feeding.join(10.0)
        self.served.stop()
        self.engine.end()


class Alarms:
    """The alarm of the point p as `midspan run` evaluates it; its changes go to the book and to the page."""

    SETTINGS = AlarmSettings.model_validate(
        {"name": HOSTILE, "on": "displacement", "limit_mm": 4.0, "level": "critical", "keep_firing_s": 2.0}
    )

    def __init__(self, folder, engine):
        self._engine, self._book, self._lock = engine, Book(folder), threading.Lock()
        self._watch = Watch({"p": [self.SETTINGS], "q": []}, (), ["http://example.org 1"], self._put)
        engine.answers |= {
            "alarms": self._all,
            "acknowledge": lambda head: self._text("acknowledge", head["alarm"], head["who"]),
            "silence": lambda head: self._text("silence", head["alarm"], head["who"], head["until_ns"], head["reason"]),
            "unsilence": lambda head: self._text("unsilence", head["alarm"], head["who"]),
            "test_alarms": lambda head: self._text("test", head["who"], "site"),
        }

    def rows(self, chunk):
        with self._lock:
            self._watch.rows(chunk.point, chunk, time.time_ns())

    def _put(self, entry, trees):
        self._book.write(entry)
        for tree in trees:
            self._engine.tell({"kind": "alarm", **tree})

    def _all(self, _):
        with self._lock:
            target = {"target": "http://example.org 1", "waiting": 1, "sent": 0, "fault": HOSTILE, "sent_s": None}
            return {"alarms": self._watch.trees(), "limits": self._watch.limits(), "targets": [target]}

    def _text(self, what, *arguments):
        with self._lock:
            return {"text": getattr(self._watch, what)(*arguments, time.time_ns())}


def swinging(at_ns, point, amplitude_mm=1.0):
    """Rows of one step, which go on with those before."""
    chunk = rows(at_ns, STEP_S, point=point)
    phase = (
        2
        * np.pi
        * 0.8
        * ((chunk.time_ns - chunk.time_ns[0]) / NANOSECONDS + at_ns % (1000 * NANOSECONDS) / NANOSECONDS)
    )
    chunk.columns["displacement_m"][:] = 1e-3 * amplitude_mm * np.sin(phase)
    return chunk


def picture():
    """A frame with something in it, as JPEG."""
    frame = np.random.default_rng(1).integers(60, 200, (HEIGHT // 8, WIDTH // 8, 3), dtype=np.uint8)
    frame = cv2.resize(frame, (WIDTH, HEIGHT), interpolation=cv2.INTER_NEAREST)
    return cv2.imencode(".jpg", frame)[1].tobytes()


class Wire:
    """A port that leads to another one, until it is cut."""

    def __init__(self, port):
        self.to, self.port = port, free_port()
        self._lock, self._ends = threading.Lock(), set()
        self.whole = threading.Event()
        self.whole.set()
        self._listener = socket.create_server(("127.0.0.1", self.port))
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self):
        """End what is there; what comes is ended at once."""
        self.whole.clear()
        with self._lock:
            for end in self._ends:
                with contextlib.suppress(OSError):
                    end.shutdown(socket.SHUT_RDWR)
            self._ends.clear()

    def mend(self):
        """Lead on again."""
        self.whole.set()

    def close(self):
        """End the port."""
        self.cut()
        self._listener.close()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                if not self.whole.is_set():
                    near.close()
                    continue
                far = socket.create_connection(("127.0.0.1", self.to))
                with self._lock:
                    self._ends |= {near, far}
                for pair in ((near, far), (far, near)):
                    threading.Thread(target=self._carry, args=pair, daemon=True).start()

    def _carry(self, source, sink):
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                sink.sendall(data)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        source.close()
        with self._lock:
            self._ends.discard(source)
