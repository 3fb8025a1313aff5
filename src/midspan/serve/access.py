"""Who may do what with a store: users, tokens and sessions, in a file that only the service's user may read.

Passwords are kept as argon2 hashes; tokens and sessions, which are 256 random bits, as SHA-256.
"""

import hashlib
import os
import re
import secrets
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from midspan.checks import nearest
from midspan.errors import UsageError
from midspan.store.database import sqlite_faults

SCOPES = ("read", "operate", "admin")
"""Each one may do what those before it may."""
ACCESS_FILE = "access.sqlite"
NAME = re.compile(r"[A-Za-z0-9_.@-]{1,64}")
# A session ends when it was not used for so long, s: a working day, so that a page that is open stays so.
SESSION_S = 12 * 3600.0
# Who asked is not looked up again for so long, s: file systems may give two changes within some ms one time.
RECENT_S = 1.0
# Its use is written down so often, s: not at each request.
USED_S = 600.0
MAX_SESSIONS = 50
# Without letters and digits that look alike; 20 of 54 are 115 bits.
LETTERS = "abcdefghijkmnpqrstuvwxyzABCDEFGHJKLMNPQRSTUVWXYZ23456789"
TABLES = (
    "CREATE TABLE IF NOT EXISTS login (name TEXT PRIMARY KEY, kind TEXT NOT NULL, scope TEXT NOT NULL, "
    "secret TEXT NOT NULL UNIQUE)",
    "CREATE TABLE IF NOT EXISTS session (digest TEXT PRIMARY KEY, name TEXT NOT NULL REFERENCES login ON DELETE "
    "CASCADE, used_s REAL NOT NULL)",
)


@dataclass(frozen=True, slots=True)
class Login:
    """A user or a token; kind: "user" or "token"."""

    name: str
    kind: str
    scope: str

    def may(self, scope: str) -> bool:
        """Whether it may do what needs a scope."""
        return SCOPES.index(self.scope) >= SCOPES.index(scope)


def digest(secret: str) -> str:
    """What is kept of a token or a session."""
    return hashlib.sha256(secret.encode()).hexdigest()


def state_of(file: Path) -> tuple[int, ...]:
    """What changes whenever a file does; empty without one."""
    try:
        found = file.stat()
    except OSError:
        return ()
    return found.st_ino, found.st_mtime_ns, found.st_size


def csrf_of(session: str) -> str:
    """What a page sends back with each change: it follows from the session, and the session does not from it."""
    return hashlib.sha256(f"csrf {session}".encode()).hexdigest()


def password_hash(password: str) -> str:
    """A password as it is kept; takes 0.2 s and 64 MiB."""
    from argon2 import PasswordHasher

    return str(PasswordHasher().hash(password))


def password_matches(kept: str, password: str) -> bool:
    """Whether a password is the one that was kept; takes 0.2 s and 64 MiB."""
    from argon2 import PasswordHasher
    from argon2.exceptions import Argon2Error, InvalidHashError

    try:
        return bool(PasswordHasher().verify(kept, password))
    except (Argon2Error, InvalidHashError):
        return False


class Access:
    """The logins of a folder's store. What another process changes holds at once: every call reads the file, but for
    who asked within a second, while the file is as it was.
    """

    how = "Log in (POST /api/v1/login), or send Authorization: Bearer TOKEN."
    code = ""
    serves: Literal["site", "recordings"] = "site"

    def __init__(self, folder: Path) -> None:
        self.file = folder / ACCESS_FILE
        # Of tokens and sessions: whose they are, and until when that is not looked up, s of time.monotonic(), as long
        # as the file is this one.
        self._recent: dict[str, tuple[float, Login]] = {}
        self._state: tuple[int, ...] = ()

    @property
    def is_new(self) -> bool:
        """Whether nobody was ever given access."""
        if not self.file.exists():
            return True
        with self._opened() as database:
            return not database.execute("PRAGMA user_version").fetchone()[0]

    def add_user(self, name: str, scope: str) -> str:
        """Add a user; returns the password. Raises UsageError for a name that is taken."""
        password = "".join(secrets.choice(LETTERS) for _ in range(20))
        self._add(name, "user", scope, password_hash(password))
        return password

    def add_token(self, name: str, scope: str) -> str:
        """Add a token and return it. Raises UsageError for a name that is taken."""
        token = f"midspan_{secrets.token_urlsafe(32)}"
        self._add(name, "token", scope, digest(token))
        return token

    def set_password(self, name: str) -> str:
        """Give a user another password, which is returned, and end its sessions."""
        password = "".join(secrets.choice(LETTERS) for _ in range(20))
        kept = password_hash(password)
        with self._opened() as database:
            self._require(database, name, "user")
            database.execute("UPDATE login SET secret = ? WHERE name = ?", (kept, name))
            database.execute("DELETE FROM session WHERE name = ?", (name,))
        return password

    def remove(self, name: str) -> None:
        """Remove a user or a token, and its sessions."""
        with self._opened() as database:
            self._require(database, name)
            database.execute("DELETE FROM session WHERE name = ?", (name,))
            database.execute("DELETE FROM login WHERE name = ?", (name,))

    def logins(self) -> list[Login]:
        """All of them, by name."""
        with self._opened() as database:
            return [Login(*row) for row in database.execute("SELECT name, kind, scope FROM login ORDER BY name")]

    def kept_password(self, name: str) -> str | None:
        """The hash of a user's password; None for nobody."""
        with self._opened() as database:
            row = database.execute("SELECT secret FROM login WHERE name = ? AND kind = 'user'", (name,)).fetchone()
        return None if row is None else str(row[0])

    def of_token(self, token: str) -> Login | None:
        """Whose token it is."""
        return self._looked_up(f"token {token}", lambda: self._of_token(token))

    def of_session(self, session: str) -> Login | None:
        """Whose session it is; None where it is over."""
        return self._looked_up(f"session {session}", lambda: self._of_session(session))

    def _looked_up(self, key: str, find: Callable[[], Login | None]) -> Login | None:
        now_s, state = time.monotonic(), state_of(self.file)
        if state != self._state:
            self._recent, self._state = {}, state
        until_s, login = self._recent.get(key, (0.0, None))
        if now_s < until_s:
            return login
        found = find()
        self._recent = {one: kept for one, kept in self._recent.items() if kept[0] > now_s}
        if found is not None:
            self._recent[key] = (now_s + RECENT_S, found)
        return found

    def _of_token(self, token: str) -> Login | None:
        with self._opened() as database:
            row = database.execute(
                "SELECT name, kind, scope FROM login WHERE secret = ? AND kind = 'token'", (digest(token),)
            ).fetchone()
        return None if row is None else Login(*row)

    def begin_session(self, name: str) -> str:
        """A session of a user, to be kept in a cookie."""
        session, now_s = secrets.token_urlsafe(32), time.time()
        with self._opened() as database:
            database.execute("INSERT INTO session VALUES (?, ?, ?)", (digest(session), name, now_s))
            database.execute("DELETE FROM session WHERE used_s < ?", (now_s - SESSION_S,))
            database.execute(
                "DELETE FROM session WHERE name = ? AND digest NOT IN "
                "(SELECT digest FROM session WHERE name = ? ORDER BY used_s DESC LIMIT ?)",
                (name, name, MAX_SESSIONS),
            )
        return session

    def _of_session(self, session: str) -> Login | None:
        now_s, key = time.time(), digest(session)
        with self._opened() as database:
            row = database.execute(
                "SELECT name, kind, scope, used_s FROM login JOIN session USING (name) WHERE digest = ?", (key,)
            ).fetchone()
            if row is None or now_s - row[3] > SESSION_S:
                return None
            if now_s - row[3] > USED_S:
                database.execute("UPDATE session SET used_s = ? WHERE digest = ?", (now_s, key))
        return Login(*row[:3])

    def end_session(self, session: str) -> None:
        """Log out."""
        self._recent.pop(f"session {session}", None)
        with self._opened() as database:
            database.execute("DELETE FROM session WHERE digest = ?", (digest(session),))

    def _add(self, name: str, kind: str, scope: str, secret: str) -> None:
        if not NAME.fullmatch(name):
            raise UsageError(f"NAME must be 1 to 64 letters, digits and _ . @ -; received {name!r}.")
        with self._opened() as database:
            if database.execute("SELECT 1 FROM login WHERE name = ?", (name,)).fetchone():
                raise UsageError(f"{name}: has access already. Remove it first, or choose another name.")
            database.execute("INSERT INTO login VALUES (?, ?, ?, ?)", (name, kind, scope, secret))
            database.execute("PRAGMA user_version = 1")

    def _require(self, database: Any, name: str, kind: str | None = None) -> None:
        rows = database.execute("SELECT name, kind FROM login").fetchall()
        known = [str(row[0]) for row in rows if kind in (None, row[1])]
        if name not in known:
            what = "user" if kind else "user or token"
            raise UsageError(f"{name}: is no {what} of this store. {nearest(name, known)}".rstrip())

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        with sqlite_faults(self.file):
            self.file.parent.mkdir(parents=True, exist_ok=True)
            if not self.file.exists():
                os.close(os.open(self.file, os.O_CREAT | os.O_WRONLY, 0o600))
            with closing(sqlite3.connect(self.file, timeout=5.0)) as database, database:
                for sql in TABLES:
                    database.execute(sql)
                yield database


def made_admin(access: Access) -> str | None:
    """The password of the user `admin`, whom the first start makes; None where anybody has, or had, access."""
    return access.add_user("admin", "admin") if access.is_new else None
