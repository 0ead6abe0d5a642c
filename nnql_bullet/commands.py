"""Command lines that repeat what was computed, for reports and cards."""

from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Any

from nnql_bullet.config import departures, to_values
from nnql_bullet.presets import PRESETS, load_config
from nnql_bullet.run_config import RunConfig

_MAIN = ("seed", "episodes", "world", "simulator", "physics", "vehicles")


def flag(key: str) -> str:
    """The flag of a dotted key."""
    return "--sim" if key == "simulator" else f"--{key.replace('_', '-')}"


def flags(changes: Mapping[str, Any], table: str = "") -> list[str]:
    """Writes nested values of a configuration as flags.

    Args:
        changes: Values, tables, and options instances, of which only what differs from the defaults is written; None
            leaves a key out.
        table: Dotted name of the table that they are in, with a dot at its end.
    """
    found: list[str] = []
    for key, value in changes.items():
        if is_dataclass(value) and not isinstance(value, type):
            found += flags(departures(to_values(value), to_values(type(value)())), f"{table}{key}.")
        elif isinstance(value, Mapping):
            found += flags(value, f"{table}{key}.")
        elif value is not None:
            found += [flag(table + key), *map(_text, value if isinstance(value, list | tuple) else [value])]
    return found


def _text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else str(value)


def preset_of(config: RunConfig) -> tuple[str, list[str]] | None:
    """The preset and the flags of `nnql-bullet train` that make up the whole configuration; None if there is none."""
    given = {key: getattr(config, key) for key in _MAIN}
    for preset, usual in PRESETS.items():
        if load_config(preset, given) == config:
            return preset, flags({key: value for key, value in given.items() if value != getattr(usual, key)})
    return None
