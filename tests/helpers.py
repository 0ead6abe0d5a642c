"""What several tests use: one vehicle of a simulator, seen alone, and observations made by hand."""

from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.agents.base import Overridable
from nnql_bullet.env import Navigation, Observation, Transition
from nnql_bullet.geometry import Array, Pose
from nnql_bullet.rollout import Actions, Overriding, Policy
from nnql_bullet.sim.base import Motion, Sample, Simulator
from nnql_bullet.sim.contact import VehicleMotion
from nnql_bullet.task import ENDINGS, NO_ENDING
from nnql_bullet.training.base import LearningAgent, TrainingEpisode
from nnql_bullet.worlds.spec import WorldSpec

Arrays = Mapping[str, NDArray[Any]]


class Alone(AbstractContextManager["Alone"]):
    """A simulator of one vehicle, with plain numbers in and out."""

    pose: Pose
    """Where the vehicle is."""
    rays: Array
    """What it saw last (72,) [m]."""
    end: Sample
    """The end of the last control period."""

    def __init__(self, simulator: Simulator) -> None:
        assert simulator.size == 1
        self.simulator = simulator

    def __exit__(self, *error: object) -> None:
        self.simulator.close()

    def reset(self, world: WorldSpec) -> None:
        (pose,), (self.rays,) = self.simulator.reset({0: world})
        self.pose = Pose(*pose.tolist())

    def advance(self, turn: float, trace: list[Sample] | None = None, speed_scale: float = 1.0) -> VehicleMotion:
        own: list[Sample] = []
        scale = np.array([speed_scale])
        motion, (self.rays,) = self.simulator.advance(np.array([turn]), speed_scales=scale, traces={0: own})
        if trace is not None:
            trace += own
        self.end = own[-1]
        done = row(motion, 0)
        self.pose = done.pose
        return done


def row(motion: Motion, vehicle: int) -> VehicleMotion:
    """The motion of one of several vehicles."""
    values = {field.name: getattr(motion, field.name)[vehicle] for field in fields(Motion)}
    return VehicleMotion(Pose(*values.pop("pose").tolist()), **{name: value.item() for name, value in values.items()})


def begun(navigation: Navigation, world: WorldSpec) -> Observation:
    """The first observation of an episode of one vehicle."""
    navigation.reset({0: world})
    return navigation.observation


def step(navigation: Navigation, action: int) -> Transition:
    """A step of one vehicle."""
    return navigation.step(np.array([action]))


def ending(transition: Transition) -> str | None:
    """How the episode of one vehicle ended, or None."""
    (end,) = transition.ending.tolist()
    return None if end == NO_ENDING else ENDINGS[end]


def observed(*vehicles: Iterable[Any]) -> Observation:
    """An observation of n vehicles, each given as the values of the record's fields in their order."""
    return Observation(*(np.array(column) for column in zip(*vehicles, strict=True)))


class Driving:
    """A policy and its state for n vehicles."""

    def __init__(self, policy: Policy, size: int = 1) -> None:
        self.policy = policy
        self.state = policy.initial_state(size)

    def reset(self, *vehicles: int) -> "Driving":
        """Puts vehicles into worlds whose seeds are their numbers."""
        self.state = self.policy.reset(self.state, {vehicle: vehicle for vehicle in vehicles})
        return self

    def act(self, observations: Observation) -> Actions:
        actions, self.state = self.policy.act(observations, self.state)
        return actions

    def action_values(self, observations: Observation) -> Array:
        return self.policy.action_values(observations, self.state)

    def override(self, actions: Actions) -> None:
        assert isinstance(self.policy, Overridable)
        self.state = self.policy.override(self.state, actions)

    @property
    def overridden(self) -> list[bool]:
        assert isinstance(self.policy, Overriding)
        return [bool(one) for one in self.policy.overridden(self.state)]


def learn(agent: LearningAgent, transitions: Transition) -> Array:
    """Lets an agent without memory learn in its first episode."""
    return agent.learn(transitions, None, np.zeros(len(transitions.a_tm1), np.int64))


def same(one: Arrays, other: Arrays) -> bool:
    """Whether the arrays have the same names and the same numbers."""
    return one.keys() == other.keys() and all(np.array_equal(one[name], other[name]) for name in one)


@dataclass(frozen=True)
class Stop:
    """A training just after it gave out an episode."""

    done: list[TrainingEpisode]
    learned: Arrays
    under_way: Arrays


def stops(made: Any, episodes: int) -> list[Stop]:
    """What each of the first episodes of `made.training` of `made.agent` leaves."""
    done: list[TrainingEpisode] = []
    found = []
    for episode in islice(made.training.episodes(), episodes):
        done.append(episode)
        found.append(Stop(list(done), made.agent.state_dict(), made.training.state_dict()))
    return found


def going_on(made: Any, stop: Stop, episodes: int) -> Stop:
    """What a new training leaves that resumes from a stop until it has so many episodes."""
    made.agent.load_state_dict(stop.learned)
    made.training.load_state_dict(stop.under_way)
    more = list(islice(made.training.episodes(), episodes - len(stop.done)))
    return Stop(stop.done + more, made.agent.state_dict(), made.training.state_dict())
