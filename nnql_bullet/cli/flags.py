"""Verbs as tyro parses them: every key of a configuration is a flag, help fits a screen, and a mistake is one line."""

import functools
import shutil
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, make_dataclass
from inspect import Parameter, getdoc, signature
from itertools import takewhile
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro
from tyro import _errors as tyro_errors

from nnql_bullet.cli.console import say
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
SHORT_FLAGS = {"rays": "--rays", "sensor_range": "--sensor-range", "blind_arc_degrees": "--blind-arc"}
"""Short flags of some keys of the conditions."""
GROUPS = {
    "simulation": ("sim", "against", "physics", "shield", "faults"),
    "picture": ("camera", "size", "fps", "speed", "begin", "end", "renderer"),
    "output": ("out", "video", "gui", "clips", "format", "frames", "sheet", "json"),
    "parallel work": ("workers", "executor", "address"),
}
"""Parameters of verbs that `--help` shows together; the others come first."""
GROUPED_FROM = 8
"""A verb with fewer flags shows them in one group."""
WIDEST = 100
"""Longest line of the text of `--help` [columns]."""


def _numbers(words: Sequence[str]) -> tuple[float, ...]:
    return tuple(float(its) for word in words for its in word.split(","))


NUMBERS = tyro.constructors.PrimitiveConstructorSpec[tuple[float, ...]](
    nargs="*",
    metavar="X,...",
    instance_from_str=_numbers,
    is_instance=lambda its: isinstance(its, tuple),
    str_from_instance=lambda its: [] if its is None else [",".join(map(str, its))],
)
"""Annotates numbers with commas or spaces between them."""
Place = Annotated[tuple[float, ...] | None, NUMBERS]
"""The numbers of a start or target."""
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
    for before, argument in zip(("", *arguments), arguments, strict=False):
        name, is_given, value = argument.partition("=")
        if not argument.strip() or (argument.startswith("--") and is_given and not value.strip()):
            where = name.strip() or (before if before.startswith("--") else "an argument")
            raise UserError(f"{where} has an empty value; see: {prog} --help")  # a path of '' would be this folder
    for_help = not {"-h", "--help"}.isdisjoint(arguments)
    about, _, examples = (getdoc(verb) or "").partition("\n\nArgs:")[0].partition("For example:\n")
    if for_help:
        say(_wrapped(about))

    def refuse(event: tyro_errors.ParseErrorEvent) -> None:
        raise UserError(f"{_mistake(event, verb, arguments)}; see: {prog} --help")

    with tyro_errors.on_parse_error(refuse):
        try:
            return tyro.cli(_noting(verb, for_help), prog=prog, args=arguments, config=(tyro.conf.FlagCreatePairsOff,))
        except SystemExit:
            if examples:
                say(f"For example:\n{textwrap.indent(textwrap.dedent(examples.strip(chr(10))), '  ')}")
            raise


def _wrapped(text: str) -> str:
    """Paragraphs in lines that the terminal has room for."""
    width = min(shutil.get_terminal_size().columns, WIDEST)
    paragraphs = text.strip().split("\n\n")
    return "".join(f"{textwrap.fill(its, width, break_on_hyphens=False)}\n\n" for its in paragraphs)[:-1]


def _noting(verb: Callable[..., int], for_help: bool) -> Callable[..., Callable[[], int]]:
    """The verb with its help, which only takes note of its arguments."""

    def note(*args: object, **kwargs: object) -> Callable[[], int]:
        grouped = {name: value for its in kwargs.values() if _is(its, "Group") for name, value in vars(its).items()}
        single = {name: _given(its) for name, its in kwargs.items() if not _is(its, "Group")}
        return functools.partial(verb, *args, **single, **grouped)

    hints, abouts = get_type_hints(verb, include_extras=True), abouts_of(verb)
    parameters = [
        _parameter(its, hints[its.name], abouts.get(its.name, ""), for_help)
        for its in signature(verb).parameters.values()
    ]
    if len(parameters) >= GROUPED_FROM:
        for title, names in GROUPS.items():
            group = [its for its in parameters if its.name in names]
            if len(group) > 1:
                parameters = [its for its in parameters if its not in group] + [_grouped(title, group)]
    note.__signature__ = signature(verb).replace(parameters=parameters)  # type: ignore[attr-defined]
    note.__annotations__ = {its.name: its.annotation for its in parameters}
    return note


def _parameter(its: Parameter, hint: Any, about: str, for_help: bool) -> Parameter:
    """A parameter of a verb as tyro takes it."""
    mark = _mark(hint)
    if mark:
        constructor, table = _flags_class(tuple(mark.keys(for_help))), mark.table(its.name).rstrip(".")
        return _nested(its.name, table or "configuration", constructor, prefixed=bool(table))
    choices = _choices(hint)
    told = tyro.conf.arg(help=about, help_behavior_hint=functools.partial(_hint, choices))
    named = (tyro.conf.arg(metavar="NAME"),) if choices else ()
    return its.replace(annotation=Annotated[(hint, *named, told)])


def _grouped(title: str, group: Sequence[Parameter]) -> Parameter:
    """One parameter in place of several, which `--help` shows together."""
    parts = [(its.name, its.annotation, its.default) for its in group]
    return _nested(title.replace(" ", "_"), title, make_dataclass("Group", parts, frozen=True), prefixed=False)


def _nested(name: str, title: str, cls: type, prefixed: bool) -> Parameter:
    """A parameter that takes a dataclass, with a flag for each of its fields."""
    marks = (tyro.conf.arg(name=title, constructor=cls), *(() if prefixed else (tyro.conf.OmitArgPrefixes,)))
    return Parameter(name, Parameter.POSITIONAL_OR_KEYWORD, default=None, annotation=Annotated[(Any, *marks)])


def _choices(hint: Any) -> tuple[str, ...]:
    """The values that a type of literals allows; none for others."""
    if get_origin(hint) is Literal:
        return tuple(map(str, get_args(hint)))
    return tuple(choice for its in get_args(hint) for choice in _choices(its))


def _hint(choices: Sequence[str], default: object) -> str:
    """What stands behind the meaning of a flag in `--help`."""
    parts = [", ".join(choices), "" if str(default) in ("", "None", "False", "True") else f"default: {default}"]
    return f"({'; '.join(filter(None, parts))})" if any(parts) else ""


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
                    name=flag(name).removeprefix("--"),
                    aliases=_short_flags(name),
                    help=its[0].about,
                    metavar=_metavar(its[0].type),
                    help_behavior_hint=_hint(_choices(its[0].type), its[0].default),
                ),
            ],
            None,
        )
        for name, its in by_name.items()
    ]
    return make_dataclass("KeysGiven", parts, frozen=True)


def _short_flags(name: str) -> tuple[str, ...]:
    """The other flags of a key, of the conditions' own table or of a configuration."""
    short = SHORT_FLAGS.get(name.removeprefix("conditions."))
    return (short,) if short else ()


def _joined(types: Sequence[Any]) -> Any:
    """The type of a key that tables of several kinds have; true and false as TOML writes them."""
    literals = [value for its in types if get_origin(its) is Literal for value in get_args(its)]
    if literals:
        return Literal[tuple(dict.fromkeys(literals))]
    if all(get_origin(its) is tuple and get_args(its)[0] is float for its in types):
        return Annotated[tuple[float, ...], NUMBERS]
    return Union[tuple(Literal["true", "false"] if its is bool else its for its in types)]  # noqa: UP007


def _metavar(its: Any) -> str:
    if get_origin(its) is Literal:
        return "NAME"
    return f"{_metavar(get_args(its)[0])} ..." if get_origin(its) is tuple else _METAVARS[its]


def _given(value: object) -> object:
    """What was given of the flags of a class made by `_flags_class`, nested; any other value as it is."""
    if not _is(value, "KeysGiven"):
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


def _is(value: object, cls: str) -> bool:
    """Whether a value is of a dataclass that this module made."""
    return type(value).__module__ == "types" and type(value).__name__ == cls


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
            for key in mark.keys(for_help=False):
                yield from (flag(mark.table(name) + key.name), *_short_flags(key.name))
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
