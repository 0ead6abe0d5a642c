"""Results of pieces of work in a folder, so that work which was interrupted goes on where it was."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol, TypeVar

from nnql_bullet import __version__
from nnql_bullet.errors import UserError
from nnql_bullet.files import write_text

R = TypeVar("R")


class Piece(Protocol):
    """A piece of work whose result can be kept: some records."""

    @property
    def part(self) -> str:
        """A name for its result, another one whenever something that the result depends on is another."""

    @property
    def size(self) -> int:
        """How much of the work it is."""


def part_name(*depends: object) -> str:
    """A hash of what a result depends on, and of the program's version."""
    return hashlib.sha256(" ".join(map(str, (__version__, *depends))).encode()).hexdigest()[:24]


class Parts:
    """Lists of dataclass records, each in a JSON file of its own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def load(self, name: str, record: type[R]) -> list[R] | None:
        """The records of a piece, if they are there.

        Raises:
            UserError: If their file is damaged.
        """
        path = self._folder / f"{name}.json"
        if not path.exists():
            return None
        try:
            return [record(**values) for values in json.loads(path.read_text(encoding="utf-8"))]
        except (OSError, ValueError, TypeError) as error:
            raise UserError(f"{path}: damaged ({error}); delete it, and its work is done again") from None

    def save(self, name: str, records: Sequence[Any]) -> None:
        """Keeps the records of a piece."""
        self._folder.mkdir(parents=True, exist_ok=True)
        write_text(self._folder / f"{name}.json", json.dumps([asdict(record) for record in records]) + "\n")
