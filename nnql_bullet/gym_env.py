"""The task as the Gymnasium environment `nnql_bullet/Tricycle-v0`, with one vehicle, or n by `make_vec`.

Observation, `Box` of 11 float32:

| index | what | unit | range |
|---|---|---|---|
| 0-7 | smallest distance in each 45-degree sector, from straight ahead counter-clockwise | m | 0 to 10 (nothing seen) |
| 8 | distance to the target | m | 0 to the arena's diagonal |
| 9 | bearing of the target, positive to the left | rad | -pi to pi |
| 10 | yaw rate, positive to the left | rad/s | -10 to 10, clipped |

Action, `Discrete(6)`: 0 straight on, 1 left 30 degrees, 2 left 60, 3 right 30, 4 right 60, 5 toward the target. With
`manoeuvres=True` it is `Discrete(24)`: add 6 to brake and turn on the spot, 12 to turn while driving backwards, 18 to
drive slowly.

Reward: the paper's (II.C), the sum of six named terms of which at most one is not zero, or one of your own. An episode
terminates at the target or at a collision; it is truncated after 500 steps, or as `stuck` once the vehicle has stayed
about one place for long. `info` holds `world_seed`, and after a step also `ending`, `state_property`, `heading_error`
and a `reward/NAME` for each term.
"""

from collections.abc import Mapping, Sequence
from math import hypot, pi
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.env import (
    ACTIONS,
    MANOEUVRES,
    MOST_YAW_RATE,
    Observation,
    Reward,
    Transition,
    as_actions,
    as_numbers,
)
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.presets import load_config
from nnql_bullet.run_config import RunConfig, changed
from nnql_bullet.seeding import TRAINING_WORLDS
from nnql_bullet.sim.base import Simulator
from nnql_bullet.task import ENDINGS, TRUNCATIONS, StateProperty
from nnql_bullet.worlds.source import checked_place, in_frame
from nnql_bullet.worlds.spec import WorldSpec

_ENDINGS = np.array([*ENDINGS, None], dtype=object)  # `NO_ENDING` is its last
_TRUNCATIONS = [ENDINGS.index(name) for name in TRUNCATIONS]
_LABELS = np.array([state.label for state in StateProperty], dtype=object)
_BLANK: dict[str, Any] = {"O": None, "f": 0.0}  # in `info`, of a vehicle that stands by, by kind of value


def _experiment(config: RunConfig | str, changes: dict[str, Any]) -> Experiment:
    resolved = config if isinstance(config, RunConfig) else load_config(config, {})
    return Experiment(changed(resolved, **changes))


def _observation_space(experiment: Experiment) -> gymnasium.spaces.Space[NDArray[np.float32]]:
    world = experiment.worlds
    low = [0.0] * paper.SECTORS + [0.0, -pi, -MOST_YAW_RATE]
    high = [experiment.vehicle.sensor.range] * paper.SECTORS + [hypot(world.width, world.depth), pi, MOST_YAW_RATE]
    bounds = np.array([low, high], dtype=np.float32)
    return gymnasium.spaces.Box(bounds[0], bounds[1], dtype=np.float32)


def _vectors(observation: Observation, space: gymnasium.spaces.Space[NDArray[np.float32]]) -> NDArray[np.float32]:
    """The observation as rows (n, 11) of the module's table."""
    return np.minimum(np.maximum(as_numbers(observation), space.low), space.high)  # type: ignore[attr-defined]


def _infos(t: Transition) -> dict[str, NDArray[Any]]:
    """The values of `info` after a step, by name (n,)."""
    return {
        "ending": _ENDINGS[t.ending],
        "state_property": _LABELS[t.s_t.state_property],
        "heading_error": t.motion.heading_error,
        **{f"reward/{name}": values for name, values in zip(t.term_names, t.terms.T, strict=True)},
    }


def _over(t: Transition) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether an episode terminated, and whether it was truncated (n,)."""
    return t.active & (t.discount_t == 0.0), t.active & np.isin(t.ending, _TRUNCATIONS)


def _in_arena(experiment: Experiment, targets: Sequence[Sequence[float]]) -> list[tuple[float, float]]:
    """Targets in the frame of the arena, of those in the frame of the map."""
    frame = experiment.worlds.frame
    return [in_frame(frame, checked_place("target", target)) for target in targets]


def _draw_seed(generator: np.random.Generator) -> int:
    return int(generator.integers(TRAINING_WORLDS.start, TRAINING_WORLDS.stop))


class TricycleEnv(gymnasium.Env[NDArray[np.float32], np.int64]):
    """One vehicle, in a new world each episode."""

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own convention)

    def __init__(
        self,
        config: RunConfig | str = "paper",
        reward: Reward | None = None,
        manoeuvres: bool = False,
        **changes: Any,
    ) -> None:
        """Makes the simulator.

        Args:
            config: A run's configuration, a preset's name or a TOML file.
            reward: A reward in place of the paper's.
            manoeuvres: Whether an action may also stop or reverse.
            **changes: Top-level keys to replace in it: world, robot, physics, simulator, conditions.

        Raises:
            UserError: If a key or value is wrong.
        """
        self._experiment = _experiment(config, changes)
        self._navigation = self._experiment.new_navigation(self._experiment.simulator, reward)
        self.observation_space = _observation_space(self._experiment)
        self._count = MANOEUVRES if manoeuvres else ACTIONS
        self.action_space = gymnasium.spaces.Discrete(self._count)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Starts an episode in the world `options["world_seed"]`, or in one drawn from the environment's generator."""
        super().reset(seed=seed)
        given = (options or {}).get("world_seed")
        world = self.world(_draw_seed(self.np_random) if given is None else int(given))
        self._navigation.reset({0: world})
        return self._vector(), {"world_seed": world.seed}

    def step(self, action: np.int64) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Carries out one decision.

        Raises:
            UserError: If there is no such action.
        """
        t = self._navigation.step(as_actions([action], 1, self._count))
        terminated, truncated = _over(t)
        info = {name: values.item() for name, values in _infos(t).items()}
        return self._vector(), t.r_t.item(), terminated.item(), truncated.item(), info

    def set_target(self, *targets: Sequence[float]) -> NDArray[np.float32]:
        """Gives the vehicle, in the middle of its episode, another target, or several to reach in turn.

        Args:
            *targets: x, y [m] in the frame of the world's map; the last is the target.

        Returns:
            The observation, which tells of the first of them.

        Raises:
            UserError: If one is outside the arena, or there is a plan and no way.
        """
        self._navigation.set_targets({0: _in_arena(self._experiment, targets)})
        return self._vector()

    @property
    def simulator(self) -> Simulator:
        """The simulator of the vehicle."""
        return self._navigation.simulator

    def world(self, seed: int) -> WorldSpec:
        """The world of a seed."""
        return self._experiment.world(seed)

    def close(self) -> None:
        """Frees the simulator."""
        self.simulator.close()

    def _vector(self) -> NDArray[np.float32]:
        (vector,) = _vectors(self._navigation.observation, self.observation_space)
        return np.asarray(vector)


class TricycleVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.int64], NDArray[Any]]):
    """n vehicles, each in a world of its own, in lockstep.

    Row i does what a `TricycleEnv` that is reset with seed + i does. A vehicle whose episode is over is put into its
    next world by the step after that, whatever its action.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int,
        config: RunConfig | str = "paper",
        workers: int | None = None,
        reward: Reward | None = None,
        manoeuvres: bool = False,
        **changes: Any,
    ) -> None:
        """Makes the vehicles.

        Args:
            num_envs: Number of vehicles.
            config: A run's configuration, a preset's name or a TOML file.
            workers: Number of processes (contact physics) or threads (kinematic model), one a core by default.
            reward: A reward in place of the paper's.
            manoeuvres: Whether an action may also stop or reverse.
            **changes: Top-level keys to replace in the configuration: world, robot, physics, simulator, conditions.

        Raises:
            UserError: If a key or value is wrong.
        """
        self._experiment = _experiment(config, {**changes, "vehicles": num_envs})
        self.num_envs = num_envs
        self.single_observation_space = _observation_space(self._experiment)
        self._count = MANOEUVRES if manoeuvres else ACTIONS
        self.single_action_space = gymnasium.spaces.Discrete(self._count)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        simulator = self._experiment.new_simulator(workers)
        self._navigation = self._experiment.new_navigation(simulator, reward)
        self._generators = [np_random()[0] for _ in range(num_envs)]
        self._over = np.zeros(num_envs, np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Starts an episode for every vehicle, or for those in `options["reset_mask"]` (n,).

        Args:
            seed: Seed of vehicle 0, from which the others count on; or one for each; None keeps the generators.
            options: `world_seed` names the worlds, as one number or as one for each vehicle.
        """
        options = options or {}
        mask = np.array(options.get("reset_mask", np.ones(self.num_envs, np.bool_)), np.bool_)
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed or [None] * self.num_envs
        if len(seeds) != self.num_envs or mask.shape != (self.num_envs,):
            raise UserError(f"give seeds and a reset_mask for {self.num_envs} vehicles")
        for i in np.flatnonzero(mask).tolist():
            if seeds[i] is not None:
                self._generators[i] = np_random(seeds[i])[0]
        given = options.get("world_seed")
        if given is not None and np.shape(given) not in ((), (self.num_envs,)):
            raise UserError(f"give one world_seed, or one for each of {self.num_envs} vehicles")
        worlds = None if given is None else np.broadcast_to(given, self.num_envs).tolist()
        return self._begin(mask, worlds)

    def step(
        self, actions: NDArray[np.int64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Carries out one decision of each vehicle.

        Raises:
            UserError: If these are not an action for each vehicle.
        """
        begun, active = self._over.copy(), ~self._over
        actions = as_actions(actions, self.num_envs, self._count)
        t = self._navigation.step(actions, None if active.all() else active)
        terminated, truncated = _over(t)
        named = _infos(t)
        if not active.all():
            named = {name: np.where(active, values, _BLANK[values.dtype.kind]) for name, values in named.items()}
        infos = named | {f"_{name}": active for name in named} if active.any() else {}
        if begun.any():
            infos |= self._begin(begun, None)[1]
        self._over = terminated | truncated
        vectors = _vectors(self._navigation.observation, self.single_observation_space)
        return vectors, np.where(active, t.r_t, 0.0), terminated, truncated, infos

    def set_target(self, targets: Mapping[int, Sequence[Sequence[float]]]) -> NDArray[np.float32]:
        """Gives some vehicles, in the middle of their episodes, other targets to reach in turn.

        Args:
            targets: x, y [m] of each in the frame of the world's map, by vehicle; the last is the target.

        Returns:
            The observations of all vehicles.

        Raises:
            UserError: See `TricycleEnv.set_target`; then nothing has changed.
        """
        self._navigation.set_targets({i: _in_arena(self._experiment, its) for i, its in targets.items()})
        return _vectors(self._navigation.observation, self.single_observation_space)

    def close_extras(self, **kwargs: Any) -> None:
        """Frees the vehicles."""
        self._navigation.simulator.close()

    def _begin(self, mask: NDArray[np.bool_], worlds: list[int] | None) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Puts the vehicles of `mask` (n,) into the worlds of the seeds (n,), or into worlds that they draw."""
        seeds = np.zeros(self.num_envs, np.int64)
        for i in np.flatnonzero(mask).tolist():
            seeds[i] = _draw_seed(self._generators[i]) if worlds is None else worlds[i]
        self._navigation.reset({i: self._experiment.world(int(seeds[i])) for i in np.flatnonzero(mask).tolist()})
        self._over &= ~mask
        vectors = _vectors(self._navigation.observation, self.single_observation_space)
        return vectors, {"world_seed": seeds, "_world_seed": mask}
