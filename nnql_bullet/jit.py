"""Numba's compiler behind a typed decorator. Compiled code is cached on disk where a folder can be written to.

Without Numba, as on a vehicle that `deploy` drives, functions stay as they are: they do the same, and take longer.
"""

import logging
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from types import SimpleNamespace
from typing import Any, Protocol, TypeVar

from nnql_bullet.machine import private_folder, warned_once

try:
    with warned_once():
        import numba
        from numba.core import event
except ImportError:
    numba, event = None, SimpleNamespace(Listener=object)

F = TypeVar("F", bound=Callable[..., Any])

_log = logging.getLogger(__name__)
_lock = threading.Lock()


class Compiler(Protocol):
    """Compiles a function and keeps its type."""

    def __call__(self, function: F, /) -> F:
        """Returns the compiled function."""


def njit(**settings: Any) -> Compiler:
    """Returns a decorator that compiles a function in nopython mode, where Numba is installed.

    The code is cached where Numba finds a folder that can be written to: NUMBA_CACHE_DIR, beside the module, or in the
    user's cache. Where it finds none, the cache is `machine.private_folder`; without that, every process compiles.

    Args:
        **settings: Options of `numba.njit`, beside `cache=True`.
    """

    def compiled(function: F) -> F:
        if numba is None:
            return function
        homeless = os.path.expanduser("~") == "~"  # Numba would make a folder of that name in the working folder
        for instead in (homeless, True):
            try:
                with _cache_instead(instead):
                    its: F = numba.njit(cache=True, **settings)(function)
                    return its
            except (RuntimeError, OSError):  # no folder can be written to
                continue
        uncached: F = numba.njit(**settings)(function)
        return uncached

    return compiled


@contextmanager
def _cache_instead(instead: bool) -> Iterator[None]:
    """Lets Numba cache in the user's private folder, if asked to and if there is one, and then as before."""
    folder = private_folder() if instead else None
    with _lock:
        before = numba.config.CACHE_DIR
        if folder and not (before and os.access(before, os.W_OK)):
            numba.config.CACHE_DIR = str(folder)
        try:
            yield
        finally:
            numba.config.CACHE_DIR = before


class _Announcement(event.Listener):  # type: ignore[misc]  # Numba has no types
    """Logs the first compilation of this process; code that is loaded from the cache is not compiled."""

    made = False

    def on_start(self, event: Any) -> None:
        dispatcher = event.data["dispatcher"]
        # Worker processes say nothing: each of them would say the same.
        if _Announcement.made or parent_process() or not dispatcher.py_func.__module__.startswith("nnql_bullet."):
            return
        _Announcement.made = True
        folder = dispatcher.stats.cache_path
        kept = f"they are kept in {folder}, so this happens once" if folder else "to keep them, set NUMBA_CACHE_DIR"
        package = dispatcher.py_func.__module__.rpartition(".")[0]  # films compile others than simulations
        _log.warning("compiling the inner loops of %s; %s", package, kept)

    def on_end(self, event: Any) -> None:
        """Nothing is left to say."""


@contextmanager
def announced() -> Iterator[None]:
    """Logs a warning as soon as the body compiles something, once in a process."""
    if numba is None:
        yield
        return
    with event.install_listener("numba:compile", _Announcement()):
        yield
