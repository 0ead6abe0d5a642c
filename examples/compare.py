"""Policies compared over the same worlds, with intervals and tests.

python examples/compare.py --worlds 100 --workers 2
"""

import argparse

import nnql_bullet as nb


def main() -> None:
    """Evaluates two shipped policies and a rule."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=100, help="validation worlds of each kind")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    a = parser.parse_args()
    results = nb.evaluate(
        ["double_dqn", "tuned", "vfh"],
        worlds=["cover_10", "traps"],
        n_worlds=a.worlds,
        simulator="kinematic",
        workers=a.workers,
    )
    print(results.table())
    for test in results.comparisons:
        print(f"{test.world}: {test.first} against {test.second}, McNemar p = {test.p_value:.2g}")


if __name__ == "__main__":
    main()
