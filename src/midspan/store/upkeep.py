"""A store looked through, mended, and saved while it is written."""

import os
import shutil
import sqlite3
import tarfile
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

from midspan.errors import DataError, MidspanError, UsageError
from midspan.store.database import LOCKS, Database, Division, FileLocks, SqliteDatabase, lock_file, sqlite_faults
from midspan.store.days import DAYS, TABLES
from midspan.store.group_rows import decoded
from midspan.store.group_state import STATES, files_of, is_damaged
from midspan.store.parts import kept_checkpoint
from midspan.store.pieces import LOGS, whole_bytes
from midspan.store.store import CHECKPOINT_FILE, SITE_FILE, Store, is_address, open_store

DAMAGED, UNFINISHED = ".damaged", ".part"
# What a backup leaves out: locks are of processes, captures are recordings, large and made anew by a point that opens.
LEFT_OUT = (LOCKS, LOGS, "captures")
NO_SERVER = "{}: works only on a store in a folder. For PostgreSQL use pg_dump for a copy and pg_amcheck to check."


@dataclass(frozen=True, slots=True)
class Fault:
    """What is wrong with a file of a store, its path relative to that."""

    file: str
    text: str


@dataclass(frozen=True, slots=True)
class Checked:
    """What was looked at, and what is wrong."""

    files: int
    chunks: int
    rows: int
    faults: tuple[Fault, ...]


def check(where: str) -> Checked:
    """Look through all of a store: the files' pages, each chunk's check sum and stamps, the logs, the checkpoints.

    It may be written meanwhile. Raises UsageError for a PostgreSQL store, DataError where there is none.
    """
    folder = _folder(where, "check")
    faults, chunks, rows, files = list[Fault](), 0, 0, _databases(folder)
    for file in files:
        name = str(file.relative_to(folder))
        faults += [Fault(name, text) for text in _page_faults(file)]
        if file.parent.name == DAYS:
            for found, text in _chunks(file):
                chunks, rows = chunks + 1, rows + found
                faults += [Fault(name, text)] if text else []
    if (folder / CHECKPOINT_FILE).is_file() and not any(one.file == CHECKPOINT_FILE for one in faults):
        with closing(SqliteDatabase(folder / CHECKPOINT_FILE, read_only=True)) as database:
            faults += [Fault(CHECKPOINT_FILE, text) for _, text in _damaged_checkpoints(database)]
    states = sorted((folder / STATES).glob("*.0"))
    faults += [
        Fault(str(file.relative_to(folder)), "the group's state is damaged")
        for file in states
        if is_damaged(files_of(file))
    ]
    logs = _logs(folder)
    for log in logs:
        cut = log.stat().st_size - whole_bytes(log)
        if cut > 0 and _is_free(log):
            text = f"its last {cut} bytes are an incomplete record, as after a power cut"
            faults.append(Fault(str(log.relative_to(folder)), text))
    return Checked(len(files) + len(logs) + len(states), chunks, rows, tuple(faults))


def repair(where: str) -> list[str]:
    """Mend a store that nobody writes: each damaged file is made anew of what can be read of it (the old one stays as
    NAME.damaged), damaged chunks are removed, logs become blocks, and histories are made anew. What was done.

    Raises UsageError where a process writes it, or for a PostgreSQL store.
    """
    folder = _folder(where, "repair")
    locks = FileLocks(folder, [file.stem for file in sorted((folder / LOCKS).glob("*.lock"))])
    done = list[str]()
    try:
        for file in _databases(folder):
            if any(_page_faults(file)):
                kept = _salvaged(file)
                done.append(
                    f"{file.relative_to(folder)}: rebuilt with {kept} rows; the old file is {file.name}{DAMAGED}"
                )
        for file in sorted((folder / DAYS).glob("*.sqlite")):
            done += [f"{file.relative_to(folder)}: removed: {text}" for text in _without_damaged_chunks(file)]
        for file in sorted((folder / STATES).glob("*.0")):
            if is_damaged(files_of(file)):
                for one in files_of(file):
                    one.unlink(missing_ok=True)
                done.append(f"{file.relative_to(folder)}: the state of the group was removed; its points open anew")
        with closing(open_store(where)) as store:
            done += _checkpoints_removed(store)
            done += [f"log: {count} pieces became blocks" for count in store.take_over() if count]
            store.make_histories()
    finally:
        locks.close()
    return done


def take_over_left(where: str, division: Division) -> None:
    """Make blocks of what another division of a site left in the logs of stores that this one has not."""
    if is_address(where):
        return
    folder = Path(where).parent if division.count else Path(where)
    used = [f"shard-{number}" for number in range(1, division.count + 1)] or [folder.name]
    for place in [folder, *sorted(folder.glob("shard-*"))]:
        if place.name not in used and (place / SITE_FILE).is_file() and _logs(place):
            # What is damaged stays as it is; `repair` names it.
            with suppress(MidspanError), closing(open_store(place)) as store:
                store.take_over()


def backup(where: str, target: Path) -> list[str]:
    """Copy a store that may be written meanwhile to a folder, which is a store as well, or to a .tar of it.

    Checkpoints are copied first and the log before the blocks, so that nothing is missing between them. Returns the
    names of the files. Raises UsageError where there is something already, OSError where it cannot be written.
    """
    folder = _folder(where, "backup")
    if target.exists():
        raise UsageError(f"{target}: already exists; nothing was written. Give another name.")
    part = target.with_name(target.name + UNFINISHED)
    shutil.rmtree(part, ignore_errors=True)
    try:
        names = _copied(folder, part)
        if target.suffix == ".tar":
            packed = part.with_name(part.name + ".tar")
            with tarfile.open(packed, "w") as archive:
                archive.add(part, arcname=target.stem)
            shutil.rmtree(part)
            packed.rename(target)
        else:
            part.rename(target)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        part.with_name(part.name + ".tar").unlink(missing_ok=True)
        raise
    return names


def _copied(folder: Path, part: Path) -> list[str]:
    first = [folder / CHECKPOINT_FILE, *sorted((folder / STATES).glob("*"))]
    names = [name for file in first if (name := _copy(folder, part, file))]
    # Each is listed once what comes before it is copied: a log, or the blocks that one becomes, may be made meanwhile.
    for listed in (_logs, _others):
        names += [name for file in listed(folder) if (name := _copy(folder, part, file))]
    return names


def _logs(folder: Path) -> list[Path]:
    return sorted((folder / LOGS).glob("*.log"))


def _others(folder: Path) -> list[Path]:
    """What is copied besides checkpoints and logs."""
    return [
        file
        for file in sorted(folder.rglob("*"))
        if file.is_file() and file != folder / CHECKPOINT_FILE
        and file.relative_to(folder).parts[0] not in (*LEFT_OUT, STATES)
        # SQLite's own files of a database are in the copy that it makes.
        and ".sqlite-" not in file.name and not file.name.endswith((DAMAGED, UNFINISHED))
    ]  # fmt: skip


def _copy(folder: Path, part: Path, file: Path) -> str:
    """Copy a file of a folder; its name, empty where it is gone."""
    copy = part / file.relative_to(folder)
    copy.parent.mkdir(parents=True, exist_ok=True)
    if file.suffix == ".sqlite" and file.is_file():
        with sqlite_faults(file), closing(_read(file)) as one, closing(sqlite3.connect(copy)) as other:
            one.backup(other)
        shutil.copymode(file, copy)
    elif file.is_file():
        shutil.copy2(file, copy)
    else:
        return ""
    return str(file.relative_to(folder))


def _folder(where: str, action: str) -> Path:
    if is_address(where):
        raise UsageError(NO_SERVER.format(action))
    if not (Path(where) / SITE_FILE).is_file():
        raise DataError(
            f"{where}: is not a store: it has no {SITE_FILE}. `midspan replay` and `midspan run` create one."
        )
    return Path(where)


def _databases(folder: Path) -> list[Path]:
    return [*sorted(folder.glob("*.sqlite")), *sorted((folder / DAYS).glob("*.sqlite"))]


def _read(file: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)


def _page_faults(file: Path) -> list[str]:
    """What SQLite finds wrong with a file."""
    try:
        with closing(_read(file)) as database:
            found = [str(row[0]) for row in database.execute("PRAGMA integrity_check(5)")]
    except sqlite3.DatabaseError as error:
        return [str(error)]
    return [] if found == ["ok"] else found


def _chunks(file: Path) -> Iterator[tuple[int, str]]:
    """The number of rows of each chunk of a day that can be read, and what is wrong with it."""
    for _, _, count, text in _each_chunk(file):
        yield count, text


def _each_chunk(file: Path) -> Iterator[tuple[str, int, int, str]]:
    try:
        with closing(_read(file)) as database:
            names = {str(row[0]) for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            for table in [name for name in TABLES if name in names]:
                for row in database.execute(f"SELECT rowid, point, stream, t0_ns, t1_ns, n, body FROM {table}"):
                    yield table, int(row[0]), int(row[5]), _fault_of(*row[1:])
    except sqlite3.DatabaseError:
        # `_page_faults` has it.
        return


def _fault_of(point: str, stream: str, t0_ns: int, t1_ns: int, count: int, body: bytes) -> str:
    try:
        time_ns = decoded(bytes(body), point, stream).time_ns
    except DataError as error:
        return str(error)
    whole = len(time_ns) == count and int(time_ns[0]) == t0_ns and int(time_ns[-1]) == t1_ns
    if not whole or (len(time_ns) > 1 and (time_ns[1:] <= time_ns[:-1]).any()):
        return f"The stamps of a chunk of {point}, {stream} at {t0_ns} ns are wrong."
    return ""


def _damaged_checkpoints(database: Database) -> Iterator[tuple[str, str]]:
    for (point,) in database.execute("SELECT point FROM checkpoint"):
        try:
            kept_checkpoint(database, str(point))
        except DataError as error:
            yield str(point), str(error)


def _checkpoints_removed(store: Store) -> list[str]:
    points = [point for point, _ in _damaged_checkpoints(store.checkpoints)]
    for point in points:
        for table in ("checkpoint", "part"):
            store.checkpoints.execute(f"DELETE FROM {table} WHERE point = ?", (point,))
    return [f"{CHECKPOINT_FILE}: the checkpoint of {point} was removed; it opens anew" for point in points]


def _is_free(log: Path) -> bool:
    """Whether the process that wrote a log has ended."""
    file = lock_file(log)
    if file is not None:
        file.close()
    return file is not None


def _without_damaged_chunks(file: Path) -> list[str]:
    faults = [(table, number, text) for table, number, _, text in _each_chunk(file) if text]
    with sqlite_faults(file), closing(sqlite3.connect(file, isolation_level=None)) as database:
        for table, number, _ in faults:
            database.execute(f"DELETE FROM {table} WHERE rowid = ?", (number,))
    return [text for _, _, text in faults]


def _salvaged(file: Path) -> int:
    """Put what can be read of a damaged file in its place; the number of its rows."""
    damaged, made = file.with_name(file.name + DAMAGED), file.with_name(file.name + UNFINISHED)
    made.unlink(missing_ok=True)
    kept = 0
    with closing(sqlite3.connect(made, isolation_level=None)) as new:
        new.execute("PRAGMA journal_mode = OFF")
        try:
            with closing(_read(file)) as old:
                sql = "SELECT name, sql FROM sqlite_master WHERE type = 'table' AND sql IS NOT NULL"
                for name, text in old.execute(sql).fetchall():
                    new.execute(text)
                    kept += _copied_rows(old, new, str(name))
        except sqlite3.DatabaseError:
            # Nothing of it can be read: the tables are made anew when the store is opened.
            pass
    for end in ("-wal", "-shm", "-journal"):
        Path(f"{file}{end}").unlink(missing_ok=True)
    os.replace(file, damaged)
    os.replace(made, file)
    return kept


def _copied_rows(old: sqlite3.Connection, new: sqlite3.Connection, table: str) -> int:
    """Copy rows from the first one on and from the last one back, as far as each way can be read."""
    kept = 0
    for order in ("ASC", "DESC"):
        try:
            for rowid, *row in old.execute(f"SELECT rowid, * FROM {table} NOT INDEXED ORDER BY rowid {order}"):
                values = (rowid, *row)
                if new.execute(f"SELECT 1 FROM {table} WHERE rowid = ?", (rowid,)).fetchone():
                    break
                names = [str(one[1]) for one in new.execute(f"PRAGMA table_info({table})")]
                marks = ", ".join("?" * len(values))
                new.execute(f"INSERT OR IGNORE INTO {table} (rowid, {', '.join(names)}) VALUES ({marks})", values)
                kept += 1
        except sqlite3.DatabaseError:
            continue
    return kept
