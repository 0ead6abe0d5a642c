"""`evaluate`: grouping, metrics against plain sums, pieces that are kept, and a report that repeats itself."""

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.stats import binom

import nnql_bullet as nb
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.drives import Drawn, DriveTask, Tier, draw_tiers, drive, drive_tasks
from nnql_bullet.evaluation.metrics import EVERYWHERE, Evaluation, comparisons, rows
from nnql_bullet.evaluation.parts import Parts, part_name
from nnql_bullet.evaluation.policies import Policy, open_policies
from nnql_bullet.evaluation.splits import Draws
from nnql_bullet.evaluation.statistics import proportion
from nnql_bullet.geometry import OrientedBox, Pose
from nnql_bullet.recording import load_recording
from nnql_bullet.reports.evaluation import counted
from nnql_bullet.rollout import EpisodeSummary
from nnql_bullet.run_config import Conditions
from nnql_bullet.setting import Setting
from nnql_bullet.task import ENDINGS
from nnql_bullet.worlds.paths import Difficulty, difficulty
from nnql_bullet.worlds.spec import WorldSpec

RunCli = Callable[..., tuple[int, str, str]]
Snapshot = Callable[[Path], dict[str, bytes]]

KINEMATIC = Setting("kinematic", "reference")


def policy(name: str, method: str, seed: int = 0) -> Policy:
    return Policy(name, name, method, "nnql", seed, 100, 89, "It drives.", 0.8, "f" + name)


def summary(ending: str, path_length: float = 100.0, seed: int = 0) -> EpisodeSummary:
    return EpisodeSummary(seed, ending, 40, path_length / 2, path_length, 0.5, 3.0, 2.0, 0.1, 10, 1.0, {})


def tier(name: str, worlds: int, cover: float | None = None) -> Tier:
    return Tier(name, name, cover, tuple(Drawn(name, k, f"{name}-{k}") for k in range(worlds)), True)


def evaluation_of(endings: dict[tuple[str, str], str], methods: dict[str, str]) -> Evaluation:
    """From the first letters of endings, by policy and tier; the shortest path is 80 m everywhere."""
    names = {"g": "goal", "c": "collision", "t": "timeout", "s": "stuck", "o": "overturned"}
    tiers = {name: tier(name, len(letters)) for (_, name), letters in endings.items()}
    return Evaluation(
        asked=list(tiers),
        draws=Draws(range(9), None),
        setting=KINEMATIC,
        policies=[policy(name, method) for name, method in methods.items()],
        tiers=list(tiers.values()),
        difficulties={
            its.name: [Difficulty(0.05, 3.0, 80.0, 1.0, 5.0, 20.0)] * len(its.worlds) for its in tiers.values()
        },
        drives={key: [summary(names[letter]) for letter in letters] for key, letters in endings.items()},
    )


class TestMetrics:
    E = evaluation_of(
        {
            ("a-0", "easy"): "gggc",
            ("a-1", "easy"): "ggtc",
            ("rule", "easy"): "gcgg",
            ("a-0", "hard"): "gctc",
            ("a-1", "hard"): "cccc",
            ("rule", "hard"): "tstg",
        },
        {"a-0": "a", "a-1": "a", "rule": "rule"},
    )

    def row(self, method: str, world: str) -> object:
        (found,) = [row for row in rows(self.E) if (row.method, row.world) == (method, world)]
        return found

    def test_outcomes_are_shares_of_all_drives_and_add_up_to_one(self) -> None:
        found = {(r.method, r.world): [r.outcomes[ending].value for ending in ENDINGS] for r in rows(self.E)}
        assert found == {
            ("a", "easy"): [5 / 8, 2 / 8, 1 / 8, 0, 0],
            ("a", "hard"): [1 / 8, 6 / 8, 1 / 8, 0, 0],
            ("a", EVERYWHERE): [6 / 16, 8 / 16, 2 / 16, 0, 0],
            ("rule", "easy"): [3 / 4, 1 / 4, 0, 0, 0],
            ("rule", "hard"): [1 / 4, 0, 2 / 4, 1 / 4, 0],
            ("rule", EVERYWHERE): [4 / 8, 1 / 8, 2 / 8, 1 / 8, 0],
        }

    def test_success_of_each_seed(self) -> None:
        found = {(r.method, r.world): r.by_seed for r in rows(self.E)}
        assert found["a", "easy"] == (0.75, 0.5)
        assert found["a", EVERYWHERE] == (0.5, 0.25)
        assert found["rule", "hard"] == (0.25,)

    def test_over_seeds_is_there_where_there_are_several(self) -> None:
        found = {(r.method, r.world): r.over_seeds for r in rows(self.E)}
        assert found["rule", "easy"] is None
        a = found["a", "easy"]
        assert a is not None
        assert a.value == pytest.approx(0.625)
        assert a.low < 0.5 < 0.75 < a.high  # worlds vary too

    def test_spl_is_success_times_shortest_over_driven(self) -> None:
        (found,) = [r for r in rows(self.E) if (r.method, r.world) == ("a", "easy")]
        assert found.spl == pytest.approx(5 / 8 * 80 / 100)
        assert found.path_ratio == pytest.approx(100 / 80)
        assert found.time == pytest.approx(50.0)

    def test_a_path_shorter_than_the_discs_counts_as_the_shortest(self) -> None:
        short = replace(self.E, drives={key: [summary("goal", 60.0)] * 4 for key in self.E.drives})
        assert {r.spl for r in rows(short)} == {1.0}

    def test_what_is_a_mean_over_arrivals_is_nan_without_any(self) -> None:
        none = replace(self.E, drives={key: [summary("timeout")] * 4 for key in self.E.drives})
        for found in rows(none):
            assert np.isnan([found.path_ratio, found.time, found.clearance]).all()
            assert found.spl == 0.0

    def test_non_safe_is_a_share_of_decisions(self) -> None:
        assert {r.non_safe for r in rows(self.E)} == {10 / 40}

    def test_an_overridden_share_is_told_per_drive_and_pooled(self) -> None:
        long = replace(summary("goal"), steps=90, overridden_steps=90)
        short = replace(summary("goal"), steps=10, overridden_steps=0)
        drives = {key: [long, short, short, short] for key in self.E.drives}
        (found, *_) = rows(replace(self.E, drives=drives))
        assert (found.overridden, found.overridden_by_drive) == pytest.approx((90 / 120, 1 / 4))
        for name in ("overridden", "overridden_by_drive"):
            low, high = found.intervals[name]
            assert low == 0.0 < getattr(found, name) < high
        assert np.isnan(found.intervals["stops"]).all()  # never: there is nothing to draw from

    def test_pairs_are_of_each_policy_with_the_single_one_and_mcnemar_of_single_policies_only(self) -> None:
        found = {(c.world, c.first, c.second): c for c in comparisons(self.E)}
        easy = found["easy", "a", "rule"]  # a-0: +- 2nd, -+ 4th; a-1: +- 2nd, -+ 3rd and 4th
        assert (easy.pairs, easy.only_first, easy.only_second, easy.p_value) == (8, 2, 3, None)
        assert easy.difference.value == pytest.approx(3 / 4 - 5 / 8)
        assert easy.difference.low < 0 < easy.difference.high
        assert found[EVERYWHERE, "a", "rule"].only_second == 3 + 2
        single = replace(self.E, policies=[self.E.policies[0], self.E.policies[2]])
        (found_single,) = [c for c in comparisons(single) if c.world == "hard"]
        assert (found_single.only_first, found_single.only_second) == (1, 1)
        assert found_single.p_value == pytest.approx(min(1.0, 2 * binom.cdf(1, 2, 0.5)))


class TestCounting:
    """Copies of a drive count once: 100 equal drives say no more than one."""

    def counted(self, letters: str, digests: str, seeds: list[int]) -> tuple[int, Evaluation]:
        e = evaluation_of({("a", "t"): letters}, {"a": "a"})
        worlds = tuple(Drawn(f"{d}.toml", seed, d) for d, seed in zip(digests, seeds, strict=True))
        e = replace(e, tiers=[replace(e.tiers[0], worlds=worlds)])
        (row,) = rows(e)
        return row.drives, e

    def test_equal_drives_through_equal_worlds_are_one(self) -> None:
        drives, e = self.counted("gggg", "xxxx", [0, 1, 2, 3])
        assert drives == 1
        (row,) = rows(e)
        assert row.outcomes["goal"] == proportion(1, 1)
        assert counted(e) == "1 drive (nothing is random)"

    def test_drives_that_differ_count_each_as_does_each_world(self) -> None:
        assert self.counted("ggcg", "xxxx", [0, 1, 2, 3])[0] == 4
        assert self.counted("gggg", "xyzx", [0, 0, 0, 0])[0] == 3

    def test_a_copied_file_counts_once_for_each_seed(self) -> None:
        drives, e = self.counted("gcgc", "xxxx", [0, 1, 0, 1])
        assert drives == 2
        assert "(2 of a in t count, the others are copies)" in counted(e)

    def test_spl_is_a_share_wherever_the_target_is(self) -> None:
        rng = np.random.default_rng(0)
        for _ in range(60):
            radius = float(rng.uniform(0.3, 3.0))
            x, y = (rng.uniform(4, 16, 2)).tolist()
            away, bearing = radius + float(rng.exponential(0.2)) + 1e-6, float(rng.uniform(-np.pi, np.pi))
            target = x + away * np.cos(bearing), y + away * np.sin(bearing)
            boxes = [OrientedBox(*rng.uniform(2, 18, 2), *rng.uniform(0.1, 1.0, 2), 0.3) for _ in range(5)]
            world = WorldSpec("near", 0, 20.0, 20.0, tuple(boxes), Pose(x, y, 0.0), target, radius, 1.5)
            measured = difficulty(world, 0.65)
            assert measured.shortest_path > 0
            e = evaluation_of({("a", "t"): "g"}, {"a": "a"})
            driven = {("a", "t"): [summary("goal", float(rng.uniform(0, 1)))]}
            e = replace(e, difficulties={"t": [measured]}, drives=driven)
            assert all(0 <= row.spl <= 1 for row in rows(e))


@pytest.fixture
def maps(tmp_path: Path) -> Path:
    """A folder with two worlds, a copy of one, and three that are refused."""
    folder = tmp_path / "maps"
    folder.mkdir()
    text = (
        "width = 20.0\ndepth = 10.0\nstart = [3, 5]\ntarget = [17, 5]\n[layout]\nkind = 'boxes'\n"
        "boxes = [{ x = 10.0, y = %s, length = 1.0, width = %s }]\n"
    )
    for name, values in {"a": (8, 1), "b": (5, 1), "copy": (8, 1), "wall": (5, 10), "start": (3, 5)}.items():
        world = text % values
        (folder / f"{name}.toml").write_text(world.replace("x = 10.0", "x = 3.0") if name == "start" else world)
    (folder / "key.toml").write_text("widht = 3")
    (folder / "notes.txt").write_text("not a world")
    return folder


class TestFolders:
    def test_they_are_one_kind_and_what_is_refused_is_listed(
        self, maps: Path, tmp_path: Path, run_cli: RunCli, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)
        where = ("--world", "maps/", "--sim", "kinematic", "--executor", "inline", "--out", "out")
        code, printed, _ = run_cli("evaluate", "straight", *where)
        assert code == 0
        refused = [line for line in printed.splitlines() if line.startswith("refused: ")]
        assert [line.split(": ")[1] for line in refused] == ["maps/key.toml", "maps/start.toml", "maps/wall.toml"]
        values = json.loads((tmp_path / "out" / "results.json").read_text())
        assert [its["file"] for its in values["refused"]] == ["maps/key.toml", "maps/start.toml", "maps/wall.toml"]
        assert "unknown key 'widht'" in values["refused"][0]["reason"]
        assert all(its["reason"] in (tmp_path / "out" / "evaluation.md").read_text() for its in values["refused"])
        ((row,), (tier,)) = values["rows"], values["tiers"]
        assert (row["world"], row["drives"], row["outcomes"]["goal"][0]) == ("maps", 2, 0.5)
        assert [its["file"] for its in tier["worlds"]] == ["maps/a.toml", "maps/b.toml", "maps/copy.toml"]
        assert values["command"].split()[3:8] == ["--world", "maps/", "--worlds", "100", "--split"]
        (failure,) = values["failures"]
        assert failure["recording"] == "failures/straight-maps-b-0.npz"
        code, printed, _ = run_cli("failures", "out")
        assert code == 0
        assert "1 of 1 failures" in printed or "1 failure" in printed

    def test_where_all_are_refused_nothing_is_driven(self, maps: Path, tmp_path: Path, run_cli: RunCli) -> None:
        for name in ("a", "b", "copy"):
            (maps / f"{name}.toml").unlink()
        out = tmp_path / "out"
        code, _, complaint = run_cli("evaluate", "straight", "--world", maps, "--sim", "kinematic", "--out", out)
        assert code == 2
        assert f"all 3 worlds are refused; the first, {maps}/key.toml: 2 things are wrong: (1) unknown key" in complaint
        assert not out.exists()

    def test_seeds_of_ones_own_draw_the_worlds(self, maps: Path, tmp_path: Path, run_cli: RunCli) -> None:
        out = tmp_path / "out"
        where = ("--world", f"cover_10,{maps}/a.toml", "--sim", "kinematic", "--executor", "inline", "--out", out)
        assert run_cli("evaluate", "straight", *where, "--seeds", "700000:700003")[0] == 0
        with (out / "episodes.csv").open(newline="") as file:
            driven = [(e["world"], int(e["world_seed"])) for e in csv.DictReader(file)]
        assert driven == [*(("cover_10", 700_000 + k) for k in range(3)), ("a", 700_000)]
        values = json.loads((out / "results.json").read_text())
        assert (values["split"], values["seeds"]) == (None, [700_000, 700_003])
        assert "--seeds 700000:700003" in values["command"]


class TestPolicies:
    def copies(self, tiny_run: Path, tmp_path: Path, *names: str) -> list[Path]:
        return [shutil.copytree(tiny_run, tmp_path / name) for name in names]

    def test_a_rule_is_its_own_method(self) -> None:
        (found,) = open_policies([Path("straight")])
        assert (found.name, found.method, found.kind) == ("straight", "straight", "straight")
        assert (found.episodes, found.learned) == (0, 0)

    def test_a_network_has_its_weights(self, tiny_run: Path) -> None:
        (found,) = open_policies([tiny_run])
        assert (found.episodes, found.learned) == (12, 8 * 6 + 6 + 6 * 5 + 5)

    def test_policies_that_differ_by_seed_alone_are_one_method(
        self, tmp_path: Path, small_config: Path, run_cli: RunCli
    ) -> None:
        for seed in range(2):
            out = tmp_path / f"mine-{seed}"
            arguments = ("--config", small_config, "--sim", "kinematic", "--episodes", 2, "--seed", seed, "--out", out)
            assert run_cli("train", *arguments)[0] == 0
        other = tmp_path / "other-0"
        assert run_cli("train", "--config", small_config, "--sim", "kinematic", "--episodes", 3, "--out", other)[0] == 0
        found = open_policies([tmp_path / "mine-0", other, tmp_path / "mine-1"])
        assert [(p.name, p.method, p.seed) for p in found] == [
            ("mine-0", "mine", 0),
            ("other-0", "other-0", 0),
            ("mine-1", "mine", 1),
        ]
        assert len({p.fingerprint for p in found}) == 3

    def test_names_take_as_much_of_the_path_as_tells_them_apart(self, tiny_run: Path, tmp_path: Path) -> None:
        first, second = self.copies(tiny_run, tmp_path, "one/run", "two/run")
        assert [p.name for p in open_policies([first, second])] == ["one/run", "two/run"]

    def test_the_fingerprint_is_of_what_it_does_not_of_where_it_lies(self, tiny_run: Path, tmp_path: Path) -> None:
        first, second = open_policies(self.copies(tiny_run, tmp_path, "one", "two"))
        assert first.fingerprint == second.fingerprint

    def test_a_policy_given_twice_is_refused(self) -> None:
        with pytest.raises(UserError, match="straight: is given twice"):
            open_policies([Path("straight"), Path("straight")])


class TestParts:
    def test_records_come_back_as_they_were(self, tmp_path: Path) -> None:
        parts = Parts(tmp_path / "parts")
        records = [summary("goal", 1 / 3), summary("timeout", 2 / 7, seed=5)]
        assert parts.load("x", EpisodeSummary) is None
        parts.save("x", records)
        assert parts.load("x", EpisodeSummary) == records

    @pytest.mark.parametrize("text", ["", "[{", '[{"ending": "goal"}]', "[3]", "7"])
    def test_damage_is_one_line_that_says_what_to_do(self, tmp_path: Path, text: str) -> None:
        (tmp_path / "x.json").write_text(text)
        with pytest.raises(UserError, match=r"x\.json: damaged \(.*\); delete it, and its work is done again"):
            Parts(tmp_path).load("x", EpisodeSummary)

    def test_names_change_with_whatever_the_result_depends_on(self) -> None:
        one, other = tier("t", 30), tier("u", 30)
        tasks = [
            DriveTask(policy("a", "a"), one, KINEMATIC, 0),
            DriveTask(policy("b", "b"), one, KINEMATIC, 0),
            DriveTask(policy("a", "a"), other, KINEMATIC, 0),
            DriveTask(policy("a", "a"), one, replace(KINEMATIC, simulator="bullet"), 0),
            DriveTask(policy("a", "a"), one, replace(KINEMATIC, simulator="bullet", physics="fast"), 0),
            DriveTask(policy("a", "a"), one, KINEMATIC, 25),
            DriveTask(policy("a", "a"), one, replace(KINEMATIC, conditions=Conditions(wheel_friction=0.5)), 0),
            DriveTask(policy("a", "a"), one, replace(KINEMATIC, conditions=Conditions(payload=0.5)), 0),
        ]
        assert len({task.part for task in tasks}) == len(tasks)
        assert DriveTask(policy("a", "z"), one, KINEMATIC, 0).part == tasks[0].part
        assert part_name("a", 1) == part_name("a", 1) != part_name("a", 2)


def test_pieces_are_all_worlds_once() -> None:
    tiers = [tier("one", 60), tier("two", 25)]
    tasks = drive_tasks([policy("a", "a"), policy("b", "b")], tiers, KINEMATIC)
    driven = [(task.policy.name, task.tier.name, world.seed) for task in tasks for world in task.tier.block(task.first)]
    assert sorted(driven) == sorted(
        (name, t.name, seed) for name in "ab" for t in tiers for seed in range(len(t.worlds))
    )
    assert sum(task.size for task in tasks) == len(driven)


def test_the_kinematic_model_drives_alike_all_at_once_and_one_by_one(small_world: Path, tiny_run: Path) -> None:
    (its,) = open_policies([tiny_run])
    (small,), _ = draw_tiers([small_world], Draws(range(3), None), KINEMATIC, [its])
    together = drive(DriveTask(its, small, KINEMATIC, 0))
    assert [s.world_seed for s in together] == [0, 1, 2]
    for k in range(3):
        alone = replace(small, worlds=small.worlds[k : k + 1])
        assert drive(DriveTask(its, alone, KINEMATIC, 0)) == together[k : k + 1]


@pytest.fixture(scope="module")
def evaluated(
    tmp_path_factory: pytest.TempPathFactory, tiny_run: Path, small_world: Path
) -> tuple[Path, tuple[object, ...]]:
    """A report of a run and a rule in two kinds of worlds, and the command's arguments but for --out."""
    from nnql_bullet.cli import main

    out = tmp_path_factory.mktemp("evaluation") / "report"
    where = ("--world", f"{small_world},cover_10", "--cover", "5", "--sim", "kinematic", "--worlds", "4")
    arguments = ("evaluate", tiny_run, "straight", *where)
    assert main([str(part) for part in (*arguments, "--executor", "inline", "--out", out)]) == 0
    return out, arguments


def test_a_plan_of_a_policy_s_own_leads_it_alone(tmp_path: Path) -> None:
    planned = tmp_path / "planned.toml"
    planned.write_text('[agent]\nkind = "straight"\n[plan]\n', encoding="utf-8")
    asked: dict[str, Any] = {"worlds": ["cover_20"], "n_worlds": 4, "simulator": "kinematic", "workers": 1}

    def endings(policies: list[str], **more: Any) -> dict[str, list[str]]:
        rows = nb.evaluate(policies, **asked, **more).episodes
        return {name: [its["ending"] for its in rows if its["method"] == name] for name in ("planned", "straight")}

    together, led = endings([str(planned), "straight"]), endings(["straight"], plan=True)["straight"]
    assert together == {"planned": led, "straight": endings(["straight"])["straight"]}
    assert led != together["straight"]


class TestCommand:
    def test_it_leaves_the_whole_report(self, evaluated: tuple[Path, tuple[object, ...]]) -> None:
        out, _ = evaluated
        files = {"evaluation.md", "results.json", "results.csv", "episodes.csv", "outcomes.png", "cover.png"}
        assert files <= {path.name for path in out.iterdir()}
        for picture in out.glob("*.png"):
            with Image.open(picture) as image:
                assert min(image.size) > 300

    def test_csv_json_and_drives_agree(self, evaluated: tuple[Path, tuple[object, ...]]) -> None:
        out, _ = evaluated
        values = json.loads((out / "results.json").read_text())
        with (out / "episodes.csv").open(newline="") as file:
            episodes = list(csv.DictReader(file))
        assert len(episodes) == 2 * 3 * 4
        for row in values["rows"]:
            its = [e for e in episodes if e["method"] == row["method"] and row["world"] in (e["world"], EVERYWHERE)]
            its = its or [e for e in episodes if e["method"] == row["method"]]
            goals = sum(e["ending"] == "goal" for e in its)
            assert row["outcomes"]["goal"][0] == pytest.approx(goals / len(its))
            spl = sum(
                float(e["shortest_path"]) / max(float(e["shortest_path"]), float(e["path_length"]))
                for e in its
                if e["ending"] == "goal"
            )
            assert row["spl"] == pytest.approx(spl / len(its))
        assert [t["frozen"] for t in values["tiers"]] == [True, False, True]

    def test_failures_are_recorded_as_they_were_driven(self, evaluated: tuple[Path, tuple[object, ...]]) -> None:
        out, _ = evaluated
        values = json.loads((out / "results.json").read_text())
        with (out / "episodes.csv").open(newline="") as file:
            endings = {(e["policy"], e["world"], int(e["world_seed"])): e["ending"] for e in csv.DictReader(file)}
        assert values["failures"]
        for failure in values["failures"]:
            recording = load_recording(out / failure["recording"])
            key = failure["policy"], failure["world"], failure["seed"]
            assert recording.about["ending"] == endings[key] != "goal"

    def test_the_command_for_a_failure_drives_it_again(
        self, evaluated: tuple[Path, tuple[object, ...]], tmp_path: Path, run_cli: RunCli
    ) -> None:
        out, _ = evaluated
        failure = json.loads((out / "results.json").read_text())["failures"][0]
        code, _, _ = run_cli(*failure["replay"].split()[1:], "--out", tmp_path)
        assert code == 0
        again, first = load_recording(tmp_path / "trajectory.npz"), load_recording(out / failure["recording"])
        assert np.array_equal(again.state_pose, first.state_pose)

    def test_the_same_command_gives_the_same_bytes_whoever_runs_it(
        self, evaluated: tuple[Path, tuple[object, ...]], tmp_path: Path, run_cli: RunCli, snapshot: Snapshot
    ) -> None:
        out, arguments = evaluated
        code, _, _ = run_cli(*arguments, "--workers", 2, "--out", tmp_path / "again")
        assert code == 0
        assert snapshot(tmp_path / "again") == snapshot(out)

    def test_it_goes_on_from_the_pieces_that_are_there(
        self, evaluated: tuple[Path, tuple[object, ...]], tmp_path: Path, run_cli: RunCli, snapshot: Snapshot
    ) -> None:
        out, arguments = evaluated
        again = shutil.copytree(out, tmp_path / "again")
        kept, *gone = sorted((again / "parts").iterdir())
        marked = kept.stat().st_mtime_ns
        for path in gone:
            path.unlink()
        assert run_cli(*arguments, "--executor", "inline", "--out", again)[0] == 0
        assert snapshot(again) == snapshot(out)
        assert kept.stat().st_mtime_ns == marked

    @pytest.mark.parametrize(
        ("where", "departures"),
        [
            (("--sim", "kinematic"), ("--conditions.sensor-noise", "0.3", "--conditions.dead-sector", "0")),
            (
                ("--sim", "bullet", "--physics", "fast"),
                ("--conditions.wheel-friction", "0.2", "--conditions.payload", "80"),
            ),
        ],
    )
    def test_conditions_are_those_of_a_drive_with_the_same_flags(
        self,
        where: tuple[str, ...],
        departures: tuple[str, ...],
        small_world: Path,
        tiny_run: Path,
        tmp_path: Path,
        run_cli: RunCli,
    ) -> None:
        lengths = []
        for asked in ((), departures):
            out = tmp_path / str(len(asked))
            flags = ("--world", small_world, *where, *asked)
            assert run_cli("evaluate", tiny_run, *flags, "--worlds", 2, "--executor", "inline", "--out", out)[0] == 0
            with (out / "episodes.csv").open(newline="") as file:
                lengths.append([float(e["path_length"]) for e in csv.DictReader(file)])
            printed = run_cli("drive", tiny_run, *flags, "--seed", 1, "--json", "--out", tmp_path / "drive")[1]
            assert json.loads(printed)["path_length"] == lengths[-1][1]
        assert lengths[0] != lengths[1]
        values = json.loads((out / "results.json").read_text())
        assert all(value in values["command"].split() for value in departures[1::2])
        assert departures[0].rpartition(".")[2].replace("-", " ") in (out / "evaluation.md").read_text().splitlines()[2]

    def test_json_is_what_the_file_holds(
        self, evaluated: tuple[Path, tuple[object, ...]], tmp_path: Path, run_cli: RunCli
    ) -> None:
        out, arguments = evaluated
        again = shutil.copytree(out, tmp_path / "again")
        code, printed, _ = run_cli(*arguments, "--executor", "inline", "--out", again, "--json")
        assert code == 0
        assert json.loads(printed) == json.loads((out / "results.json").read_text())

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (("nobody",), "nobody: no such run or policy file, no shipped policy and no rule; policies: distilled, "),
            (("straight", "--cover", "6"), "--cover: there are worlds with 2.5, 5, 7.5, 10, 15, 20 percent, not '6'"),
            (("straight", "--seeds", "0:9", "--split", "test"), "seeds and split both say which worlds are drawn"),
            (("straight", "--seeds", "0:9", "--worlds", "9"), "seeds and worlds both say which worlds are drawn"),
            (("straight", "--seeds", "9"), "--seeds: give FROM:TO, such as 0:50 for the seeds 0 to 49, not '9'"),
            (("straight", "--seeds", "9:9"), "seeds must be FROM:TO with 0 <= FROM < TO"),
            (("straight", "--seeds", "0:9999999999"), "at most 100000 of them"),
            (("straight", "--worlds", "0"), "the number of worlds must be from 1 to 1000"),
            (("straight", "--world", "nowhere"), "worlds: there is no file 'nowhere'"),
            (("straight", "--cover", "5", "--world", "paper"), "there are two worlds named 'paper'"),
            (("straight", "straight"), "straight: is given twice"),
            (("straight", "--address", "localhost:1"), "the executor 'processes' takes no address"),
            (("straight", "--workers", "-1"), "workers must be at least 1"),
            (
                ("straight", "--conditions.wheel-friction", "0"),
                "'conditions.wheel_friction': input should be greater",
            ),
            (("straight", "--conditions.dead-sector", "8"), "'conditions.dead_sector': input should be less than 8"),
        ],
    )
    def test_bad_input_is_one_line_and_leaves_nothing(
        self, arguments: tuple[str, ...], message: str, tmp_path: Path, run_cli: RunCli
    ) -> None:
        out = tmp_path / "out"
        code, printed, complaint = run_cli("evaluate", *arguments, "--sim", "kinematic", "--out", out)
        assert (code, printed) == (2, "")
        assert message in complaint
        assert len(complaint.splitlines()) == 1
        assert not out.exists()
