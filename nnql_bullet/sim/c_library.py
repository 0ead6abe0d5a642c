"""The C library under an engine: what C code prints, and how it reads numbers."""

import ctypes
import locale
import os
from collections.abc import Iterator
from contextlib import contextmanager

from nnql_bullet.machine import open_streams

_C = ctypes.CDLL(None)
_C.newlocale.restype = _C.uselocale.restype = ctypes.c_void_p
_C.newlocale.argtypes = ctypes.c_int, ctypes.c_char_p, ctypes.c_void_p
_C.uselocale.argtypes = (ctypes.c_void_p,)
_C_LOCALE = _C.newlocale(1 << locale.LC_NUMERIC, b"C", None)


@contextmanager
def silenced() -> Iterator[None]:
    """Discards what C code prints in the meantime, in any thread; standard streams may be closed."""
    with open_streams():
        kept, nowhere = (os.dup(1), os.dup(2)), os.open(os.devnull, os.O_WRONLY)
        try:
            _C.fflush(None)  # what was printed before
            for stream in (1, 2):
                os.dup2(nowhere, stream)
            yield
        finally:
            _C.fflush(None)  # what is still buffered
            for stream, its in zip((1, 2), kept, strict=True):
                os.dup2(its, stream)
            for its in (*kept, nowhere):
                os.close(its)


@contextmanager
def decimal_points(every_thread: bool = False) -> Iterator[None]:
    """Lets the engine read numbers with decimal points, whatever the locale; it reads them by C's `atof`.

    Args:
        every_thread: Also in the threads of the engine's own that a window has. Locales have to be set in the whole
            process for that; otherwise only this thread is concerned.
    """
    before, in_process = _C.uselocale(_C_LOCALE), locale.setlocale(locale.LC_NUMERIC)
    if every_thread:
        locale.setlocale(locale.LC_NUMERIC, "C")
    try:
        yield
    finally:
        if every_thread:
            locale.setlocale(locale.LC_NUMERIC, in_process)
        _C.uselocale(before)
