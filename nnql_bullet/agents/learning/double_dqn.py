"""Double-DQN: every step is decided by a network over all six actions, from what the vehicle sees and has seen.

Mnih et al. (Nature 518, 2015), with the double estimator of van Hasselt et al. (AAAI 2016), dueling heads of Wang et
al. (ICML 2016), n-step returns, and a target network that follows slowly, which also drives.
"""

from dataclasses import fields
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents.learning.frames import MIRRORED_ACTIONS, FrameMaker, Look, Memory
from nnql_bullet.agents.learning.replay import CUT_OFF, FOR_GOOD, GOES_ON, Replay
from nnql_bullet.config import options
from nnql_bullet.env import ACTIONS, Observation, Transition, heading_change
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.seeding import Stream, fenced, rng
from nnql_bullet.sensing import FRONT
from nnql_bullet.task import NO_ENDING, StateProperty
from nnql_bullet.types import Bytes, Count, NonNegative, Positive, UnitInterval
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec

FRONT_DISTANCE = 5.0
"""Nearer than this, what is in front costs [m]."""


@options
class DoubleDqnOptions:
    """What the network sees, how it learns, and what it is paid for.

    `nnql-bullet ablate double_dqn` says what parts of it are worth.
    """

    kind: Literal["double_dqn"] = "double_dqn"
    rays: Literal[8, 24, 72] = 24
    """Readings that the 72 rays are told as, each the nearest of its own."""
    frames: Count = 3
    """Last moments that the network sees at once."""
    grid_map: bool = True
    """Whether the vehicle keeps a map of what it has seen, and the network is told of the way through it."""
    hidden: tuple[Count, ...] = (128, 128)
    """Units of the hidden layers."""
    learning_rate: Positive = 5e-4
    """Of Adam, at first."""
    learning_rate_final: Positive = 5e-5
    """From `schedule_episodes` on; it falls over the second half of them."""
    schedule_episodes: Count = 12_000
    """Episodes that schedules are made for. They do not follow the number of episodes asked for, so that a run can be
    stopped and gone on with."""
    discount: UnitInterval = 0.9
    """gamma."""
    steps: Count = 3
    """n, of n-step returns."""
    batch_size: Count = 256
    """Steps that an update learns from."""
    updates: Count = 2
    """Each time that all vehicles took a step."""
    target_rate: Annotated[float, Field(gt=0, le=1)] = 0.005
    """tau: share of the way that the target network follows in an update."""
    buffer_size: Count = 300_000
    """Steps that are remembered."""
    learning_starts: Annotated[int, Field(ge=0)] = 10_000
    """Steps before the first update."""
    exploration: Annotated[tuple[UnitInterval, ...], Field(min_length=1)] = (0.01, 0.05, 0.1, 0.2)
    """Shares of random actions, which episodes take by turns: some get far, and some see much."""
    exploration_episodes: Count = 1_000
    """Over so many the share of random actions falls from 1 to those, linearly."""
    mirrored: bool = True
    """Whether half of the steps are learned from as if left were right, which is all the same to the vehicle."""
    reward_progress: float = 0.03
    """For each metre that the way to the target gets shorter."""
    reward_step: float = -0.005
    """For each decision."""
    reward_turn: float = -0.003
    """For each radian that is asked for."""
    reward_near: float = -0.06
    """For what touches the sensor in front; with distance it falls to nothing at 5 m."""
    reward_winning: float = 0.5
    """For reaching the target."""
    reward_failure: float = -2.0
    """For touching something."""
    paper_share: NonNegative = 0.0
    """Of the paper's reward, which is added."""


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


class DoubleDqn:
    """Chooses among all six actions at every step, by what a network expects of them from what was seen so far."""

    def __init__(self, options: DoubleDqnOptions, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        self.options = options
        self._seed = seed
        self._frames = FrameMaker(options.rays, options.frames, options.grid_map, vehicle, drive)
        self._inputs = options.frames * self._frames.width
        with fenced(rng(seed, Stream.WEIGHTS)):
            self.network = DuelingNetwork(self._inputs, options.hidden)
        self.network.requires_grad_(False)
        self._memory = self._frames.nothing(0)
        self._learning: Learning | None = None
        self._decided: tuple[Look, Observation]
        """What the last actions were chosen by."""

    def reset(self, vehicle: int, world_seed: int) -> None:
        """Nothing was seen yet."""
        self._remembered(vehicle + 1)
        self._memory.age[vehicle] = 0

    def act(self, observations: Observation) -> NDArray[np.int64]:
        """The action with the largest Q-value."""
        look = self._look(observations)
        actions = np.asarray(self._values(self.network, look).argmax(axis=-1))
        self._keep(self._frames.after(look, observations, actions))
        self._decided = look, observations
        return actions

    def override(self, actions: NDArray[np.int64]) -> None:
        """Remembers what was done instead of what was last chosen."""
        look, observations = self._decided
        self._keep(self._frames.after(look, observations, actions))

    def action_values(self, observations: Observation) -> Array:
        """Q(s, a) of the five turns (n, 5), the turn toward the target left out."""
        return self._values(self.network, self._look(observations))[:, : len(paper.TURNS)]

    def act_exploring(
        self, observations: Observation, episodes: NDArray[np.int64], uniforms: Array
    ) -> NDArray[np.int64]:
        """A random action now and then, else the one that is held best by now."""
        learning = self._learn_with(len(episodes))
        learning.look, learning.episode = self._look(observations), int(episodes.max())
        best = self._values(learning.online, learning.look).argmax(axis=-1)
        shares = self.exploration(episodes)
        drawn = (uniforms / np.maximum(shares, 1e-9) * ACTIONS).astype(np.int64)
        return np.where(uniforms < shares, np.minimum(drawn, ACTIONS - 1), best)

    def learn(self, transitions: Transition) -> Array:
        """Keeps the steps, and learns from some of those that were kept.

        Returns:
            The root mean square of the temporal-difference errors learned from, for each vehicle (n,); NaN before there
            is enough to learn from.
        """
        o, t = self.options, transitions
        learning = self._learn_with(len(t.a_tm1))
        look = learning.look
        ends = np.where(t.discount_t == 0, FOR_GOOD, np.where(t.ending == NO_ENDING, GOES_ON, CUT_OFF))
        learning.replay.add(
            look.memory.frames[:, 0],
            look.memory.age,
            t.a_tm1,
            self._rewards(t),
            ends,
            o.reward_progress * look.progress,
        )
        self._keep(self._frames.after(look, t.s_tm1, t.a_tm1))
        return np.full(len(t.a_tm1), self._update(learning))

    def exploration(self, episodes: NDArray[np.int64]) -> Array:
        """Shares of random actions in training episodes (n,), counted from 0."""
        last = np.array(self.options.exploration)[episodes % len(self.options.exploration)]
        progress = np.minimum(episodes / self.options.exploration_episodes, 1.0)
        return np.asarray(1.0 + (last - 1.0) * progress)

    def learning_rate(self, episode: int) -> float:
        """In a training episode, counted from 0."""
        o = self.options
        progress = min(max(2 * episode / o.schedule_episodes - 1, 0.0), 1.0)
        return o.learning_rate + (o.learning_rate_final - o.learning_rate) * progress

    def diagnostics(self, episode: int) -> dict[str, float]:
        """Share of random actions and learning rate."""
        share = float(self.exploration(np.array([episode]))[0])
        return {"exploration": share, "learning_rate": self.learning_rate(episode)}

    def state_dict(self) -> dict[str, Array]:
        """Weights and biases of the network that drives."""
        return _weights(self.network)

    def load_state_dict(self, arrays: dict[str, Array]) -> None:
        """Replaces weights and biases."""
        if not _fits(self.network, arrays):
            widths = "-".join(map(str, (self._inputs, *self.options.hidden, ACTIONS)))
            raise UserError(f"these are not the weights of a dueling network of {widths} units")
        _load(self.network, arrays)

    def training_state(self) -> dict[str, NDArray[Any]]:
        """The network that learns, its optimizer, the replay, and what is remembered of vehicles."""
        kept: dict[str, NDArray[Any]] = {f"memory/{name}": a for name, a in self._memory.state_dict().items()}
        return kept | (self._learning.state_dict() if self._learning else {})

    def load_training_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Takes back what `under_way` gave."""
        try:
            self._memory = Memory(*(state[f"memory/{field.name}"].copy() for field in fields(Memory)))
            if "replay/count" in state:
                self._learn_with(len(self._memory.age)).load_state_dict(state)
        except (KeyError, ValueError, TypeError):
            raise UserError("this is not the state of such a double_dqn") from None

    def _look(self, observations: Observation) -> Look:
        return self._frames.look(self._remembered(len(observations.yaw_rate)), observations)

    def _remembered(self, size: int) -> Memory:
        """Memory of the first vehicles, with room for those that were never heard of."""
        more = size - len(self._memory.age)
        if more > 0:
            new = self._frames.nothing(more)
            pairs = ((getattr(self._memory, field.name), getattr(new, field.name)) for field in fields(Memory))
            self._memory = Memory(*(np.concatenate(pair) for pair in pairs))
        return self._memory.first(size)

    def _keep(self, memory: Memory) -> None:
        """Remembers this of the first vehicles."""
        for field in fields(Memory):
            kept = getattr(memory, field.name)
            getattr(self._memory, field.name)[: len(kept)] = kept

    def _learn_with(self, vehicles: int) -> "Learning":
        if self._learning is None:
            self._learning = Learning(self.options, self.network, self._frames.width, vehicles)
        return self._learning

    @staticmethod
    def _values(network: DuelingNetwork, look: Look) -> Array:
        with torch.no_grad():
            values: Array = network(torch.from_numpy(look.stacked)).numpy().astype(np.float64)
        return values

    def _rewards(self, t: Transition) -> Array:
        """Of steps (n,), but for the progress, which shows at the next look."""
        o = self.options
        nearness = np.maximum(1 - t.s_t.readings[:, FRONT] / FRONT_DISTANCE, 0.0)
        turns = np.abs(heading_change(t.a_tm1, t.s_tm1.target_bearing))
        won, failed = t.s_t.state_property == StateProperty.WINNING, t.s_t.state_property == StateProperty.FAILURE
        own = o.reward_step + o.reward_turn * turns + o.reward_near * nearness
        own += o.reward_winning * won + o.reward_failure * failed
        return np.asarray(own + o.paper_share * t.r_t)

    def _update(self, learning: "Learning") -> float:
        """Learns from batches of what was kept; root mean square of the errors, NaN if there is too little."""
        o, replay = self.options, learning.replay
        choices = replay.choices(o.steps)
        if not choices or replay.count * replay.vehicles < o.learning_starts:
            return float("nan")
        generator = rng(self._seed, Stream.REPLAY, replay.count)
        size = o.updates * o.batch_size
        times = generator.integers(choices.start, choices.stop, size)
        batch = replay.batch(times, generator.integers(replay.vehicles, size=size), o.steps, o.discount)
        seen, after, actions = batch.seen, batch.after, batch.actions
        if o.mirrored:
            turned = generator.random(size) < 0.5
            seen[turned], after[turned] = (self._frames.mirrored(stacked[turned]) for stacked in (seen, after))
            actions[turned] = MIRRORED_ACTIONS[actions[turned]]
        for group in learning.optimizer.param_groups:
            group["lr"] = self.learning_rate(learning.episode)
        errors = []
        for one in np.split(np.arange(size), o.updates):
            target = double_q_targets(
                learning.online, self.network, after[one], batch.returns[one], batch.discounts[one]
            )
            q = learning.online(torch.from_numpy(seen[one])).gather(1, torch.from_numpy(actions[one])[:, None])[:, 0]
            td_error = (target - q) * torch.from_numpy(batch.counts[one])
            learning.optimizer.zero_grad()
            td_error.square().mean().backward()
            learning.optimizer.step()
            follow(self.network, learning.online, o.target_rate)
            errors.append(td_error.detach())
        return float(torch.cat(errors).square().mean().sqrt())


def double_q_targets(
    online: DuelingNetwork, target: DuelingNetwork, after: Bytes, returns: Array, discounts: Array
) -> torch.Tensor:
    """The returns (m,) and, discounted, what `target` expects of the actions that `online` holds best after them."""
    with torch.no_grad():
        seen = torch.from_numpy(after)
        best = online(seen).argmax(dim=-1, keepdim=True)
        value: torch.Tensor = target(seen).gather(1, best)[:, 0]
        return torch.from_numpy(returns.astype(np.float32)) + torch.from_numpy(discounts.astype(np.float32)) * value


def follow(network: DuelingNetwork, other: DuelingNetwork, share: float) -> None:
    """Moves the weights of a network toward those of another by a share of the way."""
    with torch.no_grad():
        for mine, theirs in zip(network.parameters(), other.parameters(), strict=True):
            mine.lerp_(theirs, share)


class Learning:
    """What learning needs beside the network that drives."""

    look: Look
    """What the vehicles see, between `act_exploring` and `learn`."""
    episode: int
    """The latest."""

    def __init__(self, options: DoubleDqnOptions, network: DuelingNetwork, width: int, vehicles: int) -> None:
        with torch.random.fork_rng(devices=[]):  # its weights are drawn, though they are replaced at once
            self.online = DuelingNetwork(options.frames * width, options.hidden)
        _load(self.online, _weights(network))
        self.optimizer = torch.optim.Adam(self.online.parameters(), fused=True)
        rows = max(options.buffer_size // vehicles, options.steps + options.frames)
        self.replay = Replay(rows, vehicles, width, options.frames)

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """All of it, by name."""
        moments = {
            f"adam/{name}/{key}": value.detach().numpy().copy()
            for name, parameter in self.online.named_parameters()
            for key, value in self.optimizer.state[parameter].items()
        }
        online = {f"online/{name}": values for name, values in _weights(self.online).items()}
        return {**online, **moments, **{f"replay/{name}": values for name, values in self.replay.state_dict().items()}}

    def load_state_dict(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Takes back what `state_dict` gave.

        Raises:
            KeyError, ValueError: If these are not such arrays.
        """
        online = _under("online/", arrays)
        if not _fits(self.online, online):
            raise ValueError
        _load(self.online, online)
        for name, parameter in self.online.named_parameters():
            moments = _under(f"adam/{name}/", arrays)
            self.optimizer.state[parameter] = {key: torch.from_numpy(np.array(a)) for key, a in moments.items()}
        self.replay.load_state_dict(_under("replay/", arrays))


def _under(prefix: str, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}


def _weights(network: torch.nn.Module) -> dict[str, Array]:
    return {name: value.detach().numpy().copy() for name, value in network.state_dict().items()}


def _fits(network: torch.nn.Module, arrays: dict[str, Array]) -> bool:
    mine = {name: value.shape for name, value in _weights(network).items()}
    theirs = {name: value.shape for name, value in arrays.items()}
    return mine == theirs and all(np.isfinite(value).all() for value in arrays.values())


def _load(network: torch.nn.Module, arrays: dict[str, Array]) -> None:
    network.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})
