"""n vehicles with an observation, actions and a reward: what both environments are made of."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnql_bullet.agents.learning.frames import Sight
from nnql_bullet.env import Reward, Transition
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Array, as_rows, clearance_at
from nnql_bullet.gym_env.actions import ACTION_SETS, ActionsName
from nnql_bullet.gym_env.observations import OBSERVATIONS, ObservationName, Situation, Told, clipped, frame_maker
from nnql_bullet.gym_env.rewards import RewardName, goal_reward, reward_kind
from nnql_bullet.render.live import Live
from nnql_bullet.sim.base import Simulator
from nnql_bullet.task import ENDINGS, GOAL, TRUNCATIONS, StateProperty
from nnql_bullet.types import Bytes
from nnql_bullet.worlds.source import checked_place, in_frame
from nnql_bullet.worlds.spec import WorldSpec

_NEVER, _GOING, _OVER = range(3)
_ENDINGS = np.array([*ENDINGS, None], dtype=object)  # `NO_ENDING` is its last
_TRUNCATES = np.array([*(name in TRUNCATIONS for name in ENDINGS), False])
_LABELS = np.array([state.label for state in StateProperty], dtype=object)


class Fleet:
    """n vehicles, in lockstep, each in a world of its own."""

    def __init__(
        self,
        experiment: Experiment,
        simulator: Simulator,
        observation: ObservationName,
        actions: ActionsName,
        reward: RewardName | Reward,
        lives: list[Live],
    ) -> None:
        """Puts the parts together.

        Args:
            experiment: Configuration, vehicle and worlds.
            simulator: Of n vehicles.
            observation: What is told.
            actions: What may be chosen.
            reward: What is rewarded.
            lives: Show the first of the vehicles.

        Raises:
            UserError: If the reward does not follow from the goals of a goal-conditioned observation.
        """
        if observation == "goal" and reward != "sparse":
            raise UserError("the reward of observation 'goal' must follow from its goals; give reward='sparse'")
        self.experiment = experiment
        self._told, self._actions, self._reward = OBSERVATIONS[observation], ACTION_SETS[actions], reward_kind(reward)
        self.observation_space, self.action_space = self._told.space(experiment), self._actions.space
        self.navigation = experiment.new_navigation(simulator, self._reward.navigation)
        self._goals = observation == "goal"
        remembers = self._told.remembers or self._reward.score is not None
        self._sight = Sight(frame_maker(experiment), simulator.size) if remembers else None
        self._lives = lives
        n = simulator.size
        self._pose, self._target = np.zeros((n, 3)), np.zeros((n, 2))
        self._phase = np.full(n, _NEVER)
        self.closed = False

    @property
    def size(self) -> int:
        """Number of vehicles: n."""
        return self.navigation.simulator.size

    def begin(self, worlds: Mapping[int, WorldSpec]) -> dict[str, NDArray[Any]]:
        """Starts an episode for some vehicles.

        Returns:
            The values of `info`, by name (n, ...); of other vehicles they mean nothing.

        Raises:
            UserError: If the environment is closed.
        """
        if self.closed:
            raise UserError("this environment is closed; make another")
        self.navigation.reset(worlds)
        vehicles, footprint = np.array(list(worlds), np.int64), as_rows((self.experiment.vehicle.footprint,))[0]
        seeds, clearance = np.zeros(self.size, np.int64), np.zeros(self.size)
        for i, world in worlds.items():
            start = world.start
            self._pose[i], self._target[i] = (start.x, start.y, start.yaw), world.target
            seeds[i] = world.seed
            clearance[i] = clearance_at(start.x, start.y, start.yaw, footprint, world.solids_at(0.0))
        self._phase[vehicles] = _GOING
        if self._sight and len(vehicles):
            self._sight.begin(vehicles, self.navigation.observation)
        for i, live in enumerate(self._lives):
            if i in worlds:
                live.on_reset(worlds[i], self.navigation.observation, i, clearance[i])
        return {"world_seed": seeds, "pose": self._pose.copy(), "clearance": clearance}

    def set_targets(self, targets: Mapping[int, Sequence[Sequence[float]]]) -> None:
        """Gives some vehicles, in the middle of their episodes, other targets; see `Navigation.set_targets`.

        Args:
            targets: x, y [m] of each in the frame of the world's map, by vehicle.
        """
        frame = self.experiment.worlds.frame
        places = {i: [in_frame(frame, checked_place("target", one)) for one in its] for i, its in targets.items()}
        self.navigation.set_targets(places)
        for i, its in places.items():
            self._target[i] = its[-1]

    def step(
        self, actions: object, active: NDArray[np.bool_]
    ) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, NDArray[Any]]]:
        """Carries out one decision of the active vehicles (n,).

        Returns:
            Rewards, whether each episode terminated, whether it was truncated (n,), and the values of `info`, by name
            (n, ...); of vehicles that stand by they mean nothing.

        Raises:
            UserError: If these are no such actions, or a vehicle is in no episode.
        """
        if self.closed:
            raise UserError("this environment is closed; make another")
        for phase, reason in ((_NEVER, "no episode has begun"), (_OVER, "the episode is over")):
            if (active & (self._phase == phase)).any():
                raise UserError(f"{reason}; call reset before step")
        navigation = self.navigation
        commands = self._actions.read(actions, navigation.observation.target_bearing, navigation.simulator.drive)
        traces = {i: live.trace for i, live in enumerate(self._lives)}
        t = navigation.carry_out(commands, None if active.all() else active, traces)
        self._pose = np.where(active[:, None], t.motion.pose, self._pose)
        if self._sight:
            self._sight.follow(t)
        rewards, terms = self._scored(t)
        terminated, truncated = active & (t.discount_t == 0.0), active & _TRUNCATES[t.ending]
        self._phase[terminated | truncated] = _OVER
        for i, live in enumerate(self._lives):
            if active[i]:
                live.on_step(t, i)
        infos = {
            "ending": _ENDINGS[t.ending],
            "is_success": t.ending == GOAL,
            "state_property": _LABELS[t.s_t.state_property],
            "heading_error": t.motion.heading_error,
            "pose": self._pose.copy(),
            "clearance": t.motion.clearance,
            **{f"reward/{name}": values for name, values in terms.items()},
        }
        return rewards, terminated, truncated, infos

    def told(self) -> Told:
        """The present observations of all vehicles; those that were never reset mean nothing."""
        look = self._sight.look if self._sight and self._told.remembers else None
        situation = Situation(self.navigation.observation, self._pose, self._target, look)
        return clipped(self._told.tell(situation), self.observation_space)

    def goal_reward(self, achieved: ArrayLike, desired: ArrayLike) -> Array:
        """The rewards (...) of goals (..., 3), of the observation `goal`."""
        return goal_reward(achieved, desired, self.experiment.worlds.target_radius)

    def render(self) -> list[Bytes | list[Bytes]]:
        """What the vehicles that are shown look like; see `Live.render`.

        Raises:
            UserError: If no episode has begun.
        """
        if (self._phase == _NEVER).any():
            raise UserError("there is nothing to render: no episode has begun; call reset first")
        return [live.render() for live in self._lives]

    def close(self) -> None:
        """Frees the simulator and what draws; nothing happens the second time."""
        self.closed = True
        self.navigation.simulator.close()
        for live in self._lives:
            live.close()

    def _scored(self, t: Transition) -> tuple[Array, dict[str, Array]]:
        """The rewards of a step (n,), and their terms by name."""
        if self._reward.score is not None and self._sight:
            terms = self._reward.score(self.experiment, t, self._sight.look)
            return np.sum(list(terms.values()), axis=0), terms
        terms = dict(zip(t.term_names, t.terms.T, strict=True))
        if not self._goals:
            return t.r_t, terms
        told = self.told()
        return self.goal_reward(told["achieved_goal"], told["desired_goal"]), terms
