"""Figures of the README and the docs are those of results/."""

import importlib
import re
from pathlib import Path
from types import ModuleType

import pytest

import nnql_bullet as nb
from nnql_bullet.commands import train_arguments
from nnql_bullet.config import read_toml

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def claims(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "docs_site"))
    return importlib.import_module("claims")


def test_what_the_repository_says_stands(claims: ModuleType) -> None:
    assert importlib.import_module("hooks").complaints() == []


def test_make_installs_every_extra_and_the_tutorial_names_those_of_a_user() -> None:
    extras = set(read_toml(ROOT / "pyproject.toml")["project"]["optional-dependencies"])
    (installed,) = re.findall(r"--editable '\.\[(.*)\]'", (ROOT / "Makefile").read_text())
    assert set(installed.split(",")) == extras
    tutorial = (ROOT / "docs" / "tutorial.md").read_text()
    (named,) = re.findall(r"(?s)The optional parts are extras: (.*?)\n\n", tutorial)
    assert set(re.findall(r"(?:`|\.\[)(\w+)\]?'?`\s\(", named)) == extras - {"dev", "docs"}


def test_a_typed_figure_is_found_and_a_rendered_one_is_not(claims: ModuleType) -> None:
    for figure in (
        "97.5 (87.1 to 99.6)",
        "16 % (8.3-28.5)",
        "98 (97-99)",
        "none collides (0 to 3.7 %)",
        "(Wilson 95 % interval 93.0 to 99.4 %)",
    ):
        assert len(claims.typed(f"So {figure}, and\n| {figure} |")) == 2, figure
    for none in (
        "{{ success covers paper cover_10 }}",
        "(seeds 0 to 4 at 5 %)",
        "others (900000 to 900099)",
        "`x (1.0-2.0)`",
    ):
        assert claims.typed(f"So {none}.") == [], none


def test_a_new_figure_and_a_claim_that_results_do_not_hold_are_refused(claims: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text("It succeeds in 99.9 % (98.0 to 100 %).")
    (tmp_path / "docs" / "page.md").write_text("In {{ rate a }} and {{ rate b }}; {{ other }}.")
    typed, wrong = claims.complaints(tmp_path, {"rate": {"a": "1 %"}.__getitem__})
    assert typed.startswith("README.md: 1 figures are typed, 0 are known")
    assert wrong == "page.md: {{ rate b }}: 'b'"
    assert claims.filled("In {{ rate a }}.", {"rate": {"a": "1 %"}.__getitem__}) == "In 1 %."


def test_a_training_that_is_kept_is_what_its_folder_is_named_after() -> None:
    folders = sorted((ROOT / "results" / "trained").iterdir())
    assert folders
    for folder in folders:
        policy, (maker, *_) = nb.load_policy(folder), nb.load_run(folder).makers
        config = policy.experiment.config
        preset, _ = train_arguments(config)
        assert folder.name == f"{preset}-{config.seed}"
        assert maker["code"]
        assert policy.episodes > 0
