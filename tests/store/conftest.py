"""Stores to try: SQLite in a folder; the database of a PostgreSQL server where one is installed."""

import os
import secrets
import shutil
import socket
import subprocess
import tempfile
from pathlib import Path

import pytest


def server_programs():
    """The folder with PostgreSQL's programs, None where it is not installed."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    return found[-1].parent if found else None


@pytest.fixture(scope="session")
def postgres():
    """The address of a PostgreSQL server on loopback, with a folder and a port of its own."""
    programs = server_programs()
    if programs is None:
        pytest.skip("PostgreSQL is not installed")
    # Its owner is not root, who alone may enter the tests' own folders.
    folder = Path(tempfile.mkdtemp(prefix="midspan-postgres-"))
    secret, data = secrets.token_hex(8), folder / "data"
    (folder / "secret").write_text(secret)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    # The server refuses to be run by root.
    run = []
    if os.geteuid() == 0:
        shutil.chown(folder, "postgres")
        (folder / "secret").chmod(0o644)
        run = ["setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups"]
    make = [programs / "initdb", "-D", data, "-A", "scram-sha-256", f"--pwfile={folder / 'secret'}", "-U", "midspan"]
    subprocess.run([*run, *map(str, make)], check=True, capture_output=True, cwd=folder, timeout=120)
    options = f"-c listen_addresses=127.0.0.1 -p {port} -k {folder}"
    control = [*run, str(programs / "pg_ctl"), "-D", str(data), "-w", "-t", "60"]
    subprocess.run([*control, "-o", options, "-l", str(folder / "log"), "start"], check=True, cwd=folder, timeout=120)
    yield f"postgresql://midspan:{secret}@127.0.0.1:{port}"
    subprocess.run([*control, "-m", "immediate", "stop"], check=False, capture_output=True, cwd=folder, timeout=120)
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(params=["sqlite", "postgresql"])
def store_at(request, tmp_path):
    """Where an empty store can be made."""
    if request.param == "sqlite":
        return str(tmp_path / "store")
    psycopg = pytest.importorskip("psycopg")
    address = request.getfixturevalue("postgres")
    name = f"store_{secrets.token_hex(6)}"
    with psycopg.connect(f"{address}/postgres", autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name}")
    return f"{address}/{name}"
