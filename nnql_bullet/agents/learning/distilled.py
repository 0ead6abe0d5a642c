"""A search distilled into a network: it values every manoeuvre as the search of `guided_search` does, at once.

Dataset aggregation (Ross, Gordon and Bagnell, "A Reduction of Imitation Learning and Structured Prediction to No-Regret
Online Learning", AISTATS 2011): the network drives, the search says what each manoeuvre would have been worth, and the
network learns from all that was said so far. The search sees no more than the network: planning stays classical, on the
map of what was seen; what is learned is to know its outcome from what one step ahead and the surroundings look like.
"""

from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from nnql_bullet.agents.foresight import CONTEXT, MIRRORED_MANOEUVRES, PHI, WIDTH, Look, Memory
from nnql_bullet.agents.learning import weights
from nnql_bullet.agents.learning.manoeuvre_driver import MANNERS, DistilledState, ManoeuvreDriver
from nnql_bullet.agents.learning.optimizers import without_cache_folder
from nnql_bullet.agents.learning.options import DistilledOptions
from nnql_bullet.env import ACTIONS, MANOEUVRES, Observation, Transition
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Actions
from nnql_bullet.seeding import Stream, fenced, rng
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec


class ManoeuvreNetwork(torch.nn.Module):
    """Bytes to values of the 24 manoeuvres: q(s, a) = f(W phi(s, a) + h(s)), with one f for all manoeuvres."""

    def __init__(self, hidden: tuple[int, ...], per_action: int) -> None:
        super().__init__()
        layers: list[torch.nn.Module] = []
        for sizes in pairwise((CONTEXT, *hidden)):
            layers += [torch.nn.Linear(*sizes), torch.nn.LayerNorm(sizes[1]), torch.nn.ReLU()]
        self.surroundings = torch.nn.Sequential(*layers[:-2])
        self.foreseen = torch.nn.Linear(PHI + MANNERS, hidden[-1])
        self.value = torch.nn.Sequential(
            torch.nn.ReLU(), torch.nn.Linear(hidden[-1], per_action), torch.nn.ReLU(), torch.nn.Linear(per_action, 1)
        )
        for parameter in self.value[-1].parameters():  # no manoeuvre is better than another yet
            torch.nn.init.zeros_(parameter)
        self.manners = torch.eye(MANNERS).repeat_interleave(ACTIONS, dim=0)

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        """Values (m, 24) of what was seen (m, WIDTH), as bytes."""
        numbers = seen.float() / 127.5 - 1.0
        phi = numbers[:, CONTEXT:].reshape(-1, MANOEUVRES, PHI)
        hidden = self.foreseen(torch.cat([phi, self.manners.expand(len(phi), -1, -1)], dim=-1))
        q: torch.Tensor = self.value(hidden + self.surroundings(numbers[:, :CONTEXT])[:, None])[..., 0]
        return q


class Distilled(ManoeuvreDriver):
    """Takes the manoeuvre that its network values most, of those that are not foreseen to meet anything."""

    def __init__(self, options: DistilledOptions, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        super().__init__(options, vehicle, drive)
        self._seed = seed
        with fenced(rng(seed, Stream.WEIGHTS)):
            self.network = ManoeuvreNetwork(options.hidden, options.per_action)
        self._optimizer: torch.optim.Optimizer | None = None
        self._count = 0
        self._seen = np.zeros((0, WIDTH), np.uint8)
        self._scores = np.zeros((0, MANOEUVRES), np.float32)

    def act_exploring(
        self, observations: Observation, state: DistilledState, episodes: NDArray[np.int64], uniforms: Array
    ) -> tuple[Actions, DistilledState]:
        """Asks the search; lets it drive, or chance, with the scheduled probabilities, and else the network."""
        o, look = self.options, self._look(observations, state)
        scores, _ = self._foresight.searched(look, observations, o.search)
        led = uniforms >= 1.0 - o.led(episodes) * (1.0 - o.random_share)
        actions = np.where(led, scores.argmax(axis=-1), self._chosen(look, self.values(look)))
        drawn = np.minimum(uniforms / max(o.random_share, 1e-9) * MANOEUVRES, MANOEUVRES - 1).astype(np.int64)
        actions = np.where(uniforms < o.random_share, drawn, actions)
        return actions, replace(self._after(look, observations, actions), scores=scores)

    def learn(self, transitions: Transition, state: DistilledState, episodes: NDArray[np.int64]) -> Array:
        """Keeps what the search said of the last step, and learns from a sample of all that it said.

        Returns:
            The mean divergence from the search's choices, for each vehicle (n,); NaN before there is enough.
        """
        o, n = self.options, len(episodes)
        if state.last is None or state.scores is None:
            raise ValueError("learn needs the state that act_exploring returned")
        if self._count < o.buffer_size and len(self._seen) < self._count + n:
            more = min(max(4 * n, len(self._seen)), o.buffer_size + n - len(self._seen))
            self._seen = np.concatenate([self._seen, np.zeros((more, WIDTH), np.uint8)])
            self._scores = np.concatenate([self._scores, np.zeros((more, MANOEUVRES), np.float32)])
        rows = (self._count + np.arange(n)) % o.buffer_size
        self._seen[rows], self._scores[rows] = state.last[0].stacked, state.scores
        self._count += n
        if self._count < o.learning_starts:
            return np.full(n, np.nan)
        generator = rng(self._seed, Stream.REPLAY, self._count)
        optimizer = self._optimizer = self._optimizer or self._new_optimizer()
        optimizer.param_groups[0]["lr"] = o.learning_rate_at(int(episodes.max()))
        losses = []
        for _ in range(o.gradient_steps):
            drawn = generator.integers(min(self._count, o.buffer_size), size=o.batch_size)
            seen, scores = self._seen[drawn], self._scores[drawn]
            half = o.batch_size // 2
            seen[:half] = self._foresight.mirrored(seen[:half])
            scores[:half] = scores[:half, MIRRORED_MANOEUVRES]
            loss = divergence(self.network(torch.from_numpy(seen)), torch.from_numpy(scores), o.softness)
            optimizer.zero_grad()
            torch.autograd.backward(loss)
            optimizer.step()
            losses.append(float(loss.detach()))
        return np.full(n, np.mean(losses))

    def diagnostics(self, episode: int) -> dict[str, float]:
        """Share of the search's decisions, and learning rate."""
        o = self.options
        return {"led": float(o.led(np.array([episode]))[0]), "learning_rate": o.learning_rate_at(episode)}

    def state_dict(self) -> dict[str, Array]:
        """Copies weights and biases."""
        return weights.state_dict(self.network)

    def load_state_dict(self, arrays: dict[str, Array]) -> None:
        """Replaces weights and biases."""
        units = CONTEXT, *self.options.hidden, self.options.per_action, MANOEUVRES
        weights.load_state_dict(self.network, arrays, "a network of manoeuvres", units)

    def training_state(self, state: DistilledState) -> dict[str, NDArray[Any]]:
        """Copies the optimizer, what the search said, and the memory of vehicles."""
        filled = slice(0, min(self._count, self.options.buffer_size))
        kept: dict[str, NDArray[Any]] = {f"memory/{name}": a for name, a in state.memory.state_dict().items()}
        kept |= {"count": np.array([self._count]), "seen": self._seen[filled].copy()}
        kept["scores"] = self._scores[filled].copy()
        for name, parameter in self.network.named_parameters():
            for key, value in (self._optimizer.state[parameter] if self._optimizer else {}).items():
                kept[f"adam/{name}/{key}"] = value.detach().numpy().copy()
        return kept

    def load_training_state(self, arrays: dict[str, NDArray[Any]]) -> DistilledState:
        """Replaces all that by what `training_state` gave, and returns the memory of vehicles."""
        try:
            memory = Memory(*(arrays[f"memory/{field.name}"].copy() for field in fields(Memory)))
            (self._count,) = arrays["count"].tolist()
            self._seen, self._scores = arrays["seen"].copy(), arrays["scores"].copy()
        except (KeyError, ValueError, TypeError):
            raise UserError("this is not the state of such a distilled search") from None
        self._optimizer = self._new_optimizer()
        for name, parameter in self.network.named_parameters():
            prefix = f"adam/{name}/"
            moments = {key.removeprefix(prefix): a for key, a in arrays.items() if key.startswith(prefix)}
            if moments:
                self._optimizer.state[parameter] = {key: torch.from_numpy(np.array(a)) for key, a in moments.items()}
        return DistilledState(memory)

    def _new_optimizer(self) -> torch.optim.Optimizer:
        with without_cache_folder():
            return torch.optim.Adam(self.network.parameters(), fused=True)

    def values(self, look: Look) -> Array:
        """What the network says of the manoeuvres (n, 24) [m]."""
        with torch.no_grad():
            values: Array = self.network(torch.from_numpy(look.stacked)).numpy().astype(np.float64)
        return values


def divergence(q: torch.Tensor, scores: torch.Tensor, softness: float) -> torch.Tensor:
    """Mean cross-entropy -sum_a p(a) log pi(a), with p = softmax(scores / softness) and pi = softmax(q / softness).

    Args:
        q: Values of the network (m, k) [m].
        scores: Those of the search (m, k) [m].
        softness: Difference of values that matters little [m].
    """
    p = torch.softmax(scores / softness, dim=-1)
    return -(p * torch.log_softmax(q / softness, dim=-1)).sum(dim=-1).mean()
