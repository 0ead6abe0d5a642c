"""The frozen worlds of evaluations, and the check that they have not changed.

Choices use the split `validation`; the final table uses `test`. A file holds hashes of the first worlds of both, block
by block, for every shipped world file. They reveal a change of the generator, which would otherwise give other worlds.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from nnql_bullet import assets
from nnql_bullet.errors import UserError
from nnql_bullet.files import read_json
from nnql_bullet.seeding import TEST_WORLDS, VALIDATION_WORLDS
from nnql_bullet.worlds.spec import WorldSpec

SplitName = Literal["validation", "test"]
SPLITS: dict[SplitName, range] = {"validation": VALIDATION_WORLDS, "test": TEST_WORLDS}

BLOCK = 25
"""Number of worlds that share a hash."""
FROZEN = 1000
"""Number of worlds of each split that have a hash."""
MOST_SEEDS = 100_000
"""Largest number of seeds of the caller's own."""
_FILE = "splits.json"


@dataclass(frozen=True, slots=True)
class FrozenSplits:
    """The record of the frozen splits."""

    vehicle_width: float
    """Width of the vehicle for which the worlds were drawn [m]; it decides which draws count."""
    hashes: Mapping[str, Mapping[str, Sequence[str]]]
    """Hash of each block, by world file and split."""


def split_seeds(split: SplitName, worlds: int) -> range:
    """Returns the seeds of a split's first worlds.

    Raises:
        UserError: If fewer worlds are frozen.
    """
    if not 1 <= worlds <= FROZEN:
        raise UserError(f"the number of worlds must be from 1 to {FROZEN}, the worlds that are frozen, not {worlds}")
    return SPLITS[split][:worlds]


@dataclass(frozen=True, slots=True)
class Draws:
    """Which worlds of each kind are drawn."""

    seeds: range
    split: SplitName | None
    """The split whose first worlds they are; None for seeds of the caller's own."""

    @property
    def title(self) -> str:
        """Title for people."""
        return f"{self.split} worlds" if self.split else f"worlds of seeds {self.seeds[0]} to {self.seeds[-1]}"

    @property
    def flags(self) -> list[str]:
        """Flags on a command line."""
        if self.split is None:
            return ["--seeds", f"{self.seeds.start}:{self.seeds.stop}"]
        return ["--worlds", str(len(self.seeds)), "--split", self.split]


def choose_draws(split: SplitName | None, worlds: int | None, seeds: range | None) -> Draws:
    """Chooses the first worlds of a split, by default 100 of `validation`, or those of some seeds.

    Raises:
        UserError: If both are asked for, fewer worlds are frozen, or the seeds are no range of possible seeds.
    """
    if seeds is None:
        chosen = split or "validation"
        return Draws(split_seeds(chosen, 100 if worlds is None else worlds), chosen)
    for name, value in (("split", split), ("worlds", worlds)):
        if value is not None:
            raise UserError(f"seeds and {name} both say which worlds are drawn; leave one of them out")
    if seeds.step != 1 or not 0 <= seeds.start < seeds.stop <= 2**63 or seeds.stop - seeds.start > MOST_SEEDS:
        raise UserError(
            f"seeds must be FROM:TO with 0 <= FROM < TO <= 2^63, at most {MOST_SEEDS} of them (TO itself is left out), "
            f"not {seeds.start}:{seeds.stop}"
        )
    return Draws(seeds, None)


def load_frozen(path: Path | None = None) -> FrozenSplits:
    """Reads hashes; by default the shipped ones.

    Raises:
        UserError: If the file is damaged.
    """
    file = path or assets.folder("worlds") / _FILE
    try:
        values = read_json(file)
        found = {"vehicle_width": values["vehicle_width"], "hashes": values["worlds"]}
        return TypeAdapter(FrozenSplits).validate_python(found)
    except (ValidationError, TypeError, KeyError):
        raise UserError(f"{file}: damaged; install the program anew") from None


def block_hash(worlds: Sequence[WorldSpec]) -> str:
    """Combines the hashes of several worlds."""
    return hashlib.sha256("".join(world.digest for world in worlds).encode()).hexdigest()[:16]


def check_frozen(
    name: str,
    split: SplitName,
    worlds: int,
    vehicle_width: float,
    draw: Callable[[int], WorldSpec],
    frozen: FrozenSplits,
) -> bool:
    """Checks that a split's first worlds are the frozen ones.

    Args:
        name: Name of the world file.
        split: The split.
        worlds: Number of worlds; whole blocks are drawn.
        vehicle_width: Width of the vehicle for which the worlds are drawn [m].
        draw: Draws the world of a seed.
        frozen: The hashes.

    Returns:
        Whether there are hashes for this world file and this vehicle.

    Raises:
        UserError: If the worlds are not the frozen ones.
    """
    if name not in frozen.hashes or abs(vehicle_width - frozen.vehicle_width) > 1e-9:
        return False
    seeds = SPLITS[split]
    for block, expected in enumerate(frozen.hashes[name][split][: -(-worlds // BLOCK)]):
        first = block * BLOCK
        if block_hash([draw(seed) for seed in seeds[first : first + BLOCK]]) != expected:
            raise UserError(
                f"world '{name}': {split} worlds {seeds[first]} to {seeds[first + BLOCK - 1]} are not the frozen ones, "
                "so figures would not compare; undo the change to the world file or its generator, or freeze anew with "
                "scripts/freeze_splits.py and regenerate every result"
            )
    return True
