"""A world of your own: boxes in code, a picture of it, and a drive through it.

python examples/custom_world.py --out runs/slalom
"""

import argparse
from pathlib import Path

import nnql_bullet as nb


def main() -> None:
    """Builds a slalom of three walls across the diagonal."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/slalom"), help="folder of the pictures")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    walls = [(x, x + offset, 24.0, 2.0, 135.0) for x, offset in ((30.0, 8.0), (50.0, -8.0), (70.0, 8.0))]
    slalom = nb.World.from_boxes(walls, name="slalom")
    slalom.plot(out / "world.png")
    recording = nb.drive("double_dqn", world=slalom, simulator="kinematic")
    recording.plot(out / "drive.png")
    print(recording.summary.ending, f"after {recording.summary.duration:.0f} s")


if __name__ == "__main__":
    main()
