"""Neural-network Q-learning (NNQL), the paper's method (II.D, II.E, III)."""

import numpy as np
import torch
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.learning import weights
from nnql_bullet.agents.learning.options import NnqlOptions
from nnql_bullet.agents.learning.q_learning import QLearning, encode, td_errors, turn_steps
from nnql_bullet.env import Observation, Transition
from nnql_bullet.geometry import Array
from nnql_bullet.seeding import Stream, rng


class Nnql(QLearning):
    """The 8-6-5 network: sigmoid hidden units, linear outputs (targets reach -0.6), one Q-value per turn."""

    options: NnqlOptions

    def __init__(self, options: NnqlOptions, seed: int, scale: float = 1.0) -> None:
        self.options, self._scale = options, scale
        self._units = paper.SECTORS, options.hidden_units, len(paper.TURNS)
        inputs, hidden, outputs = self._units
        with torch.random.fork_rng(devices=[]):  # torch draws weights of its own, from the global generator
            self.network = torch.nn.Sequential(
                torch.nn.Linear(inputs, hidden, dtype=torch.float64),
                torch.nn.Sigmoid(),
                torch.nn.Linear(hidden, outputs, dtype=torch.float64),
            )
        generator = rng(seed, Stream.WEIGHTS)
        ranges = {"0.weight": options.hidden_weights, "2.weight": options.output_weights}
        initial = {name: np.zeros(value.shape) for name, value in self.state_dict().items()}
        for name, limit in ranges.items():
            initial[name] = generator.uniform(-limit, limit, initial[name].shape)
        self.load_state_dict(initial)

    def values(self, observations: Observation, asked: NDArray[np.bool_]) -> Array:
        """The network's outputs."""
        with torch.no_grad():
            values: Array = self.network(self._encoded(observations.readings[asked])).numpy()
        return values

    def learn(self, transitions: Transition, state: None, episodes: NDArray[np.int64]) -> Array:
        """Updates the network by eq. (2), whose right-hand side is the target of the selected output (III.B).

        The gradients of the vehicles' squared errors add up: the network stands still while they are computed.
        """
        t, o = transitions, self.options
        errors = np.full(len(t.r_t), np.nan)
        learned = np.flatnonzero(t.active & (o.learn_in_safe_states | self.asks(t.s_tm1)))
        if len(learned) == 0:
            return errors
        steps = turn_steps(t, learned, o.discount)
        if o.mirrored:
            steps = steps.with_mirror_images()
        # One pass for both: the network's sums may round differently in batches of another size.
        q_all = self.network(self._encoded(np.concatenate([steps.s_tm1, steps.s_t])))
        q_tm1, q_t = q_all.split(len(steps.a_tm1))
        q_a_tm1 = q_tm1.gather(1, torch.from_numpy(steps.a_tm1)[:, None])[:, 0]
        td_error = td_errors(q_tm1.detach().numpy(), steps.a_tm1, steps.r_t, steps.discount_t, q_t.detach().numpy())
        gradients = squared_error_gradients(self.network, q_a_tm1, o.learning_rate * td_error)
        with torch.no_grad():
            for parameter, gradient in zip(self.network.parameters(), gradients, strict=True):
                parameter.sub_(gradient, alpha=o.gradient_step)
        errors[learned] = td_error[: len(learned)]
        return errors

    def state_dict(self) -> dict[str, Array]:
        """Copies the weights W1 and W2 and their biases."""
        return weights.state_dict(self.network)

    def load_state_dict(self, arrays: dict[str, Array]) -> None:
        """Replaces the weights and biases."""
        weights.load_state_dict(self.network, arrays, "an NNQL network", self._units)

    def _encoded(self, readings: Array) -> torch.Tensor:
        return torch.from_numpy(encode(readings / self._scale, self.options.encoding))


def squared_error_gradients(network: torch.nn.Module, q_a_tm1: torch.Tensor, errors: Array) -> tuple[torch.Tensor, ...]:
    """Gradients of the sum of 1/2 (target_tm1 - q_a_tm1)^2 by the network's parameters, the targets held fixed.

    Args:
        network: Whose parameters the outputs depend on.
        q_a_tm1: Its outputs for the turns taken (m,), with their graph.
        errors: target_tm1 - q_a_tm1 (m,): by eq. (2) the learning rate times the temporal-difference errors.
    """
    return torch.autograd.grad(q_a_tm1, list(network.parameters()), -torch.from_numpy(errors))
