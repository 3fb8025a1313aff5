"""Where jobs run: in this process, in processes of this machine, on a cluster. Algorithms know none of them."""

import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from types import ModuleType
from typing import Any, Protocol

from midspan.errors import MidspanError, UsageError

# Threads of numerical libraries in a worker: there are as many workers as processors.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# A task whose worker died is begun this often at most.
ATTEMPTS = 2
PRELOADED = ("midspan.recording.estimate", "midspan.evaluate.result_file", "midspan.sinks.parquet", "pyarrow.parquet")


class Died(Exception):
    """A worker ended while it had a task, as often as it may."""


class Runner(Protocol):
    """Gives each task to a function in some place; yields number and result as they come: a `Died` for what killed its
    workers, a MidspanError where the function raised one.
    """

    def run(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Run the tasks; closing the iterator ends the workers."""
        ...


class LocalRunner:
    """One after another in this process."""

    def run(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Run the tasks in their order."""
        for number, task in enumerate(tasks):
            try:
                result = function(task)
            except MidspanError as error:
                result = error
            yield number, result


class ProcessRunner:
    """In processes of this machine that live for many tasks; one that dies is replaced."""

    def __init__(self, workers: int | None = None) -> None:
        self._workers = workers or len(os.sched_getaffinity(0))

    def run(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Run the tasks as workers are free."""
        from multiprocessing import get_context
        from multiprocessing.connection import wait

        context = get_context("forkserver")
        context.set_forkserver_preload(list(PRELOADED))
        waiting = deque((number, 1) for number in range(len(tasks)))
        busy: dict[Any, tuple[Any, int, int]] = {}
        idle = list[tuple[Any, Any]]()
        before = {name: os.environ.get(name) for name in ONE_THREAD}
        os.environ |= dict.fromkeys(ONE_THREAD, "1")
        try:
            while waiting or busy:
                while waiting and len(busy) < self._workers:
                    number, attempt = waiting.popleft()
                    pipe, process = _begun(context, function, idle, tasks[number])
                    busy[pipe] = process, number, attempt
                ready: list[Any] = wait(list(busy))
                for pipe in ready:
                    process, number, attempt = busy.pop(pipe)
                    try:
                        result = pipe.recv()
                    except (EOFError, OSError):
                        process.join()
                        pipe.close()
                        if attempt < ATTEMPTS:
                            waiting.append((number, attempt + 1))
                        else:
                            yield number, Died(f"its worker ended with exit code {process.exitcode}, {ATTEMPTS} times")
                        continue
                    idle.append((pipe, process))
                    yield number, result
        finally:
            for name, value in before.items():
                os.environ.pop(name, None) if value is None else os.environ.__setitem__(name, value)
            for pipe, process in [*idle, *((pipe, process) for pipe, (process, *_) in busy.items())]:
                pipe.close()
                process.terminate()
                process.join()


def _begun(context: Any, function: Callable[[Any], Any], idle: list[tuple[Any, Any]], task: Any) -> tuple[Any, Any]:
    """A worker that has the task: an idle one that lives still, or a new one."""
    while idle:
        pipe, process = idle.pop()
        try:
            pipe.send(task)
        except OSError:
            pipe.close()
            process.join()
        else:
            return pipe, process
    pipe, process = _started(context, function)
    with suppress(OSError):
        # One that ended at its start is seen by the end of its pipe.
        pipe.send(task)
    return pipe, process


def _started(context: Any, function: Callable[[Any], Any]) -> tuple[Any, Any]:
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, function), daemon=True)
    # A worker imports the main module of who starts it, which a script without a guard does not bear.
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        process.start()
    finally:
        sys.modules["__main__"] = main
    theirs.close()
    return ours, process


def _serve(pipe: Any, function: Callable[[Any], Any]) -> None:
    import signal
    from multiprocessing import parent_process
    from multiprocessing.connection import wait
    from threading import Thread

    # Ctrl-C is the campaign's; it ends its workers. They end with it, too, where it is killed.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    assert parent is not None
    Thread(target=lambda: wait([parent.sentinel]) and os._exit(1), daemon=True).start()
    while True:
        try:
            task = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            result = function(task)
        except MidspanError as error:
            # As of a full disk: no task goes on.
            result = UsageError(str(error))
        try:
            pipe.send(result)
        except OSError:
            # Another worker's error has ended the campaign.
            return


class RayRunner:
    """On a cluster of Ray, one processor a task; what a lost worker had is begun once more."""

    def __init__(self, workers: int | None = None) -> None:
        from midspan.scale.ray_cluster import RayCluster

        self._cluster = RayCluster(workers or os.cpu_count() or 1)

    def run(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Run the tasks as processors are free."""
        ray = self._cluster.ray
        remote = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(function)
        numbers = {remote.remote(task): number for number, task in enumerate(tasks)}
        try:
            while numbers:
                (done,), _ = ray.wait(list(numbers), num_returns=1)
                number = numbers.pop(done)
                try:
                    result = ray.get(done)
                except ray.exceptions.RayTaskError as error:
                    if not isinstance(error.cause, MidspanError):
                        raise
                    result = error.cause
                except ray.exceptions.RayError as error:
                    result = Died(f"its worker ended ({type(error).__name__}), {ATTEMPTS} times")
                yield number, result
        finally:
            for pending in numbers:
                ray.cancel(pending, force=True)
            self.close()

    def close(self) -> None:
        """End what this has started."""
        self._cluster.close()


RUNNERS: dict[str, Callable[[int | None], Runner]] = {
    "local": lambda workers: LocalRunner(),
    "process": ProcessRunner,
    "ray": RayRunner,
}
