"""What is kept of alarms next to the store: alarms, silences, the audit list, and messages that are not delivered yet.

An alarm's change, its line of the audit list and its messages are one transaction: after a `kill -9` either all of them
are there or none.
"""

import json
import threading
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from midspan.alarms.machine import OPEN, Alarm
from midspan.errors import DataError
from midspan.store.database import SqliteDatabase

ALARMS_FILE = "alarms.sqlite"
# How long what ended is kept, and lines of the audit list, days; and how many of these at most.
KEEP_DAYS, AUDIT_DAYS, MAX_AUDIT = 30, 400, 200_000
DAY_NS = 86_400_000_000_000
TABLES = (
    "CREATE TABLE IF NOT EXISTS alarm (id TEXT PRIMARY KEY, state TEXT NOT NULL, reported TEXT NOT NULL, "
    "time_ns INTEGER NOT NULL, tree TEXT NOT NULL)",
    "CREATE TABLE IF NOT EXISTS kept (key TEXT PRIMARY KEY, tree TEXT NOT NULL)",
    "CREATE TABLE IF NOT EXISTS audit (number INTEGER PRIMARY KEY AUTOINCREMENT, time_ns INTEGER NOT NULL, "
    "alarm TEXT NOT NULL, what TEXT NOT NULL, who TEXT NOT NULL, text TEXT NOT NULL)",
    "CREATE TABLE IF NOT EXISTS outbox (number INTEGER PRIMARY KEY AUTOINCREMENT, target TEXT NOT NULL, "
    "time_ns INTEGER NOT NULL, topic TEXT NOT NULL, tree TEXT NOT NULL)",
)


@dataclass(frozen=True, slots=True)
class Message:
    """What one target gets; number: of the book, 0 where it could not be kept; topic: below the site's on MQTT."""

    target: str
    time_ns: int
    topic: str
    tree: dict[str, Any]
    number: int = 0


@dataclass(frozen=True, slots=True)
class Audit:
    """A line of the audit list: what became of an alarm, or of a calibration, by whom ("" for midspan itself).

    alarm: its id, or `calibration_id`.
    """

    time_ns: int
    alarm: str
    what: str
    who: str
    text: str


@dataclass(frozen=True, slots=True)
class Entry:
    """What is written together; kept: trees by key, None removes one."""

    alarms: Sequence[Alarm] = ()
    audit: Sequence[Audit] = ()
    messages: Sequence[Message] = ()
    kept: dict[str, Any] = field(default_factory=dict)


class Book:
    """The file; used by several threads. Raises what a store does: StoreFault, DataError."""

    def __init__(self, folder: Path, *, read_only: bool = False) -> None:
        self._database = SqliteDatabase(folder / ALARMS_FILE, read_only=read_only)
        self._lock = threading.Lock()
        if not read_only:
            with self._lock, self._database.transaction():
                for statement in TABLES:
                    self._database.execute(statement)

    def write(self, entry: Entry) -> list[Message]:
        """Keep what happened; returns the messages with their numbers."""
        numbered = []
        with self._lock, self._database.transaction():
            run = self._database.execute
            for one in entry.alarms:
                row = (one.id, one.state, one.reported, one.time_ns, json.dumps(asdict(one)))
                run("INSERT OR REPLACE INTO alarm VALUES (?, ?, ?, ?, ?)", row)
            for line in entry.audit:
                noted = (line.time_ns, line.alarm, line.what, line.who, line.text)
                run("INSERT INTO audit (time_ns, alarm, what, who, text) VALUES (?, ?, ?, ?, ?)", noted)
            for key, tree in entry.kept.items():
                if tree is None:
                    run("DELETE FROM kept WHERE key = ?", (key,))
                else:
                    run("INSERT OR REPLACE INTO kept VALUES (?, ?)", (key, json.dumps(tree)))
            for message in entry.messages:
                values = (message.target, message.time_ns, message.topic, json.dumps(message.tree))
                sql = "INSERT INTO outbox (target, time_ns, topic, tree) VALUES (?, ?, ?, ?) RETURNING number"
                ((number,),) = run(sql, values)
                numbered.append(Message(message.target, message.time_ns, message.topic, message.tree, number))
        return numbered

    def delivered(self, number: int) -> None:
        """A message has arrived, or is given up."""
        with self._lock:
            self._database.execute("DELETE FROM outbox WHERE number = ?", (number,))

    def waiting(self) -> list[Message]:
        """The messages that are not delivered, in their order."""
        with self._lock:
            rows = self._database.execute("SELECT target, time_ns, topic, tree, number FROM outbox ORDER BY number")
        return [
            Message(target, time_ns, topic, json.loads(tree), number) for target, time_ns, topic, tree, number in rows
        ]

    def alarms(self, since_ns: int = 0) -> list[Alarm]:
        """Alarms that are open, or about which something is to be said, and those that ended after an instant."""
        listed = ", ".join(f"'{state}'" for state in OPEN)
        sql = f"SELECT tree FROM alarm WHERE state IN ({listed}) OR time_ns >= ? ORDER BY time_ns DESC"
        with self._lock:
            rows = self._database.execute(sql, (since_ns,))
        try:
            return [Alarm(**json.loads(tree)) for (tree,) in rows]
        except (TypeError, ValueError) as error:
            raise DataError(f"{self._database.file}: contains an unreadable alarm ({error}).") from None

    def kept(self) -> dict[str, Any]:
        """The trees by their keys."""
        with self._lock:
            rows = self._database.execute("SELECT key, tree FROM kept")
        return {key: json.loads(tree) for key, tree in rows}

    def audit(self, count: int, alarm: str | None = None) -> list[Audit]:
        """The newest lines, newest first; of one alarm where its id is given."""
        where, values = ("", ()) if alarm is None else ("WHERE alarm = ? ", (alarm,))
        sql = f"SELECT time_ns, alarm, what, who, text FROM audit {where}ORDER BY number DESC LIMIT ?"
        with self._lock:
            return [Audit(*row) for row in self._database.execute(sql, (*values, count))]

    def forget(self, now_ns: int) -> None:
        """Remove what is too old."""
        with self._lock, self._database.transaction():
            run = self._database.execute
            run("DELETE FROM alarm WHERE state = 'ended' AND time_ns < ?", (now_ns - KEEP_DAYS * DAY_NS,))
            run("DELETE FROM audit WHERE time_ns < ?", (now_ns - AUDIT_DAYS * DAY_NS,))
            run("DELETE FROM audit WHERE number <= (SELECT max(number) FROM audit) - ?", (MAX_AUDIT,))

    def close(self) -> None:
        """Let the file go."""
        with self._lock:
            self._database.close()


def calibration_id(point: str, number: int) -> str:
    """What stands for a point's calibration in the audit list."""
    return f"calibration {point} {number}"


def has_book(folder: Path) -> bool:
    """Whether alarms were kept there ever."""
    return (folder / ALARMS_FILE).is_file()
