"""Verbs as tyro parses them: every key of a configuration is a flag, and a mistake is one line."""

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, make_dataclass
from inspect import Parameter, signature
from itertools import takewhile
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro
from tyro import _errors as tyro_errors

from nnql_bullet.commands import flag
from nnql_bullet.config import Key, abouts_of, keys, nearest
from nnql_bullet.errors import UserError
from nnql_bullet.run_config import RENAMED_KEYS, RENAMED_SIMULATORS

RENAMED_FLAGS = {
    "--friction": "--conditions.wheel-friction",
    "--payload": "--conditions.payload",
    "--noise": "--conditions.sensor-noise",
    "--dead-sector": "--conditions.dead-sector",
    **{flag(old): flag(new) for old, new in RENAMED_KEYS.items()},
}
"""Flags of version 0.1, and their names now."""
_METAVARS = {float: "X", int: "N", bool: "true|false", str: "TEXT"}


@dataclass(frozen=True)
class KeyFlags:
    """Annotates a parameter of a verb that takes nested values: each key of an options class is a flag."""

    cls: type
    tables: tuple[str, ...] = ()
    """Only keys in these tables; all by default."""
    shown: Callable[[str], bool] = lambda name: True
    """Whether `--help` shows a key."""

    def table(self, parameter: str) -> str:
        """The table that the keys are in, with a dot: the parameter's name where it names the options class."""
        return f"{parameter}." if self.cls.__name__.lower() == parameter else ""

    def keys(self, for_help: bool) -> list[Key]:
        """The keys that have a flag."""
        tables = tuple(f"{table}." for table in self.tables)
        found = [key for key in keys(self.cls) if key.name.startswith(tables or "")]
        return [key for key in found if not for_help or self.shown(key.name)]


def parse(verb: Callable[..., int], prog: str, arguments: Sequence[str]) -> Callable[[], int]:
    """Parses the arguments of a verb.

    Returns:
        The call of the verb with them.

    Raises:
        UserError: If they are wrong.
        SystemExit: If they ask for help, which is then printed.
    """
    noting = _noting(verb, for_help=not {"-h", "--help"}.isdisjoint(arguments))

    def refuse(event: tyro_errors.ParseErrorEvent) -> None:
        raise UserError(f"{_mistake(event, verb, arguments)}; see: {prog} --help")

    with tyro_errors.on_parse_error(refuse):
        return tyro.cli(noting, prog=prog, args=arguments, config=(tyro.conf.FlagCreatePairsOff,))


def _noting(verb: Callable[..., int], for_help: bool) -> Callable[..., Callable[[], int]]:
    """The verb with its help, which only takes note of its arguments."""

    def note(*args: object, **kwargs: object) -> Callable[[], int]:
        return functools.partial(verb, *map(_given, args), **{name: _given(value) for name, value in kwargs.items()})

    hints, abouts = get_type_hints(verb, include_extras=True), abouts_of(verb)
    parameters = [
        _parameter(its, hints[its.name], abouts.get(its.name, ""), for_help)
        for its in signature(verb).parameters.values()
    ]
    note.__doc__ = verb.__doc__
    note.__signature__ = signature(verb).replace(parameters=parameters)  # type: ignore[attr-defined]
    note.__annotations__ = {its.name: its.annotation for its in parameters}
    return note


def _parameter(its: Parameter, hint: Any, about: str, for_help: bool) -> Parameter:
    """A parameter of a verb as tyro takes it."""
    mark = _mark(hint)
    if not mark:
        return its.replace(annotation=Annotated[hint, tyro.conf.arg(help=about, help_behavior_hint=_default)])
    taken = tyro.conf.arg(name=mark.table(its.name).rstrip("."), constructor=_flags_class(tuple(mark.keys(for_help))))
    return its.replace(annotation=Annotated[Any, taken], default=None)


def _default(text: str) -> str:
    return "" if text in ("None", "False", "True") else f"(default: {text})"


@functools.cache
def _flags_class(found: tuple[Key, ...]) -> type:
    """A dataclass with a field for each key, None unless its flag is given."""
    by_name: dict[str, list[Key]] = {}
    for key in found:
        by_name.setdefault(key.name, []).append(key)
    parts = [
        (
            name.replace(".", "__"),
            Annotated[
                _joined([key.type for key in its]) | None,
                tyro.conf.arg(
                    name=name.replace("_", "-"),
                    aliases=() if flag(name) == f"--{name.replace('_', '-')}" else (flag(name),),
                    help=its[0].about,
                    metavar=_metavar(its[0].type),
                    help_behavior_hint="" if its[0].default is None else f"(default: {its[0].default})",
                ),
            ],
            None,
        )
        for name, its in by_name.items()
    ]
    return make_dataclass("KeysGiven", parts, frozen=True)


def _joined(types: Sequence[Any]) -> Any:
    """The type of a key that tables of several kinds have; true and false as TOML writes them."""
    literals = [value for its in types if get_origin(its) is Literal for value in get_args(its)]
    if literals:
        return Literal[tuple(dict.fromkeys(literals))]
    return Union[tuple(Literal["true", "false"] if its is bool else its for its in types)]  # noqa: UP007


def _metavar(its: Any) -> str:
    if get_origin(its) is Literal:
        return "|".join(map(str, get_args(its)))
    return f"{_metavar(get_args(its)[0])} ..." if get_origin(its) is tuple else _METAVARS[its]


def _given(value: object) -> object:
    """What was given of the flags of a class made by `_flags_class`, nested; any other value as it is."""
    if type(value).__name__ != "KeysGiven":
        return value
    found: dict[str, Any] = {}
    for field in fields(value):  # type: ignore[arg-type]
        its = getattr(value, field.name)
        if its is not None:
            *tables, last = field.name.split("__")
            table = found
            for name in tables:
                table = table.setdefault(name, {})
            table[last] = {"true": True, "false": False}.get(its, its) if isinstance(its, str) else its
    return found


def _mistake(event: tyro_errors.ParseErrorEvent, verb: Callable[..., int], arguments: Sequence[str]) -> str:
    """What is wrong with the arguments, in a sentence."""
    match event:
        case tyro_errors.UnrecognizedArgs():
            return _unknown(event.tokens[0], verb)
        case tyro_errors.InvalidChoice():
            where = _flag_of(event.argument)
            if event.value in RENAMED_SIMULATORS:
                return f"{where} {event.value} is now {where} {RENAMED_SIMULATORS[event.value]}"
            choices = sorted(choice for choice in event.choices if choice != "None")
            return f"{where}: '{event.value}' is not valid; give one of: {', '.join(choices)}"
        case tyro_errors.BadValue():
            return f"{_flag_of(event.argument)} needs a value"
        case tyro_errors.MissingArgs():
            return f"give {', '.join(_flag_of(its.arg) for its in event.missing_arguments)}"
        case tyro_errors.InstantiationFailure() if event.argument is not None:
            where = _flag_of(event.argument)
            return f"{where}: not a valid value: '{' '.join(_values_of(where, arguments))}'"
        case _:
            return "the arguments are wrong"


def _unknown(token: str, verb: Callable[..., int]) -> str:
    """What is said of a token that is no flag."""
    name = token.partition("=")[0]
    for old, new in RENAMED_FLAGS.items():
        if name == old or name.startswith(f"{old}."):
            return f"{name} is now {new}{name.removeprefix(old)}"
    if not token.startswith("-"):
        return f"unexpected argument '{token}'"
    known = {its.replace("-", "_").lstrip("_"): its for its in _flags_of(verb)}
    close = [known[one] for one in nearest(name.replace("-", "_").lstrip("_"), known)]
    return f"unknown flag '{name}'" + (f" (did you mean {' or '.join(close)}?)" if close else "")


def _flags_of(verb: Callable[..., int]) -> Iterator[str]:
    for name, hint in get_type_hints(verb, include_extras=True).items():
        mark = _mark(hint)
        if mark:
            yield from (flag(mark.table(name) + key.name) for key in mark.keys(for_help=False))
        elif name != "return" and signature(verb).parameters[name].kind is not Parameter.POSITIONAL_ONLY:
            yield flag(name)


def _mark(hint: Any) -> KeyFlags | None:
    return next((mark for mark in get_args(hint) if isinstance(mark, KeyFlags)), None)


def _flag_of(argument: Any) -> str:
    """The flag of an argument of tyro's, or the name of one without a flag."""
    return str(argument.lowered.name_or_flags[0] if argument.lowered.name_or_flags[0] else argument.lowered.metavar)


def _values_of(where: str, arguments: Sequence[str]) -> list[str]:
    """What was given for a flag."""
    if where not in arguments:
        return [its.partition("=")[2] for its in arguments if its.startswith(f"{where}=")]
    return list(takewhile(lambda its: not its.startswith("--"), arguments[arguments.index(where) + 1 :]))
