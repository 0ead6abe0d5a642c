"""Locks folders, so that two processes never write the same results."""

import errno
import fcntl
import logging
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TextIO

from nnql_bullet.errors import UserError
from nnql_bullet.files import sweep

LOCK = ".lock"
"""The file that is locked; it says who holds the lock, and is gone when nobody does."""
_NO_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK)

_log = logging.getLogger(__name__)


@contextmanager
def locked(folder: Path | None) -> Iterator[None]:
    """Keeps other processes and threads out of a folder, which is made if it is not there.

    The system releases the lock of a process that dies, so what is left of it is taken over; temporary files that it
    left below the folder are removed. No folder needs no lock.

    Raises:
        UserError: If somebody else holds the lock, or there is a file of that name.
        OSError: If the folder cannot be written to.
    """
    if folder is None:
        yield
        return
    if folder.exists() and not folder.is_dir():
        raise UserError(f"{folder}: is a file; give another folder")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / LOCK
    with _taken(path) as file:
        try:
            file.truncate(0)
            file.write(f"process {os.getpid()} on {platform.node()} since {datetime.now():%Y-%m-%d %H:%M:%S}\n")
            file.flush()
            sweep(folder)
            yield
        finally:
            with suppress(OSError):
                path.unlink()


def _taken(path: Path) -> TextIO:
    """Opens and locks the file, which is no link: what it led to would be overwritten.

    Raises:
        UserError: If somebody else holds the lock, or there is a link of that name.
    """
    while True:
        if path.is_symlink():
            raise UserError(f"{path}: is a symbolic link; remove it")
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW, 0o666)
        file = os.fdopen(descriptor, "a+", encoding="utf-8")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_at(file, path):
                return file
            file.close()  # its holder has just removed it
        except OSError as error:
            if error.errno in _NO_LOCKS:
                _log.warning("%s: this file system has no locks; let no other process write there", path.parent)
                return file
            file.seek(0)
            holder = file.read().strip() or "another process"
            file.close()
            if not isinstance(error, BlockingIOError):
                raise
            raise UserError(f"{path.parent}: is in use by {holder}; wait for its end, or give another folder") from None


def _is_at(file: TextIO, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False
