"""Neural-network Q-learning (NNQL), the paper's method (II.D, II.E, III)."""

from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.learning.q_learning import QLearning, QLearningOptions
from nnql_bullet.agents.turns import nearest_turns
from nnql_bullet.config import options
from nnql_bullet.env import Observation, Transition, heading_change
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.types import Count, Positive


@options
class NnqlOptions(QLearningOptions):
    """The paper's numbers and, with their reasons, the choices it leaves open.

    Percentages are successes at 10 % cover in a kinematic study that came before this program, one factor at a time.
    """

    kind: Literal["nnql"] = "nnql"
    hidden_units: Count = paper.HIDDEN_UNITS
    """Of the network."""
    encoding: Literal["proximity", "distance"] = "proximity"
    """What the network sees of a reading d. "proximity" is 1 - d/10, 0 when nothing is seen; "distance" is d/10 and,
    after the letter of II.B, 0 when nothing is seen, which makes "free" and "touching" neighbours (41 against 97 %)."""
    gradient_step: Positive = 0.4
    """Step of gradient descent, which the paper does not give. alpha times step 0.01 / 0.04 / 0.15 / 0.5 / 1.5 gave
    90 / 97 / 97 / 94 / 42 %."""
    learn_in_safe_states: bool = False
    """Whether steps from safe states train the network too. The text asks it only in non-safe states, so its reward for
    safe to non-safe teaches nothing; with this on, the turn toward the target counts as the nearest of the five."""
    mirrored: bool = False
    """Whether every step teaches its mirror image too, as left and right are all the same to the vehicle. The text says
    nothing of it; what it is worth to the preset `tuned` says `nnql-bullet ablate tuned`."""
    hidden_weights: Positive = 1.0
    """Initial weights into the hidden layer are uniform within +- this; all zero could not break the symmetry."""
    output_weights: Positive = 0.1
    """Initial weights into the output layer are uniform within +- this: Q-values start near zero (II.D)."""


MIRRORED_SECTORS = -np.arange(paper.SECTORS) % paper.SECTORS
"""Of each of the eight sectors the one on the other side (8,)."""
MIRRORED_TURNS = nearest_turns(-np.array(paper.TURNS))
"""Of each of the five turns the one to the other side, by number (5,)."""


class Nnql(QLearning):
    """The 8-6-5 network: sigmoid hidden units, linear outputs (targets reach -0.6), one Q-value a turn."""

    options: NnqlOptions

    def __init__(self, options: NnqlOptions, seed: int) -> None:
        self.options = options
        with torch.random.fork_rng(devices=[]):  # torch draws weights of its own, from the global generator
            self.network = torch.nn.Sequential(
                torch.nn.Linear(paper.SECTORS, options.hidden_units, dtype=torch.float64),
                torch.nn.Sigmoid(),
                torch.nn.Linear(options.hidden_units, len(paper.TURNS), dtype=torch.float64),
            )
        generator = rng(seed, Stream.WEIGHTS)
        ranges = {"0.weight": options.hidden_weights, "2.weight": options.output_weights}
        weights = {name: np.zeros(value.shape) for name, value in self.state_dict().items()}
        for name, limit in ranges.items():
            weights[name] = generator.uniform(-limit, limit, weights[name].shape)
        self.load_state_dict(weights)

    def values(self, observations: Observation, asked: NDArray[np.bool_]) -> Array:
        """What the network puts out."""
        with torch.no_grad():
            values: Array = self.network(self._encoded(observations.readings[asked])).numpy()
        return values

    def learn(self, transitions: Transition) -> Array:
        """One update of eq. (2): its right-hand side is the target of the selected output (III.B).

        The steps of several vehicles are learned from at once: the gradients of their squared errors add up, as those
        of steps one after another would if the network stood still meanwhile.
        """
        t, o = transitions, self.options
        td_errors = np.full(len(t.r_t), np.nan)
        taught = np.flatnonzero(t.active & (o.learn_in_safe_states | self.asks(t.s_tm1)))
        if len(taught) == 0:
            return td_errors
        turns = nearest_turns(heading_change(t.a_tm1[taught], t.s_tm1.target_bearing[taught]))
        before, after, r_t, discount_t = (x[taught] for x in (t.s_tm1.readings, t.s_t.readings, t.r_t, t.discount_t))
        if o.mirrored:
            before, after = (np.concatenate([x, x[:, MIRRORED_SECTORS]]) for x in (before, after))
            turns = np.concatenate([turns, MIRRORED_TURNS[turns]])
            r_t, discount_t = np.tile(r_t, 2), np.tile(discount_t, 2)
        q_before, q_t = self.network(self._encoded(np.concatenate([before, after]))).split(len(turns))
        q_tm1 = q_before.gather(1, torch.from_numpy(turns)[:, None])[:, 0]
        rewards, discounts = torch.from_numpy(r_t), torch.from_numpy(discount_t)
        td_error = rewards + discounts * o.discount * q_t.detach().amax(dim=-1) - q_tm1.detach()
        # d/dq of 1/2 (target - q)^2, where the target of eq. (2) is q + learning_rate * td_error.
        parameters = list(self.network.parameters())
        gradients = torch.autograd.grad(q_tm1, parameters, -o.learning_rate * td_error)
        with torch.no_grad():
            for parameter, gradient in zip(parameters, gradients, strict=True):
                parameter.sub_(gradient, alpha=o.gradient_step)
        td_errors[taught] = td_error.numpy()[: len(taught)]
        return td_errors

    def state_dict(self) -> dict[str, Array]:
        """Weights W1 and W2 and their biases."""
        return {name: value.numpy().copy() for name, value in self.network.state_dict().items()}

    def load_state_dict(self, arrays: dict[str, Array]) -> None:
        """Replaces weights and biases."""
        mine = {name: value.shape for name, value in self.state_dict().items()}
        theirs = {name: value.shape for name, value in arrays.items()}
        if mine != theirs or not all(np.isfinite(value).all() for value in arrays.values()):
            units = f"{paper.SECTORS}-{self.options.hidden_units}-{len(paper.TURNS)}"
            raise UserError(f"these are not the weights of an NNQL network of {units} units")
        self.network.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})

    def _encoded(self, readings: Array) -> torch.Tensor:
        return torch.from_numpy(encode(readings, self.options.encoding))


def encode(readings: Array, encoding: str) -> Array:
    """Network inputs (..., 8) of readings (..., 8) [m]: see `NnqlOptions.encoding`."""
    nearness = 1.0 - readings / paper.SENSOR_RANGE
    if encoding == "proximity":
        return nearness
    return np.where(readings < paper.SENSOR_RANGE, 1.0 - nearness, 0.0)
