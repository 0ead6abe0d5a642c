"""Options as frozen dataclasses, and their TOML. Every key is checked, and an error is one line."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from difflib import get_close_matches
from functools import wraps
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

import docstring_parser
import numpy as np
import tomlkit
from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic_core import ErrorDetails
from typing_extensions import dataclass_transform

from nnql_bullet.errors import UserError
from nnql_bullet.files import read_text
from nnql_bullet.text import listed

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

T = TypeVar("T")

MOST_TOML = 20_000_000
"""Size of the largest TOML file that is read [bytes]; of larger ones Python's parser takes minutes."""
MOST_VALUE = 80
"""Characters of a wrong value that an error shows."""
_UNKNOWN_KEY = ("unexpected_keyword_argument", "extra_forbidden")


@dataclass_transform(frozen_default=True, kw_only_default=True)
def options(cls: type[T]) -> type[T]:
    """Makes a class a group of options: frozen, keyword-only, with checked types and ranges and no unknown keys."""
    strict = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    made = pydantic_dataclass(frozen=True, kw_only=True, config=strict)(cls)
    init: Callable[..., None] = made.__init__

    @wraps(init)
    def checked_init(self: T, *unnamed: Any, **values: Any) -> None:
        try:
            init(self, *unnamed, **{name: _plain_number(value) for name, value in values.items()})
        except ValidationError as error:
            raise UserError(f"{cls.__name__}: {_mistakes(made, error)}") from None

    made.__init__ = checked_init  # type: ignore[assignment]
    return made  # type: ignore[return-value]


def refuse_crossed_ranges(group: object, *names: str) -> None:
    """Checks in a `__post_init__` that no key `min_NAME` is above its `max_NAME`.

    Raises:
        ValueError: If one is; `parse` turns it into a `UserError`.
    """
    for name in names:
        low, high = getattr(group, f"min_{name}"), getattr(group, f"max_{name}")
        if low > high:
            raise ValueError(f"min_{name} {low:g} is above max_{name} {high:g}")


def parse(cls: type[T], values: Mapping[str, Any], where: str) -> T:
    """Builds options from plain values.

    Args:
        cls: A class made by `options`.
        values: As read from TOML.
        where: Names the source in errors.

    Raises:
        UserError: For all keys that are unknown, missing, of the wrong type or out of range.
    """
    try:
        # Strict reading of JSON accepts an integer for a float and an array for a tuple, which TOML users write.
        text = json.dumps(values, default=_plain_value, ensure_ascii=False)
        return TypeAdapter(cls).validate_json(text.encode("utf-8"))
    except ValidationError as error:
        raise UserError(f"{where}: {_mistakes(cls, error)}") from None
    except UnicodeEncodeError:  # Python names bytes of a file's name that are not UTF-8 by halves of characters
        raise UserError(f"{where}: the name of a file is not UTF-8; rename it") from None
    except RecursionError:
        raise UserError(f"{where}: its values are nested too deeply") from None
    except (TypeError, ValueError) as error:  # of JSON: a key that is no text, a whole number of thousands of digits
        raise UserError(f"{where}: {_reason(error)}") from None


def read_toml(path: Path) -> dict[str, Any]:
    """Reads the values of a TOML file of at most `MOST_TOML` bytes, which may begin with a byte order mark.

    Raises:
        UserError: If the file cannot be read or is not TOML.
    """
    try:
        return tomllib.loads(read_text(path, MOST_TOML))
    except RecursionError:
        raise UserError(f"{path}: its values are nested too deeply") from None
    except ValueError as error:
        raise UserError(f"{path}: cannot be read as TOML: {_reason(error)}") from None


def write_toml(values: Mapping[str, Any]) -> str:
    """Writes values as TOML text; floats stay exact."""
    return tomlkit.dumps(values)


def to_values(instance: Any) -> dict[str, Any]:
    """Converts options to the plain values that `parse` takes; values of None are left out, as TOML has none."""
    values: dict[str, Any] = TypeAdapter(type(instance)).dump_python(instance, mode="json", exclude_none=True)
    return values


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Merges `changes` into a copy of `base`, table by table.

    A table of another `kind` and an options instance replace the table in `base`; a value of None changes nothing.
    """
    result = dict(base)
    for key, value in changes.items():
        if value is None:
            continue
        if is_dataclass(value):
            result[key] = to_values(value)
            continue
        old = result.get(key)
        if isinstance(old, Mapping) and isinstance(value, Mapping) and _same_kind(old, value):
            result[key] = merged(old, value)
        elif isinstance(value, Mapping):
            result[key] = merged({}, value)
        else:
            result[key] = value
    return result


def departures(values: Mapping[str, Any], base: Mapping[str, Any]) -> dict[str, Any]:
    """Finds the smallest changes with which `merged` turns `base` into `values`; ignores keys only in `base`."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        old = base.get(key)
        if isinstance(value, Mapping) and isinstance(old, Mapping) and _same_kind(value, old):
            if inner := departures(value, old):
                found[key] = inner
        elif value != old:
            found[key] = value
    return found


def dotted(values: Mapping[str, Any], table: str = "") -> dict[str, Any]:
    """Returns nested values by their dotted names; `nested` is the inverse. An empty table leaves nothing."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        found |= dotted(value, f"{table}{key}.") if isinstance(value, Mapping) else {table + key: value}
    return found


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns values by dotted names as nested tables."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        *tables, last = name.split(".")
        table = found
        for part in tables:
            table = table.setdefault(part, {})
        table[last] = value
    return found


def _same_kind(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    return "kind" not in one or "kind" not in other or one["kind"] == other["kind"]


@dataclass(frozen=True, slots=True)
class Key:
    """A key of an options class, or of the options nested in it."""

    name: str
    """Dotted name, with the tables that contain the key."""
    kind: str
    """The `kind` of the key's table; empty if that table has only one kind."""
    type: Any
    """Type without bounds and without None."""
    type_text: str
    """Type in words, with bounds."""
    default: Any
    """Default value; None if there is none or if it is None."""
    about: str
    """Meaning, from the docstring below the field."""


def keys(cls: Any, table: str = "", kind: str = "", told: bool = True) -> Iterator[Key]:
    """Lists the keys of an options class and of the options nested in it, in their order.

    Args:
        cls: A class made by `options`.
        table: Dotted name of the keys' table, with a dot at its end.
        kind: The `kind` of that table if it has several.
        told: Whether they say what they mean, which takes long to read from the sources.
    """
    abouts = abouts_of(cls) if told else {}
    for field in fields(cls):
        # A table that a user may give by its name is one key.
        named = str in _leaves(field.type)
        groups = [] if named else _options_in(field.type)
        for group in groups:
            yield from keys(group, f"{table}{field.name}.", _tags(group)[0] if len(groups) > 1 else "", told)
        if not groups:
            default = None if field.default is MISSING else field.default
            plain = _plain(field.type)
            text = type_text(plain if named else field.type)
            yield Key(table + field.name, kind, plain, text, default, abouts.get(field.name, ""))


def abouts_of(what: Any) -> dict[str, str]:
    """Reads the meaning of each field of a class and its bases, or argument of a function, from docstrings."""
    parts = reversed(what.__mro__[:-1]) if isinstance(what, type) else [what]
    found = [its for part in parts for its in docstring_parser.parse_from_object(part).params]
    return {its.arg_name: " ".join((its.description or "").split()) for its in found}


def _leaves(annotation: Any) -> list[Any]:
    """Lists the types that a type consists of."""
    if get_origin(annotation) is Annotated:
        return _leaves(get_args(annotation)[0])
    return [leaf for part in get_args(annotation) for leaf in _leaves(part)] or [annotation]


def _plain(annotation: Any) -> Any:
    """Removes bounds and None from a type."""
    if get_origin(annotation) is Annotated:
        return _plain(get_args(annotation)[0])
    members = [member for member in get_args(annotation) if member is not NoneType]
    if NoneType in get_args(annotation):
        return _plain(members[0])
    if get_origin(annotation) is not tuple and str in map(_plain, members):
        return str
    if get_origin(annotation) is tuple:
        return tuple[tuple(map(_plain, members))]  # type: ignore[misc]
    return annotation


def type_text(annotation: Any) -> str:
    """Describes a type and its bounds in words."""
    if get_origin(annotation) is Annotated:
        inner, *extra = get_args(annotation)
        bounds = [bound for its in extra for bound in getattr(its, "metadata", ())]
        signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
        limits = [f"{sign} {getattr(b, name):g}" for b in bounds for name, sign in signs.items() if hasattr(b, name)]
        return " ".join((type_text(inner), ", ".join(limits))).strip()
    members = [member for member in get_args(annotation) if member is not NoneType]
    if get_origin(annotation) is Literal:
        return " | ".join(map(str, members))
    if get_origin(annotation) is tuple:
        return f"list of: {type_text(members[0])}"
    if NoneType in get_args(annotation):
        return type_text(members[0])
    return {float: "number", int: "whole number", bool: "true | false", str: "text"}.get(annotation, str(annotation))


def nearest(name: str, names: Iterable[str], most: int = 3) -> list[str]:
    """Finds the names that a wrong dotted name may mean: their last part is equal or similar.

    Names in the same table come alone if there are any.
    """
    by_last: dict[str, list[str]] = {}
    for one in dict.fromkeys(names):
        by_last.setdefault(one.rpartition(".")[2], []).append(one)
    table, _, last = name.rpartition(".")
    close = [last] if last in by_last else get_close_matches(last, by_last, most, cutoff=0.75)
    found = [one for its in close for one in by_last[its]]
    return ([one for one in found if one.rpartition(".")[0] == table] or found)[:most]


def _mistakes(cls: type, error: ValidationError) -> str:
    """All that is wrong, an unknown key first: it is often the misspelt name of a missing one."""
    found = sorted(error.errors(), key=lambda mistake: mistake["type"] not in _UNKNOWN_KEY)
    meant = [name for its in found if its["type"] in _UNKNOWN_KEY for name in _meant(cls, its)]
    said = [f"key '{name}' is missing" for name in meant]  # by the hint of the unknown one
    return listed([text for text in (_mistake(cls, its) for its in found) if text not in said])


def _meant(cls: type, unknown: ErrorDetails) -> list[str]:
    """The keys that an unknown one may be the misspelt name of."""
    name = ".".join(_walk(cls, unknown["loc"])[0])
    return nearest(name, (key.name for key in keys(cls, told=False) if key.name != name))


def _mistake(cls: type, mistake: ErrorDetails) -> str:
    path, members = _walk(cls, mistake["loc"])
    name = ".".join(path)
    if mistake["type"] in _UNKNOWN_KEY:
        _, members = _walk(cls, mistake["loc"][:-1])
        valid = sorted({field.name for member in members for field in fields(member)})
        kinds = [repr(key.kind) for key in keys(cls, told=False) if key.name == name]
        close = [repr(one) for one in _meant(cls, mistake)]
        hint = f" (did you mean {' or '.join(close)}?)" if close else ""
        hint = f" (it belongs to kind {' or '.join(kinds)})" if kinds else hint
        return f"unknown key '{name}'{hint}; valid keys: {', '.join(valid)}"
    if mistake["type"] in ("missing", "missing_argument", "missing_keyword_only_argument"):
        return f"key '{name}' is missing"
    if mistake["type"] in ("union_tag_invalid", "union_tag_not_found"):
        return f"'{name}.kind' must be one of: {', '.join(tag for member in members for tag in _tags(member))}"
    if mistake["type"] == "value_error":
        return f"'{name}': {mistake['ctx']['error']}" if name else str(mistake["ctx"]["error"])
    if mistake["type"] == "json_invalid":
        return str(mistake["ctx"]["error"])
    return f"'{name}': {mistake['msg'][0].lower()}{mistake['msg'][1:]}, not {_shortened(mistake['input'])}"


def _plain_value(value: Any) -> Any:
    """What JSON has no type for: a number or an array of NumPy as Python's own, and all else as text."""
    plain = _plain_number(value)
    return str(value) if plain is value else plain


def _plain_number(value: Any) -> Any:
    """A number or an array of NumPy as Python's own; all else as it is."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value


def _reason(error: Exception) -> str:
    """What is wrong, without advice to a programmer."""
    return "a whole number has too many digits" if "set_int_max_str_digits" in str(error) else str(error)


def _shortened(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= MOST_VALUE else f"{text[:MOST_VALUE]}..."


def _walk(cls: Any, location: tuple[str | int, ...]) -> tuple[list[str], list[Any]]:
    """Finds the keys that lead to a place in nested options, and the options classes at that place.

    In a location of pydantic, the `kind` of the chosen member follows a union; it is not a key.
    """
    keys: list[str] = []
    members = [cls]
    for part in location:
        tagged = [member for member in members if part in _tags(member)] if len(members) > 1 else []
        if tagged:
            members = tagged
            continue
        if isinstance(part, str) and " " in part:  # the tag of a union
            continue
        keys.append(str(part))
        if isinstance(part, str):  # a number counts the items of an array
            fields = [member.__dataclass_fields__[part] for member in members if part in member.__dataclass_fields__]
            members = [found for field in fields for found in _options_in(field.type)]
    return keys, members


def _tags(cls: Any) -> tuple[str, ...]:
    field = cls.__dataclass_fields__.get("kind")
    return get_args(field.type) if field else ()


def _options_in(annotation: Any) -> list[Any]:
    if get_origin(annotation) is Annotated:
        return _options_in(get_args(annotation)[0])
    if is_dataclass(annotation):
        return [annotation]
    return [found for part in get_args(annotation) for found in _options_in(part)]
