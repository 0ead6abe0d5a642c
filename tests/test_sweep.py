"""Sweeps: what a file may ask, the same trials however they are run, and what is left of them."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nnql_bullet as nb
from nnql_bullet.errors import UserError, WorkFailed
from nnql_bullet.evaluation import sweep as trainings
from nnql_bullet.evaluation.space import Trial, bars, best_of, is_hopeless, read_space
from nnql_bullet.evaluation.sweep import read_sweep
from nnql_bullet.presets import load_config
from nnql_bullet.run_config import RunConfig
from nnql_bullet.runs import load_run

Cli = Callable[..., tuple[int, str, str]]
Write = Callable[..., Path]
BASE = """\
world = "{world}"
simulator = "kinematic"
vehicles = 4
episodes = 8
task = {{ max_steps = 40 }}
agent = {{ kind = "q_table" }}
training = {{ evaluate_every = 4, evaluate_count = 4 }}
"""
SPACE = """\
[sweep]
trials = 5
random = 2
together = 2
[sweep.space]
agent.discount = {{ low = 0.1, high = 0.9 }}
agent.temperature_max = {{ low = 0.1, high = 10.0, log = true }}
task.max_steps = {{ low = 30, high = 50 }}
task.closer = ["smallest", "mean"]
"""


@pytest.fixture
def write(tmp_path: Path, small_world: Path) -> Write:
    """Writes a file of a sweep."""

    def make(text: str = BASE + SPACE, name: str = "small.toml") -> Path:
        path = tmp_path / name
        path.write_text(text.format(world=small_world))
        return path

    return make


def ranges(**values: Any) -> dict[str, Any]:
    return {"agent": {"gradient_step": {"low": 0.1, "high": 2.0} | values}}


class TestSpace:
    @pytest.mark.parametrize(
        ("values", "said"),
        [
            ({}, "names no key to search"),
            ({"agent": {"discont": [0, 1]}}, r"unknown key 'agent.discont' \(did you mean 'agent.discount'\?\)"),
            ({"agent": {"hidden": [[8], [9]]}}, "unknown key 'agent.hidden'"),  # of another kind of agent
            ({"seed": [1, 2]}, "'seed' is the same for all trials"),
            ({"agent": {"discount": [0.5]}}, "needs two values"),
            ({"agent": {"discount": 0.5}}, "needs a list of values, or a table"),
            ({"agent": {"discount": {"low": 0.5, "high": 2.0}}}, "'agent.discount': input should be less than"),
            ({"agent": {"encoding": ["proximity", "near"]}}, "'agent.encoding'"),
            ({"agent": {"encoding": {"low": 0, "high": 1}}}, "takes no numbers from a range"),
            ({"agent": {"hidden_units": {"low": 1.5, "high": 3}}}, "takes whole numbers"),
            (ranges(low=3.0), "low 3 is not below high 2"),
            (ranges(low=0.0, log=True), "log needs a low above 0"),
            (ranges(heigh=3.0), "unknown key 'heigh'"),
            ({"agent": {"discount": {"low": 0.1}}}, "key 'high' is missing"),
        ],
    )
    def test_what_is_wrong_is_named(self, values: dict[str, Any], said: str) -> None:
        with pytest.raises(UserError, match=said):
            read_space(values, RunConfig(), "file", "nnql", ("seed",))

    def test_its_values_make_options(self) -> None:
        space = read_space(
            {"agent.hidden_units": {"low": 3, "high": 9}, "drive": {"speed": [1.0, 2.0]}}, RunConfig(), "file", "nnql"
        )
        assert space.own == {"agent.hidden_units": 6, "drive.speed": "2.0"}
        made = space.options({"agent.hidden_units": 4, "drive.speed": "1.0"})
        assert (made.agent.hidden_units, made.drive.speed) == (4, 1.0)  # type: ignore[union-attr]
        assert read_space(ranges(low=1.0), RunConfig(), "file", "nnql").own is None  # 0.4 is not in it


class TestPruning:
    def test_the_bar_is_the_median_of_those_that_got_as_far(self) -> None:
        generator = np.random.default_rng(0)
        histories = [tuple(generator.random(generator.integers(1, 5)).tolist()) for _ in range(30)]
        trials = [Trial(i, {}, its, "failed" if i % 7 == 0 else "pruned") for i, its in enumerate(histories)]
        found = bars(trials, 4)
        for k in range(3):
            values = [its[k] for i, its in enumerate(histories) if i % 7 and len(its) > k]
            assert found[k] == pytest.approx(np.median(values))
        assert len(found) == 3
        assert bars(trials[:5], 4) == ()

    def test_the_best_so_far_decides_and_the_last_evaluation_never(self) -> None:
        assert is_hopeless([0.1], (0.2, 0.3))
        assert not is_hopeless([0.4, 0.1], (0.2, 0.3))
        assert not is_hopeless([0.1, 0.1, 0.1], (0.2, 0.3))
        assert not is_hopeless([], (0.2,))

    def test_of_equals_the_steadier_is_best(self) -> None:
        trials = [
            Trial(0, {}, (0.1, 0.8), "trained"),
            Trial(1, {}, (0.5, 0.8), "trained"),
            Trial(2, {}, (1.0,), "pruned"),
        ]
        assert best_of(trials) is trials[1]
        assert best_of(trials[2:]) is None


class TestFile:
    @pytest.mark.parametrize(
        ("text", "said"),
        [
            (BASE, r"has no table \[sweep\]"),
            (BASE + SPACE.replace("trials", "tirals"), "unknown key 'tirals'.*did you mean 'trials'"),
            (BASE.replace("evaluate_every = 4", "evaluate_every = 3") + SPACE, "that divides the 8 episodes"),
            (BASE.replace("episodes = 8", "episode = 8") + SPACE, "unknown key 'episode'"),
            (BASE + SPACE + 'world = ["cover_10", "traps"]', "'world' is searched; give training.evaluate_worlds"),
        ],
    )
    def test_what_is_wrong_is_named(self, write: Write, text: str, said: str) -> None:
        with pytest.raises(UserError, match=said):
            read_sweep(write(text))


class TestSweep:
    pytest.importorskip("optuna", reason="needs the extra [sweep]")

    @pytest.mark.slow
    def test_interrupts_and_workers_change_nothing(
        self, write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        file = write()
        whole = nb.sweep(file, out=tmp_path / "whole")
        assert len(whole.rows) == 5
        assert len({tuple(its.values.items()) for its in whole.trials}) == 5

        def dying(task: Any) -> Trial:
            if task.number == 3:
                raise KeyboardInterrupt
            return trainings.train_trial(task)

        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr("nnql_bullet.api.sweep.train_trial", dying)
            nb.sweep(file, out=tmp_path / "parts")
        done = (tmp_path / "parts" / "trials" / "0002" / "episodes.csv").stat().st_mtime_ns
        assert nb.sweep(file, trials=3, out=tmp_path / "parts").rows == whole.rows[:3]
        assert (tmp_path / "parts" / "trials" / "0002" / "episodes.csv").stat().st_mtime_ns == done  # not trained again
        assert nb.sweep(file, out=tmp_path / "parts").rows == whole.rows
        assert nb.sweep(file, out=tmp_path / "parts").rows == whole.rows  # it is over

    def test_the_best_is_a_configuration_that_trains_to_the_same(self, write: Write, tmp_path: Path) -> None:
        results = nb.sweep(write(), trials=2, out=tmp_path / "sweep")
        best = tmp_path / "sweep" / "best.toml"
        assert load_config(str(best), {}) == results.config
        run = nb.train(best, out=tmp_path / "run")
        assert tuple(its.success for its in run.evaluations) == results.best.history
        assert {its.name for its in (tmp_path / "sweep").iterdir()} == {
            *("study.db", "trials", "best.toml", "sweep.csv", "sweep.json", "sweep.png"),
        }

    def test_a_trial_without_prospects_ends_early(
        self, write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("nnql_bullet.api.sweep.bars", lambda trials, evaluations: (1.1,) if trials else ())
        results = nb.sweep(write(), out=tmp_path / "sweep")
        assert [its.state for its in results.trials] == ["trained", "trained", "pruned", "pruned", "pruned"]
        assert len(load_run(tmp_path / "sweep" / "trials" / "0003").evaluations) == 1

    def test_values_that_do_not_go_together_are_a_failed_trial(
        self, write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        values = {"agent.discount": 0.5, "agent.temperature_max": 0.1, "task.max_steps": 40, "task.closer": '"mean"'}
        file = write(BASE + SPACE + "agent.temperature_min = {{ low = 0.05, high = 0.2 }}\n")
        monkeypatch.setattr(
            "nnql_bullet.evaluation.search.Search.draw", lambda *_: values | {"agent.temperature_min": 0.15}
        )
        with pytest.raises(WorkFailed, match=r"none of 1 trials.*temperature_min 0.15 is above"):
            nb.sweep(file, trials=1, out=tmp_path / "sweep")

    def test_another_sweep_is_not_mixed_in(self, write: Write, tmp_path: Path) -> None:
        nb.sweep(write(), trials=1, out=tmp_path / "sweep")
        with pytest.raises(UserError, match="holds a search among other values"):
            nb.sweep(write((BASE + SPACE).replace("0.9", "0.8"), "other.toml"), out=tmp_path / "sweep")
        (tmp_path / "sweep" / "study.db").write_text("not a database, but a text that is long enough" * 9)
        with pytest.raises(UserError, match="cannot be read as a study of Optuna"):
            nb.sweep(write(), out=tmp_path / "sweep")

    @pytest.mark.slow
    def test_processes_give_the_same(self, write: Write, tmp_path: Path) -> None:
        file = write()
        rows = nb.sweep(file, trials=4, executor="processes", workers=2, out=tmp_path / "two").rows
        assert rows == nb.sweep(file, trials=4, out=tmp_path / "one").rows


class TestCommandLine:
    def test_it_says_what_is_best(self, run_cli: Cli, write: Write, tmp_path: Path) -> None:
        pytest.importorskip("optuna", reason="needs the extra [sweep]")
        code, out, err = run_cli("sweep", write(), "--trials", "2", "--executor", "inline", "--out", tmp_path / "s")
        assert code == 0, err
        assert out.splitlines()[0].split() == [
            "trial",
            "success",
            *("agent.discount", "agent.temperature_max"),
            *("task.max_steps", "task.closer"),
        ]
        assert "train --config" in out

    def test_without_optuna_it_names_the_extra(
        self, run_cli: Cli, write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setitem(sys.modules, "nnql_bullet.evaluation.search", None)
        code, _, err = run_cli("sweep", write(), "--out", tmp_path / "sweep")
        assert code == 2
        assert "pip install 'nnql-bullet[sweep]'" in err
        assert not (tmp_path / "sweep").exists()
