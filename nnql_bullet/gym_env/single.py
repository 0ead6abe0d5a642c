"""The environment of one vehicle."""

from collections.abc import Sequence
from typing import Any, get_args

import gymnasium
import numpy as np
from gymnasium.utils.seeding import np_random
from numpy.typing import ArrayLike

from nnql_bullet.geometry import Array
from nnql_bullet.gym_env.fleet import Fleet
from nnql_bullet.gym_env.observations import Told, rows_of
from nnql_bullet.gym_env.starts import checked_options, starting_world
from nnql_bullet.render.live import RenderMode, modes_here
from nnql_bullet.seeding import as_seed
from nnql_bullet.sim.base import Simulator
from nnql_bullet.sim.copying import CopyableSimulator
from nnql_bullet.types import Bytes
from nnql_bullet.worlds.spec import WorldSpec


def rendering(decision_period: float) -> dict[str, Any]:
    """What `metadata` says of rendering: the modes, and the rate [Hz] at which a picture a decision is real time."""
    return {"render_modes": modes_here(), "render_fps": 1 / decision_period}


class TricycleEnv(gymnasium.Env[Told, Any]):
    """One vehicle, in a new world each episode; `api.environment.make_env` makes it."""

    metadata = {"render_modes": list(get_args(RenderMode)), "render_fps": 2.0}  # noqa: RUF012 (Gymnasium's own convention)

    def __init__(self, fleet: Fleet, render_mode: RenderMode | None = None) -> None:
        """Takes a fleet of one vehicle.

        Args:
            fleet: The vehicle with its observation, actions and reward.
            render_mode: How it is shown.
        """
        self._fleet, self.render_mode = fleet, render_mode
        self.observation_space, self.action_space = fleet.observation_space, fleet.action_space
        self.metadata = {**self.metadata, **rendering(self.simulator.drive.decision_period)}

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Told, dict[str, Any]]:
        """Starts an episode in the world that the options name, or in one drawn from the environment's generator.

        Args:
            seed: Seed of the generator: a whole number or a `SeedSequence`; None goes on with it.
            options: `world_seed`, `world` (as in `make_env`), `start` (x, y [m], yaw [rad]) and `target` (x, y [m]),
                each for this episode alone.

        Raises:
            UserError: If an option or the seed is wrong, or the environment is closed.
        """
        given, seed = checked_options(options), as_seed(seed)
        if seed is not None:
            self._np_random, self._np_random_seed = np_random(seed)
        world = starting_world(self._fleet.experiment, given, self.np_random)
        infos = self._fleet.begin({0: world})
        return self._told(), _first(infos)

    def step(self, action: Any) -> tuple[Told, float, bool, bool, dict[str, Any]]:
        """Carries out one decision.

        Raises:
            UserError: If there is no such action, or no episode under way.
        """
        rewards, terminated, truncated, infos = self._fleet.step([action], np.ones(1, np.bool_))
        return self._told(), rewards.item(), terminated.item(), truncated.item(), _first(infos)

    def render(self) -> Bytes | list[Bytes] | None:  # type: ignore[override]
        """Draws what the `render_mode` says; a window shows each step by itself.

        Raises:
            UserError: If no episode has begun.
        """
        if self.render_mode is None or self.render_mode == "human":
            return None
        return self._fleet.render()[0]

    def set_target(self, *targets: Sequence[float]) -> Told:
        """Gives the vehicle, in the middle of its episode, another target, or several to reach in turn.

        Args:
            *targets: x, y [m] in the frame of the world's map; the last is the target.

        Returns:
            The observation, which tells of the first of them.

        Raises:
            UserError: If one is outside the arena, or there is a plan and no way; then nothing has changed.
        """
        self._fleet.set_targets({0: targets})
        return self._told()

    @property
    def simulator(self) -> Simulator:
        """The simulator of the vehicle."""
        simulator = self._fleet.navigation.simulator
        return simulator.inner if isinstance(simulator, CopyableSimulator) else simulator

    def world(self, seed: int) -> WorldSpec:
        """The world of a seed."""
        return self._fleet.experiment.world(seed)

    def close(self) -> None:
        """Frees the simulator and what draws; nothing happens the second time."""
        self._fleet.close()

    def _told(self) -> Told:
        (told,) = rows_of(self._fleet.told(), 1)
        return told


class TricycleGoalEnv(TricycleEnv):
    """One vehicle that is told of goals, for learning in hindsight."""

    def compute_reward(self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any) -> Array | float:
        """The rewards (...) of goals (..., 3); `info` is of no account."""
        rewards = self._fleet.goal_reward(achieved_goal, desired_goal)
        return rewards if rewards.ndim else rewards.item()


def _first(infos: dict[str, Any]) -> dict[str, Any]:
    """The `info` of the first vehicle, from values by name (n, ...)."""
    return {name: values[0] if values.ndim > 1 else values[:1].item() for name, values in infos.items()}
