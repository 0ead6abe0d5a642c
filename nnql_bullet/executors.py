"""Runs many independent tasks in this process, in processes of this machine, or on a Ray cluster."""

import multiprocessing
import os
import signal
import socket
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing.connection import Connection
from typing import Any, Generic, Literal, Protocol, TypeVar

from typing_extensions import TypedDict

from nnql_bullet.errors import UserError
from nnql_bullet.machine import allowed_cores, may_start_processes

ExecutorKind = Literal["inline", "processes", "ray"]

RAY_TIMEOUT = 5.0
"""Longest wait for a Ray cluster to answer, and for its tasks to end [s]."""

T = TypeVar("T")
V = TypeVar("V")


class ExecutorArguments(TypedDict, total=False):
    """Where pieces of work run.

    Attributes:
        executor: "inline", "processes" or "ray"; by default inline with one worker and processes with more. A script
            that starts processes needs `if __name__ == "__main__":`.
        workers: Pieces at a time, by default one; None takes one a core. The results do not depend on it.
        address: HOST:PORT of a running Ray cluster; without it, Ray is started on this machine.
    """

    executor: ExecutorKind | None
    workers: int | None
    address: str | None


@dataclass(frozen=True, slots=True)
class TaskError:
    """The reason why a task has no value."""

    message: str
    """One line: type and text of the exception."""
    traceback: str
    """The whole traceback in the process that ran the task."""


@dataclass(frozen=True, slots=True)
class Outcome(Generic[T, V]):
    """Result of a task that has ended: a value or an error."""

    index: int
    """Position of the task among all tasks."""
    task: T
    value: V | None
    """Return value of the function; None after an error."""
    error: TaskError | None
    """None if the function returned."""


class Executor(Protocol):
    """Runs tasks. All executors give the same outcomes if the function depends on its task alone."""

    def map(self, function: Callable[[T], V], tasks: Iterable[T]) -> Iterator[Outcome[T, V]]:
        """Runs a function on every task and yields each outcome as soon as the task ends.

        Closing the iterator stops the tasks that still run.

        Args:
            function: A function at the top of a module that the workers can import.
            tasks: Values that can be pickled; the results must be, too. A free worker takes the next task.
        """


def make_executor(kind: ExecutorKind | None = None, workers: int | None = None, address: str | None = None) -> Executor:
    """Makes an executor.

    Args:
        kind: "inline" runs tasks one after another in this process, "processes" in processes of this machine, "ray" on
            Ray. The default is inline with one worker and processes with more. In a daemonic process, which may have no
            children, tasks run inline.
        workers: Number of tasks that run at a time; the default is one per core that this process may use. Inline
            always runs one.
        address: HOST:PORT of a running Ray cluster; without it, Ray is started on this machine.

    Raises:
        UserError: If there is no worker, Ray is not installed or does not answer, or another kind gets an address.
    """
    workers = at_once(workers)
    if kind == "ray":
        return RayExecutor(workers, address)
    if address is not None:
        raise UserError(f"the executor '{kind or 'inline'}' takes no address: leave it out, or choose 'ray'")
    inline = not may_start_processes() or (workers == 1 if kind is None else kind == "inline")
    return InlineExecutor() if inline else ProcessExecutor(workers)


def at_once(workers: int | None) -> int:
    """Returns the number of tasks that run at a time; None is one per core that this process may use.

    Raises:
        UserError: If it is below 1.
    """
    workers = allowed_cores() if workers is None else workers
    if workers < 1:
        raise UserError(f"workers must be at least 1, not {workers}")
    return workers


def executor_of(asked: ExecutorArguments) -> Executor:
    """Makes the executor that is asked for.

    Raises:
        UserError: See `make_executor`.
    """
    return make_executor(asked.get("executor"), asked.get("workers", 1), asked.get("address"))


_Attempt = tuple[V | None, TaskError | None]


class _Submit(Protocol):
    def __call__(self, function: Callable[[T], V], task: T) -> Future[_Attempt[V]]: ...


class InlineExecutor:
    """Runs the tasks in this process, each when the caller asks for its outcome."""

    def map(self, function: Callable[[T], V], tasks: Iterable[T]) -> Iterator[Outcome[T, V]]:
        """See `Executor.map`."""
        for index, task in enumerate(tasks):
            yield Outcome(index, task, *_attempt(function, task))


class ThreadExecutor:
    """Runs the tasks in threads of this process: for functions that spend their time in compiled code without the GIL.

    Nothing has to start, and no result is copied. Closing the iterator waits for the tasks that run.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers

    def map(self, function: Callable[[T], V], tasks: Iterable[T]) -> Iterator[Outcome[T, V]]:
        """See `Executor.map`."""
        return _run(self._pool(), self._workers, function, tasks)

    @contextmanager
    def _pool(self) -> Iterator[_Submit]:
        with ThreadPoolExecutor(self._workers) as pool:
            yield lambda function, task: pool.submit(_attempt, function, task)


class ProcessExecutor:
    """Runs the tasks in new processes of this machine.

    Every worker is a pool of one process, so a worker that dies loses only its own task.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers

    def map(self, function: Callable[[T], V], tasks: Iterable[T]) -> Iterator[Outcome[T, V]]:
        """See `Executor.map`."""
        return _run(self._pools(), self._workers, function, tasks)

    @staticmethod
    @contextmanager
    def _pools() -> Iterator[_Submit]:
        latest: dict[ProcessPoolExecutor, Future[Any]] = {}
        context = multiprocessing.get_context("spawn")
        lifeline, held = context.Pipe(duplex=False)

        def submit(function: Callable[[T], V], task: T) -> Future[_Attempt[V]]:
            for pool in [pool for pool, future in latest.items() if future.done()]:
                with suppress(BrokenProcessPool):
                    latest[pool] = pool.submit(_attempt, function, task)
                    return latest[pool]
                pool.shutdown()
                del latest[pool]
            pool = ProcessPoolExecutor(1, context, _prepare_worker, (lifeline,))
            latest[pool] = pool.submit(_attempt, function, task)
            return latest[pool]

        try:
            yield submit
        finally:
            held.close()
            for pool in latest:
                pool.shutdown(cancel_futures=True)
            lifeline.close()


class RayExecutor:
    """Runs the tasks on a Ray cluster, one CPU each.

    It uses the cluster that this process is connected to, or the one at `address`, or starts one on this machine.
    """

    def __init__(self, workers: int, address: str | None = None) -> None:
        try:
            import ray
        except ImportError:
            raise UserError("Ray is not installed; install it with: pip install 'nnql-bullet[ray]'") from None
        if address is not None:
            _check_answers(address)
        self._ray = ray
        self._workers = workers
        self._address = address

    def map(self, function: Callable[[T], V], tasks: Iterable[T]) -> Iterator[Outcome[T, V]]:
        """See `Executor.map`."""
        return _run(self._cluster(), self._workers, function, tasks)

    @contextmanager
    def _cluster(self) -> Iterator[_Submit]:
        ray = self._ray
        connected = ray.is_initialized()
        if not connected:
            with nullcontext() if self._address else _on_loopback(ray):
                ray.init(
                    self._address or "local",
                    num_cpus=None if self._address else self._workers,
                    include_dashboard=False,
                    log_to_driver=False,
                    logging_level="ERROR",
                )
        attempt = ray.remote(max_retries=0)(_attempt)
        running: dict[Future[Any], Any] = {}

        def submit(function: Callable[[T], V], task: T) -> Future[_Attempt[V]]:
            reference = attempt.remote(function, task)
            future: Future[_Attempt[V]] = reference.future()
            running[future] = reference
            future.add_done_callback(running.pop)
            return future

        try:
            yield submit
        finally:
            for reference in list(running.values()):
                ray.cancel(reference, force=True)
            wait(list(running), RAY_TIMEOUT)
            if not connected:
                ray.shutdown()


@contextmanager
def _on_loopback(ray: Any) -> Iterator[None]:
    """Lets Ray listen on the loopback interface alone, as it does where it makes no clusters of several machines."""
    settings = ray._private.ray_constants
    before = settings.ENABLE_RAY_CLUSTER
    settings.ENABLE_RAY_CLUSTER = False
    try:
        yield
    finally:
        settings.ENABLE_RAY_CLUSTER = before


def _check_answers(address: str) -> None:
    """Raises UserError if nothing listens at the address; Ray itself would try for many minutes."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=RAY_TIMEOUT).close()
    except (OSError, ValueError, OverflowError):
        raise UserError(f"no Ray cluster at '{address}': give HOST:PORT of one (`ray start --head` shows it)") from None


def _run(
    place: AbstractContextManager[_Submit], workers: int, function: Callable[[T], V], tasks: Iterable[T]
) -> Iterator[Outcome[T, V]]:
    """Gives each worker one task at a time, so that a worker that dies loses only one."""
    waiting = enumerate(tasks)
    running: dict[Future[_Attempt[V]], tuple[int, T]] = {}
    ended: list[Outcome[T, V]] = []
    with place as submit:
        while True:
            for index, task in islice(waiting, workers - len(running)):
                running[submit(function, task)] = index, task
            yield from ended
            if not running:
                return
            futures = wait(running, return_when=FIRST_COMPLETED).done
            ended = [_outcome(future, *running.pop(future)) for future in futures]


def _outcome(future: Future[_Attempt[V]], index: int, task: T) -> Outcome[T, V]:
    """Makes the outcome of a task that returned, raised, or was lost with its worker."""
    try:
        return Outcome(index, task, *future.result())
    except Exception as error:
        return Outcome(index, task, None, _describe(error))


def _attempt(function: Callable[[T], V], task: T) -> _Attempt[V]:
    """Runs one task in the worker; an exception becomes text, because some exceptions cannot be pickled."""
    try:
        return function(task), None
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit too
        return None, _describe(error)


def _describe(error: BaseException) -> TaskError:
    message = " ".join("".join(traceback.format_exception_only(error)).split())
    return TaskError(message, "".join(traceback.format_exception(error)))


def _prepare_worker(lifeline: Connection) -> None:
    """Ignores Ctrl-C and a closed terminal, and uses one core.

    The worker ends when the parent closes the other end of the pipe or dies.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # torch, which is imported later, reads it; Ray sets it too
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    with suppress(EOFError, OSError):
        lifeline.recv_bytes()
    os.kill(os.getpid(), signal.SIGKILL)
