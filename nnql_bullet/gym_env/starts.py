"""Where episodes start: the seeds and options of `reset`."""

from collections.abc import Mapping, Sequence
from math import hypot
from pathlib import Path
from typing import Any

import numpy as np

from nnql_bullet.config import nearest
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.seeding import TRAINING_WORLDS
from nnql_bullet.worlds.source import World
from nnql_bullet.worlds.spec import WorldSpec

OPTIONS = ("world_seed", "world", "start", "target")
"""Options of `reset`."""


def drawn_seed(generator: np.random.Generator) -> int:
    """Draws the seed of a training world."""
    return int(generator.integers(TRAINING_WORLDS.start, TRAINING_WORLDS.stop))


def checked_options(options: Mapping[str, Any] | None, more: tuple[str, ...] = ()) -> dict[str, Any]:
    """The options of `reset`, without those that are None.

    Raises:
        UserError: If one is unknown.
    """
    if options is not None and not isinstance(options, Mapping):
        raise UserError(f"options must be a dictionary or None, not a value of type {type(options).__name__}")
    known = (*OPTIONS, *more)
    for name in options or {}:
        if name not in known:
            close = nearest(str(name), known)
            hint = f" (did you mean '{close[0]}'?)" if close else ""
            raise UserError(f"unknown option '{name}' of reset{hint}; valid options: {', '.join(known)}")
    return {name: value for name, value in (options or {}).items() if value is not None}


def options_of_each(options: Mapping[str, Any], size: int) -> list[dict[str, Any]]:
    """The options of each of n vehicles: a value is one for all, or a sequence of one for each.

    Raises:
        UserError: If a sequence has another length.
    """
    each: list[dict[str, Any]] = [{} for _ in range(size)]
    for name, value in options.items():
        several = isinstance(value, Sequence | np.ndarray) and not isinstance(value, str) and np.ndim(value) > 0
        if name in ("start", "target"):  # which are sequences themselves
            several = several and len(value) > 0 and not np.isscalar(value[0])
        if several and len(value) != size:
            raise UserError(f"give one {name}, or one for each of {size} vehicles")
        for i in range(size):
            each[i][name] = value[i] if several else value
    return each


def starting_world(experiment: Experiment, options: Mapping[str, Any], generator: np.random.Generator) -> WorldSpec:
    """The world in which an episode starts.

    Args:
        experiment: Its worlds are meant where the options name no other kind.
        options: Those of `OPTIONS` that are given.
        generator: Draws the seed if the options have none.

    Raises:
        UserError: If a value is wrong, or the world is not one of the environment's observations.
    """
    seed = _whole(options["world_seed"]) if "world_seed" in options else drawn_seed(generator)
    source = experiment.worlds
    if "world" in options:
        name = options["world"]
        if not isinstance(name, str | Path | World):
            raise UserError(f"the option 'world' must be a name, a path or a World, not {name!r}")
        source = experiment.kind(name if isinstance(name, World) else str(name))
        _check_fits(source, experiment.worlds)
    ends = [options.get(name) for name in ("start", "target")]
    return experiment.draw(source.between(*ends), seed)


def _whole(value: Any) -> int:
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer):
        raise UserError(f"the option 'world_seed' must be a whole number, not {value!r}")
    return int(value)


def _check_fits(other: World, own: World) -> None:
    """Refuses a kind of worlds whose distances or goals the observations cannot tell."""
    if hypot(other.width, other.depth) > hypot(own.width, own.depth) or other.target_radius != own.target_radius:
        raise UserError(
            f"world '{other.name}' is larger than '{own.name}', for which this environment is made, or its "
            f"target_radius is another; make the environment with world='{other.name}'"
        )
