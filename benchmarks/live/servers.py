"""Servers on loopback that can be stopped and started again at the same port: an MQTT broker, an RTSP camera."""

import base64
import hashlib
import os
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

# The system's, which has GStreamer's bindings.
PYTHON = "/usr/bin/python3"
LONGEST_S = 3600
CLOCK_SHAPE = (0, 48, 384)


def free_port() -> int:
    """A port of loopback that nothing listens on."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def wait_for(port: int, seconds: float = 120.0) -> None:
    """Wait until something listens on a port."""
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=10.0).close()
        except OSError:
            time.sleep(0.1)
        else:
            return
    raise TimeoutError(port)


def command(*arguments: object) -> list[str]:
    """The midspan command as a process of its own."""
    return [sys.executable, "-c", "from midspan.cli.main import main; main()", *map(str, arguments)]


class Server:
    """A process that listens on a port of its own."""

    def __init__(self) -> None:
        self.port = free_port()
        self._process: subprocess.Popen[bytes] | None = None

    def _command(self) -> list[str]:
        raise NotImplementedError

    def start(self) -> None:
        """Start it, and wait until it listens."""
        self._process = subprocess.Popen(self._command(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wait_for(self.port)

    @property
    def pid(self) -> int:
        """Of its process, which runs."""
        assert self._process is not None
        return self._process.pid

    def stop(self) -> None:
        """End it; nothing where it does not run."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(timeout=60)
            self._process = None


class Mosquitto(Server):
    """An MQTT broker."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._file = folder / "mosquitto.conf"
        self._file.write_text(
            f"listener {self.port} 127.0.0.1\nallow_anonymous true\npersistence false\nmax_queued_messages 0\n"
        )

    def require(self, user: str, password: str) -> None:
        """Let only one user in, from the next start on."""
        salt = secrets.token_bytes(12)
        key = hashlib.pbkdf2_hmac("sha512", password.encode(), salt, 101)
        coded = "$".join(base64.b64encode(part).decode() for part in (salt, key))
        known = self._file.with_name("mosquitto.passwords")
        known.write_text(f"{user}:$7$101${coded}\n")
        text = self._file.read_text().replace("allow_anonymous true", "allow_anonymous false")
        # Started by root it would read the file as another user, who may not.
        self._file.write_text(f"{text}password_file {known}\nuser root\n")

    def use_tls(self, ca: Path, cert: Path, key: Path, *, ask: bool) -> None:
        """Speak TLS alone, from the next start on; ask: clients need a certificate too."""
        text = f"cafile {ca}\ncertfile {cert}\nkeyfile {key}\nrequire_certificate {str(ask).lower()}\nuser root\n"
        self._file.write_text(self._file.read_text() + text)

    @staticmethod
    def program() -> str | None:
        """Where it is installed."""
        return shutil.which("mosquitto") or shutil.which("/usr/sbin/mosquitto")

    def _command(self) -> list[str]:
        return [self.program() or "mosquitto", "-c", str(self._file)]


class Postgres:
    """A PostgreSQL server in a folder of its own, which `stop` ends at once and `start` starts again.

    synced: whether it waits for the disk. Without, a kill of the server loses nothing, a power cut may.
    """

    def __init__(self, *, synced: bool = True) -> None:
        # Its owner is not root, who alone may enter the folders of a program that root runs.
        self._folder = Path(tempfile.mkdtemp(prefix="midspan-postgres-"))
        self._data, secret, port = self._folder / "data", secrets.token_hex(8), free_port()
        (self._folder / "secret").write_text(secret)
        # The server refuses to be run by root.
        self._as_owner: list[str] = []
        if os.geteuid() == 0:
            shutil.chown(self._folder, "postgres")
            (self._folder / "secret").chmod(0o644)
            self._as_owner = ["setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups"]
        self.address = f"postgresql://midspan:{secret}@127.0.0.1:{port}"
        sync = "on" if synced else "off"
        self._options = f"-c fsync={sync} -c listen_addresses=127.0.0.1 -p {port} -k {self._folder}"
        secret_file = f"--pwfile={self._folder / 'secret'}"
        self._run("initdb", "-A", "scram-sha-256", secret_file, "-U", "midspan")

    @staticmethod
    def programs() -> Path | None:
        """The folder with its programs, None where it is not installed."""
        found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
        return found[-1].parent if found else None

    def start(self) -> None:
        """Start it, and wait until it answers."""
        self._run("pg_ctl", "-w", "-t", "180", "-o", self._options, "-l", str(self._folder / "log"), "start")

    def stop(self) -> None:
        """End it at once, as a crash does."""
        self._run("pg_ctl", "-w", "-t", "60", "-m", "immediate", "stop")

    def database(self, name: str) -> str:
        """Make a database; returns its address."""
        import psycopg

        with psycopg.connect(f"{self.address}/postgres", autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE {name}")
        return f"{self.address}/{name}"

    def remove(self) -> None:
        """Let its folder go."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _run(self, program: str, *arguments: str) -> None:
        path = self.programs()
        assert path is not None
        line = [*self._as_owner, str(path / program), "-D", str(self._data), *arguments]
        subprocess.run(line, check=True, stdout=subprocess.DEVNULL, cwd=self._folder, timeout=120)


class RtspCamera(Server):
    """A camera that shows a film (frames, rows, columns) of grey levels round and round; None: a clock.

    `film`, and the `path` at which it is served, may be set anew before it is started again.
    """

    def __init__(self, folder: Path, film: NDArray[np.uint8] | None, rate_hz: int) -> None:
        super().__init__()
        self._file, self._rate_hz = folder / f"film-{self.port}.raw", rate_hz
        self.film, self.path = film, "/cam"

    @staticmethod
    def is_installed() -> bool:
        """Whether GStreamer's RTSP server is there."""
        ready = "import gi; gi.require_version('GstRtspServer', '1.0')"
        return Path(PYTHON).exists() and not subprocess.run([PYTHON, "-c", ready], capture_output=True).returncode

    @property
    def address(self) -> str:
        """Where it is seen."""
        return f"rtsp://127.0.0.1:{self.port}/cam"

    def _command(self) -> list[str]:
        _, rows, columns = CLOCK_SHAPE if self.film is None else self.film.shape
        if self.film is not None:
            self.film.tofile(self._file)
        shown = "clock" if self.film is None else str(self._file)
        script = Path(__file__).with_name("rtsp_server.py")
        numbers = (columns, rows, self._rate_hz, self.port, LONGEST_S)
        return [PYTHON, str(script), shown, *map(str, numbers), self.path]
