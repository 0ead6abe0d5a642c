"""The environment of many vehicles."""

from collections.abc import Mapping, Sequence
from typing import Any, get_args

import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from nnql_bullet.errors import UserError
from nnql_bullet.gym_env.fleet import Fleet
from nnql_bullet.gym_env.observations import Told, rows_of
from nnql_bullet.gym_env.single import rendering
from nnql_bullet.gym_env.starts import checked_options, options_of_each, starting_world
from nnql_bullet.render.live import RenderMode
from nnql_bullet.seeding import as_seed

Infos = dict[str, Any]


class TricycleVectorEnv(VectorEnv[Told, Any, NDArray[Any]]):
    """n vehicles, each in a world of its own, in lockstep; `api.environment.make_env` makes it.

    Row i does what a `TricycleEnv` that is reset with seed + i does. What becomes of a vehicle whose episode is over,
    the autoreset mode says: the next step puts it into its next world, whatever its action (NEXT_STEP); the same step
    does (SAME_STEP), and tells of the last state in `final_obs` and `final_info`; or the caller does, by `reset` with a
    `reset_mask` (DISABLED).
    """

    metadata = {  # noqa: RUF012 (Gymnasium's own convention)
        "render_modes": list(get_args(RenderMode)),
        "render_fps": 2.0,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        fleet: Fleet,
        render_mode: RenderMode | None = None,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    ) -> None:
        """Takes a fleet.

        Args:
            fleet: The vehicles with their observation, actions and reward.
            render_mode: How they are shown.
            autoreset_mode: What becomes of a vehicle whose episode is over.
        """
        self._fleet, self.num_envs, self.render_mode, self._mode = fleet, fleet.size, render_mode, autoreset_mode
        self.single_observation_space, self.single_action_space = fleet.observation_space, fleet.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        shown = rendering(fleet.navigation.simulator.drive.decision_period)
        self.metadata = {**self.metadata, **shown, "autoreset_mode": autoreset_mode}
        self._generators = [np_random()[0] for _ in range(self.num_envs)]
        self._over = np.zeros(self.num_envs, np.bool_)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Told, Infos]:
        """Starts an episode for every vehicle, or for those in `options["reset_mask"]` (n,).

        Args:
            seed: Seed of vehicle 0, from which the others count on: a whole number or a `SeedSequence`; or one for
                each; None keeps the generators.
            options: Those of `TricycleEnv.reset`, each one for all or one for each vehicle, and `reset_mask`.

        Raises:
            UserError: If an option or a seed is wrong, or the environment is closed.
        """
        given = checked_options(options, ("reset_mask",))
        mask = np.asarray(given.pop("reset_mask", np.ones(self.num_envs, np.bool_)))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            raise UserError(f"give a reset_mask of True or False for each of {self.num_envs} vehicles")
        for i, one in enumerate(self._seeds(seed)):
            if mask[i] and one is not None:
                self._generators[i] = np_random(one)[0]
        return self._begin(mask, options_of_each(given, self.num_envs))

    def step(self, actions: Any) -> tuple[Told, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Carries out one decision of each vehicle.

        Raises:
            UserError: If these are not an action for each vehicle, or one is in no episode.
        """
        begun = self._over if self._mode == AutoresetMode.NEXT_STEP else np.zeros(self.num_envs, np.bool_)
        active = ~begun
        rewards, terminated, truncated, values = self._fleet.step(actions, active)
        infos = _masked(values, active)
        self._over = over = terminated | truncated
        told = self._fleet.told()
        if begun.any():
            told, begin = self._begin(begun)
            infos, self._over = _merged(infos, begin), over
        elif self._mode == AutoresetMode.SAME_STEP and over.any():
            rows = rows_of(told, self.num_envs)
            last = np.full(self.num_envs, None, object)
            for i in np.flatnonzero(over).tolist():
                last[i] = rows[i]
            final = {"final_obs": last, "_final_obs": over, "final_info": _masked(values, over), "_final_info": over}
            told, begin = self._begin(over)
            infos = _merged(_masked(values, ~over), begin) | final
        return told, np.where(active, rewards, 0.0), terminated, truncated, infos

    def render(self) -> tuple[Any, ...] | None:
        """A picture of each vehicle, or a list of them, as the `render_mode` says; a window shows vehicle 0 by itself.

        Raises:
            UserError: If no episode has begun.
        """
        if self.render_mode is None or self.render_mode == "human":
            return None
        return tuple(self._fleet.render())

    def set_target(self, targets: Mapping[int, Sequence[Sequence[float]]]) -> Told:
        """Gives some vehicles, in the middle of their episodes, other targets to reach in turn.

        Args:
            targets: x, y [m] of each in the frame of the world's map, by vehicle; the last is the target.

        Returns:
            The observations of all vehicles.

        Raises:
            UserError: See `TricycleEnv.set_target`.
        """
        self._fleet.set_targets(targets)
        return self._fleet.told()

    def close_extras(self, **kwargs: Any) -> None:
        """Frees the vehicles."""
        self._fleet.close()

    def _seeds(self, seed: Any) -> list[int | None]:
        """The seed of each vehicle.

        Raises:
            UserError: If they are wrong.
        """
        if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str):
            if len(seed) != self.num_envs:
                raise UserError(f"give one seed, or one for each of {self.num_envs} vehicles")
            return [as_seed(one) for one in seed]
        first = as_seed(seed)
        return [None if first is None else first + i for i in range(self.num_envs)]

    def _begin(self, mask: NDArray[np.bool_], options: list[dict[str, Any]] | None = None) -> tuple[Told, Infos]:
        """Puts the vehicles of `mask` (n,) into the worlds that the options name, or into worlds that they draw."""
        experiment, given = self._fleet.experiment, options or [{} for _ in range(self.num_envs)]
        worlds = {i: starting_world(experiment, given[i], self._generators[i]) for i in np.flatnonzero(mask).tolist()}
        infos = self._fleet.begin(worlds)
        self._over = self._over & ~mask
        return self._fleet.told(), _masked(infos, mask)


def _masked(values: dict[str, NDArray[Any]], mask: NDArray[np.bool_]) -> Infos:
    """Values of `info` (n, ...) with blanks for the vehicles outside the mask (n,), and the mask; of none, nothing."""
    infos: Infos = {}
    for name, its in values.items() if mask.any() else ():
        blank: Any = None if its.dtype == object else its.dtype.type(0)
        infos[name] = its if mask.all() else np.where(mask.reshape(-1, *[1] * (its.ndim - 1)), its, blank)
        infos[f"_{name}"] = mask
    return infos


def _merged(infos: Infos, others: Infos) -> Infos:
    """The `info` of some vehicles and of others."""
    merged = infos | others
    for name in infos.keys() & others.keys():
        if not name.startswith("_"):
            there = others[f"_{name}"]
            merged[name] = np.where(there.reshape(-1, *[1] * (infos[name].ndim - 1)), others[name], infos[name])
            merged[f"_{name}"] = infos[f"_{name}"] | there
    return merged
