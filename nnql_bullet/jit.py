"""Numba's compiler behind a typed decorator. Compiled code is cached on disk."""

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numba

F = TypeVar("F", bound=Callable[..., Any])


class Compiler(Protocol):
    """Compiles a function and keeps its type."""

    def __call__(self, function: F, /) -> F:
        """Returns the compiled function."""


def njit(**settings: Any) -> Compiler:
    """Returns a decorator that compiles a function in nopython mode.

    Args:
        **settings: Options of `numba.njit`, beside `cache=True`.
    """
    compiler: Compiler = numba.njit(cache=True, **settings)
    return compiler
