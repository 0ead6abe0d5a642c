"""Keeps results of pieces of work in a folder, so that interrupted work continues where it stopped."""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol, TypeVar

from pydantic import TypeAdapter, ValidationError

from nnql_bullet.errors import UserError
from nnql_bullet.executors import Executor
from nnql_bullet.files import read_json, write_text
from nnql_bullet.provenance import code_digest, libraries, made_by
from nnql_bullet.work import OnProgress, run_all

R = TypeVar("R")


class Piece(Protocol):
    """A piece of work whose result, a list of records, can be kept."""

    @property
    def part(self) -> str:
        """Name of the result, a hash of everything it depends on (`part_name`); one with an empty name is not kept."""

    @property
    def size(self) -> int:
        """Units of work."""


P = TypeVar("P", bound=Piece)


def part_name(module: str, *depends: object) -> str:
    """Hashes everything that a result depends on, so that a result of other code is not found and is made anew.

    Args:
        module: Name of the module whose code makes the result; the digest of its code and the versions of the libraries
            go in.
        depends: What else it depends on: configuration, weights, worlds, robot.
    """
    made_with = code_digest(module), *sorted(libraries().items())
    return hashlib.sha256(" ".join(map(str, (*made_with, *depends))).encode()).hexdigest()[:24]


class Parts:
    """Lists of dataclass records, each list in its own JSON file. Without a folder, nothing is kept."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def load(self, name: str, record: type[R]) -> list[R] | None:
        """Reads the records of a piece; None if there are none.

        Raises:
            UserError: If their file is damaged.
        """
        path = self._path(name)
        if path is None or not path.exists():
            return None
        try:
            return TypeAdapter(list[record]).validate_python(read_json(path))  # type: ignore[valid-type]
        except (UserError, ValidationError) as error:
            reason = str(error).partition("\n")[0]
            raise UserError(f"{path}: damaged ({reason}); delete it, and its work is done again") from None

    def save(self, name: str, records: Sequence[Any]) -> None:
        """Writes the records of a piece."""
        path = self._path(name)
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, json.dumps([asdict(record) for record in records]) + "\n")

    def _path(self, name: str) -> Path | None:
        return self._folder / f"{name}.json" if self._folder and name else None


def run_kept(
    executor: Executor,
    what: str,
    function: Callable[[P], list[R]],
    tasks: Sequence[P],
    parts: Parts,
    record: type[R],
    on_progress: OnProgress | None = None,
) -> list[list[R]]:
    """Applies a function to every task whose result is not kept yet; returns all results in the order of the tasks.

    Args:
        executor: Runs the tasks.
        what: Name of the work, for its progress and its errors.
        function: See `executors.Executor.map`.
        tasks: The pieces of work; those with the same `part` are done once.
        parts: Keeps each result as soon as its piece ends.
        record: Class of the records.
        on_progress: Receives the progress.

    Raises:
        WorkFailed: If the function raises on a task; the others are stopped.
        UserError: If a kept result is damaged.
    """
    made_by()  # which is asked for at the end, when the sources may be others
    names = [task.part or f"not kept {number}" for number, task in enumerate(tasks)]
    kept = {name: parts.load(task.part, record) for name, task in zip(names, tasks, strict=True)}
    missing = {name: task for name, task in zip(names, tasks, strict=True) if kept[name] is None}
    found = run_all(
        executor,
        what,
        function,
        list(missing.values()),
        lambda task: task.size,
        lambda task, its: parts.save(task.part, its),
        on_progress,
    )
    done = dict(zip(missing, found, strict=True))
    return [done[name] if name in done else kept[name] or [] for name in names]
