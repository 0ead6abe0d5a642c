"""Options of the agents whose networks need torch. Torch is loaded when such an agent is built, not before.

The other agents' options stand in the agents' own modules.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents import foresight
from nnql_bullet.agents.learning.frames import frame_width
from nnql_bullet.agents.learning.q_learning import QLearningOptions
from nnql_bullet.config import options
from nnql_bullet.env import ACTIONS
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.mapping import grid_map
from nnql_bullet.mapping.body_map import SIDE
from nnql_bullet.types import BatchSize, BufferSize, Count, Few, Frames, Layers, Number, Positive, UnitInterval, Units
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec

if TYPE_CHECKING:
    from nnql_bullet.agents.learning.distilled import Distilled
    from nnql_bullet.agents.learning.double_dqn import DoubleDqn
    from nnql_bullet.agents.learning.nnql import Nnql
    from nnql_bullet.agents.learning.sb3_dqn import Sb3Dqn

SB3_INPUTS = paper.SECTORS + 3
"""Inputs of `sb3_dqn`'s network: the numbers of `env.as_numbers`."""


@contextmanager
def _torch() -> Iterator[None]:
    """Raises a UserError in place of an ImportError of torch."""
    try:
        yield
    except ImportError as error:
        raise UserError(f"PyTorch is not installed, or does not load ({error}): pip install torch") from None


@options
class NnqlOptions(QLearningOptions):
    """Options of NNQL: the paper's numbers, and the choices that it leaves open.

    results/ablation compares the values of each open choice.
    """

    network: ClassVar[tuple[str, ...]] = ("hidden_units", "encoding")
    """Keys that two agents have to share for the weights of one to be those of the other."""
    kind: Literal["nnql"] = "nnql"
    hidden_units: Units = paper.HIDDEN_UNITS
    """Units of the hidden layer."""
    encoding: Literal["proximity", "distance"] = "proximity"
    """How a reading d becomes a network input: "proximity" is 1 - d/10, 0 when nothing is seen; "distance" is d/10 and,
    after the letter of II.B, 0 when nothing is seen, which makes "free" and "touching" neighbours."""
    gradient_step: Positive = 0.4
    """Step size of gradient descent, which the paper does not give."""
    learn_in_safe_states: bool = False
    """Whether steps from safe states train the network too. The text asks it only in non-safe states, so its reward for
    safe to non-safe teaches nothing; with this on, the turn toward the target counts as the nearest of the five."""
    mirrored: bool = False
    """Whether every step also trains the network as its mirror image, with left and right exchanged. The text does not
    do so."""
    hidden_weights: Positive = 1.0
    """Initial weights into the hidden layer are uniform within +- this; all zero could not break the symmetry."""
    output_weights: Positive = 0.1
    """Initial weights into the output layer are uniform within +- this: Q-values start near zero (II.D)."""

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "Nnql":
        """Builds the untrained agent."""
        with _torch():
            from nnql_bullet.agents.learning.nnql import Nnql

        return Nnql(self, seed, length_scale(vehicle.footprint))


@options
class DoubleDqnOptions:
    """Options of double DQN: its inputs, its learning and its reward.

    results/ablation-double_dqn compares some of them.
    """

    network: ClassVar[tuple[str, ...]] = ("rays", "frames", "grid_map", "hidden")
    """Keys that two agents have to share for the weights of one to be those of the other."""
    kind: Literal["double_dqn"] = "double_dqn"
    rays: Literal[8, 24, 72] = 24
    """Readings of the network: each is the nearest of its share of the 72 rays."""
    frames: Frames = 3
    """Last moments that the network sees at once."""
    grid_map: bool = True
    """Whether the vehicle keeps a map of what it has seen, and the network is given path lengths through it."""
    hidden: Layers = (128, 128)
    """Units of the hidden layers."""
    learning_rate: Positive = 5e-4
    """Learning rate of Adam in the first half of the scheduled episodes."""
    learning_rate_final: Positive = 5e-5
    """Learning rate from `schedule_episodes` on; it falls over the second half of them."""
    schedule_episodes: Count = 12_000
    """Episodes that schedules are made for. They do not follow the number of training episodes, so that a run can be
    stopped and resumed."""
    discount: UnitInterval = 0.9
    """gamma."""
    n_step: Few = 3
    """Steps of a return before it is bootstrapped."""
    batch_size: BatchSize = 256
    """Steps that one gradient step learns from."""
    gradient_steps: Few = 2
    """Gradient steps after each step of all vehicles."""
    tau: Annotated[float, Field(gt=0, le=1)] = 0.005
    """Fraction by which the target network moves toward the online network in a gradient step."""
    buffer_size: BufferSize = 300_000
    """Steps in the replay buffer, of all vehicles together."""
    learning_starts: Annotated[int, Field(ge=0, le=1_000_000_000)] = 10_000
    """Steps of all vehicles together before the first gradient step."""
    exploration_final: Annotated[tuple[UnitInterval, ...], Field(min_length=1, max_length=100)] = (0.01, 0.05, 0.1, 0.2)
    """Probabilities of a random action, which episodes take by turns: some get far, and some see much."""
    exploration_episodes: Count = 1_000
    """Episodes over which the probability of a random action falls from 1 to those, linearly."""
    mirrored: bool = True
    """Whether half of the steps are learned from as their mirror images, with left and right exchanged."""
    reward_progress: Number = 0.03
    """Reward for each metre that the path to the target gets shorter."""
    reward_step: Number = -0.005
    """Reward for each decision."""
    reward_turn: Number = -0.003
    """Reward for each radian of heading change that is asked for."""
    reward_near: Number = -0.06
    """Reward for an obstacle that touches the front sensor; it shrinks to nothing at 5 m."""
    reward_winning: Number = 0.5
    """Reward for reaching the target."""
    reward_failure: Number = -2.0
    """Reward for touching something."""

    def training_memory(self, vehicles: int) -> int:
        """Memory that a training with so many vehicles needs at least: buffer, maps, batch, weights [bytes]."""
        width = frame_width(self.rays, self.grid_map)
        seen, steps = self.frames * width, max(self.buffer_size, (self.n_step + self.frames) * vehicles)
        weights = sum(one * other for one, other in pairwise((seen, *self.hidden, ACTIONS)))
        maps = vehicles * (seen + (grid_map.SIZE**2 if self.grid_map else 0))
        return steps * (width + 8) + maps + 2 * self.gradient_steps * self.batch_size * seen + 16 * weights

    def exploration(self, episodes: NDArray[np.int64]) -> Array:
        """Probability of a random action in training episodes (n,), counted from 0."""
        final = np.array(self.exploration_final)[episodes % len(self.exploration_final)]
        progress = np.minimum(episodes / self.exploration_episodes, 1.0)
        return np.asarray(1.0 + (final - 1.0) * progress)

    def learning_rate_at(self, episode: int) -> float:
        """Learning rate in a training episode, counted from 0."""
        progress = min(max(2 * episode / self.schedule_episodes - 1, 0.0), 1.0)
        return self.learning_rate + (self.learning_rate_final - self.learning_rate) * progress

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "DoubleDqn":
        """Builds the untrained agent."""
        with _torch():
            from nnql_bullet.agents.learning.double_dqn import DoubleDqn

        return DoubleDqn(self, seed, vehicle, drive)


@options
class DistilledOptions:
    """Options of a search distilled into a network."""

    network: ClassVar[tuple[str, ...]] = ("hidden", "per_action")
    """Keys that two agents have to share for the weights of one to be those of the other."""
    kind: Literal["distilled"] = "distilled"
    hidden: Layers = (128, 64)
    """Units of the hidden layers for the surroundings; the last are added to what is foreseen of each manoeuvre."""
    per_action: Units = 32
    """Units of the layer that then values each manoeuvre, the same for all."""
    search: foresight.SearchOptions = foresight.SearchOptions()
    """The search that is learned from."""
    learning_rate: Positive = 2e-3
    """Learning rate of Adam in the first half of the scheduled episodes."""
    learning_rate_final: Positive = 1e-4
    """Learning rate from `schedule_episodes` on; it falls over the second half of them."""
    schedule_episodes: Count = 1_500
    """Episodes that schedules are made for. They do not follow the number of training episodes, so that a run can be
    stopped and resumed."""
    led_episodes: Count = 200
    """Episodes over which the share of decisions that the search itself takes falls from all to none, linearly."""
    random_share: UnitInterval = 0.05
    """Probability of a random manoeuvre, after which the search is asked what to do about it."""
    softness: Positive = 0.1
    """Difference of values that matters little [m]."""
    batch_size: BatchSize = 256
    """Decisions that one gradient step learns from."""
    gradient_steps: Few = 8
    """Gradient steps after each step of all vehicles."""
    buffer_size: BufferSize = 200_000
    """Decisions that are learned from, the last ones."""
    learning_starts: Annotated[int, Field(ge=0, le=1_000_000_000)] = 1_000
    """Decisions before the first gradient step."""

    def training_memory(self, vehicles: int) -> int:
        """Memory that a training with so many vehicles needs at least: buffer and maps [bytes]."""
        return (foresight.WIDTH + 100) * self.buffer_size + 3 * SIDE**2 * vehicles

    def led(self, episodes: NDArray[np.int64]) -> Array:
        """Share of decisions by the search in training episodes (n,), counted from 0."""
        return np.asarray(np.maximum(1.0 - episodes / self.led_episodes, 0.0))

    def learning_rate_at(self, episode: int) -> float:
        """Learning rate in a training episode, counted from 0."""
        progress = min(max(2 * episode / self.schedule_episodes - 1, 0.0), 1.0)
        return self.learning_rate + (self.learning_rate_final - self.learning_rate) * progress

    def in_shield(self) -> "DistilledOptions":
        """Returns the options for drives in a shield."""
        return replace(self, search=self.search.in_shield())

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "Distilled":
        """Builds the untrained agent."""
        with _torch():
            from nnql_bullet.agents.learning.distilled import Distilled

        return Distilled(self, seed, vehicle, drive)


@options
class Sb3DqnOptions:
    """The hyper-parameters that differ from the library's defaults, or matter most; they were hardly tuned."""

    network: ClassVar[tuple[str, ...]] = ("hidden",)
    """Keys that two agents have to share for the weights of one to be those of the other."""
    kind: Literal["sb3_dqn"] = "sb3_dqn"
    hidden: Layers = (64, 64)
    """Units of the hidden layers."""
    learning_rate: Positive = 5e-4
    """Learning rate of Adam; the library's default is 1e-4."""
    discount: UnitInterval = 0.9
    """gamma; the library's default is 0.99."""
    buffer_size: BufferSize = 1_000_000
    """Steps in the replay buffer."""
    learning_starts: Annotated[int, Field(ge=0, le=1_000_000_000)] = 100
    """Steps before the first update."""
    batch_size: BatchSize = 32
    """Steps that an update learns from."""
    steps_per_update: Count = 4
    """Steps, of all vehicles together, from one update to the next."""
    target_update_steps: Count = 500
    """Steps after which the target network is renewed; the library's default is 10 000."""
    exploration_steps: Count = 12_000
    """Steps over which the probability of a random action falls from 1, linearly. They do not follow the number of
    training episodes, so that a run can be resumed."""
    exploration_final: UnitInterval = 0.05
    """Probability of a random action after that."""

    def training_memory(self, vehicles: int) -> int:
        """Memory that a training needs at least: its buffer, which keeps what is seen twice, and weights [bytes]."""
        del vehicles
        weights = sum(one * other for one, other in pairwise((SB3_INPUTS, *self.hidden, ACTIONS)))
        return self.buffer_size * (2 * 4 * SB3_INPUTS + 16) + 16 * weights

    def exploration(self, steps: int) -> float:
        """Probability of a random action after so many steps."""
        progress = min(steps / self.exploration_steps, 1.0)
        return 1.0 + (self.exploration_final - 1.0) * progress

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "Sb3Dqn":
        """Builds the agent."""
        with _torch():
            from nnql_bullet.agents.learning.sb3_dqn import Sb3Dqn

        return Sb3Dqn(self, seed, length_scale(vehicle.footprint))
