"""Long work in pieces: spread over processes, its progress shown, its results in order."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from nnql_bullet.cli.console import progress
from nnql_bullet.executors import Executor, Task

T = TypeVar("T", bound=Task)
V = TypeVar("V")


class WorkFailed(Exception):
    """A piece of work raised, or its process died; the message is one line that says which."""


def run_all(
    executor: Executor,
    what: str,
    function: Callable[[T], V],
    tasks: Sequence[T],
    size: Callable[[T], int] = lambda _: 1,
) -> list[V]:
    """What a function makes of every task, in their order.

    Args:
        executor: Where it runs.
        what: Said beside the progress.
        function: See `executors.Executor.map`.
        tasks: The pieces.
        size: How much of the work a piece is.

    Raises:
        WorkFailed: If it raises on one; the others are stopped.
    """
    results: dict[int, V] = {}
    finished = 0
    with progress(what, sum(map(size, tasks))) as show:
        for outcome in executor.map(function, tasks):
            if outcome.error:
                raise WorkFailed(f"{what}, piece {outcome.index + 1} of {len(tasks)}: {outcome.error.message}")
            results[outcome.index] = outcome.value  # type: ignore[assignment]  # there is no error
            finished += size(outcome.task)
            show(finished, "")
    return [results[index] for index in range(len(tasks))]
