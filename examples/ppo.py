"""Proximal policy optimization in one file, over many vehicles at once; then its policy against the rule `straight`.

PPO of Schulman et al., 2017 (arXiv:1707.06347), with generalized advantages (arXiv:1506.02438).

python examples/ppo.py --world paper --steps 60000
"""

from dataclasses import dataclass

import numpy as np
import torch
import tyro
from torch import nn
from torch.distributions import Categorical

import nnql_bullet as nb
from nnql_bullet.env import as_numbers


@dataclass(frozen=True)
class Options:
    """What is learned from, and how."""

    world: str = "paper"
    """Kind of worlds."""
    steps: int = 60_000
    """Decisions of all vehicles together."""
    seed: int = 0
    """Of worlds, weights and exploration."""
    vehicles: int = 64
    """That drive at once."""
    horizon: int = 64
    """Decisions of each vehicle from one update to the next."""
    epochs: int = 10
    """Passes over the decisions of an update."""
    minibatch: int = 512
    """Decisions of one gradient step."""
    learning_rate: float = 3e-4
    """Of Adam."""
    discount: float = 0.99
    """Of later rewards."""
    trace: float = 0.95
    """Lambda of the generalized advantages."""
    clip: float = 0.2
    """How far a probability may move in an update, as a share."""
    value_share: float = 0.5
    """Weight of the value's error in the loss."""
    largest_gradient: float = 0.5
    """Norm to which a longer gradient is cut."""
    worlds: int = 50
    """Validation worlds in the end."""


class Scale:
    """Mean and variance of all rows so far (n, width)."""

    def __init__(self, width):
        """Begins with no row."""
        self.count, self.mean, self.variance = 1e-4, np.zeros(width), np.ones(width)

    def add(self, rows):
        """Takes in more rows."""
        share, away = len(rows) / (self.count + len(rows)), rows.mean(axis=0) - self.mean
        self.variance += share * (rows.var(axis=0) - self.variance + away**2 * (1 - share))
        self.mean += away * share
        self.count += len(rows)

    def of(self, rows):
        """The rows, with mean 0 and variance 1, as the networks are given them."""
        return torch.as_tensor(np.clip((rows - self.mean) / np.sqrt(self.variance + 1e-8), -10, 10)).float()


class Agent(nn.Module):
    """Logits of the actions, and the value of a state."""

    def __init__(self, inputs, actions):
        """Makes two networks of the same shape."""
        super().__init__()
        self.seen = Scale(inputs)
        self.logits, self.value = self.network(inputs, actions, 0.01), self.network(inputs, 1, 1.0)

    @staticmethod
    def network(inputs, outputs, gain):
        """Two hidden layers, with orthogonal weights."""
        layers = [nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)]
        for layer, its in zip(layers[::2], (2**0.5, 2**0.5, gain), strict=True):
            nn.init.orthogonal_(layer.weight, its)
            nn.init.zeros_(layer.bias)
        return nn.Sequential(*layers)

    def values(self, observations):
        """What states are worth (n,)."""
        with torch.no_grad():
            return self.value(self.seen.of(observations))[:, 0].numpy()

    def act(self, observations):
        """The likeliest actions (n,): with this method the agent drives like every policy of the package."""
        with torch.no_grad():
            return self.logits(self.seen.of(as_numbers(observations))).argmax(dim=1).numpy()


def advantages(rewards, values, next_values, over, o):
    """Generalized advantages (horizon, n); where an episode is over, none is handed back from the next."""
    found, later = np.zeros_like(rewards), np.zeros(rewards.shape[1])
    for t in reversed(range(len(rewards))):
        error = rewards[t] + o.discount * next_values[t] - values[t]
        found[t] = later = error + o.discount * o.trace * np.where(over[t], 0.0, later)
    return found


def update(agent, optimizer, batch, o):
    """Makes the gradient steps of one update; the batch holds rows of states, actions, chances, gains and returns."""
    for _ in range(o.epochs):
        for rows in torch.randperm(len(batch[0])).split(o.minibatch):
            seen, actions, old, gain, returns = (its[rows] for its in batch)
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            ratio = (Categorical(logits=agent.logits(seen)).log_prob(actions) - old).exp()
            policy = -torch.min(ratio * gain, ratio.clamp(1 - o.clip, 1 + o.clip) * gain).mean()
            loss = policy + o.value_share * (agent.value(seen)[:, 0] - returns).square().mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), o.largest_gradient)
            optimizer.step()


def train(o):
    """Learns, and returns the agent."""
    torch.manual_seed(o.seed)
    torch.set_num_threads(1)  # the networks are so small that several wait for each other
    envs = nb.make_env(
        world=o.world, simulator="kinematic", reward="progress", n_envs=o.vehicles, autoreset_mode="SameStep"
    )
    agent = Agent(envs.single_observation_space.shape[0], envs.single_action_space.n)
    optimizer = torch.optim.Adam(agent.parameters(), o.learning_rate, eps=1e-5)
    observations, _ = envs.reset(seed=o.seed)
    totals, gained = np.zeros(o.vehicles), Scale(1)
    for number in range(1, o.steps // (o.horizon * o.vehicles) + 1):
        steps, successes = [], []
        for _ in range(o.horizon):
            agent.seen.add(observations)
            seen = agent.seen.of(observations)
            with torch.no_grad():
                choice = Categorical(logits=agent.logits(seen))
                actions = choice.sample()
            values = agent.values(observations)
            observations, rewards, terminated, truncated, infos = envs.step(actions.numpy())
            over = terminated | truncated
            next_observations = observations.copy()
            if over.any():  # the vehicle is in its next world already
                next_observations[over] = np.stack(infos["final_obs"][over])
                successes += infos["final_info"]["is_success"][over].tolist()
            totals = o.discount * totals + rewards
            gained.add(totals[:, None])
            totals[over] = 0.0
            rewards = rewards / np.sqrt(gained.variance + 1e-8)
            next_values = np.where(terminated, 0.0, agent.values(next_observations))
            steps.append((seen, actions, choice.log_prob(actions), rewards, values, next_values, over))
        seen, actions, chances, *numbers = zip(*steps, strict=True)
        rewards, values, next_values, over = map(np.array, numbers)
        gains = advantages(rewards, values, next_values, over, o)
        rows = [torch.as_tensor(its.ravel()).float() for its in (gains, gains + values)]
        update(agent, optimizer, [*(torch.cat(its) for its in (seen, actions, chances)), *rows], o)
        print(f"{number * o.horizon * o.vehicles} steps, {np.mean(successes or [0]):.0%} of {len(successes)} episodes")
    envs.close()
    return agent


def main() -> None:
    """Trains, and compares what was learned with a rule in worlds that it has not seen."""
    o = tyro.cli(Options, description=__doc__)
    results = nb.evaluate([train(o), "straight"], worlds=[o.world], n_worlds=o.worlds, simulator="kinematic")
    print(results.table())


if __name__ == "__main__":
    main()
