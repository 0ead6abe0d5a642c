"""Signals that ask a verb to end: Ctrl-C (SIGINT), SIGTERM, and SIGHUP, which a terminal sends when it is closed."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from nnql_bullet.cli.console import tell

Handler = Callable[[int, FrameType | None], Any]


def interrupt(number: int, frame: FrameType | None) -> None:
    """Ends what is running; everything that is open is closed."""
    raise KeyboardInterrupt


@contextmanager
def handled(handler: Handler | signal.Handlers, last: bool = False) -> Iterator[None]:
    """Handles these signals, and puts back how they were handled before.

    Only the main thread handles signals: in another one this does nothing. SIGHUP stays ignored under `nohup`.

    Args:
        handler: As for `signal.signal`.
        last: Whether the process ends afterwards; they are then ignored to its end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    if before[signal.SIGHUP] is signal.SIG_IGN:
        del before[signal.SIGHUP]
    for number in before:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, signal.SIG_IGN if last else old)


@contextmanager
def held_back() -> Iterator[Callable[[], bool]]:
    """Holds them back until the present episode of a training is over; a second one ends at once.

    Yields:
        Whether there has been one.
    """
    asked = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        with suppress(OSError):  # the terminal may be closed
            tell("ending after this episode (once more: at once, from the last checkpoint)")

    with handled(note):
        yield lambda: asked
