"""A reward of your own, in training and in the Gymnasium environment.

python examples/custom_reward.py --episodes 1000 --out runs/careful
"""

import argparse

import numpy as np

import nnql_bullet as nb


def careful(transitions):
    """The paper's reward, less a cost (n,) that grows as obstacles come near."""
    nearest = transitions.s_t.readings.min(axis=1)
    return transitions.terms.sum(axis=1) - 0.2 * np.exp(-nearest)


def main() -> None:
    """Trains with the reward, then takes a step with it in the environment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=1000, help="training episodes")
    parser.add_argument("--out", default="runs/careful", help="run folder")
    a = parser.parse_args()
    run = nb.train("paper", simulator="kinematic", vehicles=16, episodes=a.episodes, reward=careful, out=a.out)
    print(f"{len(run.episodes)} episodes, {run.folder}")
    env = nb.make_env(simulator="kinematic", reward=careful)
    env.reset(seed=0)
    print(f"reward of a step ahead: {env.step(0)[1]:.4f}")
    env.close()


if __name__ == "__main__":
    main()
