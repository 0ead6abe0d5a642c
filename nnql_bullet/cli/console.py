"""Printing: lines, complaints, and the progress of long work."""

import logging
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

UNSUPPORTED_PYTHON = (
    ""
    if (3, 10) <= sys.version_info < (3, 12)
    else f"CPython 3.10 or 3.11 is needed, not {sys.version.split()[0]}: PyBullet has no wheels for it"
)

LINE_EVERY = 10.0
"""Seconds between plain progress lines where there is no terminal."""

out = Console(highlight=False, soft_wrap=True)
err = Console(stderr=True, highlight=False, soft_wrap=True)


def say(text: str) -> None:
    """A line on standard output."""
    out.print(text, markup=False)


def say_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table on standard output, its columns as wide as they have to be."""
    widths = [max(len(line[column]) for line in (header, *rows)) for column in range(len(header))]
    for line in (header, *rows):
        say("  ".join(f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)).rstrip())


def complain(text: str) -> int:
    """One line on standard error; the exit code of bad input."""
    err.print(f"nnql-bullet: {' '.join(text.split())}", markup=False)
    return 2


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
def progress(what: str, total: int, done: int = 0) -> Iterator[Callable[[int, str], None]]:
    """Shows how far long work is, on standard error: a bar on a terminal, a line now and then elsewhere.

    Gives a function of (finished so far, what to say beside it).
    """
    if err.is_terminal:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=None),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
            TimeRemainingColumn(),
            TextColumn("left"),
        )
        with Progress(*columns, console=err, expand=True) as bar:
            task = bar.add_task(what, total=total, completed=done, note="")
            yield lambda finished, note: bar.update(task, completed=finished, note=note)
    else:
        yield _Lines(what, total, done)


class _Lines:
    def __init__(self, what: str, total: int, done: int) -> None:
        self._what, self._total, self._first = what, total, done
        self._begin = self._last = time.monotonic()

    def __call__(self, finished: int, note: str) -> None:
        now = time.monotonic()
        if now - self._last < LINE_EVERY and finished < self._total:
            return
        self._last = now
        left = (now - self._begin) / max(finished - self._first, 1) * (self._total - finished)
        err.print(f"{self._what} {finished}/{self._total}  {note}  {left:.0f} s left", markup=False)
