"""One `map` for many independent tasks: in this process, in processes of this machine, or on a Ray cluster."""

import multiprocessing
import os
import signal
import socket
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from typing import Any, Generic, Literal, Protocol, TypeVar

from nnql_bullet.errors import UserError

ExecutorKind = Literal["inline", "processes", "ray"]

GRACE = 5.0
"""Seconds that what is stopped has to end by itself [s]."""


@dataclass(frozen=True, slots=True)
class TaskError:
    """Why a task has no value."""

    message: str
    """One line: the exception's type and what it says."""
    traceback: str
    """In full, from the process the task ran in."""


T = TypeVar("T")
V = TypeVar("V")


@dataclass(frozen=True, slots=True)
class Outcome(Generic[T, V]):
    """A task that has ended."""

    index: int
    """Its position among the tasks."""
    task: T
    value: V | None
    """What the function returned, if it did."""
    error: TaskError | None
    """What kept it from returning."""


class Executor(Protocol):
    """Where tasks run. Their outcomes are the same everywhere if the function depends on nothing but its task."""

    def map(self, function: Callable[[T], V], tasks: Iterable[T]) -> Iterator[Outcome[T, V]]:
        """Runs a function on every task, and yields each as it ends; closing the iterator stops what still runs.

        Args:
            function: Of a module that workers can import too; arguments and results have to be picklable.
            tasks: Taken one by one as workers become free.
        """


def make_executor(kind: ExecutorKind | None = None, workers: int | None = None, address: str | None = None) -> Executor:
    """Makes an executor.

    Args:
        kind: "inline" runs tasks one after another in this process, "processes" in processes of this machine, "ray" on
            Ray. By default inline with one worker and processes with more.
        workers: Tasks that run at a time; by default as many as the machine has cores. Inline always runs one.
        address: HOST:PORT of a running Ray cluster; without it, Ray is started on this machine.

    Raises:
        UserError: If there is no worker, Ray is not installed or does not answer, or another kind is given an address.
    """
    workers = os.cpu_count() or 1 if workers is None else workers
    if workers < 1:
        raise UserError(f"workers must be at least 1, not {workers}")
    if kind == "ray":
        return RayExecutor(workers, address)
    if address is not None:
        raise UserError(f"the executor '{kind or 'inline'}' takes no address: leave it out, or choose 'ray'")
    return (
        InlineExecutor()
        if (kind or ("inline" if workers == 1 else "processes")) == "inline"
        else ProcessExecutor(workers)
    )


_Attempt = tuple[V | None, TaskError | None]


class _Submit(Protocol):
    def __call__(self, function: Callable[[T], V], task: T) -> Future[_Attempt[V]]: ...


class InlineExecutor:
    """Runs tasks in this process, each when its outcome is asked for."""

    def map(self, function: Callable[[T], V], tasks: Iterable[T]) -> Iterator[Outcome[T, V]]:
        """See `Executor`."""
        for index, task in enumerate(tasks):
            yield Outcome(index, task, *_attempt(function, task))


class ProcessExecutor:
    """Runs tasks in fresh processes of this machine.

    Every worker is a pool of its own, so one that dies takes its own task along and no other.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers

    def map(self, function: Callable[[T], V], tasks: Iterable[T]) -> Iterator[Outcome[T, V]]:
        """See `Executor`."""
        return _run(self._pools(), self._workers, function, tasks)

    @staticmethod
    @contextmanager
    def _pools() -> Iterator[_Submit]:
        latest: dict[ProcessPoolExecutor, Future[Any]] = {}
        context = multiprocessing.get_context("spawn")

        def submit(function: Callable[[T], V], task: T) -> Future[_Attempt[V]]:
            for pool in [pool for pool, future in latest.items() if future.done()]:
                with suppress(BrokenProcessPool):
                    latest[pool] = pool.submit(_attempt, function, task)
                    return latest[pool]
                pool.shutdown()
                del latest[pool]
            pool = ProcessPoolExecutor(1, context, _prepare_worker)
            latest[pool] = pool.submit(_attempt, function, task)
            return latest[pool]

        try:
            yield submit
        finally:
            processes = [process for pool in latest for process in pool._processes.values()]
            for pool in latest:
                pool.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                process.terminate()
            for process in processes:
                process.join(GRACE)
                process.kill()
                process.join()


class RayExecutor:
    """Runs tasks on a Ray cluster, one CPU each.

    Joins the Ray that this process is connected to, else the cluster at `address`, else starts one on this machine.
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
        """See `Executor`."""
        return _run(self._cluster(), self._workers, function, tasks)

    @contextmanager
    def _cluster(self) -> Iterator[_Submit]:
        ray = self._ray
        connected = ray.is_initialized()
        if not connected:
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
            wait(list(running), GRACE)
            if not connected:
                ray.shutdown()


def _check_answers(address: str) -> None:
    """Spares the quarter of an hour that Ray looks for a cluster that is not there."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=GRACE).close()
    except (OSError, ValueError, OverflowError):
        raise UserError(f"no Ray cluster at '{address}': give HOST:PORT of one (`ray start --head` shows it)") from None


def _run(
    place: AbstractContextManager[_Submit], workers: int, function: Callable[[T], V], tasks: Iterable[T]
) -> Iterator[Outcome[T, V]]:
    """Keeps all workers busy, and has no more tasks under way than those run at once: a died worker had but one."""
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
    """Of a task whose function returned or raised, or that never came to either: its worker died, for one."""
    try:
        return Outcome(index, task, *future.result())
    except Exception as error:
        return Outcome(index, task, None, _describe(error))


def _attempt(function: Callable[[T], V], task: T) -> _Attempt[V]:
    """Runs one task, in the worker. Exceptions leave it as text, since not every one of them can be pickled."""
    try:
        return function(task), None
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit too
        return None, _describe(error)


def _describe(error: BaseException) -> TaskError:
    message = " ".join("".join(traceback.format_exception_only(error)).split())
    return TaskError(message, "".join(traceback.format_exception(error)))


def _prepare_worker() -> None:
    """Leaves Ctrl-C to the parent process, keeps to one core, and ends the worker when the parent is gone."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # as Ray does; torch, which reads it, is not loaded yet
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGKILL)
