"""Writes command lines that reproduce a result, for reports and cards."""

from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Any

from nnql_bullet.config import departures, merged, to_values
from nnql_bullet.presets import PRESETS
from nnql_bullet.run_config import RunConfig

PLACES = {"start": ",", "target": ",", "waypoints": ";"}
"""Keys whose values are one word, and what stands between them."""


def flag(key: str) -> str:
    """Returns the flag of a dotted key."""
    return "--sim" if key == "simulator" else f"--{key.replace('_', '-')}"


def flags(changes: Mapping[str, Any], table: str = "") -> list[str]:
    """Writes nested values of a configuration as flags.

    Args:
        changes: Values, tables and options instances. Of options, only values that differ from the defaults are
            written. A value of None is left out.
        table: Dotted name of their table, with a dot at its end.
    """
    found: list[str] = []
    for key, value in changes.items():
        if is_dataclass(value) and not isinstance(value, type):
            found += flags(departures(to_values(value), to_values(type(value)())), f"{table}{key}.")
        elif isinstance(value, Mapping):
            found += flags(value, f"{table}{key}.")
        elif value is not None:
            words = list(map(_text, value if isinstance(value, list | tuple) else [value]))
            together = PLACES.get(table + key)
            found += [flag(table + key), *(words if together is None else [together.join(words)])]
    return found


def _text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return ",".join(map(_text, value))
    return f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else str(value)


def preset_and_changes(config: RunConfig) -> tuple[str, dict[str, Any]]:
    """Finds the preset and the fewest values over it that give a configuration."""
    values = to_values(config)
    found = []
    for preset, its in PRESETS.items():
        base = to_values(its)
        changes = departures(values, base)
        if merged(base, changes) == values:  # nothing can remove a table that the preset sets
            found.append((preset, changes))
    return min(found, key=lambda pair: len(flags(pair[1])))


def train_arguments(config: RunConfig) -> tuple[str, list[str]]:
    """Finds the preset and the fewest flags of `nnql-bullet train` that give a configuration."""
    preset, changes = preset_and_changes(config)
    return preset, flags(changes)
