"""The process around a command: signals that ask it to stop, and standard streams that cannot be written."""

import errno
import os
import signal
import sys

TYPE_CHECKING = False  # see `cli/main.py`
if TYPE_CHECKING:
    from asyncio import AbstractEventLoop
    from collections.abc import Callable
    from types import FrameType
    from typing import Any

# Ctrl-C; a service manager, a cluster's time limit; a closed terminal.
_STOPPING = ("SIGINT", "SIGTERM", "SIGHUP")
_BY_SIGNAL = 128  # exit code of a stopped process, to which the signal's number is added, as shells do
_BROKEN_PIPE = _BY_SIGNAL + 13  # SIGPIPE
_CANNOT_WRITE = 2


_AGAIN_AFTER_S = 0.05  # a signal that got lost inside a library is sent again
_asked: list[int] = []  # the signals that have arrived


class Stopped(BaseException):
    """A signal asked the process to stop; every `finally` on the way out cleans up."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class OutputError(BaseException):
    """Standard output cannot be written. No Exception, lest a reader of files takes the error for its own."""

    def __init__(self, error: OSError) -> None:
        super().__init__(str(error))
        self.error = error


def supervised(command: "Callable[[], int]") -> int:
    """Run a command and return its exit code; a signal or a stream that fails ends it with a sentence, too."""
    streams, hook = (sys.stdout, sys.stderr), sys.unraisablehook
    before: tuple[int, ...] = ()
    _asked.clear()
    try:
        before = _catch_signals()
        # A closed stream is None, which click and print know.
        sys.stdout = sys.stdout and _Stream(sys.stdout, fails=True)
        # Of standard error there is no place left to complain.
        sys.stderr = sys.stderr and _Stream(sys.stderr, fails=False)
        sys.unraisablehook = lambda lost: _again(lost, hook)
        code = command()
    except Stopped as stopped:
        _use(before, signal.SIG_IGN)
        name = "interrupted" if stopped.number == signal.SIGINT else f"stopped by {signal.Signals(stopped.number).name}"
        _say(f"midspan: {name}; no partial files were left.")
        code = _BY_SIGNAL + stopped.number
    except OutputError as failed:
        broken = failed.error.errno == errno.EPIPE
        if not broken:
            _say(f"midspan: standard output: {failed.error.strerror}.")
        code = _BROKEN_PIPE if broken else _CANNOT_WRITE
    finally:
        (sys.stdout, sys.stderr), sys.unraisablehook = streams, hook
    # The work is done: what comes now ends the process at once and without a traceback.
    _use(before, signal.SIG_DFL)
    return code


def stop_by_signals(loop: "AbstractEventLoop", stop: "Callable[[], None]") -> None:
    """Let Ctrl-C and a service manager's signal call `stop` in a loop of this thread.

    The loop's own handlers are woken by a byte in the socket that its other threads wake it by: where hundreds of
    messages wait, that is full, and the signal is lost.
    """

    def heard(_number: int, _frame: "FrameType | None") -> None:
        if not loop.is_closed():
            loop.call_soon_threadsafe(stop)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, heard)


def _catch_signals() -> "tuple[int, ...]":
    """Let the signals raise `Stopped`; returns those that do. What the caller ignores (nohup) stays ignored."""
    caught = []
    for name in _STOPPING:
        number = getattr(signal, name, None)
        if number is None or signal.getsignal(number) not in (signal.SIG_DFL, signal.default_int_handler):
            continue
        try:
            signal.signal(number, _stop)
        except ValueError:  # not the main thread, which alone may do this
            continue
        caught.append(int(number))
    return tuple(caught)


def _use(numbers: "tuple[int, ...]", handler: "signal.Handlers") -> None:
    for number in numbers:
        signal.signal(number, handler)


def _stop(number: int, frame: "FrameType | None") -> None:
    _asked.append(number)
    raise Stopped(number)


def stop_if_asked() -> None:
    """Raise `Stopped` again if a signal has arrived."""
    if _asked:
        raise Stopped(_asked[-1])


def _again(lost: "sys.UnraisableHookArgs", hook: "Callable[[sys.UnraisableHookArgs], None]") -> None:
    """Send a signal again that arrived where no exception can leave, in a destructor say; what follows is silent."""
    if isinstance(lost.exc_value, Stopped):
        import threading

        threading.Timer(_AGAIN_AFTER_S, os.kill, (os.getpid(), lost.exc_value.number)).start()
    elif not _asked:
        hook(lost)


def _say(text: str) -> None:
    if sys.stderr is not None:
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()


class _Stream:
    """A text stream whose errors of writing are OutputError, or nothing; everything else goes to the stream itself."""

    def __init__(self, stream: "Any", *, fails: bool) -> None:
        self._stream, self._fails = stream, fails

    def __getattr__(self, name: str) -> "Any":
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write, or give up."""
        try:
            return int(self._stream.write(text))
        except OSError as error:
            self._give_up(error)
            return len(text)

    def flush(self) -> None:
        """Flush, or give up."""
        try:
            self._stream.flush()
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        # What is left in the buffer goes nowhere, or the interpreter would try again at its end and complain.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)
        if self._fails:
            raise OutputError(error)
