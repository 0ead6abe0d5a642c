"""Double-DQN: every step is decided by a network over all six actions, from what the vehicle sees and has seen.

Mnih et al. (Nature 518, 2015), with the double estimator of van Hasselt et al. (AAAI 2016), dueling heads of Wang et
al. (ICML 2016), n-step returns, and a target network that follows slowly, which also drives.
"""

from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from nnql_bullet.agents.learning import weights
from nnql_bullet.agents.learning.frame_driver import Choice, FrameDriver, FrameState
from nnql_bullet.agents.learning.frames import FrameMaker, Look, Memory
from nnql_bullet.agents.learning.optimizers import without_cache_folder
from nnql_bullet.agents.learning.options import DoubleDqnOptions
from nnql_bullet.agents.learning.replay import CONTINUES, TERMINATED, TRUNCATED, Batch, Replay
from nnql_bullet.agents.learning.shaped_reward import reward
from nnql_bullet.agents.symmetry import MIRRORED_ACTIONS
from nnql_bullet.env import ACTIONS, Observation, Transition
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Actions
from nnql_bullet.seeding import Stream, fenced, rng
from nnql_bullet.task import NO_ENDING
from nnql_bullet.types import Bytes
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec


class DuelingNetwork(torch.nn.Module):
    """Bytes to Q-values of the six actions: Q = V + A - mean of A, over hidden layers with layer norm."""

    def __init__(self, inputs: int, hidden: tuple[int, ...]) -> None:
        super().__init__()
        layers: list[torch.nn.Module] = []
        for sizes in pairwise((inputs, *hidden)):
            layers += [torch.nn.Linear(*sizes), torch.nn.LayerNorm(sizes[1]), torch.nn.ReLU()]
        self.hidden = torch.nn.Sequential(*layers)
        self.value = torch.nn.Linear((inputs, *hidden)[-1], 1)
        self.advantage = torch.nn.Linear((inputs, *hidden)[-1], ACTIONS)
        for head in (self.value, self.advantage):  # nothing is expected of any action yet
            torch.nn.init.zeros_(head.weight)
            torch.nn.init.zeros_(head.bias)

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        """Q-values (m, 6) of what was seen (m, inputs), as bytes."""
        hidden = self.hidden(seen.float() / 127.5 - 1.0)
        advantage = self.advantage(hidden)
        q: torch.Tensor = self.value(hidden) + advantage - advantage.mean(dim=-1, keepdim=True)
        return q


class DoubleDqn(FrameDriver):
    """Chooses among all six actions at every step, by what a network expects of them from what was seen so far."""

    def __init__(self, options: DoubleDqnOptions, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        super().__init__(options, vehicle, drive)
        self._seed = seed
        self._scale = length_scale(vehicle.footprint)
        self._inputs = options.frames * self._frames.width
        with fenced(rng(seed, Stream.WEIGHTS)):
            self.network = DuelingNetwork(self._inputs, options.hidden)
        self.network.requires_grad_(False)
        self._learning: Learning | None = None

    def values(self, look: Look) -> Array:
        """Q(s, a) of the six actions (n, 6), by the target network."""
        return _values(self.network, look)

    def act_exploring(
        self, observations: Observation, state: FrameState, episodes: NDArray[np.int64], uniforms: Array
    ) -> tuple[Actions, FrameState]:
        """Chooses a random action with the scheduled probability, else the one with the largest Q-value."""
        look = self._frames.look(state.memory, observations)
        best = _values(self._learn_with(len(episodes)).online, look).argmax(axis=-1)
        chance = self.options.exploration(episodes)
        drawn = (uniforms / np.maximum(chance, 1e-9) * ACTIONS).astype(np.int64)
        actions = np.where(uniforms < chance, np.minimum(drawn, ACTIONS - 1), best)
        return actions, self._after(Choice(look, observations, actions))

    def learn(self, transitions: Transition, state: FrameState, episodes: NDArray[np.int64]) -> Array:
        """Stores the steps in the replay buffer, and learns from a sample of it.

        Returns:
            The root mean square of the temporal-difference errors learned from, for each vehicle (n,); NaN before there
            is enough to learn from.
        """
        o, t, learning = self.options, transitions, self._learn_with(len(transitions.a_tm1))
        if state.last is None:
            raise ValueError("learn needs the state that act_exploring returned")
        look = state.last.look
        ends = np.where(t.discount_t == 0, TERMINATED, np.where(t.ending == NO_ENDING, CONTINUES, TRUNCATED))
        learning.replay.add(
            look.memory.frames[:, 0],
            look.memory.age,
            t.a_tm1,
            reward(t, o, self._scale),
            ends,
            o.reward_progress * look.progress,
        )
        return np.full(len(t.a_tm1), self._update(learning, int(episodes.max())))

    def diagnostics(self, episode: int) -> dict[str, float]:
        """Probability of a random action and learning rate."""
        o = self.options
        return {
            "exploration": float(o.exploration(np.array([episode]))[0]),
            "learning_rate": o.learning_rate_at(episode),
        }

    def state_dict(self) -> dict[str, Array]:
        """Copies the weights and biases of the target network, which drives."""
        return weights.state_dict(self.network)

    def load_state_dict(self, arrays: dict[str, Array]) -> None:
        """Replaces weights and biases."""
        units = self._inputs, *self.options.hidden, ACTIONS
        weights.load_state_dict(self.network, arrays, "a dueling network", units)

    def training_state(self, state: FrameState) -> dict[str, NDArray[Any]]:
        """Copies the online network, its optimizer, the replay buffer and the memory of vehicles."""
        kept: dict[str, NDArray[Any]] = {f"memory/{name}": a for name, a in state.memory.state_dict().items()}
        return kept | (self._learning.state_dict() if self._learning else {})

    def load_training_state(self, arrays: dict[str, NDArray[Any]]) -> FrameState:
        """Replaces all that by what `training_state` gave, and returns the memory of vehicles."""
        try:
            memory = Memory(*(arrays[f"memory/{field.name}"].copy() for field in fields(Memory)))
            if "replay/count" in arrays:
                self._learn_with(len(memory.age)).load_state_dict(arrays)
        except (KeyError, ValueError, TypeError, UserError):
            raise UserError("this is not the state of such a double_dqn") from None
        return FrameState(memory)

    def _learn_with(self, vehicles: int) -> "Learning":
        if self._learning is None:
            self._learning = Learning(self.options, self.network, self._frames.width, vehicles)
        return self._learning

    def _update(self, learning: "Learning", episode: int) -> float:
        """Takes gradient steps on batches from the replay buffer, in a training episode.

        Returns:
            Root mean square of the temporal-difference errors; NaN while there are too few steps.
        """
        o, replay = self.options, learning.replay
        if not replay.choices(o.n_step) or replay.count * replay.vehicles < o.learning_starts:
            return float("nan")
        generator = rng(self._seed, Stream.REPLAY, replay.count)
        batch = replay.sample(o.gradient_steps * o.batch_size, o.n_step, o.discount, generator)
        if o.mirrored:
            batch = partly_mirrored(batch, self._frames, generator)
        learning.optimizer.param_groups[0]["lr"] = o.learning_rate_at(episode)
        errors = []
        for part in batch.split(o.gradient_steps):
            td_error = td_errors(learning.online, self.network, part)
            learning.optimizer.zero_grad()
            torch.autograd.backward(td_error.square().mean())
            learning.optimizer.step()
            soft_update(self.network, learning.online, o.tau)
            errors.append(td_error.detach())
        return float(torch.cat(errors).square().mean().sqrt())


def _values(network: DuelingNetwork, look: Look) -> Array:
    with torch.no_grad():
        values: Array = network(torch.from_numpy(look.stacked)).numpy().astype(np.float64)
    return values


def partly_mirrored(batch: Batch, frames: FrameMaker, generator: np.random.Generator) -> Batch:
    """The batch with half of its steps, drawn at random, replaced by their mirror images."""
    which = generator.random(len(batch.a_tm1)) < 0.5
    s_tm1, a_tm1, s_t = batch.s_tm1.copy(), batch.a_tm1.copy(), batch.s_t.copy()
    s_tm1[which], s_t[which] = frames.mirrored(s_tm1[which]), frames.mirrored(s_t[which])
    a_tm1[which] = MIRRORED_ACTIONS[a_tm1[which]]
    return replace(batch, s_tm1=s_tm1, a_tm1=a_tm1, s_t=s_t)


def double_q_targets(
    online: torch.nn.Module, target: torch.nn.Module, r_t: Array, discount_t: Array, s_t: Bytes
) -> torch.Tensor:
    """Targets of double Q-learning (m,): r_t + discount_t q_target(s_t, argmax_a q_online(s_t, a)).

    Args:
        online: The network that learns; it selects the action.
        target: The network that follows it; it evaluates that action.
        r_t: Returns of the steps up to s_t (m,).
        discount_t: Discounts of what follows (m,); 0 where the episode ended for good.
        s_t: What was seen then (m, inputs).
    """
    with torch.no_grad():
        seen = torch.from_numpy(s_t)
        a_t = online(seen).argmax(dim=-1, keepdim=True)
        q_t: torch.Tensor = target(seen).gather(1, a_t)[:, 0]
        return torch.from_numpy(r_t.astype(np.float32)) + torch.from_numpy(discount_t.astype(np.float32)) * q_t


def td_errors(online: torch.nn.Module, target: torch.nn.Module, batch: Batch) -> torch.Tensor:
    """Temporal-difference errors of a batch (m,), 0 for steps that do not count; the loss is their mean square."""
    target_tm1 = double_q_targets(online, target, batch.r_t, batch.discount_t, batch.s_t)
    q_tm1 = online(torch.from_numpy(batch.s_tm1)).gather(1, torch.from_numpy(batch.a_tm1)[:, None])[:, 0]
    errors: torch.Tensor = (target_tm1 - q_tm1) * torch.from_numpy(batch.counts)
    return errors


def soft_update(target: torch.nn.Module, online: torch.nn.Module, tau: float) -> None:
    """Moves the weights of the target network toward those of the online network by the fraction tau."""
    with torch.no_grad():
        for mine, theirs in zip(target.parameters(), online.parameters(), strict=True):
            mine.lerp_(theirs, tau)


class Learning:
    """Online network, optimizer and replay buffer: what learning needs beside the target network."""

    def __init__(self, options: DoubleDqnOptions, network: DuelingNetwork, width: int, vehicles: int) -> None:
        with torch.random.fork_rng(devices=[]):  # its weights are drawn, though they are replaced at once
            self.online = DuelingNetwork(options.frames * width, options.hidden)
        weights.load_state_dict(self.online, weights.state_dict(network))
        with without_cache_folder():
            self.optimizer = torch.optim.Adam(self.online.parameters(), fused=True)
        rows = max(options.buffer_size // vehicles, options.n_step + options.frames)
        self.replay = Replay(rows, vehicles, width, options.frames)

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """All of it, by name."""
        moments = {
            f"adam/{name}/{key}": value.detach().numpy().copy()
            for name, parameter in self.online.named_parameters()
            for key, value in self.optimizer.state[parameter].items()
        }
        online = {f"online/{name}": values for name, values in weights.state_dict(self.online).items()}
        return {**online, **moments, **{f"replay/{name}": values for name, values in self.replay.state_dict().items()}}

    def load_state_dict(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Takes back what `state_dict` gave.

        Raises:
            KeyError, ValueError, UserError: If these are not such arrays.
        """
        weights.load_state_dict(self.online, _under("online/", arrays))
        for name, parameter in self.online.named_parameters():
            moments = _under(f"adam/{name}/", arrays)
            self.optimizer.state[parameter] = {key: torch.from_numpy(np.array(a)) for key, a in moments.items()}
        self.replay.load_state_dict(_under("replay/", arrays))


def _under(prefix: str, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}
