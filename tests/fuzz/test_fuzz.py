"""Some mutated files of every class, always the same ones; `fuzz.py` reads many more by hand."""

from pathlib import Path

import pytest
from fuzz import faults, limited
from targets import Target, targets

INPUTS = 60
CLASSES = (
    *("configuration", "worlds", "robots", "policies", "checkpoints", "episodes.csv", "recordings", "results.json"),
    *("splits", "parts", "sources", "folders of worlds", "maps", "BARN", "way points", "descriptions"),
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Target]:
    return targets(tmp_path_factory.mktemp("valid"))


@pytest.mark.parametrize("name", CLASSES)
def test_a_file_is_read_or_refused_in_one_line(made: dict[str, Target], name: str, tmp_path: Path) -> None:
    assert made.keys() == set(CLASSES)
    with limited():
        assert list(faults(made[name], name, INPUTS, 0, tmp_path)) == []
