"""Shards as processes of this machine, which end with the process that started them."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

from midspan.scale.fleet import ShardState
from midspan.scale.pulse import SILENT_S, Pauses, Pulse

# A service that was asked to stop stores what it has, s; then force comes.
END_S = 30.0


class ShardProcess:
    """One shard; command: what runs it."""

    def __init__(self, number: int, command: Sequence[str]) -> None:
        self._number, self._command = number, command
        self._pulse, self._pauses = Pulse(), Pauses()
        self._process: subprocess.Popen[bytes] | None = None
        self._again_s, self._restarts, self._text = 0.0, -1, ""

    def look(self) -> ShardState:
        """Start it where it does not run, end it where it hangs."""
        process = self._process
        if process is not None and process.poll() is not None:
            self._ended(f"it ended with {_reason(process.returncode)}")
        elif process is not None and self._pulse.silent_s() > SILENT_S:
            process.kill()
            process.wait()
            self._ended(f"it gave no sign of life for {SILENT_S:.0f} s and was ended")
        if self._process is None and time.monotonic() >= self._again_s:
            self._start()
        pid = None if self._process is None else self._process.pid
        return ShardState(self._number, pid, max(self._restarts, 0), "", self._text)

    def terminate(self) -> None:
        """Ask it to stop."""
        if self._process is not None:
            with suppress(ProcessLookupError):
                self._process.terminate()

    def end(self, until_s: float) -> None:
        """Wait for it until an instant, and use force after that."""
        if self._process is not None:
            try:
                self._process.wait(max(until_s - time.monotonic(), 0.0))
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._pulse.close()

    def _start(self) -> None:
        self._pulse.begin()
        self._pauses.begun()
        self._restarts += 1
        # A signal of the terminal is for the driver, which ends all of them. Standard output is its own.
        try:
            self._process = subprocess.Popen(
                self._command, env={**os.environ, "NOTIFY_SOCKET": self._pulse.address}, stdin=subprocess.DEVNULL,
                stdout=2, start_new_session=True, preexec_fn=_ending_with(os.getpid()),
            )  # fmt: skip
        except OSError as error:
            self._ended(f"it could not be started ({error.strerror})")

    def _ended(self, why: str) -> None:
        pause_s = self._pauses.ended()
        self._process, self._again_s = None, time.monotonic() + pause_s
        self._text = f"{why}; it is started again after {pause_s:.0f} s."


class ProcessShards:
    """All shards of a site; arguments: of `midspan run` besides the shard."""

    def __init__(self, site_file: str, count: int, arguments: Sequence[str] = ()) -> None:
        run = [sys.executable, "-m", "midspan", "run", site_file, *arguments]
        self._shards = [ShardProcess(k, [*run, "--shard", f"{k}/{count}"]) for k in range(1, count + 1)]

    def look(self) -> list[ShardState]:
        """Start those that ended, or hang; how all stand."""
        return [one.look() for one in self._shards]

    def stop(self) -> None:
        """End all; what they received is stored."""
        for one in self._shards:
            one.terminate()
        until_s = time.monotonic() + END_S
        for one in self._shards:
            one.end(until_s)


def _reason(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    return signal.Signals(-code).name if -code in {int(one) for one in signal.Signals} else f"signal {-code}"


def _ending_with(parent: int) -> Callable[[], None] | None:
    """What a new process does first: the kernel is to end it when the process that started it has ended."""
    if sys.platform != "linux":
        return None
    import ctypes

    libc = ctypes.CDLL(None)

    def prepare() -> None:
        libc.prctl(1, int(signal.SIGTERM))  # PR_SET_PDEATHSIG
        if os.getppid() != parent:
            os._exit(1)

    return prepare
