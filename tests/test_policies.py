"""The trained policies that are shipped: that they are whole, are what their cards say, and can be driven by name."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from nnql_bullet import assets
from nnql_bullet.config import to_values, write_toml
from nnql_bullet.errors import UserError
from nnql_bullet.runs import drives_folder, load_policy

Run = Callable[..., tuple[int, str, str]]
shipped = pytest.mark.parametrize("name", assets.policies())


def test_some_are_shipped_and_small() -> None:
    assert {"double_dqn", "paper"} <= set(assets.policies())
    assert sum(path.stat().st_size for path in assets.policies().values()) < 1_000_000


@shipped
def test_a_card_says_what_the_policy_is(name: str) -> None:
    policy = load_policy(Path(name), {})
    experiment, episodes = policy.experiment, policy.episodes
    text = assets.card(assets.policies()[name]).read_text(encoding="utf-8")
    assert text.startswith(f"# {name}: ")
    assert f"{episodes} episodes, seed {experiment.config.seed}" in text.splitlines()[0]
    assert f"```toml\n{write_toml(to_values(experiment.config)).strip()}\n```" in text
    for part in ("## How good", "kinematic", "contact physics", "## Limits"):
        assert part in text


def test_drives_of_shipped_policies_are_kept_where_one_may_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert drives_folder(Path("double_dqn")) == Path("runs/double_dqn/drives")


def test_a_file_of_that_name_goes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("paper").write_text("something else")
    with pytest.raises(UserError, match="paper: damaged"):
        load_policy(Path("paper"), {})


def test_they_are_listed_with_what_they_are(run_cli: Run) -> None:
    code, out, _ = run_cli("policies")
    assert code == 0
    assert [line.partition(":")[0] for line in out.splitlines()] == list(assets.policies())
    assert run_cli("policies", "paper")[1].startswith("# paper: ")


def test_what_is_not_shipped_is_refused_with_what_is(run_cli: Run) -> None:
    names = ", ".join(assets.policies())
    assert run_cli("policies", "nobody") == (
        2,
        "",
        f"nnql-bullet: there is no shipped policy 'nobody'; there are: {names}\n",
    )
    code, _, err = run_cli("drive", "nobody")
    assert code == 2
    assert f"policies: {names}; rules: " in err


def test_without_a_policy_the_best_one_drives(run_cli: Run, tmp_path: Path, small_world: Path) -> None:
    """A new user sees a good drive."""
    code, out, _ = run_cli("drive", "--world", small_world, "--seed", 2, "--json", "--out", tmp_path)
    assert (code, json.loads(out)["ending"]) == (0, "goal")
