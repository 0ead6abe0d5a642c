"""Neural-network Q-learning (NNQL), the paper's method (II.D, II.E, III)."""

from typing import Annotated, Literal

import numpy as np
import torch
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.config import options
from nnql_bullet.env import TOWARD_TARGET, Observation, Transition, heading_change
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.task import Property

Positive = Annotated[float, Field(gt=0)]
UnitInterval = Annotated[float, Field(ge=0, le=1)]


@options
class NnqlOptions:
    """The paper's numbers and, with their reasons, the choices it leaves open.

    Percentages are successes at 10 % cover in a kinematic study that came before this program, one factor at a time.
    """

    kind: Literal["nnql"] = "nnql"
    learning_rate: UnitInterval = paper.LEARNING_RATE
    """alpha of eq. (2)."""
    discount: UnitInterval = paper.DISCOUNT
    """gamma of eq. (2)."""
    temperature_max: Positive = paper.TEMPERATURE_MAX
    """T of eq. (3) in the first episode."""
    temperature_min: Positive = paper.TEMPERATURE_MIN
    """T of eq. (3) from the last scheduled episode on."""
    schedule_episodes: Annotated[int, Field(ge=2)] = paper.EPISODES
    """Episodes over which the temperature falls, linearly: only its ends are given. It does not follow the number of
    episodes asked for, so that a run can be stopped and gone on with."""
    encoding: Literal["proximity", "distance"] = "proximity"
    """What the network sees of a reading d. "proximity" is 1 - d/10, 0 when nothing is seen; "distance" is d/10 and,
    after the letter of II.B, 0 when nothing is seen, which makes "free" and "touching" neighbours (41 against 97 %)."""
    gradient_step: Positive = 0.4
    """Step of gradient descent, which the paper does not give. alpha times step 0.01 / 0.04 / 0.15 / 0.5 / 1.5 gave
    90 / 97 / 97 / 94 / 42 %."""
    learn_in_safe_states: bool = False
    """Whether steps from safe states train the network too. The text asks it only in non-safe states, so its reward for
    safe to non-safe teaches nothing; with this on, the turn toward the target counts as the nearest of the five."""
    hidden_weights: Positive = 1.0
    """Initial weights into the hidden layer are uniform within +- this; all zero could not break the symmetry."""
    output_weights: Positive = 0.1
    """Initial weights into the output layer are uniform within +- this: Q-values start near zero (II.D)."""

    def __post_init__(self) -> None:
        """Refuses temperatures in the wrong order."""
        if self.temperature_min > self.temperature_max:
            raise ValueError(
                f"temperature_min {self.temperature_min:g} is above temperature_max {self.temperature_max:g}"
            )


class Nnql:
    """The 8-6-5 network: sigmoid hidden units, linear outputs (targets reach -0.6), one Q-value a turn."""

    def __init__(self, options: NnqlOptions, seed: int) -> None:
        self.options = options
        with torch.device("meta"):  # without weights yet: torch would draw its own from the global generator
            self.network = torch.nn.Sequential(
                torch.nn.Linear(paper.SECTORS, paper.HIDDEN_UNITS, dtype=torch.float64),
                torch.nn.Sigmoid(),
                torch.nn.Linear(paper.HIDDEN_UNITS, len(paper.TURNS), dtype=torch.float64),
            )
        self.network.to_empty(device="cpu")
        self.temperature = options.temperature_max
        self._optimizer = torch.optim.SGD(self.network.parameters(), lr=options.gradient_step)
        self._errors: list[float] = []
        generator = rng(seed, Stream.WEIGHTS)
        ranges = {"0.weight": options.hidden_weights, "2.weight": options.output_weights}
        weights = {name: np.zeros(value.shape) for name, value in self.arrays().items()}
        for name, limit in ranges.items():
            weights[name] = generator.uniform(-limit, limit, weights[name].shape)
        self.load(weights)

    def begin_episode(self, episode: int) -> None:
        """Sets the episode's temperature."""
        o = self.options
        progress = min(episode / (o.schedule_episodes - 1), 1.0)
        self.temperature = o.temperature_max + (o.temperature_min - o.temperature_max) * progress
        self._errors = []

    def explore(self, observation: Observation, rng: np.random.Generator) -> int:
        """Toward the target in a safe state (III.C), else by the Boltzmann distribution."""
        if observation.property is Property.SAFE:
            return TOWARD_TARGET
        probabilities = boltzmann(self.action_values(observation), self.temperature)
        return int(rng.choice(len(probabilities), p=probabilities))

    def exploit(self, observation: Observation) -> int:
        """Toward the target in a safe state, else the turn with the largest Q-value: eq. (4)."""
        if observation.property is Property.SAFE:
            return TOWARD_TARGET
        return int(np.argmax(self.action_values(observation)))

    def action_values(self, observation: Observation) -> Array:
        """Q(s, a) of the five turns (5,); NaN in safe states, where the network is not asked."""
        if observation.property is Property.SAFE:
            return np.full(len(paper.TURNS), np.nan)
        with torch.no_grad():
            values: Array = self.network(self._encoded(observation)).numpy()
        return values

    def learn(self, transition: Transition) -> float | None:
        """One update of eq. (2): its right-hand side is the target of the selected output (III.B)."""
        t = transition
        action = t.a_tm1
        if t.s_tm1.property is Property.SAFE:
            if not self.options.learn_in_safe_states:
                return None
            action = nearest_turn(heading_change(action, t.s_tm1.target_bearing))
        with torch.no_grad():
            q_t = self.network(self._encoded(t.s_t))
        q_tm1 = self.network(self._encoded(t.s_tm1))[action]
        td_error = t.r_t + t.discount_t * self.options.discount * q_t.max() - q_tm1.detach()
        target = q_tm1.detach() + self.options.learning_rate * td_error
        self._optimizer.zero_grad()
        (0.5 * (target - q_tm1) ** 2).backward()
        self._optimizer.step()
        self._errors.append(float(td_error))
        return float(td_error)

    def diagnostics(self) -> dict[str, float]:
        """Temperature, and the root mean square of the episode's temporal-difference errors."""
        td_error = float(np.sqrt(np.mean(np.square(self._errors)))) if self._errors else 0.0
        return {"temperature": self.temperature, "td_error": td_error}

    def arrays(self) -> dict[str, Array]:
        """Weights W1 and W2 and their biases."""
        return {name: value.numpy().copy() for name, value in self.network.state_dict().items()}

    def load(self, arrays: dict[str, Array]) -> None:
        """Replaces weights and biases."""
        mine = {name: value.shape for name, value in self.arrays().items()}
        theirs = {name: value.shape for name, value in arrays.items()}
        if mine != theirs or not all(np.isfinite(value).all() for value in arrays.values()):
            raise UserError("these are not the weights of an NNQL network of 8-6-5 units")
        self.network.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})

    def _encoded(self, observation: Observation) -> torch.Tensor:
        return torch.from_numpy(encode(observation.readings, self.options.encoding))


def encode(readings: Array, encoding: str) -> Array:
    """Network inputs (8,) of the readings (8,) [m]: see `NnqlOptions.encoding`."""
    nearness = 1.0 - readings / paper.SENSOR_RANGE
    if encoding == "proximity":
        return nearness
    return np.where(readings < paper.SENSOR_RANGE, 1.0 - nearness, 0.0)


def boltzmann(values: Array, temperature: float) -> Array:
    """Probabilities of eq. (3)."""
    weights = np.exp((values - values.max()) / temperature)
    return np.asarray(weights / weights.sum())


def nearest_turn(heading_change: float) -> int:
    """The paper's turn closest to a heading change [rad]."""
    return int(np.argmin([abs(turn - heading_change) for turn in paper.TURNS]))
