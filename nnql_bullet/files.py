"""Reads text, and writes files atomically: a file is complete or does not exist."""

import errno
import fcntl
import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from nnql_bullet.errors import UserError

MOST_TEXT = 256_000_000
"""Size of the largest text file that is read [bytes]."""
MOST_DEPTH = 100
"""Deepest nesting of JSON that is read."""
_TEMPORARY = ".writing-"
"""Begins the names of temporary folders."""


def is_file(path: Path | str) -> bool:
    """Whether there is a plain file; False too for a name that no file can have."""
    return os.path.isfile(path)


def plain_file(path: Path) -> Path:
    """A path, checked before it is opened: to open a named pipe would wait for ever.

    Raises:
        FileNotFoundError: If there is no plain file.
    """
    if not is_file(path):
        raise FileNotFoundError(errno.ENOENT, "there is no such plain file", str(path))
    return path


def real(path: Path) -> Path:
    """A path without links; one whose links lead in a circle stays as it is, where `Path.resolve` is no `OSError`."""
    return Path(os.path.realpath(path))


def read_text(path: Path, most: int = MOST_TEXT) -> str:
    """Reads UTF-8 text of at most `most` bytes, with or without a byte order mark.

    Raises:
        UserError: If there is no such plain file, it is too large, it cannot be read, or it is not UTF-8.
    """
    if not is_file(path):
        raise UserError(f"{path}: is a folder, not a file" if os.path.isdir(path) else f"{path}: there is no such file")
    try:
        size = path.stat().st_size
        if size > most:
            raise UserError(f"{path}: has {size} bytes; such a file is read up to {most} bytes")
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
    """Writes a file in a temporary folder beside `path` and then renames it to `path` in one step.

    After an error, an old file at `path` is unchanged and no other file remains. What a process leaves that is killed
    is removed by the next one that writes into the folder.

    Args:
        path: The file to write, in an existing folder.
        write: Writes the content to the path in its argument, which has the name of `path`.

    Raises:
        OSError: If it cannot be written; it names `path`.
    """
    try:
        with temporary_folder(path.parent) as folder:
            temporary = folder / path.name
            temporary.touch(exist_ok=False)
            mode = temporary.stat().st_mode
            write(temporary)
            with temporary.open("rb") as file:
                os.fsync(file.fileno())
            temporary.chmod(mode)  # some writers replace the file, for example safetensors
            temporary.replace(path)
    except OSError as error:
        raise _naming(path, error) from None


def _naming(path: Path, error: OSError) -> OSError:
    """The error with the path that the caller knows, in place of a temporary one; not where progress is unread."""
    if isinstance(error, BrokenPipeError):
        return error
    return OSError(error.errno or errno.EIO, error.strerror or str(error), str(path))


def write_text(path: Path, text: str) -> None:
    """Writes UTF-8 text with line feeds atomically."""
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8", newline="\n"))


@contextmanager
def temporary_folder(parent: Path) -> Iterator[Path]:
    """Yields an empty folder in a folder, and removes it afterwards; those of dead processes are removed before.

    It is locked as long as it is used. The system releases the lock of a process that dies.
    """
    _sweep_one(parent)
    while True:
        folder = Path(mkdtemp(prefix=_TEMPORARY, dir=parent))
        lock = os.open(folder, os.O_RDONLY)
        if _locks(lock) is not False and folder.exists():
            break
        os.close(lock)  # another process took it for one of a dead process in this very moment
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


@contextmanager
def staged(folder: Path, last: str, old: Iterable[str] = ()) -> Iterator[Path]:
    """Yields an empty folder for files that belong together, and puts them into `folder` when all are written.

    After an error the older files are unchanged. If the process is killed while they are replaced, `last` is missing,
    so that a reader does not take old and new files for a whole.

    Args:
        folder: Where they go; it is made if it is not there.
        last: Name of the file that readers look for.
        old: Patterns of older files to remove, within the folder.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with temporary_folder(folder) as stage:
            yield stage
            for path in [folder / last, *(path for pattern in old for path in folder.glob(pattern))]:
                path.unlink(missing_ok=True)
            for path in sorted(stage.rglob("*"), key=lambda path: (path == stage / last, path)):
                target = folder / path.relative_to(stage)
                if path.is_dir():
                    target.mkdir(exist_ok=True)
                else:
                    path.replace(target)
    except OSError as error:
        raise _naming(folder, error) from None


def sweep(folder: Path) -> None:
    """Removes temporary folders of dead processes in a folder and below."""
    for parent, names, _ in os.walk(folder):
        _sweep_one(Path(parent))
        names[:] = [name for name in names if not name.startswith(_TEMPORARY)]


def _sweep_one(parent: Path) -> None:
    with os.scandir(parent) as entries:
        folders = [entry.path for entry in entries if entry.name.startswith(_TEMPORARY) and not entry.is_symlink()]
    for folder in folders:
        try:
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except OSError:  # gone, or of another user
            continue
        if _locks(lock):
            shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def _locks(descriptor: int) -> bool | None:
    """Whether a folder could be locked, or is by another process; None if its file system has no locks."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True
