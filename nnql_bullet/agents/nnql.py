"""Neural-network Q-learning (NNQL), the paper's method (II.D, II.E, III)."""

from typing import Annotated, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents.base import Memoryless
from nnql_bullet.agents.turns import nearest_turns
from nnql_bullet.config import options
from nnql_bullet.env import TOWARD_TARGET, Observations, Transitions, heading_change
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


class Nnql(Memoryless):
    """The 8-6-5 network: sigmoid hidden units, linear outputs (targets reach -0.6), one Q-value a turn."""

    def __init__(self, options: NnqlOptions, seed: int) -> None:
        self.options = options
        with torch.random.fork_rng(devices=[]):  # torch draws weights of its own, from the global generator
            self.network = torch.nn.Sequential(
                torch.nn.Linear(paper.SECTORS, paper.HIDDEN_UNITS, dtype=torch.float64),
                torch.nn.Sigmoid(),
                torch.nn.Linear(paper.HIDDEN_UNITS, len(paper.TURNS), dtype=torch.float64),
            )
        generator = rng(seed, Stream.WEIGHTS)
        ranges = {"0.weight": options.hidden_weights, "2.weight": options.output_weights}
        weights = {name: np.zeros(value.shape) for name, value in self.arrays().items()}
        for name, limit in ranges.items():
            weights[name] = generator.uniform(-limit, limit, weights[name].shape)
        self.load(weights)

    def temperature(self, episodes: NDArray[np.int64]) -> Array:
        """T of eq. (3) in training episodes (n,), counted from 0."""
        o = self.options
        progress = np.minimum(episodes / (o.schedule_episodes - 1), 1.0)
        return np.asarray(o.temperature_max + (o.temperature_min - o.temperature_max) * progress)

    def explore(self, observations: Observations, episodes: NDArray[np.int64], uniforms: Array) -> NDArray[np.int64]:
        """Toward the target in a safe state (III.C), else by the Boltzmann distribution."""
        actions = np.full(len(uniforms), TOWARD_TARGET)
        asked = observations.property != Property.SAFE
        if asked.any():
            probabilities = boltzmann(self._values(observations.readings[asked]), self.temperature(episodes[asked]))
            cumulated = probabilities.cumsum(axis=-1)
            actions[asked] = (cumulated / cumulated[:, -1:] <= uniforms[asked, None]).sum(axis=-1)
        return actions

    def exploit(self, observations: Observations) -> NDArray[np.int64]:
        """Toward the target in a safe state, else the turn with the largest Q-value: eq. (4)."""
        actions = np.full(len(observations.property), TOWARD_TARGET)
        asked = observations.property != Property.SAFE
        if asked.any():
            actions[asked] = self._values(observations.readings[asked]).argmax(axis=-1)
        return actions

    def action_values(self, observations: Observations) -> Array:
        """Q(s, a) of the five turns (n, 5); NaN in safe states, where the network is not asked."""
        values = np.full((len(observations.property), len(paper.TURNS)), np.nan)
        asked = observations.property != Property.SAFE
        values[asked] = self._values(observations.readings[asked])
        return values

    def learn(self, transitions: Transitions) -> Array:
        """One update of eq. (2): its right-hand side is the target of the selected output (III.B).

        The steps of several vehicles are learned from at once: the gradients of their squared errors add up, as those
        of steps one after another would if the network stood still meanwhile.
        """
        t, o = transitions, self.options
        td_errors = np.full(len(t.r_t), np.nan)
        taught = np.flatnonzero(t.active & (o.learn_in_safe_states | (t.s_tm1.property != Property.SAFE)))
        if len(taught) == 0:
            return td_errors
        turns = nearest_turns(heading_change(t.a_tm1[taught], t.s_tm1.target_bearing[taught]))
        inputs = np.concatenate([t.s_tm1.readings[taught], t.s_t.readings[taught]])
        q_before, q_t = self.network(self._encoded(inputs)).split(len(taught))
        q_tm1 = q_before.gather(1, torch.from_numpy(turns)[:, None])[:, 0]
        r_t, discount_t = torch.from_numpy(t.r_t[taught]), torch.from_numpy(t.discount_t[taught])
        td_error = r_t + discount_t * o.discount * q_t.detach().amax(dim=-1) - q_tm1.detach()
        # d/dq of 1/2 (target - q)^2, where the target of eq. (2) is q + learning_rate * td_error.
        parameters = list(self.network.parameters())
        gradients = torch.autograd.grad(q_tm1, parameters, -o.learning_rate * td_error)
        with torch.no_grad():
            for parameter, gradient in zip(parameters, gradients, strict=True):
                parameter.sub_(gradient, alpha=o.gradient_step)
        td_errors[taught] = td_error.numpy()
        return td_errors

    def diagnostics(self, episode: int) -> dict[str, float]:
        """The temperature."""
        return {"temperature": float(self.temperature(np.array(episode)))}

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

    def _values(self, readings: Array) -> Array:
        """Q(s, a) (n, 5) of readings (n, 8) [m]."""
        with torch.no_grad():
            values: Array = self.network(self._encoded(readings)).numpy()
        return values

    def _encoded(self, readings: Array) -> torch.Tensor:
        return torch.from_numpy(encode(readings, self.options.encoding))


def encode(readings: Array, encoding: str) -> Array:
    """Network inputs (..., 8) of readings (..., 8) [m]: see `NnqlOptions.encoding`."""
    nearness = 1.0 - readings / paper.SENSOR_RANGE
    if encoding == "proximity":
        return nearness
    return np.where(readings < paper.SENSOR_RANGE, 1.0 - nearness, 0.0)


def boltzmann(values: Array, temperature: Array) -> Array:
    """Probabilities (n, 5) of eq. (3) for values (n, 5) and temperatures (n,)."""
    weights = np.exp((values - values.max(axis=-1, keepdims=True)) / temperature[:, None])
    return np.asarray(weights / weights.sum(axis=-1, keepdims=True))
