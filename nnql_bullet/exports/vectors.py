"""Test vectors: what a policy sees in drives in the kinematic model, and what it decides."""

import csv
import io
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.base import TurnChooser
from nnql_bullet.env import Observation, Transition, heading_change, speed_scale
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.exports.contract import STOPPED, Contract
from nnql_bullet.exports.maps import map_of
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Decision, finished_episodes
from nnql_bullet.run_config import changed
from nnql_bullet.task import NON_SAFE, SAFE, TaskOptions, is_safe, readings_of
from nnql_bullet.worlds.spec import WorldSpec

WORLDS = ("cover_10", "cover_20", "traps", "rooms", "aisles", "cells", "cluttered", "poles", "moving")
"""Kinds of worlds that drives are recorded in."""
DRIVES = 1
"""Drives in each kind of worlds."""
BAD = (
    ("distances", np.nan),
    ("distances", -1.0),
    ("distances", np.inf),
    ("target_distance", np.nan),
    ("target_distance", 1e9),
    ("target_bearing", 4.0),
    ("yaw_rate", -np.inf),
    ("way", np.nan),
    ("speed", np.nan),
)
"""Inputs that are refused, where there are such."""
_FIELDS = tuple(its.name for its in fields(Observation))


@dataclass
class Seen:
    """Keeps what one vehicle sees; a `rollout.Watcher`."""

    observations: list[Observation] = field(default_factory=list)
    """Before each decision, each of one vehicle."""
    trace: None = None

    def on_reset(self, world: WorldSpec, observation: Observation, vehicle: int) -> None:
        """Does nothing: the first step tells what was seen before it."""

    def on_step(self, transition: Transition, decision: Decision, vehicle: int) -> None:
        """Keeps what the decision was made by."""
        s_tm1, row = transition.s_tm1, slice(vehicle, vehicle + 1)
        self.observations.append(Observation(*(getattr(s_tm1, name)[row].copy() for name in _FIELDS)))


def recorded_drives(
    experiment: Experiment, kinds: Sequence[str] = WORLDS, seeds: Sequence[int] = range(DRIVES)
) -> list[Observation]:
    """Drives a policy in the kinematic model.

    Args:
        experiment: Whose policy drives.
        kinds: Kinds of worlds; those that its vehicle cannot drive in are left out.
        seeds: Of the worlds of each kind.

    Returns:
        What was seen at each decision of each drive (steps, ...).

    Raises:
        UserError: If it can drive in none of the worlds.
    """
    worlds = list(_worlds(experiment, kinds, seeds))
    if not worlds:
        raise UserError(f"the vehicle '{experiment.vehicle.name}' can drive in none of the worlds: {', '.join(kinds)}")
    config = changed(experiment.config, simulator="kinematic", vehicles=min(len(worlds), 64))
    where = Experiment(config, experiment.agent)
    watchers = [Seen() for _ in worlds]
    with closing(where.new_simulator(1)) as simulator:
        for _ in finished_episodes(where.new_navigation(simulator), worlds, where.policy, dict(enumerate(watchers))):
            pass
    return [_together(watcher.observations) for watcher in watchers]


def _worlds(experiment: Experiment, kinds: Sequence[str], seeds: Sequence[int]) -> Iterator[WorldSpec]:
    for kind in kinds:
        try:
            drawn = [experiment.draw(experiment.kind(kind, own_ends=True), seed) for seed in seeds]
        except UserError:
            continue
        yield from drawn


def _together(observations: Sequence[Observation]) -> Observation:
    return Observation(*(np.concatenate([getattr(its, name) for its in observations]) for name in _FIELDS))


def observed(contract: Contract, task: TaskOptions, rows: NDArray[np.floating[Any]]) -> Observation:
    """The observation that inputs (n, numbers) stand for."""
    numbers, d = rows.astype(np.float64), contract.distances
    distances, (away, bearing, yaw_rate) = numbers[:, :d], numbers[:, d : d + 3].T
    speed = numbers[:, d + 3] if contract.takes_speed else np.zeros(len(rows))
    readings = readings_of(distances, task) if contract.by_rays else distances
    properties = np.where(is_safe(readings, task), SAFE, NON_SAFE)
    return Observation(readings, away, bearing, yaw_rate, speed, properties, distances)


@dataclass(frozen=True, slots=True)
class Vectors:
    """Inputs of k decisions, and the outputs that belong to them."""

    contract: Contract
    drives: NDArray[np.int64]
    """The drive of each decision (k,); -1 for those with bad input, which belong to none."""
    inputs: NDArray[np.float32]
    """(k, numbers)"""
    frames: NDArray[np.uint8]
    """Frames before each decision (k, bytes); none but beside a map."""
    statuses: NDArray[np.int64]
    """Indices into `Contract.statuses` (k,)."""
    actions: NDArray[np.int64]
    """(k,)"""
    turns: Array
    """Heading changes (k,) [rad]."""
    shares: Array
    """Of the drive's speed (k,)."""
    overridden: NDArray[np.bool_]
    """Whether a shield replaced the action (k,)."""
    values: Array
    """Q-values of the turns (k, 5); NaN if it has none."""
    safe: NDArray[np.bool_]
    """(k,)"""

    def csv(self) -> str:
        """A line for each decision; numbers are exact in single precision."""
        c, text = self.contract, io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        kept = c.memory if self.frames.size else ()
        names = [_numbered(signal.name, signal.count) for signal in (*c.inputs, *kept, *c.outputs)]
        writer.writerow(["drive", "status", *(name for its in names for name in its)])
        outputs = {signal.name for signal in c.outputs}
        for k in range(len(self.inputs)):
            row = [self.drives[k], self.statuses[k], *self.inputs[k], *self.frames[k]]
            row += [self.actions[k], np.float32(self.turns[k]), f"{self.shares[k]:g}"]
            row += [int(self.overridden[k])] if "overridden" in outputs else []
            row += [int(self.safe[k])] if "safe" in outputs else []
            row += list(self.values[k].astype(np.float32)) if "values" in outputs else []
            writer.writerow(row)
        return text.getvalue()


def _numbered(name: str, count: int) -> list[str]:
    return [name] if count == 1 else [f"{name}_{i}" for i in range(count)]


def vectors_of(contract: Contract, experiment: Experiment, drives: Sequence[Observation]) -> Vectors:
    """What the policy decides by inputs in single precision: those of drives, one after the other, and bad ones.

    Args:
        contract: Of the policy.
        experiment: That it is of.
        drives: What was seen (steps, ...) in each.
    """
    decided = [_decided(contract, experiment, drive) for drive in drives]
    inputs, actions, values, frames, overridden = (np.concatenate(part) for part in zip(*decided, strict=True))
    numbers = np.repeat(np.arange(len(drives)), [len(its[0]) for its in decided])
    ends = np.cumsum([signal.count for signal in contract.inputs])
    places = {signal.name: int(end) - signal.count for signal, end in zip(contract.inputs, ends, strict=True)}
    bad = [(name, value) for name, value in BAD if name in places]
    refused = np.repeat(inputs[:1], len(bad), axis=0)
    for row, (name, value) in zip(refused, bad, strict=True):
        row[places[name]] = value
    seen, nothing = observed(contract, experiment.task, inputs), np.zeros(len(bad))
    statuses = [contract.statuses.index(f"BAD_{_STATUS.get(name, name.upper())}") for name, _ in bad]
    return Vectors(
        contract=contract,
        drives=np.array([*numbers, *[-1] * len(bad)]),
        inputs=np.concatenate([inputs, refused]),
        frames=np.concatenate([frames, np.repeat(frames[:1], len(bad), axis=0)]),
        statuses=np.array([0] * len(inputs) + statuses),
        actions=np.concatenate([actions, np.full(len(bad), STOPPED)]),
        turns=np.concatenate([heading_change(actions, seen.target_bearing), nothing]),
        shares=np.concatenate([speed_scale(actions, experiment.config.drive), nothing]),
        overridden=np.concatenate([overridden, nothing > 0]),
        values=np.concatenate([values, np.zeros((len(bad), values.shape[1]))]),
        safe=np.concatenate([seen.state_property == SAFE, nothing > 0]),
    )


_STATUS = {"distances": "DISTANCE", "way": "MAP"}
"""What the status of a bad input is called, where not like the input."""


def _decided(
    contract: Contract, experiment: Experiment, drive: Observation
) -> tuple[NDArray[np.float32], NDArray[np.int64], Array, NDArray[np.uint8], NDArray[np.bool_]]:
    """Inputs (k, numbers), actions (k,), Q-values (k, m), frames before (k, bytes), overridden (k,) of a drive."""
    policy: Any = experiment.policy
    rows, beside = contract.rows(drive), map_of(experiment) if contract.map_beside else None
    state, actions = policy.initial_state(1), np.empty(len(rows), np.int64)
    overridden = np.zeros(len(rows), np.bool_)
    mapped, values, frames = [], [], []
    for k in range(len(rows)):
        seen = observed(contract, experiment.task, rows[k : k + 1])
        if beside is not None:
            told = beside.told(state.memory, seen)
            mapped.append(told.inputs[0])
            frames.append(told.frames[0])
        (actions[k],), state = policy.act(seen, state)
        overridden[k] = contract.shielded and policy.overridden(state)[0]
        if beside is not None:
            values.append(beside.values_of(policy, state)[0])
        elif contract.has_values and contract.remembers_alone:
            values.append(policy.values_of(state)[0])
    if beside is not None:
        inputs = np.concatenate([rows, np.array(mapped)], axis=1)
        return inputs, actions, np.array(values), np.array(frames), overridden
    found = np.array(values) if values else np.full((len(rows), len(paper.TURNS)), np.nan)
    if isinstance(policy, TurnChooser):
        found = policy.values(observed(contract, experiment.task, rows), np.ones(len(rows), np.bool_))
    return rows, actions, found, np.empty((len(rows), 0), np.uint8), overridden
