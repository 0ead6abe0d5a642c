"""Neural-network Q-learning for an industrial three-wheeled vehicle, validated in contact physics.

Importing it makes `nnql_bullet/Tricycle-v0` known to `gymnasium.make` and `gymnasium.make_vec`.
"""

from gymnasium.envs.registration import register

__version__ = "0.2.0"

register(
    id="nnql_bullet/Tricycle-v0",
    entry_point="nnql_bullet.gym_env:TricycleEnv",
    vector_entry_point="nnql_bullet.gym_env:TricycleVectorEnv",
)
