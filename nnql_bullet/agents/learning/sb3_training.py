"""Training by the DQN of stable-baselines3.

Resuming retrains. The library's replay buffer, optimizer and random generators are not saved; a checkpoint holds only
the number of finished episodes. A resumed training repeats these from the first one, which takes as long as it did
before, and then continues with the same results as a training that never stopped.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import count
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3 import DQN
from stable_baselines3.common.logger import Logger

from nnql_bullet.agents.learning.optimizers import without_cache_folder
from nnql_bullet.agents.learning.options import SB3_INPUTS
from nnql_bullet.agents.learning.sb3_dqn import Sb3Dqn, inputs
from nnql_bullet.agents.learning.sb3_vehicles import VehiclesVecEnv
from nnql_bullet.agents.learning.weights import load_state_dict, state_dict
from nnql_bullet.env import ACTIONS, Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import EpisodeSummary, Tally
from nnql_bullet.seeding import Stream, fenced, rng
from nnql_bullet.training.base import TrainingEpisode
from nnql_bullet.worlds.spec import WorldSpec


class DqnTraining:
    """A `Trainer`, see the module. Each update has a random generator of its own, made of the seed and its number."""

    def __init__(self, agent: Sb3Dqn, navigation: Navigation, world_of: Callable[[int], WorldSpec], seed: int) -> None:
        self._agent = agent
        self._navigation = navigation
        self._world_of = world_of
        self._seed = seed
        self._given = 0
        self._start = agent.start

    def episodes(self) -> Iterator[TrainingEpisode]:
        """See `Trainer`; after `load_state_dict` the episodes finished before are repeated, and not yielded again."""
        for done, (episode, weights) in enumerate(self._train()):
            if done == self._given:
                self._given += 1
                self._agent.load_state_dict(weights)
                yield episode

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """The number of episodes yielded."""
        return {"given": np.array([self._given])}

    def load_state_dict(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Resumes from what `state_dict` gave, see the module."""
        try:
            (self._given,) = arrays["given"].tolist()
        except (KeyError, ValueError, TypeError):
            raise UserError("this is not the state of a training by stable-baselines3") from None

    def _train(self) -> Iterator[tuple[TrainingEpisode, dict[str, Array]]]:
        """Trains from the beginning; yields each episode as it finishes, with the weights of then."""
        o = self._agent.options
        vehicles = TrainingVehicles(self._navigation, self._world_of, self._agent.scale)
        n = vehicles.num_envs
        together = max(o.steps_per_update // n, 1)
        with fenced(rng(self._seed, Stream.WEIGHTS)), without_cache_folder():
            dqn = DQN(
                "MlpPolicy",
                VehiclesVecEnv(vehicles),
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
        if self._start is not None:
            for network in (dqn.q_net.q_net, dqn.q_net_target.q_net):
                load_state_dict(network, self._start)
        dqn.set_logger(Logger(None, []))  # else it makes one at every call of `learn`
        dqn.exploration_schedule = lambda _: o.exploration(dqn.num_timesteps)
        for update in count():
            generator = rng(self._seed, Stream.POLICY, update)
            dqn.action_space.seed(int(generator.integers(2**32)))
            with fenced(generator):
                dqn.learn(1, reset_num_timesteps=False)  # until the next update
            learned = state_dict(dqn.q_net.q_net)
            for number, summary in vehicles.finished:
                yield TrainingEpisode(number, summary, {"exploration": dqn.exploration_rate}), learned
            vehicles.finished.clear()


class TrainingVehicles(VectorEnv[NDArray[np.float32], NDArray[np.int64], Any]):
    """Vehicles of a training, each in the next episode that nobody has begun as soon as its own is over."""

    def __init__(self, navigation: Navigation, world_of: Callable[[int], WorldSpec], scale: float = 1.0) -> None:
        self._navigation, self._scale = navigation, scale
        self._world_of = world_of
        self.num_envs = navigation.simulator.size
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP}
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (SB3_INPUTS,), np.float32)
        self.single_action_space = gymnasium.spaces.Discrete(ACTIONS)
        self._tally = Tally(navigation)
        self._episode = np.zeros(self.num_envs, np.int64)
        self._next_episode = 0
        self.finished: list[tuple[int, EpisodeSummary]] = []
        """Number and summary of the episodes that have finished; whoever reads it empties it."""

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Starts an episode for every vehicle; the training has drawn them all."""
        return self._begin(range(self.num_envs)), {}

    def step(
        self, actions: NDArray[np.int64]
    ) -> tuple[NDArray[np.float32], Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Carries out one decision of each vehicle."""
        t = self._navigation.step(actions)
        self._tally.add(t)
        seen, over = inputs(t.s_t, self._scale), self._tally.over
        truncated = over & (t.discount_t > 0)
        ended = np.flatnonzero(over).tolist()
        done = {vehicle: self._tally.summary(vehicle) for vehicle in ended}
        self.finished += [(int(self._episode[vehicle]), summary) for vehicle, summary in done.items()]
        endings = {vehicle: summary.ending for vehicle, summary in done.items()}
        final = {"ending": endings, "is_success": {vehicle: its == "goal" for vehicle, its in endings.items()}}
        infos = {"final_obs": seen, "final_info": final}
        return self._begin(ended), t.r_t, over & ~truncated, truncated, infos

    def _begin(self, vehicles: Sequence[int]) -> NDArray[np.float32]:
        worlds = {}
        for vehicle in vehicles:
            worlds[vehicle] = self._world_of(self._next_episode)
            self._episode[vehicle] = self._next_episode
            self._tally.reset(vehicle, worlds[vehicle].seed)
            self._next_episode += 1
        self._navigation.reset(worlds)
        return inputs(self._navigation.observation, self._scale)
