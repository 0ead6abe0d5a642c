"""The cards of run folders: what the Hub reads, and what is left to their authors."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import nnql_bullet as nb
from nnql_bullet.reports.card import MARK

Cli = Callable[..., tuple[int, str, str]]


def front(card: Path) -> dict[str, Any]:
    """The front matter of a card."""
    begin, head, _ = card.read_text(encoding="utf-8").split("---\n", 2)
    assert begin == ""
    found: dict[str, Any] = yaml.safe_load(head)
    return found


def train(small_config: Path, out: Path, **more: Any) -> Path:
    values: dict[str, Any] = {"simulator": "kinematic", "vehicles": 4, "episodes": 8, "agent": {"kind": "q_table"}}
    return nb.train(small_config, out=out, **values | more).folder / "README.md"


def test_it_has_what_the_hub_reads(tiny_run: Path) -> None:
    found = front(tiny_run / "README.md")
    assert found["library_name"] == "nnql-bullet"
    assert {"reinforcement-learning", "nnql"} <= set(found["tags"])
    assert "model-index" not in found  # nothing was measured
    text = (tiny_run / "README.md").read_text()
    assert "nnql-bullet train --config" in text
    assert "Not measured yet" in text


def test_its_result_is_that_of_the_last_evaluation(small_config: Path, tmp_path: Path) -> None:
    card = train(small_config, tmp_path / "run", training={"evaluate_every": 4, "evaluate_count": 5})
    (model,) = front(card)["model-index"]
    (result,) = model["results"]
    last = nb.load_run(tmp_path / "run").evaluations[-1]
    assert result["metrics"][0]["value"] == last.goals / 5
    assert "5 validation worlds" in result["dataset"]["name"]
    assert {"type", "name"} <= result["task"].keys()


def test_or_that_of_the_selection(small_config: Path, tmp_path: Path) -> None:
    card = train(small_config, tmp_path / "run", training={"selection": {"candidates": 2, "every": 4, "count": 4}})
    rows = [line.split(",") for line in (tmp_path / "run" / "selection.csv").read_text().splitlines()[1:]]
    (goals,) = [int(row[1]) for row in rows if row[3] == "1"]
    assert front(card)["model-index"][0]["results"][0]["metrics"][0]["value"] == goals / 4


def test_what_python_adds_is_said_and_no_command_claimed(small_config: Path, tmp_path: Path) -> None:
    text = train(small_config, tmp_path / "run", reward=lambda t: np.zeros(len(t.a_tm1))).read_text()
    assert "Trained in Python, with a reward of the author's own" in text
    assert "train --config" not in text


@pytest.mark.parametrize("own", [False, True])
def test_it_is_written_anew_unless_it_is_an_authors(tiny_run: Path, tmp_path: Path, own: bool) -> None:
    run = shutil.copytree(tiny_run, tmp_path / "run")
    text = (run / "README.md").read_text()
    assert MARK in text
    (run / "README.md").write_text(text.replace(MARK if own else "after 12 training", "mine"))
    nb.resume(run)
    assert ("mine" in (run / "README.md").read_text()) == own
