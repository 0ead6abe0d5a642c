"""From training to a film.

python examples/train_drive_film.py --episodes 1000 --out runs/example
"""

import argparse
from pathlib import Path

import nnql_bullet as nb


def main() -> None:
    """Trains in the kinematic model, drives in contact physics, and films the drive."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=1000, help="training episodes")
    parser.add_argument("--seconds", type=float, default=None, help="of the film; by default all of the drive")
    parser.add_argument("--size", type=int, nargs=2, default=(1280, 720), help="of the film [pixels]")
    parser.add_argument("--out", type=Path, default=Path("runs/example"), help="run folder")
    a = parser.parse_args()
    run = nb.train("tuned", episodes=a.episodes, out=a.out, on_progress=lambda p: print(p.done, p.note, end="\r"))
    recording = nb.drive(run.policy, world="cover_10", seed=4, physics="fast", shield=True)
    print(f"\n{recording.summary.ending} after {recording.summary.duration:.0f} s")
    recording.render(a.out / "drive.mp4", size=tuple(a.size), end=a.seconds)
    print(a.out / "drive.mp4")


if __name__ == "__main__":
    main()
