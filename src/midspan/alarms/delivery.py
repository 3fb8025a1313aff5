"""The thread that keeps what happened, and the senders behind it: whoever puts something in never waits."""

import queue
import shutil
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from midspan.alarms.book import Audit, Book, Entry, Message
from midspan.alarms.senders import Deliver, Sender
from midspan.errors import MidspanError

# Changes that wait to be kept at most, and how often they are tried where the file cannot be written, s.
MAX_WAITING, AGAIN_S = 10_000, 1.0
# How often the disk is looked at, and old entries are removed, s.
DISK_S, FORGET_S = 10.0, 3600.0
# All senders together are waited for so long at the end, s: an attempt that lasts longer is left.
END_S = 2.0


class Delivery(threading.Thread):
    """targets: how to deliver, by name. folder: of the book; say: takes one line for a person.

    Where the book cannot be written, messages go out all the same, and what happened is written once it can be.
    """

    def __init__(self, folder: Path, targets: Mapping[str, Deliver], say: Callable[[str], None]) -> None:
        super().__init__(name="alarms", daemon=True)
        self._folder, self._say = folder, say
        self._queue: queue.Queue[Entry] = queue.Queue(MAX_WAITING)
        self._unkept: list[Entry] = []
        self._ending = threading.Event()
        self.book: Book | None = None
        self.fault = ""
        self.senders = {name: Sender(name, deliver, self._done) for name, deliver in targets.items()}
        # How much of the disk is used, %, None before it was looked at; when.
        self.disk_percent: float | None = None
        self._disk_s = self._forgot_s = 0.0

    def open(self) -> Book | None:
        """Open the book and give the senders what it holds for them; None where it cannot be opened now."""
        try:
            self.book = Book(self._folder)
            for message in self.book.waiting():
                if message.target in self.senders:
                    self.senders[message.target].put(message)
                else:
                    # A target that SITE.toml no longer has.
                    self.book.delivered(message.number)
        except MidspanError as error:
            self._failed(error)
        return self.book

    def change(self, targets: Mapping[str, Deliver]) -> None:
        """Deliver to other targets; what waits for one of the same name stays with its sender."""
        before = self.senders
        new = {name: Sender(name, deliver, self._done) for name, deliver in targets.items() if name not in before}
        kept = {name: sender for name, sender in before.items() if name in targets}
        for name, sender in kept.items():
            sender.change(targets[name])
        # At once for the thread that hands messages to them.
        self.senders = {**kept, **new}
        for sender in new.values():
            sender.start()
        _stop([sender for name, sender in before.items() if name not in targets])

    def put(self, entry: Entry) -> None:
        """Queue what happened; where too much waits it is lost, and said."""
        try:
            self._queue.put_nowait(entry)
        except queue.Full:
            self._say(f"alarms: {MAX_WAITING} unsaved changes; the newest is discarded.")

    def run(self) -> None:
        """Keep one after another until `stop`, and then what waits."""
        for sender in self.senders.values():
            sender.start()
        while not (self._ending.is_set() and self._queue.empty()):
            try:
                self._take(self._queue.get(timeout=0.2))
            except queue.Empty:
                self._look()

    def stop(self) -> None:
        """Keep what waits, and end; messages that are not delivered stay in the book."""
        self._ending.set()
        if self.is_alive():
            self.join(5.0)
        _stop(list(self.senders.values()))
        if self.book is not None:
            self.book.close()

    def _take(self, entry: Entry) -> None:
        messages = list(entry.messages)
        try:
            self._keep_late()
            messages = self._written(entry)
        except MidspanError as error:
            self._failed(error)
            if len(self._unkept) < MAX_WAITING:
                self._unkept.append(replace(entry, messages=()))
        for message in messages:
            if (sender := self.senders.get(message.target)) is not None:
                sender.put(message)

    def _written(self, entry: Entry) -> list[Message]:
        if self.book is None:
            self.book = Book(self._folder)
        messages = self.book.write(entry)
        self.fault = ""
        return messages

    def _keep_late(self) -> None:
        """What could not be written before."""
        while self._unkept:
            self._written(self._unkept[0])
            self._unkept.pop(0)

    def _look(self) -> None:
        """What is done now and then."""
        now_s = time.monotonic()
        try:
            if now_s - self._disk_s > DISK_S or self.disk_percent is None:
                self._disk_s = now_s
                usage = shutil.disk_usage(self._folder)
                self.disk_percent = 100.0 * (1.0 - usage.free / usage.total) if usage.total else None
                self._keep_late()
            if self.book is not None and now_s - self._forgot_s > FORGET_S:
                self._forgot_s = now_s
                self.book.forget(time.time_ns())
        except (MidspanError, OSError) as error:
            self._failed(error)

    def _failed(self, error: Exception) -> None:
        if not self.fault:
            self._say(f"alarms: changes cannot be saved ({error}); notifications are still sent.")
        self.fault = str(error)

    def _done(self, message: Message, why: str) -> None:
        """A sender delivered a message, or gave it up."""
        if why:
            self._say(f"alarms: notification to {message.target} abandoned: {why}.")
            text = f"{message.target}: {why}"
            self.put(Entry(audit=[Audit(time.time_ns(), str(message.tree["id"]), "given up", "", text)]))
        if self.book is None or not message.number:
            return
        try:
            self.book.delivered(message.number)
        except MidspanError as error:
            self._failed(error)


def _stop(senders: Sequence[Sender]) -> None:
    """End senders, all together within `END_S`."""
    for sender in senders:
        sender.stop()
    until_s = time.monotonic() + END_S
    for sender in senders:
        if sender.is_alive():
            sender.join(max(until_s - time.monotonic(), 0.0))
