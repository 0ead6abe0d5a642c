"""Training (III.C): episode after episode in a new world each, learning at every step.

One policy learns from n vehicles in lockstep. A vehicle whose episode is over takes the next one that nobody has begun,
so all of them drive all the time, and what comes out depends on the seed and on n alone. With one vehicle this is the
paper's online learning.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.env import Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.rollout import Tally
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.training.base import LearningAgent, TrainingEpisode
from nnql_bullet.worlds.spec import WorldSpec

_AGENT = "agent/"
_NONE = -1
"""Stands for no episode or no action."""


class Training:
    """A training in progress, of a `LearningAgent`.

    When a vehicle finishes an episode, others are in the midst of theirs. A checkpoint keeps the actions of those: a
    simulator that is given the same actions again does the same again, bit for bit.
    """

    def __init__(
        self, agent: LearningAgent, navigation: Navigation, world_of: Callable[[int], WorldSpec], seed: int
    ) -> None:
        self._agent = agent
        self._navigation = navigation
        self._world_of = world_of
        self._seed = seed
        n, most = navigation.simulator.size, navigation.task.max_steps
        self._vehicles = np.arange(n)
        self._next_episode = 0
        self._episode = np.full(n, _NONE)
        self._actions = np.full((n, most), _NONE, np.int8)
        self._uniforms = np.zeros((n, most))
        self._squared_errors, self._updates = np.zeros(n), np.zeros(n, np.int64)
        self._tally = Tally(navigation)
        self._state = agent.initial_state(n)
        self._worlds: dict[int, WorldSpec] = {}

    def episodes(self) -> Iterator[TrainingEpisode]:
        """Trains without end, and yields each episode as it finishes; `state_dict` may be asked for in between.

        Raises:
            WorkerDied: If a process that holds vehicles is gone; `state_dict` then gives the state before this step.
        """
        while True:
            for vehicle in self._vehicles.tolist():
                if self._episode[vehicle] != _NONE and self._tally.over[vehicle]:
                    yield self._finish(vehicle)
                if self._episode[vehicle] == _NONE:
                    self._episode[vehicle] = self._next_episode
                    self._next_episode += 1
                    self._begin(vehicle)
            self._step()

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Copies the state of the training, with the agent's `training_state`, by name."""
        longest = int((self._actions != _NONE).sum(axis=1).max())
        return {
            "next_episode": np.array([self._next_episode]),
            "episode": self._episode.copy(),
            "actions": self._actions[:, :longest].copy(),
            "squared_errors": self._squared_errors.copy(),
            "updates": self._updates.copy(),
            **{_AGENT + name: values for name, values in self._agent.training_state(self._state).items()},
        }

    def load_state_dict(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Resumes from what `state_dict` gave: drives the unfinished episodes again up to where they were.

        Raises:
            UserError: If these are not the arrays of a training with as many vehicles.
        """
        try:
            if arrays["episode"].shape != self._episode.shape:
                raise ValueError
            (self._next_episode,) = arrays["next_episode"].tolist()
            self._episode[:] = arrays["episode"]
            self._squared_errors[:], self._updates[:] = arrays["squared_errors"], arrays["updates"]
            self._actions[:, : arrays["actions"].shape[1]] = arrays["actions"]
        except (KeyError, ValueError, IndexError, TypeError):
            raise UserError(f"this is not the state of a training with {len(self._vehicles)} vehicles") from None
        for vehicle in np.flatnonzero(self._episode != _NONE).tolist():
            self._begin(vehicle)
        self._put_into_worlds()
        for actions in self._actions.T:
            active = actions != _NONE
            if not active.any():
                break
            self._tally.add(self._navigation.step(np.where(active, actions, 0), active))
        kept = {name.removeprefix(_AGENT): values for name, values in arrays.items() if name.startswith(_AGENT)}
        self._state = self._agent.load_training_state(kept)

    def _begin(self, vehicle: int) -> None:
        """Draws the world and all random numbers of the vehicle's episode."""
        episode = int(self._episode[vehicle])
        world = self._world_of(episode)
        self._worlds[vehicle] = world
        self._tally.reset(vehicle, world.seed)
        self._state = self._agent.reset(self._state, {vehicle: world.seed})
        self._uniforms[vehicle] = rng(self._seed, Stream.POLICY, episode).random(self._uniforms.shape[1])

    def _put_into_worlds(self) -> None:
        self._navigation.reset(self._worlds)
        self._worlds = {}

    def _step(self) -> None:
        """One decision of every vehicle, and one update."""
        self._put_into_worlds()
        now = self._vehicles, self._tally.steps
        observations, uniforms = self._navigation.observation, self._uniforms[now]
        actions, state = self._agent.act_exploring(observations, self._state, self._episode, uniforms)
        transitions = self._navigation.step(actions)
        td_errors = self._agent.learn(transitions, state, self._episode)
        self._state = state
        self._actions[now] = actions
        self._tally.add(transitions)
        self._squared_errors += np.nan_to_num(td_errors) ** 2
        self._updates += ~np.isnan(td_errors)

    def _finish(self, vehicle: int) -> TrainingEpisode:
        episode = int(self._episode[vehicle])
        td_error = float(np.sqrt(self._squared_errors[vehicle] / max(self._updates[vehicle], 1)))
        diagnostics = {**self._agent.diagnostics(episode), "td_error": td_error}
        self._episode[vehicle] = _NONE
        self._actions[vehicle] = _NONE
        self._squared_errors[vehicle] = self._updates[vehicle] = 0
        return TrainingEpisode(episode, self._tally.summary(vehicle), diagnostics)
