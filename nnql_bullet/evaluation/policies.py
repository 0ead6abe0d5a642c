"""Reads and names the policies of an evaluation, and groups those that differ only by their training seed."""

import hashlib
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from inspect import getdoc
from pathlib import Path
from typing import Any

import numpy as np

from nnql_bullet import assets, rollout
from nnql_bullet.agents import RULES, Trainable
from nnql_bullet.agents.base import Custom
from nnql_bullet.config import to_values
from nnql_bullet.errors import UserError
from nnql_bullet.executors import Executor, ExecutorArguments, executor_of
from nnql_bullet.experiment import Experiment
from nnql_bullet.files import is_file
from nnql_bullet.geometry import Array
from nnql_bullet.run_config import DRIVING, RunConfig
from nnql_bullet.runs import LoadedPolicy, PolicyLike, load_policy, tell_differences
from nnql_bullet.setting import Setting
from nnql_bullet.vehicle.urdf import load_vehicle


@dataclass(frozen=True, slots=True)
class Policy:
    """A policy of an evaluation."""

    path: str
    """Run folder, policy file, rule or TOML file."""
    name: str
    """Short name, unique in the evaluation."""
    method: str
    """Name of the method; policies of a method differ only by their training seed."""
    kind: str
    """Kind of the agent."""
    seed: int
    """Training seed; 0 for rules."""
    episodes: int
    """Number of training episodes; 0 for rules."""
    learned: int
    """Number of learned values: weights, or entries of a table; 0 for rules."""
    about: str
    """One sentence about the agent."""
    vehicle_width: float
    """Width of the vehicle that it drives [m]."""
    fingerprint: str
    """Hash of the learned values and of the policy's own configuration for driving."""
    shielded: bool = False
    """Whether the evaluation adds a shield that the policy's own configuration lacks."""
    own_shield: bool = False
    """Whether the policy's own configuration has a shield."""
    robot: str = ""
    """Name of the vehicle that it drives."""
    vehicle: str = ""
    """Hash of that vehicle (`VehicleSpec.digest`)."""
    custom: Custom | None = None
    """The policy's object, if it is an object of this process; the fingerprint is then empty."""

    @property
    def source(self) -> PolicyLike:
        """The argument for `runs.load_policy`."""
        return self.custom or self.path

    @property
    def values(self) -> dict[str, Any]:
        """The fields that JSON can represent."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "custom"}

    def own(self, setting: Setting) -> Setting:
        """Returns what of a setting holds for it: a shield's keys only if it drives in one."""
        in_shield = self.shielded or self.own_shield
        keys = tuple(its for its in setting.keys if in_shield or not its[0].startswith("shield."))
        return replace(setting, keys=keys, shield=self.shielded)


def open_policies(
    policies: PolicyLike | Sequence[PolicyLike],
    shield: bool = False,
    robot: str | None = None,
    own_world: bool = False,
) -> list[Policy]:
    """Reads policies and groups them by method.

    Args:
        policies: One policy or several.
        shield: Whether each policy is also evaluated in a shield.
        robot: What they drive in place of each policy's own vehicle.
        own_world: Whether each drives in the world in which it learned. What is not as it was then is logged.

    Raises:
        UserError: If there is no policy, one cannot be read, is given twice or has changed since it was loaded, or
            vehicles differ in size, so that the same seeds would be different worlds.
    """
    several = list(policies) if isinstance(policies, Sequence) and not isinstance(policies, str) else [policies]
    if not several:
        raise UserError(
            f"give a policy: a run folder, a policy file, or one of: {', '.join((*assets.policies(), *RULES))}"
        )
    # A loaded policy is read again by its name, because worker processes also read it by its name.
    opened = [load_policy(_named(policy)) for policy in several]
    experiments = [its.experiment for its in opened]
    agents = [experiment.agent for experiment in experiments]
    given = _paths(several, agents)
    for policy, experiment in zip(several, experiments, strict=True):
        if isinstance(policy, LoadedPolicy) and fingerprint(experiment) != fingerprint(policy.experiment):
            raise UserError(f"{policy.name}: is not what is saved there; load it again, without changes")
    for policy in several:
        tell_differences(policy, robot, own_world)
    vehicles = [load_vehicle(robot or experiment.config.robot) for experiment in experiments]
    odd = [path for path, its in zip(given, vehicles, strict=True) if its.width != vehicles[0].width]
    if odd:
        raise UserError(
            f"{given[0]} and {odd[0]} drive vehicles of different size, so worlds differ; evaluate them apart"
        )
    names = _short_names(given)
    recipes = [
        path if isinstance(its.agent, Custom) else _recipe(its) for path, its in zip(given, experiments, strict=True)
    ]
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
            kind=agent.name if isinstance(agent, Custom) else experiment.config.agent.kind,
            seed=experiment.config.seed,
            episodes=its.episodes,
            learned=sum(values.size for values in _learned(agent).values()),
            about=(getdoc(type(agent.given if isinstance(agent, Custom) else agent)) or "").partition("\n")[0],
            vehicle_width=vehicle.width,
            fingerprint=fingerprint(experiment),
            own_shield=experiment.config.shield is not None,
            robot=vehicle.name,
            vehicle=vehicle.digest,
            custom=agent if isinstance(agent, Custom) else None,
        )
        for path, name, recipe, agent, its, experiment, vehicle in zip(
            given, names, recipes, agents, opened, experiments, vehicles, strict=True
        )
    ]
    return [policy for one in bare for policy in ((one, _shielded(one)) if shield else (one,))]


def executor_for(policies: Sequence[Policy], asked: ExecutorArguments) -> Executor:
    """Makes the executor that runs drives. Objects of this process drive in this process.

    Raises:
        UserError: If an object of this process would drive elsewhere; see also `executors.make_executor`.
    """
    custom = [policy.name for policy in policies if policy.custom]
    if custom and asked.get("executor") not in (None, "inline"):
        raise UserError(f"policy '{custom[0]}' is an object of this process; give it the executor 'inline'")
    return executor_of({**asked, "executor": "inline"} if custom else asked)


def _named(policy: PolicyLike) -> PolicyLike:
    own = isinstance(policy, LoadedPolicy) and isinstance(policy.experiment.agent, Custom)
    return policy.name if isinstance(policy, LoadedPolicy) and not own else policy


def _paths(policies: Sequence[PolicyLike], agents: Sequence[rollout.Policy]) -> list[str]:
    """Finds the path of each policy, or the name of its class, with a number if the name is taken.

    Raises:
        UserError: If a policy is given twice.
    """
    found: list[str] = []
    for policy, agent in zip(policies, agents, strict=True):
        if isinstance(agent, Custom):
            numbered = (agent.name if number == 1 else f"{agent.name} {number}" for number in itertools.count(1))
            path = next(name for name in numbered if name not in found)
        else:
            path = policy.name if isinstance(policy, LoadedPolicy) else str(policy)
            if path in found:
                raise UserError(f"{path}: is given twice; give each policy once")
        found.append(path)
    return found


def _shielded(policy: Policy) -> Policy:
    """Returns the policy in a shield."""
    experiment = load_policy(policy.source, {"shield": {}}).experiment
    return replace(
        policy,
        name=f"{policy.name}+shield",
        method=f"{policy.method}+shield",
        about=f"{policy.about} In a shield.",
        fingerprint=fingerprint(experiment),
        shielded=True,
    )


def _short_names(paths: Sequence[str]) -> list[str]:
    """Shortens paths to their last parts, as many as make them different."""
    parts = [Path(path.removesuffix(".toml")).parts for path in paths]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(its[-count:]) for its in parts]
        if len(set(names)) == len(names):
            return names
    return list(paths)


def _learned(agent: rollout.Policy) -> dict[str, Array]:
    return agent.state_dict() if isinstance(agent, Trainable) else {}


def _recipe(experiment: Experiment) -> str:
    """Writes a configuration without its training seed as text."""
    config = experiment.config
    return json.dumps(to_values(config) | {"seed": 0, "robot": _robot(config)}, sort_keys=True)


def _robot(config: RunConfig) -> str:
    """Returns what a robot is, wherever its files are: the name of a shipped one, else a hash."""
    return load_vehicle(config.robot).digest if is_file(config.robot) else config.robot


def fingerprint(experiment: Experiment) -> str:
    """Hashes a policy's learned values and its configuration for driving, apart from world and simulator.

    The hash is empty for an object of this process, because what it depends on is unknown.
    """
    if isinstance(experiment.agent, Custom):
        return ""
    values = to_values(experiment.config)
    values["robot"] = _robot(experiment.config)
    driving = {key: values[key] for key in ("seed", "conditions", *DRIVING) if key in values}
    whole = hashlib.sha256(json.dumps(driving, sort_keys=True).encode())
    for name, array in sorted(_learned(experiment.agent).items()):
        whole.update(name.encode())
        whole.update(np.ascontiguousarray(array).tobytes())
    return whole.hexdigest()[:16]
