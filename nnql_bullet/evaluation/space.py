"""Values to search among: for some keys of options a range of numbers or a list of values; and trials of them."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Annotated, Any, Generic, Literal, TypeVar

import numpy as np
from pydantic import Field

from nnql_bullet.config import dotted, keys, merged, nearest, nested, options, parse, to_values
from nnql_bullet.errors import UserError
from nnql_bullet.types import Number

T = TypeVar("T")

State = Literal["trained", "pruned", "failed"]
ENOUGH = 5
"""Trials that a median is taken of."""


@options
class Range:
    """Numbers from `low` to `high`, whole ones for a key that takes whole ones."""

    low: Number
    high: Number
    log: bool = False
    """Whether ten times as much counts as much as a tenth."""
    step: Annotated[float, Field(gt=0)] | None = None
    """Distance of the numbers; by default any number in between is taken, or every whole one."""

    def __post_init__(self) -> None:
        """Refuses an empty range, and a logarithm that there is not."""
        if self.low >= self.high:
            raise ValueError(f"low {self.low:g} is not below high {self.high:g}")
        if self.log and (self.low <= 0 or self.step is not None):
            raise ValueError("log needs a low above 0, and no step")


@dataclass(frozen=True)
class Space(Generic[T]):
    """The values that some keys of options may have."""

    base: T
    """Options that all other keys are of."""
    ranges: Mapping[str, Range]
    """By dotted names."""
    choices: Mapping[str, tuple[str, ...]]
    """Values as JSON, by dotted names."""
    whole: frozenset[str]
    """The names of ranges of whole numbers."""

    @property
    def names(self) -> tuple[str, ...]:
        """The keys, by dotted names."""
        return (*self.ranges, *self.choices)

    def options(self, values: Mapping[str, Any]) -> T:
        """The options with values of the search.

        Raises:
            UserError: If they do not go together.
        """
        plain = {name: json.loads(value) if name in self.choices else value for name, value in values.items()}
        return _with(self.base, plain, "these values")

    @property
    def own(self) -> dict[str, Any] | None:
        """The values of `base`, if all of them are in the space."""
        values, own = dotted(to_values(self.base)), {}
        for name, its in self.ranges.items():
            if not isinstance(values.get(name), int | float) or not its.low <= values[name] <= its.high:
                return None
            own[name] = values[name]
        for name, texts in self.choices.items():
            own[name] = json.dumps(values.get(name))
            if own[name] not in texts:
                return None
        return own


def read_space(values: Mapping[str, Any], base: T, where: str, kind: str = "", fixed: tuple[str, ...] = ()) -> Space[T]:
    """Reads a space.

    Args:
        values: Nested or by dotted names: a table with `low` and `high`, or a list, for each key.
        base: Options that all other keys are of.
        where: Names the source in errors.
        kind: The kind of a table of which there are several.
        fixed: Keys that may not be searched, and all keys of tables of these names.

    Raises:
        UserError: If a key is unknown, or a value is not one of it.
    """
    known = {key.name: key.type for key in keys(type(base)) if key.kind in ("", kind)}
    ranges: dict[str, Range] = {}
    choices: dict[str, tuple[str, ...]] = {}
    for name, given in _entries(values):
        if name not in known:
            close = nearest(name, known)
            hint = f" (did you mean {' or '.join(repr(one) for one in close)}?)" if close else ""
            raise UserError(f"{where}: unknown key '{name}'{hint}; to list them: nnql-bullet keys")
        if any(name == one or name.startswith(f"{one}.") for one in fixed):
            raise UserError(f"{where}: '{name}' is the same for all trials; leave it out of the space")
        if isinstance(given, list):
            if len(given) < 2:
                raise UserError(f"{where}: '{name}' needs two values at least, or a table of low and high")
            choices[name] = tuple(dict.fromkeys(json.dumps(value) for value in given))
            tried = given
        elif isinstance(given, Mapping):
            ranges[name] = its = parse(Range, given, f"{where}: {name}")
            if known[name] not in (int, float):
                raise UserError(f"{where}: '{name}' takes no numbers from a range; give a list of values")
            if known[name] is int and any(one is not None and one % 1 for one in (its.low, its.high, its.step)):
                raise UserError(f"{where}: '{name}' takes whole numbers")
            tried = [int(its.low), int(its.high)] if known[name] is int else [its.low, its.high]
        else:
            raise UserError(
                f"{where}: '{name}' needs a list of values, or a table of low and high; in TOML: {_EXAMPLE}"
            )
        for value in tried:
            _with(base, {name: value}, where)
    if not ranges and not choices:
        raise UserError(f"{where}: names no key to search; in TOML: {_EXAMPLE}")
    return Space(base, ranges, choices, frozenset(name for name in ranges if known[name] is int))


_EXAMPLE = "agent.discount = { low = 0.1, high = 0.9 } or agent.discount = [0.3, 0.9]"


def _entries(values: Mapping[str, Any], table: str = "") -> Iterator[tuple[str, Any]]:
    """The keys by dotted names, with what stands for each."""
    for key, value in values.items():
        if isinstance(value, Mapping) and not {"low", "high"} & value.keys():
            yield from _entries(value, f"{table}{key}.")
        else:
            yield table + key, value


def _with(base: T, values: Mapping[str, Any], where: str) -> T:
    """Options with some values, by dotted names, in place of their own.

    Raises:
        UserError: If one is wrong.
    """
    return parse(type(base), merged(to_values(base), nested(values)), where)


@dataclass(frozen=True)
class Trial:
    """A trial that is over."""

    number: int
    values: Mapping[str, Any]
    """Of the space, by dotted names."""
    history: tuple[float, ...]
    """What its evaluations came to; more is better."""
    state: State
    reason: str = ""
    """Why it failed."""

    @property
    def score(self) -> float | None:
        """What it came to in the end; None if it came to none."""
        return self.history[-1] if self.state == "trained" else None


def best_of(trials: Sequence[Trial]) -> Trial | None:
    """The trial with the largest score, of equals the one whose evaluations are better in the mean, then the first."""
    scored = [its for its in trials if its.score is not None]
    return max(scored, key=lambda its: (its.score, np.mean(its.history)), default=None)


def bars(trials: Sequence[Trial], evaluations: int) -> tuple[float, ...]:
    """The least that the best of a trial must have come to by each evaluation but the last, to be gone on with.

    It is the median of all trials that got as far, where they are `ENOUGH`.
    """
    reached = zip_longest(*(its.history[: evaluations - 1] for its in trials if its.state != "failed"))
    found = [[value for value in values if value is not None] for values in reached]
    return tuple(float(np.median(values)) for values in found if len(values) >= ENOUGH)


def is_hopeless(history: Sequence[float], least: Sequence[float]) -> bool:
    """Whether the best of a trial so far is less than it must be by now (see `bars`)."""
    return 0 < len(history) <= len(least) and max(history) < least[len(history) - 1]
