"""Printing: lines, complaints, and the progress of long work."""

import errno
import logging
import os
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from datetime import timedelta
from pathlib import Path
from time import monotonic

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn
from rich.progress import Progress as RichProgress

from nnql_bullet.errors import RobotWarning, UserError
from nnql_bullet.files import is_file
from nnql_bullet.machine import open_streams
from nnql_bullet.text import one_line, printable
from nnql_bullet.work import OnProgress, Progress

UNSUPPORTED = (
    f"CPython 3.10 or a newer one is needed, not {sys.version.split()[0]}"
    if sys.version_info < (3, 10)
    else "Windows is not supported; run it in the Windows Subsystem for Linux (WSL 2)"
    if os.name == "nt"
    else ""
)
"""Why this Python or system cannot run the program; where it can, empty."""

LINE_EVERY = 10.0
"""Seconds between plain progress lines where there is no terminal."""
PIECES = 10
"""Number of pieces of work after the first one before the time left is estimated."""
ESTIMATE_AFTER = 5.0
"""Time after the first piece of work before the time left is estimated [s]."""


class _Stream(Console):
    def on_broken_pipe(self) -> None:
        """Leaves the exit code to the parser."""
        raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))


out = _Stream()
err = _Stream(stderr=True)


def say(text: str) -> None:
    """A line on standard output.

    Raises:
        UserError: If it cannot be written, as where a disk is full.
        BrokenPipeError: If nobody reads it any more.
    """
    if reason := _printed(out, text):
        raise UserError(f"standard output: {reason}; what is printed there is not whole")


def tell(text: str) -> None:
    """A line on standard error, if there is room for it: no work ends for the sake of its messages.

    Raises:
        BrokenPipeError: If nobody reads it any more.
    """
    _printed(err, text)


def _printed(stream: Console, text: str) -> str:
    """Prints a line; returns why it cannot be written, or nothing."""
    try:
        stream.out(printable(text, stream.encoding), highlight=False)
    except OSError as error:
        if is_unread(error):
            raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE)) from None
        return error.strerror or str(error)
    return ""


@contextmanager
def streams() -> Iterator[None]:
    """Sends to nowhere what is printed to closed standard streams."""
    with open_streams(), ExitStack() as opened:
        for stream, redirect in ((sys.stdout, redirect_stdout), (sys.stderr, redirect_stderr)):  # noqa: TID251
            if stream is None:
                opened.enter_context(redirect(opened.enter_context(Path(os.devnull).open("w", encoding="utf-8"))))
        yield


def complain(text: str) -> int:
    """One line on standard error, if somebody reads it; the exit code of bad input."""
    with suppress(OSError):
        tell(f"nnql-bullet: {one_line(text)}")
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
    """The parts of a list with commas; a comma in the name of a file that is there is part of it."""
    parts, found = (text or "").split(","), list[str]()
    while parts:
        ends = range(len(parts), 1, -1)
        end = next((end for end in ends if is_file(",".join(parts[:end]).strip())), 1)
        found.append(",".join(parts[:end]).strip())
        parts = parts[end:]
    return [item for item in found if item]


class _Telling(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        tell(self.format(record))


@contextmanager
def messages() -> Iterator[None]:
    """Prints in lines on standard error what the library logs, and warnings; standard output is for results."""

    def warn(message: Warning | str, category: type[Warning], *_: object) -> None:
        text = str(message).strip()
        tell(f"nnql-bullet: {one_line(text)}" if issubclass(category, RobotWarning) else text.partition("\n")[0])

    logger, handler = logging.getLogger("nnql_bullet"), _Telling()
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", RobotWarning)
            warnings.showwarning = warn  # type: ignore[assignment]  # takes what it does not say
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
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with RichProgress(*columns, console=err, expand=True) as bars:
        tasks: dict[str, tuple[TaskID, _TimeLeft]] = {}

        def show(now: Progress) -> None:
            if now.what not in tasks:
                what = printable(now.what, err.encoding)
                tasks[now.what] = bars.add_task(what, total=now.total, completed=now.done, note=""), _TimeLeft()
            task, left = tasks[now.what]
            note = printable("  ".join(filter(None, (now.note, left(now)))), err.encoding)
            bars.update(task, completed=now.done, total=now.total, note=note)

        yield show


def seed_range(text: str | None) -> range | None:
    """The seeds that FROM:TO names; None if none are asked for.

    Raises:
        UserError: If the text is not of that form.
    """
    if text is None:
        return None
    found = re.fullmatch(r"(\d{1,19}):(\d{1,19})", text, re.ASCII)
    if not found:
        raise UserError(f"--seeds: give FROM:TO, such as 0:50 for the seeds 0 to 49, not '{text}'")
    return range(int(found[1]), int(found[2]))


class _TimeLeft:
    """Estimates the time left of a work. It counts from the first piece, before which processes start and compile."""

    def __init__(self) -> None:
        self._done, self._pieces = -1, -1

    def __call__(self, now: Progress) -> str:
        """The time left; empty as long as an estimate means nothing."""
        time = monotonic()
        if now.done > self._done:
            self._done, self._pieces = now.done, self._pieces + 1
            if self._pieces == 1:
                self._first, self._begin = now.done, time
        if self._pieces <= PIECES or time - self._begin < ESTIMATE_AFTER:
            return ""
        left = (time - self._begin) / (now.done - self._first) * (now.total - now.done)
        return f"{timedelta(seconds=round(left))} left"


class _Lines:
    """Progress as plain lines."""

    def __init__(self) -> None:
        self._what = ""

    def __call__(self, now: Progress) -> None:
        time = monotonic()
        if now.what != self._what:
            self._what, self._first, self._last, self._left = now.what, now.done, time, _TimeLeft()
        left = self._left(now)
        if (time - self._last < LINE_EVERY and now.done < now.total) or now.done == self._first:
            return
        self._last = time
        tell("  ".join(filter(None, (f"{now.what} {now.done}/{now.total}", now.note, left))))
