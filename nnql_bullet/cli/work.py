"""Long work in pieces: spread over processes, its progress shown, its results in order."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from nnql_bullet.cli.console import progress
from nnql_bullet.evaluation.parts import Parts, Piece
from nnql_bullet.executors import Executor

T = TypeVar("T")
P = TypeVar("P", bound=Piece)
R = TypeVar("R")
V = TypeVar("V")


class WorkFailed(Exception):
    """A piece of work raised, or its process died; the message is one line that says which."""


def run_all(
    executor: Executor,
    what: str,
    function: Callable[[T], V],
    tasks: Sequence[T],
    size: Callable[[T], int] = lambda _: 1,
    keep: Callable[[T, V], None] = lambda task, value: None,
) -> list[V]:
    """What a function makes of every task, in their order.

    Args:
        executor: Where it runs.
        what: Said beside the progress.
        function: See `executors.Executor.map`.
        tasks: The pieces.
        size: How much of the work a piece is.
        keep: Is given each piece and its result as it ends.

    Raises:
        WorkFailed: If it raises on one; the others are stopped.
    """
    results: dict[int, V] = {}
    finished = 0
    with progress(what, sum(map(size, tasks))) as show:
        for outcome in executor.map(function, tasks):
            if outcome.error:
                raise WorkFailed(f"{what}, piece {outcome.index + 1} of {len(tasks)}: {outcome.error.message}")
            value: V = outcome.value  # type: ignore[assignment]  # there is no error
            keep(outcome.task, value)
            results[outcome.index] = value
            finished += size(outcome.task)
            show(finished, "")
    return [results[index] for index in range(len(tasks))]


def run_kept(
    executor: Executor, what: str, function: Callable[[P], list[R]], tasks: Sequence[P], parts: Parts, record: type[R]
) -> list[list[R]]:
    """What a function makes of every task, in their order; results that are there are not worked out again.

    Args:
        executor: Where it runs.
        what: Said beside the progress.
        function: See `executors.Executor.map`.
        tasks: The pieces.
        parts: Where their results are kept, each as soon as it is there.
        record: What they are lists of.

    Raises:
        WorkFailed: If it raises on one; the others are stopped.
        UserError: If a kept result is damaged.
    """
    kept = {task.part: parts.load(task.part, record) for task in tasks}
    missing = {task.part: task for task in tasks if kept[task.part] is None}
    todo = list(missing.values())
    found = run_all(
        executor, what, function, todo, lambda task: task.size, lambda task, its: parts.save(task.part, its)
    )
    done = dict(zip(missing, found, strict=True))
    return [done[task.part] if task.part in done else kept[task.part] or [] for task in tasks]
