"""Verbs as tyro parses them: every key of a configuration is a flag, help fits a screen, and a mistake is one line."""

import functools
import shutil
import textwrap
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, make_dataclass
from inspect import Parameter, getdoc, signature
from itertools import takewhile
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro
from tyro import _errors as tyro_errors

from nnql_bullet.cli.console import say
from nnql_bullet.commands import flag
from nnql_bullet.config import Key, abouts_of, keys, nearest, nested
from nnql_bullet.errors import UserError
from nnql_bullet.run_config import RENAMED_KEYS, RENAMED_SIMULATORS, RunConfig
from nnql_bullet.worlds.waypoints import read_waypoints

RENAMED_FLAGS = {
    "--friction": "--conditions.wheel-friction",
    "--payload": "--conditions.payload",
    "--noise": "--conditions.sensor-noise",
    "--dead-sector": "--conditions.dead-sector",
    **{flag(old): flag(new) for old, new in RENAMED_KEYS.items()},
}
"""Flags of version 0.1, and their names now."""
SHORT_FLAGS = {
    "start_from": "--from",
    "drive.speed": "--speed",
    "conditions.rays": "--rays",
    "conditions.sensor_range": "--sensor-range",
    "conditions.blind_arc_degrees": "--blind-arc",
}
"""Short flags of some keys of a configuration."""
GROUPS = {
    "goal": ("start", "target", "waypoints", "plan"),
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
WAYPOINTS = tyro.constructors.PrimitiveConstructorSpec[tuple[tuple[float, float], ...]](
    nargs=1,
    metavar="FILE|X,Y;...",
    instance_from_str=lambda words: read_waypoints(words[0]),
    is_instance=lambda its: isinstance(its, tuple),
    str_from_instance=lambda its: [] if its is None else [";".join(f"{x},{y}" for x, y in its)],
)
"""Annotates way points, which may be in a file."""
_METAVARS = {float: "X", int: "N", bool: "true|false", str: "TEXT"}


@dataclass(frozen=True)
class KeyFlags:
    """Annotates a parameter of a verb that takes nested values: each key of an options class is a flag."""

    cls: type = RunConfig
    names: tuple[str, ...] = ()
    """Only keys that begin like this; all by default."""
    shown: tuple[str, ...] = ()
    """Keys that `--help` shows; by default those that are in no table."""
    title: str = "configuration"
    """Title of their group in `--help`."""
    defaults: bool = True
    """Whether they take the place of the defaults, which `--help` then shows."""
    about: str = ""
    """A paragraph of `--help` about the keys that it does not show."""

    def keys(self, for_help: bool) -> list[Key]:
        """The keys that have a flag."""
        found = [key for key in keys(self.cls, told=for_help) if not self.names or key.name.startswith(self.names)]
        if not for_help:
            return found
        if not self.shown:
            return [key for key in found if "." not in key.name]
        return [key for name in self.shown for key in found if key.name == name]


OF_DRIVES = ("--world", "--seed", "--seeds", "--start", "--target", "--sim", "--shield", "--robot", "--speed", "--rays")
"""Flags of drives that people may look for where nothing is driven."""
ELSEWHERE = {
    "failures": "the drives are those of the evaluation; give it to `evaluate`",
    "view": "a recording is shown as it was driven; give it to `drive`",
    "report": "it shows what there is; give it to `train`, `evaluate` or `gap`",
}
"""What verbs that drive nothing of their own say of flags of drives."""


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
        marks = filter(None, (_mark(hint) for _, hint in _parameters(verb).values()))
        say(_wrapped("\n\n".join((about.strip(), *(mark.about for mark in marks)))))

    def refuse(event: tyro_errors.ParseErrorEvent) -> None:
        raise UserError(f"{_mistake(event, verb, arguments)}; see: {prog} --help")

    with tyro_errors.on_parse_error(refuse):
        try:
            noting = _noting(verb, for_help, arguments)
            return tyro.cli(noting, prog=prog, args=arguments, config=(tyro.conf.FlagCreatePairsOff,))
        except SystemExit:
            if examples:
                say(f"For example:\n{textwrap.indent(textwrap.dedent(examples.strip(chr(10))), '  ')}")
            raise


def _wrapped(text: str) -> str:
    """Paragraphs in lines that the terminal has room for."""
    width = min(shutil.get_terminal_size().columns, WIDEST)
    paragraphs = text.strip().split("\n\n")
    return "".join(f"{textwrap.fill(its, width, break_on_hyphens=False)}\n\n" for its in paragraphs)[:-1]


def _noting(verb: Callable[..., int], for_help: bool, arguments: Sequence[str]) -> Callable[..., Callable[[], int]]:
    """The verb with its help, which only takes note of its arguments.

    Of the keys of a configuration, tyro learns those that it shows and those that are given: all of them take it long.
    """

    def note(*args: object, **kwargs: object) -> Callable[[], int]:
        grouped = {name: value for its in kwargs.values() if _is(its, "Group") for name, value in vars(its).items()}
        given = {name: _given(its) for name, its in kwargs.items() if not _is(its, "Group")} | grouped
        made = {name: cls(**{its.name: given.pop(its.name) for its in fields(cls)}) for name, cls in records.items()}
        return functools.partial(verb, *args, **given, **made)

    taken, records = _parameters(verb), _records(verb)
    told = (*records.values(), verb) if for_help else ()
    abouts = {name: about for its in told for name, about in abouts_of(its).items()}
    words = {word.partition("=")[0].replace("_", "-") for word in arguments}
    flags = frozenset(map(flag, taken))
    parameters = [_parameter(*its, abouts.get(name, ""), for_help, flags, words) for name, its in taken.items()]
    if len(parameters) >= GROUPED_FROM:
        for title, names in GROUPS.items():
            group = [its for its in parameters if its.name in names]
            if len(group) > 1:
                parameters = [its for its in parameters if its not in group] + [_grouped(title, group)]
    note.__signature__ = signature(verb).replace(parameters=parameters)  # type: ignore[attr-defined]
    note.__annotations__ = {its.name: its.annotation for its in parameters}
    return note


def _parameters(verb: Callable[..., int]) -> dict[str, tuple[Parameter, Any]]:
    """The parameters of a verb and their types, with the fields of a record of shared flags in its place."""
    hints, found = get_type_hints(verb, include_extras=True), {}
    for its in signature(verb).parameters.values():
        record = hints[its.name]
        if not is_dataclass(record):
            found[its.name] = its, record
            continue
        inner = get_type_hints(record, include_extras=True)
        for one in fields(record):
            parameter = Parameter(one.name, Parameter.POSITIONAL_OR_KEYWORD, default=one.default)
            found[one.name] = parameter, inner[one.name]
    return found


def _records(verb: Callable[..., int]) -> dict[str, Any]:
    """The parameters of a verb that are records of shared flags, and their classes."""
    return {name: its for name, its in get_type_hints(verb).items() if is_dataclass(its)}


def _parameter(
    its: Parameter, hint: Any, about: str, for_help: bool, taken: frozenset[str], given: Collection[str]
) -> Parameter:
    """A parameter of a verb as tyro takes it."""
    mark = _mark(hint)
    if mark:
        found = [key for key in mark.keys(for_help) if for_help or {*_flags_of_key(key.name, taken)} & {*given}]
        return _nested(its.name, mark.title, _flags_class(tuple(found), taken, mark.defaults, for_help))
    choices = _choices(hint)
    told = tyro.conf.arg(help=about, help_behavior_hint=functools.partial(_hint, choices))
    named = (tyro.conf.arg(metavar="NAME"),) if choices else ()
    return its.replace(annotation=Annotated[(hint, *named, told)])


def _grouped(title: str, group: Sequence[Parameter]) -> Parameter:
    """One parameter in place of several, which `--help` shows together."""
    parts = [(its.name, its.annotation, its.default) for its in group]
    return _nested(title.replace(" ", "_"), title, make_dataclass("Group", parts, frozen=True))


def _nested(name: str, title: str, cls: type) -> Parameter:
    """A parameter that takes a dataclass, with a flag for each of its fields."""
    marks = (tyro.conf.arg(name=title, constructor=cls), tyro.conf.OmitArgPrefixes)
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
def _flags_class(found: tuple[Key, ...], taken: frozenset[str], defaults: bool, for_help: bool) -> type:
    """A dataclass with a field for each key, None unless its flag is given.

    Args:
        found: The keys.
        taken: Flags of the verb's own, which are no short flags of keys.
        defaults: Whether `--help` shows the defaults of the keys.
        for_help: Whether each key has its first flag alone.
    """
    by_name: dict[str, list[Key]] = {}
    for key in found:
        by_name.setdefault(key.name, []).append(key)
    parts = [
        (
            name.replace(".", "__"),
            Annotated[
                _joined([key.type for key in its]) | None,
                tyro.conf.arg(
                    name=_flags_of_key(name, taken)[0].removeprefix("--"),
                    aliases=() if for_help else _flags_of_key(name, taken)[1:],
                    help=its[0].about,
                    metavar=_metavar(its[0].type),
                    help_behavior_hint=_hint(_choices(its[0].type), its[0].default if defaults else None),
                ),
            ],
            None,
        )
        for name, its in by_name.items()
    ]
    return make_dataclass("KeysGiven", parts, frozen=True)


def _flags_of_key(name: str, taken: Collection[str]) -> tuple[str, ...]:
    """The flags of a key, the short one first."""
    short = SHORT_FLAGS.get(name, "")
    return (short, flag(name)) if short and short not in taken else (flag(name),)


def _joined(types: Sequence[Any]) -> Any:
    """The type of a key that tables of several kinds have; true and false as TOML writes them."""
    literals = [value for its in types if get_origin(its) is Literal for value in get_args(its)]
    if literals:
        return Literal[tuple(dict.fromkeys(literals))]
    if get_origin(types[0]) is tuple and get_origin(get_args(types[0])[0]) is tuple:
        return Annotated[types[0], WAYPOINTS]
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
    given = {field.name.replace("__", "."): getattr(value, field.name) for field in fields(value)}  # type: ignore[arg-type]
    words: dict[Any, Any] = {"true": True, "false": False}
    return nested({name: words.get(its, its) for name, its in given.items() if its is not None})


def _is(value: object, cls: str) -> bool:
    """Whether a value is of a dataclass that this module made."""
    its = type(value)
    return its.__name__ == cls and its.__module__ in ("types", __name__)  # the second from CPython 3.12 on


def _mistake(event: tyro_errors.ParseErrorEvent, verb: Callable[..., int], arguments: Sequence[str]) -> str:
    """What is wrong with the arguments, in a sentence."""
    match event:
        case tyro_errors.UnrecognizedArgs():
            return _unknown(event.tokens[0], verb)
        case tyro_errors.InvalidChoice():
            where = _flag_of(event.argument, arguments)
            if event.value in RENAMED_SIMULATORS:
                return f"{where} {event.value} is now {where} {RENAMED_SIMULATORS[event.value]}"
            choices = sorted(choice for choice in event.choices if choice != "None")
            return f"{where}: '{event.value}' is not valid; give one of: {', '.join(choices)}"
        case tyro_errors.BadValue():
            return f"{_flag_of(event.argument, arguments)} needs a value"
        case tyro_errors.MissingArgs():
            return f"give {', '.join(_flag_of(its.arg, arguments) for its in event.missing_arguments)}"
        case tyro_errors.InstantiationFailure() if event.argument is not None:
            where = _flag_of(event.argument, arguments)
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
    if name in OF_DRIVES and verb.__name__ in ELSEWHERE:
        return f"{name}: {ELSEWHERE[verb.__name__]}"
    known = {its.replace("-", "_").lstrip("_"): its for its in _flags_of(verb)}
    close = [known[one] for one in nearest(name.replace("-", "_").lstrip("_"), known)]
    return f"unknown flag '{name}'" + (f" (did you mean {' or '.join(close)}?)" if close else "")


def _flags_of(verb: Callable[..., int]) -> Iterator[str]:
    parameters = _parameters(verb)
    taken = set(map(flag, parameters))
    for name, (its, hint) in parameters.items():
        mark = _mark(hint)
        if mark:
            for key in mark.keys(for_help=False):
                yield from _flags_of_key(key.name, taken)
        elif its.kind is not Parameter.POSITIONAL_ONLY:
            yield flag(name)


def _mark(hint: Any) -> KeyFlags | None:
    return next((mark for mark in get_args(hint) if isinstance(mark, KeyFlags)), None)


def _flag_of(argument: Any, arguments: Sequence[str]) -> str:
    """The flag of an argument of tyro's as it was given, or the name of one without a flag."""
    names = argument.lowered.name_or_flags
    given = {its.partition("=")[0] for its in arguments}
    return str(next((name for name in names if name in given), names[0]) or argument.lowered.metavar)


def _values_of(where: str, arguments: Sequence[str]) -> list[str]:
    """What was given for a flag."""
    if where not in arguments:
        return [its.partition("=")[2] for its in arguments if its.startswith(f"{where}=")]
    return list(takewhile(lambda its: not its.startswith("--"), arguments[arguments.index(where) + 1 :]))
