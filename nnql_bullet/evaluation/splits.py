"""The worlds that policies are judged in: frozen, so that a figure can be regenerated, and known to be the same ones.

Choices are made on the split `validation`; `test` is for the final table. The first worlds of both are kept as hashes,
block by block, for every shipped world file. A generator that has changed would silently give other worlds; here it is
refused.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from nnql_bullet import assets
from nnql_bullet.errors import UserError
from nnql_bullet.seeding import TEST_WORLDS, VALIDATION_WORLDS
from nnql_bullet.worlds.spec import WorldSpec

SplitName = Literal["validation", "test"]
SPLITS: dict[SplitName, range] = {"validation": VALIDATION_WORLDS, "test": TEST_WORLDS}

BLOCK = 25
"""Worlds that share a hash."""
FROZEN = 1000
"""Worlds of each split that have one."""
_FILE = "splits.json"


@dataclass(frozen=True, slots=True)
class FrozenSplits:
    """What was written down when the splits were frozen."""

    room: float
    """Half width of the path that every world has [m]: it decides which draws are taken, and belongs to a vehicle."""
    hashes: Mapping[str, Mapping[str, Sequence[str]]]
    """Of each block, by world file and split."""


def split_seeds(split: SplitName, worlds: int) -> range:
    """The seeds of a split's first worlds.

    Raises:
        UserError: If there are not so many that are frozen.
    """
    if not 1 <= worlds <= FROZEN:
        raise UserError(f"the number of worlds must be from 1 to {FROZEN}, the worlds that are frozen, not {worlds}")
    return SPLITS[split][:worlds]


def load_frozen() -> FrozenSplits:
    """The shipped hashes."""
    values = json.loads((assets.folder("worlds") / _FILE).read_text(encoding="utf-8"))
    return FrozenSplits(values["room"], values["worlds"])


def block_hash(worlds: Sequence[WorldSpec]) -> str:
    """One hash of several worlds, from their own."""
    return hashlib.sha256("".join(world.digest for world in worlds).encode()).hexdigest()[:16]


def check_frozen(
    name: str, split: SplitName, worlds: int, room: float, draw: Callable[[int], WorldSpec], frozen: FrozenSplits
) -> bool:
    """Whether a split's first worlds are the frozen ones, as far as such worlds were frozen.

    Args:
        name: Of the world file.
        split: Which.
        worlds: How many; the blocks that they are in are drawn whole.
        room: Half width of the path that is asked of worlds [m].
        draw: The world of a seed.
        frozen: The hashes.

    Returns:
        Whether there was something to compare: a shipped world file, for a vehicle as wide as the shipped one.

    Raises:
        UserError: If they are other worlds.
    """
    if name not in frozen.hashes or abs(room - frozen.room) > 1e-9:
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
