"""Holds an exported policy against the policy itself, decision by decision, and tells ties from faults.

A difference is a tie if the policy itself takes either action when what it sees is moved by single-precision rounding.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.agents.base import TurnChooser
from nnql_bullet.agents.rules.vfh import VfhState
from nnql_bullet.env import ACTIONS, Observation, heading_change
from nnql_bullet.experiment import Experiment
from nnql_bullet.exports.running import LibraryPolicy, OnnxMapPolicy, OnnxPolicy
from nnql_bullet.exports.vectors import observed
from nnql_bullet.geometry import wrap_angles
from nnql_bullet.rollout import PolicyState
from nnql_bullet.seeding import Stream, rng

ROUNDING = 1e-6
"""Largest share by which distances and yaw rates are moved, and largest angle by which bearings are [rad]."""
EXACT = 1e-5
"""Error of Q-values that single precision alone explains, as a share of the largest."""
TRIES = 256
"""Times that what was seen is moved."""


@dataclass(frozen=True, slots=True)
class Parity:
    """Counts over decisions, which add up."""

    states: int = 0
    differences: int = 0
    """Decisions with another action."""
    same_turn: int = 0
    """Of these, with the same heading change within twice `ROUNDING`."""
    ties: int = 0
    """Of the others, those that rounding explains."""
    valued: int = 0
    """Decisions whose Q-values were compared; none in a shield, which tells no values."""
    inexact: int = 0
    """Of these, those that are farther off than `EXACT`: of what is seen as bytes, one was rounded to the next."""
    value_error: float = 0.0
    """Largest error of a Q-value, as a share of the largest Q-value of the decision."""

    @property
    def unexplained(self) -> int:
        """Differences that are neither."""
        return self.differences - self.same_turn - self.ties

    def __add__(self, other: "Parity") -> "Parity":
        return Parity(
            self.states + other.states,
            self.differences + other.differences,
            self.same_turn + other.same_turn,
            self.ties + other.ties,
            self.valued + other.valued,
            self.inexact + other.inexact,
            max(self.value_error, other.value_error),
        )


def compare(experiment: Experiment, exported: LibraryPolicy | OnnxPolicy, drive: Observation) -> Parity:
    """Compares the decisions by what was seen in a drive (steps, ...).

    A policy with a memory decides in the order of the drive. The exported one begins each decision with the policy's
    own memory, so that each is judged by itself. One that remembers alone, as in a shield, does not: then both decide
    by inputs in single precision, and what is remembered is compared with thresholds in double precision by both.
    """
    policy: Any = experiment.policy
    contract, steps = exported.contract, len(drive.readings)
    if contract.remembers_alone:
        drive = observed(contract, experiment.task, contract.rows(drive))
    if contract.memory:
        states = [policy.initial_state(1)]
        actions = np.empty(steps, np.int64)
        for k in range(steps):
            action, state = policy.act(_rows(drive, k), states[-1])
            actions[k] = action[0]
            states.append(state)
    else:
        states, (actions, _) = [None] * steps, policy.act(drive, None)
    outputs = _outputs(exported, drive, states[:steps])
    values = None
    if isinstance(policy, TurnChooser):
        values = policy.values(drive, np.ones(steps, np.bool_))
    elif isinstance(exported, OnnxMapPolicy):
        values = np.concatenate([exported.values_of(policy, state) for state in states[1:]])
    elif contract.has_values:
        values = np.concatenate([policy.values_of(state) for state in states[1:]])
    differ = np.flatnonzero(outputs["action"] != actions)
    mine = heading_change(actions[differ], drive.target_bearing[differ])
    same_turn = np.abs(outputs["heading_change"][differ] - mine) < 2 * ROUNDING  # both may be rounded
    same_turn &= outputs["action"][differ] // ACTIONS == actions[differ] // ACTIONS
    ties = (
        0
        if contract.remembers_alone
        else sum(
            _is_tie(experiment, exported, _rows(drive, k), states[k], int(outputs["action"][k]))
            for k in differ[~same_turn].tolist()
        )
    )
    errors = np.empty(0)
    if values is not None:
        largest = np.abs(values).max(axis=-1)
        errors = np.abs(outputs["values"] - values).max(axis=-1)[largest > 0] / largest[largest > 0]
    counts = steps, len(differ), int(same_turn.sum()), ties, len(errors), int((errors > EXACT).sum())
    return Parity(*counts, float(errors.max(initial=0.0)))


def _rows(drive: Observation, places: int | NDArray[np.int64]) -> Observation:
    rows = np.atleast_1d(places)
    return Observation(*(getattr(drive, field.name)[rows] for field in fields(Observation)))


def _outputs(
    exported: LibraryPolicy | OnnxPolicy, drive: Observation, states: list[PolicyState]
) -> Mapping[str, NDArray[Any]]:
    if isinstance(exported, OnnxMapPolicy):
        seen = [exported.see(_rows(drive, k), state.memory) for k, state in enumerate(states)]
        rows = np.concatenate([inputs for inputs, _ in seen])
        return exported.decide(rows, np.concatenate([told.frames for _, told in seen]))
    contract = exported.contract
    rows = contract.rows(drive)
    if isinstance(exported, OnnxPolicy):
        return exported.decide(rows)
    memory = exported.initial_state(1 if contract.remembers_alone else len(rows))
    if contract.remembers_alone:
        found = []
        for k in range(len(rows)):
            _, outputs, memory = exported.decide(rows[k : k + 1], memory)
            found.append(outputs)
        outputs = np.concatenate(found)
        return {name: outputs[name] for name in outputs.dtype.names or ()}
    if memory is not None:
        memory["heading"] = wrap_angles(np.array([state.headings[0] for state in states]))
        memory["chosen"] = wrap_angles(np.array([state.chosen[0] for state in states]))
        memory["blocked"] = [state.blocked[0] for state in states]
    _, outputs, _ = exported.decide(rows, memory)
    return {name: outputs[name] for name in outputs.dtype.names or ()}


def _is_tie(
    experiment: Experiment, exported: LibraryPolicy | OnnxPolicy, seen: Observation, state: PolicyState, action: int
) -> bool:
    """Whether the policy takes the action too, of what it sees (1, ...) moved a little."""
    contract, generator = exported.contract, rng(0, Stream.POLICY)
    distances = seen.ray_distances if contract.by_rays else seen.readings
    numbers = np.concatenate([distances[0], contract.rows(seen)[0, len(distances[0]) :]]).astype(np.float64)
    moves = ROUNDING * generator.uniform(-1, 1, (TRIES, len(numbers)))
    moved = np.where(numbers < contract.sensor_range, numbers * (1 + moves), numbers)
    bearing = len(distances[0]) + 1
    moved[:, bearing] = numbers[bearing] + moves[:, bearing]
    if isinstance(state, VfhState):
        turned = ROUNDING * generator.uniform(-1, 1, (2, TRIES))
        blocked = np.repeat(state.blocked, TRIES, axis=0)
        state = replace(state, headings=state.headings + turned[0], chosen=state.chosen + turned[1], blocked=blocked)
    if isinstance(exported, OnnxMapPolicy):
        memory = {field.name: getattr(state.memory, field.name) for field in fields(state.memory)}
        memory = {name: np.repeat(values, TRIES, axis=0) for name, values in memory.items()}
        state = replace(state, memory=replace(state.memory, **memory))
    actions, _ = experiment.policy.act(observed(contract, experiment.task, moved), state)
    return bool((actions == action).any())
