"""What holds for every agent that learns."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import pytest
from helpers import same
from safetensors.numpy import load_file

from nnql_bullet.agents import LearnerOptions

Cli = Callable[..., tuple[int, str, str]]
SMALL: dict[str, tuple[str, str]] = {
    "nnql": ("", "temperature,td_error"),
    "q_table": ("", "temperature,states,table_share,td_error"),
    "genetic": ("population = 4\nworlds = 2\nelites = 1", "generation,genome"),
    "double_dqn": (
        "hidden = [8]\nbatch_size = 8\nlearning_starts = 40\nbuffer_size = 200",
        "exploration,learning_rate,td_error",
    ),
    "distilled": (
        "hidden = [8]\nbatch_size = 8\nlearning_starts = 40\nbuffer_size = 200\nsearch.depth = 2\nsearch.width = 2",
        "led,learning_rate,td_error",
    ),
    "sb3_dqn": ("hidden = [8]\nbuffer_size = 1000\nlearning_starts = 20", "exploration"),
}
"""By kind: options with which a few episodes learn something, and the columns that it adds to episodes.csv."""


@pytest.fixture(params=SMALL)
def kind(request: pytest.FixtureRequest) -> Any:
    return request.param


def test_every_kind_is_here() -> None:
    assert SMALL.keys() == {options.kind for options in get_args(LearnerOptions)}


def test_in_two_parts_and_with_other_workers_is_as_in_one(
    kind: str, run_cli: Cli, small_config: Path, tmp_path: Path
) -> None:
    options, columns = SMALL[kind]
    config, one, two = tmp_path / "config.toml", tmp_path / "one", tmp_path / "two"
    config.write_text(f"{small_config.read_text()}\n[agent]\nkind = '{kind}'\n{options}\n")
    more = ("--config", config, "--sim", "kinematic", "--vehicles", 3)
    assert run_cli("train", *more, "--episodes", 12, "--workers", 1, "--out", one)[0] == 0
    assert run_cli("train", *more, "--episodes", 5, "--workers", 2, "--out", two)[0] == 0
    assert run_cli("train", "--resume", two, "--episodes", 12)[0] == 0
    for name in ("episodes.csv", "config.toml"):
        assert (one / name).read_bytes() == (two / name).read_bytes(), name
    for name in ("checkpoint.safetensors", "policy.safetensors"):
        assert same(load_file(one / name), load_file(two / name)), name
    assert (one / "episodes.csv").read_text().splitlines()[0].endswith(f",failure,{columns}")
    code, out, _ = run_cli("drive", one, "--sim", "kinematic", "--json")
    assert code == 0
    assert '"ending"' in out
