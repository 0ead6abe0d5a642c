"""The task as a Gymnasium environment, `nnql_bullet/Tricycle-v0`.

Observation, `Box` of 11 float32:

| index | what | unit | range |
|---|---|---|---|
| 0-7 | smallest distance in each 45-degree sector, from straight ahead counter-clockwise | m | 0 to 10 (nothing seen) |
| 8 | distance to the target | m | 0 to the arena's diagonal |
| 9 | bearing of the target, positive to the left | rad | -pi to pi |
| 10 | yaw rate, positive to the left | rad/s | -10 to 10, clipped |

Action, `Discrete(6)`: 0 straight on, 1 left 30 degrees, 2 left 60, 3 right 30, 4 right 60, 5 toward the target.

Reward: the paper's (II.C), the sum of six named terms of which at most one is not zero. An episode terminates at the
target or at a collision and is truncated after 500 steps. `info` holds `world_seed`, and after a step also `ending`,
`property`, `heading_error` and a `reward/NAME` for each term.
"""

from math import hypot, pi
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.env import ACTIONS, Observation
from nnql_bullet.experiment import Experiment, RunConfig, changed, load_config
from nnql_bullet.seeding import TRAINING_WORLDS
from nnql_bullet.sim.base import Simulator
from nnql_bullet.worlds.spec import WorldSpec

MOST_YAW_RATE = 10.0


class TricycleEnv(gymnasium.Env[NDArray[np.float32], np.int64]):
    """One vehicle in a new world each episode."""

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own convention)

    def __init__(self, config: RunConfig | str = "paper", **changes: Any) -> None:
        """Sets up the simulator.

        Args:
            config: A run's configuration, a preset's name or a TOML file.
            **changes: Top-level keys to replace in it: world, robot, physics, simulator.

        Raises:
            UserError: If a key or value is wrong.
        """
        resolved = config if isinstance(config, RunConfig) else load_config(config, {})
        self._experiment = Experiment(changed(resolved, **changes))
        file = self._experiment.worlds.file
        low = [0.0] * paper.SECTORS + [0.0, -pi, -MOST_YAW_RATE]
        high = [paper.SENSOR_RANGE] * paper.SECTORS + [hypot(file.width, file.depth), pi, MOST_YAW_RATE]
        bounds = np.array([low, high], dtype=np.float32)
        self.observation_space = gymnasium.spaces.Box(bounds[0], bounds[1], dtype=np.float32)
        self.action_space = gymnasium.spaces.Discrete(ACTIONS)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Starts an episode in the world `options["world_seed"]`, or in one drawn from the environment's generator."""
        super().reset(seed=seed)
        given = (options or {}).get("world_seed")
        drawn = self.np_random.integers(TRAINING_WORLDS.start, TRAINING_WORLDS.stop) if given is None else given
        observation, _ = self._experiment.navigation.reset(self.world(int(drawn)))
        return self._vector(observation), {"world_seed": int(drawn)}

    def step(self, action: np.int64) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Carries out one decision."""
        t = self._experiment.navigation.step(int(action))
        info = {
            "ending": t.ending,
            "property": t.s_t.property.value,
            "heading_error": t.motion.heading_error,
            **{f"reward/{name}": value for name, value in t.terms.items()},
        }
        over = t.ending in ("goal", "collision")
        return self._vector(t.s_t), t.r_t, over, t.ending == "timeout", info

    @property
    def simulator(self) -> Simulator:
        """What moves the vehicle."""
        return self._experiment.simulator

    def world(self, seed: int) -> WorldSpec:
        """The world of a seed."""
        return self._experiment.world(seed)

    def close(self) -> None:
        """Frees the simulator."""
        self.simulator.close()

    def _vector(self, observation: Observation) -> NDArray[np.float32]:
        o = observation
        numbers = np.array([*o.readings, o.target_distance, o.target_bearing, o.yaw_rate], dtype=np.float32)
        space = self.observation_space
        return np.asarray(np.clip(numbers, space.low, space.high))  # type: ignore[attr-defined]
