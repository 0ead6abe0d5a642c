"""Training by the DQN of stable-baselines3. The only module that imports it.

That library keeps a replay memory, an optimizer and generators of its own, of which nothing is written down: what is
kept of a training is how many episodes it had given out, and going on redoes these before it comes to new ones. That
takes as long as they took, and comes to the same, bit for bit.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import count
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import DQN
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv

from nnql_bullet.agents.learning.sb3_dqn import INPUTS, Sb3Dqn, inputs
from nnql_bullet.env import ACTIONS, Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import EpisodeSummary, Tally
from nnql_bullet.seeding import Stream, fenced, rng
from nnql_bullet.training.base import TrainingEpisode
from nnql_bullet.worlds.spec import WorldSpec


class DqnTraining:
    """A `Trainer`. Each update draws from a generator of its own, a function of the seed and its number."""

    def __init__(self, agent: Sb3Dqn, navigation: Navigation, world_of: Callable[[int], WorldSpec], seed: int) -> None:
        self._agent = agent
        self._navigation = navigation
        self._world_of = world_of
        self._seed = seed
        self._given = 0

    def episodes(self) -> Iterator[TrainingEpisode]:
        """See `Trainer`; those that were given out before `load_state_dict` are redone without a word."""
        for done, (episode, weights) in enumerate(self._train()):
            if done == self._given:
                self._given += 1
                self._agent.load_state_dict(weights)
                yield episode

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """How many episodes were given out."""
        return {"given": np.array([self._given])}

    def load_state_dict(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Takes back what `state_dict` gave."""
        try:
            (self._given,) = arrays["given"].tolist()
        except (KeyError, ValueError, TypeError):
            raise UserError("this is not the state of a training by stable-baselines3") from None

    def _train(self) -> Iterator[tuple[TrainingEpisode, dict[str, Array]]]:
        """Trains from the beginning; yields each episode as it finishes, with the weights of then."""
        o = self._agent.options
        vehicles = VehiclesVecEnv(self._navigation, self._world_of)
        n = vehicles.num_envs
        together = max(o.steps_per_update // n, 1)
        with fenced(rng(self._seed, Stream.WEIGHTS)):
            dqn = DQN(
                "MlpPolicy",
                vehicles,
                learning_rate=o.learning_rate,
                buffer_size=o.buffer_size,
                learning_starts=o.learning_starts,
                batch_size=o.batch_size,
                gamma=o.discount,
                train_freq=together,
                gradient_steps=max(together * n // o.steps_per_update, 1),
                target_update_interval=max(o.target_update_steps, n),
                policy_kwargs={"net_arch": list(o.hidden)},
                device="cpu",
            )
        dqn.set_logger(Logger(None, []))  # else it makes one at every call of `learn`
        dqn.exploration_schedule = lambda _: o.exploration(dqn.num_timesteps)
        for update in count():
            generator = rng(self._seed, Stream.POLICY, update)
            dqn.action_space.seed(int(generator.integers(2**32)))
            with fenced(generator):
                dqn.learn(1, reset_num_timesteps=False)  # until the next update
            weights = {name: value.numpy().copy() for name, value in dqn.q_net.q_net.state_dict().items()}
            for number, summary in vehicles.finished:
                yield TrainingEpisode(number, summary, {"exploration": dqn.exploration_rate}), weights
            vehicles.finished.clear()


class VehiclesVecEnv(VecEnv):
    """Many vehicles, as stable-baselines3 wants them: one whose episode is over is in its next world at once.

    As in `Training`, it takes the next episode that nobody has begun.
    """

    def __init__(self, navigation: Navigation, world_of: Callable[[int], WorldSpec]) -> None:
        self._navigation = navigation
        self._world_of = world_of
        n = navigation.simulator.size
        self._tally = Tally(n)
        self._episode = np.zeros(n, np.int64)
        self._next_episode = 0
        self._actions = np.zeros(n, np.int64)
        self.finished: list[tuple[int, EpisodeSummary]] = []
        """Number and summary of the episodes that have finished; whoever reads it empties it."""
        seen = gymnasium.spaces.Box(-np.inf, np.inf, (INPUTS,), np.float32)
        super().__init__(n, seen, gymnasium.spaces.Discrete(ACTIONS))

    def reset(self) -> NDArray[np.float32]:
        """Starts an episode for every vehicle."""
        return self._begin(range(self.num_envs))

    def step_async(self, actions: NDArray[np.int64]) -> None:
        """Takes down what they are to do (n,)."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Carries out one decision of each vehicle."""
        t = self._navigation.step(self._actions)
        self._tally.add(t)
        seen, over = inputs(t.s_t), self._tally.over
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = np.flatnonzero(over).tolist()
        for vehicle in ended:
            timeout = bool(t.discount_t[vehicle])
            infos[vehicle] = {"terminal_observation": seen[vehicle], "TimeLimit.truncated": timeout}
            self.finished.append((int(self._episode[vehicle]), self._tally.summary(vehicle)))
        return self._begin(ended), t.r_t.astype(np.float32), over, infos

    def _begin(self, vehicles: Sequence[int]) -> NDArray[np.float32]:
        worlds = {}
        for vehicle in vehicles:
            worlds[vehicle] = self._world_of(self._next_episode)
            self._episode[vehicle] = self._next_episode
            self._tally.reset(vehicle, worlds[vehicle].seed)
            self._next_episode += 1
        self._navigation.reset(worlds)
        return inputs(self._navigation.observation)

    def close(self) -> None:
        """Does nothing: the simulator belongs to the caller."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """None of each vehicle: they are no environments that have attributes."""
        return [None] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused."""
        raise AttributeError(attr_name)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refused."""
        raise AttributeError(method_name)

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: Any = None
    ) -> list[bool]:
        """None is."""
        return [False] * self.num_envs
