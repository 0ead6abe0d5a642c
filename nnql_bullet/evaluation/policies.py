"""The policies of an evaluation: read, named, and told which are one method with several training seeds."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from inspect import getdoc
from pathlib import Path
from typing import Any

import numpy as np

from nnql_bullet import assets
from nnql_bullet.agents import RULES, Trainable
from nnql_bullet.config import to_values
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Array
from nnql_bullet.runs import load_policy


@dataclass(frozen=True, slots=True)
class Policy:
    """What drives."""

    path: str
    """As it was given: a run folder, a policy file, a rule, or a TOML file."""
    name: str
    """Short, and no other policy's."""
    method: str
    """What it shares with policies that differ from it by their training seed alone."""
    kind: str
    """Of its agent."""
    seed: int
    """It was trained with; 0 for rules."""
    episodes: int
    """It was trained for; 0 for rules."""
    learned: int
    """Numbers that it was taught: weights, or entries of a table; 0 for rules."""
    about: str
    """What its agent does, in a sentence."""
    room: float
    """Half width of the path that every world has for its vehicle [m]."""
    fingerprint: str
    """Hash of what it learned and of the configuration that it drives with."""
    shielded: bool = False
    """Whether it is asked to drive in a shield, which its own configuration does not give it."""

    @property
    def changes(self) -> dict[str, Any]:
        """What is laid over its own configuration."""
        return {"shield": {}} if self.shielded else {}


def open_policies(paths: Sequence[Path], shield: bool = False) -> list[Policy]:
    """Reads policies.

    Args:
        paths: Run folders, policy files, rules by name, or TOML files.
        shield: Whether each is followed by itself in a shield.

    Raises:
        UserError: If there is none, one cannot be read or is given twice, or vehicles differ in size: the same seeds
            would then be different worlds.
    """
    if not paths:
        raise UserError(
            f"give a policy: a run folder, a policy file, or one of: {', '.join((*assets.policies(), *RULES))}"
        )
    given = [str(path) for path in paths]
    twice = [path for path in given if given.count(path) > 1]
    if twice:
        raise UserError(f"{twice[0]}: is given twice; give each policy once")
    opened = [load_policy(path) for path in paths]
    experiments = [its.experiment for its in opened]
    odd = [path for path, its in zip(given, experiments, strict=True) if its.room != experiments[0].room]
    if odd:
        raise UserError(
            f"{given[0]} and {odd[0]} drive vehicles of different size, so worlds differ; evaluate them apart"
        )
    names = _short_names(given)
    recipes = [_recipe(experiment) for experiment in experiments]
    methods: dict[str, str] = {}
    for recipe in recipes:
        alike = [name for name, its in zip(names, recipes, strict=True) if its == recipe]
        method = alike[0].rstrip("0123456789").rstrip("-_./ ") if len(alike) > 1 else alike[0]
        taken = [name for its, name in methods.items() if its != recipe]
        methods[recipe] = method if method and method not in taken else alike[0]
    bare = [
        Policy(
            path=path,
            name=name,
            method=methods[recipe],
            kind=experiment.config.agent.kind,
            seed=experiment.config.seed,
            episodes=its.episodes,
            learned=sum(values.size for values in _learned(experiment).values()),
            about=(getdoc(type(experiment.agent)) or "").partition("\n")[0],
            room=experiment.room,
            fingerprint=fingerprint(experiment),
        )
        for path, name, recipe, its, experiment in zip(given, names, recipes, opened, experiments, strict=True)
    ]
    return [policy for one in bare for policy in ((one, _shielded(one)) if shield else (one,))]


def _shielded(policy: Policy) -> Policy:
    """The same in a shield."""
    experiment = load_policy(Path(policy.path), {"shield": {}}).experiment
    return replace(
        policy,
        name=f"{policy.name}+shield",
        method=f"{policy.method}+shield",
        about=f"{policy.about} In a shield.",
        fingerprint=fingerprint(experiment),
        shielded=True,
    )


def _short_names(paths: Sequence[str]) -> list[str]:
    """The last parts of paths, as many as tell them apart."""
    parts = [Path(path.removesuffix(".toml")).parts for path in paths]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(its[-count:]) for its in parts]
        if len(set(names)) == len(names):
            return names
    return list(paths)


def _learned(experiment: Experiment) -> dict[str, Array]:
    return experiment.agent.state_dict() if isinstance(experiment.agent, Trainable) else {}


def _recipe(experiment: Experiment) -> str:
    """All of a configuration but the training seed."""
    return json.dumps(to_values(experiment.config) | {"seed": 0}, sort_keys=True)


def fingerprint(experiment: Experiment) -> str:
    """Hash of what a policy learned and of the configuration that it drives with, wherever it drives."""
    config = to_values(experiment.config)
    told = ("seed", "robot", "conditions", "drive", "task", "agent", "shield")
    driving = {key: config[key] for key in told if key in config}
    whole = hashlib.sha256(json.dumps(driving, sort_keys=True).encode())
    for name, values in sorted(_learned(experiment).items()):
        whole.update(name.encode())
        whole.update(np.ascontiguousarray(values).tobytes())
    return whole.hexdigest()[:16]
