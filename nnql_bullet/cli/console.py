"""Printing: lines, complaints, and the progress of long work."""

import errno
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from time import monotonic

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

from nnql_bullet.work import OnProgress, Progress

UNSUPPORTED_PYTHON = (
    ""
    if (3, 10) <= sys.version_info < (3, 12)
    else f"CPython 3.10 or 3.11 is needed, not {sys.version.split()[0]}: PyBullet has no wheels for it"
)

LINE_EVERY = 10.0
"""Seconds between plain progress lines where there is no terminal."""


class _Stream(Console):
    def on_broken_pipe(self) -> None:
        """Leaves the exit code to the parser."""
        raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))


out = _Stream(highlight=False, soft_wrap=True)
err = _Stream(stderr=True, highlight=False, soft_wrap=True)


def say(text: str) -> None:
    """A line on standard output."""
    out.print(text, markup=False)


def complain(text: str) -> int:
    """One line on standard error, if somebody reads it; the exit code of bad input."""
    with suppress(OSError):
        err.print(f"nnql-bullet: {' '.join(text.split())}", markup=False)
    return 2


def is_unread(error: OSError) -> bool:
    """Whether it is that nobody reads what is printed any more; errors of files name the file."""
    return error.filename is None and (isinstance(error, BrokenPipeError) or error.errno == errno.EIO)


def give_up_output() -> int:
    """Sends to nowhere what is still to be printed, because nobody reads it; the exit code of that."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    os.close(nowhere)
    return 128 + 13  # as if ended by SIGPIPE


def items(text: str | None) -> list[str]:
    """The parts of a list with commas."""
    return [item.strip() for item in (text or "").split(",") if item.strip()]


class _Saying(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        say(self.format(record))


@contextmanager
def messages() -> Iterator[None]:
    """Prints what the library logs for information, on standard output."""
    logger, handler = logging.getLogger("nnql_bullet"), _Saying()
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.setLevel(before)
        logger.removeHandler(handler)


@contextmanager
def progress() -> Iterator[OnProgress]:
    """Shows the progress of library functions on standard error: bars on a terminal, a line now and then elsewhere."""
    if not err.is_terminal:
        yield _Lines()
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}"),
        TimeRemainingColumn(),
        TextColumn("left"),
    )
    with RichProgress(*columns, console=err, expand=True) as bars:
        tasks: dict[str, TaskID] = {}

        def show(now: Progress) -> None:
            if now.what not in tasks:
                tasks[now.what] = bars.add_task(now.what, total=now.total, completed=now.done, note=now.note)
            bars.update(tasks[now.what], completed=now.done, total=now.total, note=now.note)

        yield show


class _Lines:
    """Progress as plain lines."""

    def __init__(self) -> None:
        self._what = ""

    def __call__(self, now: Progress) -> None:
        time = monotonic()
        if now.what != self._what:
            self._what, self._first, self._begin, self._last = now.what, now.done, time, time
        if (time - self._last < LINE_EVERY and now.done < now.total) or now.done == self._first:
            return
        self._last = time
        left = (time - self._begin) / (now.done - self._first) * (now.total - now.done)
        err.print(f"{now.what} {now.done}/{now.total}  {now.note}  {left:.0f} s left", markup=False)
