"""A policy of your own: one method, driven and evaluated like every other.

python examples/custom_agent.py --worlds 25
"""

import argparse

import numpy as np

import nnql_bullet as nb

LEFT, RIGHT, TOWARD_TARGET = 1, 3, 5
"""Actions: 30 degrees to either side, and the turn toward the target."""


class WiderSide:
    """Turns to the side with more room where something is near ahead."""

    def act(self, observations):
        """Actions (n,) for n vehicles."""
        front, left, right = observations.readings[:, 0], observations.readings[:, 1], observations.readings[:, 7]
        return np.where(front > 5.0, TOWARD_TARGET, np.where(left > right, LEFT, RIGHT))


def main() -> None:
    """Drives the policy once, then compares it with a shipped rule."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=25, help="validation worlds")
    worlds = parser.parse_args().worlds
    print(nb.drive(WiderSide(), world="cover_10", seed=1, simulator="kinematic").summary.ending)
    print(nb.evaluate([WiderSide(), "hand_rule"], worlds=["cover_10"], n_worlds=worlds, simulator="kinematic").table())


if __name__ == "__main__":
    main()
