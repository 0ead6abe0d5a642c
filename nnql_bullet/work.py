"""Runs the pieces of long work in an executor and reports progress."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from nnql_bullet.errors import WorkFailed
from nnql_bullet.executors import Executor

T = TypeVar("T")
V = TypeVar("V")


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of long work."""

    what: str
    """Name of the work."""
    done: int
    """Number of finished units."""
    total: int
    """Number of all units."""
    note: str = ""
    """A remark about the present state."""


OnProgress = Callable[[Progress], None]
"""Receives the progress of a library function at its start and after every piece."""


def silent(progress: Progress) -> None:
    """Ignores progress."""


def run_all(
    executor: Executor,
    what: str,
    function: Callable[[T], V],
    tasks: Sequence[T],
    size: Callable[[T], int] = lambda _: 1,
    keep: Callable[[T, V], None] = lambda task, value: None,
    on_progress: OnProgress | None = None,
) -> list[V]:
    """Applies a function to every task; returns the results in the order of the tasks.

    Args:
        executor: Runs the tasks.
        what: Name of the work, for its progress and its errors.
        function: See `executors.Executor.map`.
        tasks: The pieces of work.
        size: Returns the number of units of work in a piece.
        keep: Receives each piece and its result as soon as the piece ends.
        on_progress: Receives the progress.

    Raises:
        WorkFailed: If the function raises on a task; the other tasks are stopped.
    """
    report = on_progress or silent
    results: dict[int, V] = {}
    total, done = sum(map(size, tasks)), 0
    report(Progress(what, done, total))
    for outcome in executor.map(function, tasks):
        if outcome.error:
            raise WorkFailed(f"{what}, piece {outcome.index + 1} of {len(tasks)}: {outcome.error.message}")
        value: V = outcome.value  # type: ignore[assignment]  # there is no error
        keep(outcome.task, value)
        results[outcome.index] = value
        done += size(outcome.task)
        report(Progress(what, done, total))
    return [results[index] for index in range(len(tasks))]
