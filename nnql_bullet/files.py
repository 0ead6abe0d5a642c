"""Reads text, and writes files atomically: a file is complete or does not exist."""

import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any
from uuid import uuid4

from nnql_bullet.errors import UserError

MOST_TEXT = 256_000_000
"""Size of the largest text file that is read [bytes]."""
MOST_DEPTH = 100
"""Deepest nesting of JSON that is read."""


def is_file(path: Path | str) -> bool:
    """Whether there is a plain file; False too for a name that no file can have."""
    return os.path.isfile(path)


def read_text(path: Path) -> str:
    """Reads UTF-8 text, with or without a byte order mark.

    Raises:
        UserError: If there is no such plain file, it is too large, it cannot be read, or it is not UTF-8.
    """
    if not is_file(path):
        raise UserError(f"{path}: is a folder, not a file" if os.path.isdir(path) else f"{path}: there is no such file")
    try:
        size = path.stat().st_size
        if size > MOST_TEXT:
            raise UserError(f"{path}: has {size} bytes; text is read up to {MOST_TEXT} bytes")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: is not UTF-8 (byte {error.start}); save it as UTF-8") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}") from None


def read_json(path: Path) -> Any:
    """Reads JSON.

    Raises:
        UserError: See `read_text`; or the text is not JSON.
    """
    return parse_json(read_text(path), str(path))


def parse_json(text: str, where: str) -> Any:
    """Parses JSON that is not nested deeper than `MOST_DEPTH`.

    Args:
        text: The text.
        where: Names the source in errors.

    Raises:
        UserError: If it is not JSON, or nested deeper.
    """
    try:
        values = json.loads(text)
    except RecursionError:
        raise UserError(f"{where}: its values are nested too deeply") from None
    except ValueError as error:
        raise UserError(f"{where}: is not JSON: {error}") from None
    level = [values]
    for _ in range(MOST_DEPTH):
        level = [its for one in level if isinstance(one, dict | list) for its in _within(one)]
        if not level:
            return values
    raise UserError(f"{where}: its values are nested too deeply")


def _within(container: dict[str, Any] | list[Any]) -> Iterable[Any]:
    return container.values() if isinstance(container, dict) else container


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Writes a file beside `path` and then renames it to `path` in one step.

    After an error, an old file at `path` is unchanged and no other file remains.

    Args:
        path: The file to write, in an existing folder.
        write: Writes the content to the path in its argument, which has the suffix of `path`.
    """
    temporary = path.with_name(f".{path.stem}-{uuid4().hex}{path.suffix}")
    temporary.touch(exist_ok=False)
    mode = temporary.stat().st_mode
    try:
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.chmod(mode)  # some writers replace the file, for example safetensors
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Writes UTF-8 text with line feeds atomically."""
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8", newline="\n"))
