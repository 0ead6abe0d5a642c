"""Writes worlds/splits.json: hashes of the first worlds of both splits, of every shipped world file.

Needed when a world file is added. If it changes hashes that are there already, the worlds have changed, and no result
from before compares with one from after; so that has to be asked for.

    python scripts/freeze_splits.py
    python scripts/freeze_splits.py --replace
    python scripts/freeze_splits.py --replace poles rooms
"""

import argparse
import json
import sys
from pathlib import Path

from rich.progress import track

from nnql_bullet import assets
from nnql_bullet.evaluation.splits import BLOCK, FROZEN, SPLITS, block_hash
from nnql_bullet.experiment import Experiment
from nnql_bullet.files import write_text
from nnql_bullet.run_config import RunConfig

FILE = assets.folder("worlds") / "splits.json"


def hashes(name: str) -> dict[str, list[str]]:
    """Of the blocks of each split of one world file."""
    experiment = Experiment(RunConfig(world=name))
    blocks = range(0, FROZEN, BLOCK)
    return {
        split: [block_hash([experiment.world(seed) for seed in seeds[first : first + BLOCK]]) for first in blocks]
        for split, seeds in SPLITS.items()
    }


def main() -> None:
    """Draws the worlds and writes the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--replace", action="store_true", help="replace hashes that have changed")
    parser.add_argument("names", nargs="*", help="some world files, by name; all by default")
    a = parser.parse_args()
    names = sorted(path.stem for path in Path(assets.folder("worlds")).glob("*.toml"))
    known = json.loads(FILE.read_text(encoding="utf-8"))["worlds"] if FILE.exists() else {}
    drawn = {name: hashes(name) for name in track(a.names or names, "drawing")}
    found = {name: drawn.get(name) or known[name] for name in names}
    changed = [name for name in drawn if name in known and known[name] != drawn[name]]
    if changed and not a.replace:
        sys.exit(f"these worlds are not what they were: {', '.join(changed)}; if that is meant, give --replace")
    width = Experiment(RunConfig()).vehicle.width
    write_text(FILE, json.dumps({"vehicle_width": width, "worlds": found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
