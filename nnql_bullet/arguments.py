"""Checks what a caller gives to a function of the library, before the function does anything."""

import inspect
import os
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache, wraps
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from typing_extensions import is_typeddict

from nnql_bullet.errors import UserError

P = ParamSpec("P")
R = TypeVar("R")

_LARGEST = 10**30
"""Largest magnitude of a whole number; no argument is near it."""


class _Own:
    """Stands for the default that a function of its own has for an argument; `help` shows it as stubs do."""

    def __repr__(self) -> str:
        return "..."


_OWN = _Own()

_WORDS: dict[Any, str] = {
    NoneType: "None",
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    str: "text",
    Path: "a path",
    Callable: "a function",
}


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Lets a function refuse arguments that are not of the types in its signature.

    Of `**asked: Unpack[Group]` each key of the group, a `TypedDict`, becomes an argument of its own, also for `help`:
    the line about `asked` in the docstring becomes the lines of the group's section `Attributes`.

    A number of NumPy becomes one of Python. Protocols are not checked: who uses such an object says what it lacks.

    Raises:
        UserError: (The function.) If an argument is of another type.
    """
    signature, about = _unpacked(function)
    grouped = {its.name: its.annotation for its in signature.parameters.values() if its.default is _OWN}
    hints = cache(lambda: get_type_hints(function) | grouped)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            given = signature.bind(*args, **kwargs)
        except TypeError as error:
            raise TypeError(f"{function.__name__}() {error}") from None
        for name, value in given.arguments.items():
            if name not in hints() or signature.parameters[name].kind is inspect.Parameter.VAR_KEYWORD:
                continue
            plain = given.arguments[name] = value.item() if isinstance(value, np.generic) else value
            if isinstance(plain, str | Path) and not _can_name(plain):
                raise UserError(f"'{name}': no file can be named '{plain}'")
            if plain == "":
                raise UserError(f"'{name}' is empty text")
            if isinstance(plain, int) and abs(plain) > _LARGEST:
                raise UserError(f"'{name}' is a number of too many digits")
            if not _fits(plain, hints()[name]):
                shown = f"'{plain}'" if isinstance(plain, str) else f"a value of type {type(plain).__name__}"
                raise UserError(f"'{name}' must be {_text(hints()[name])}, not {shown}")
        return function(*given.args, **given.kwargs)

    call.__signature__, call.__doc__ = signature, about  # type: ignore[attr-defined]
    return call


def _unpacked(function: Callable[..., Any]) -> tuple[inspect.Signature, str | None]:
    """The signature and the docstring of a function, with each key of a group as an argument of its own."""
    signature, about = inspect.signature(function), function.__doc__
    parameters: list[inspect.Parameter] = []
    for its in signature.parameters.values():
        groups = [part for part in get_args(its.annotation) if is_typeddict(part)]
        if its.kind is not inspect.Parameter.VAR_KEYWORD or not groups:
            parameters.append(its)
            continue
        parameters += [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=_OWN, annotation=hint)
            for name, hint in get_type_hints(groups[0]).items()
        ]
        line = re.compile(rf"^ *\*\*{its.name}: .*\n", re.MULTILINE)
        about = about and line.sub(lambda _, group=groups[0]: _told(group), about)  # type: ignore[misc]
    return signature.replace(parameters=parameters), about


def _told(group: Any) -> str:
    """The lines about the keys of a group and of its bases."""
    lines = (group.__doc__ or "").partition("Attributes:\n")[2].rstrip()
    bases = "".join(_told(base) for base in group.__orig_bases__ if is_typeddict(base))
    return bases + (f"{lines}\n" if lines else "")


def _can_name(text: str | Path) -> bool:
    try:
        return b"\0" not in os.fsencode(text)
    except UnicodeEncodeError:
        return False


def _fits(value: Any, hint: Any) -> bool:
    kind, parts = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, UnionType):
        return any(_fits(value, part) for part in parts)
    if kind is Literal:
        return any(type(value) is type(part) and value == part for part in parts)
    if kind is Any or getattr(kind, "_is_protocol", False):
        return True
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if not isinstance(value, kind) or (isinstance(value, str | bytes) and kind is not str):
        return False
    return not (issubclass(kind, Sequence | Mapping) and parts) or all(_fits(one, parts[0]) for one in value)


def _text(hint: Any) -> str:
    """Says what fits, in words."""
    kind, parts = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, UnionType):
        return " or ".join(dict.fromkeys(map(_text, parts)))
    if kind is Literal:
        return " or ".join(f"'{part}'" for part in parts)
    return _WORDS.get(kind, f"a {getattr(kind, '__name__', kind)}")
