"""`barn`: scores worked out by hand, the challenge's protocol in closed form, and what the verb leaves."""

import json
import shlex
from collections.abc import Callable
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nnql_bullet as nb
from nnql_bullet.api.barn import BarnResults
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.barn import CLIPPINGS, mean_score, most_steps
from nnql_bullet.worlds.importers import Reading, read_foreign
from nnql_bullet.worlds.importers.barn import reference_length, world_files

Cli = Callable[..., tuple[int, str, str]]
Snapshot = Callable[[Path], dict[str, bytes]]

CORNERS = ((-4.425, 0.075), (-0.075, 0.075), (-4.425, 9.525), (-0.075, 9.525))
WALL = tuple((-4.425 + 0.15 * column, 7.0) for column in range(30))
CELLS = np.array([[16, 0], [16, 1], [17, 29]])


def write_world(path: Path, pillars: tuple[tuple[float, float], ...]) -> None:
    """Writes a Gazebo world of pillars, as those of BARN are."""
    solid = "<geometry><cylinder><radius>0.075</radius><length>1</length></cylinder></geometry>"
    models = "".join(
        f"<model name='p{k}'><pose>{x} {y} 0 0 0 0</pose><link name='l'><collision name='c'>{solid}</collision></link>"
        "</model>"
        for k, (x, y) in enumerate(pillars)
    )
    path.write_text(f"<sdf version='1.6'><world name='default'>{models}</world></sdf>")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with BARN in it: world 0 is open and has a path, world 2 is walled off and has none."""
    monkeypatch.chdir(tmp_path)
    for name in ("worlds", "path_files"):
        (tmp_path / "BARN" / name).mkdir(parents=True)
    write_world(tmp_path / "BARN" / "worlds" / "world_0.world", CORNERS)
    write_world(tmp_path / "BARN" / "worlds" / "world_2.world", CORNERS + WALL)
    np.save(tmp_path / "BARN" / "path_files" / "path_0.npy", CELLS)
    return tmp_path


def drive(*policies: Any, **arguments: Any) -> BarnResults:
    return nb.barn("BARN", list(policies), simulator="kinematic", **arguments)


class Turns:
    """Turns left by 60 degrees at every decision, for ever."""

    def act(self, observations: Any) -> Any:
        return np.full(len(observations.readings), 2)


class TestScore:
    @pytest.mark.parametrize(
        ("arrived", "time", "expected"),
        [
            (True, 8.0, (5 / 10, 5 / 20)),  # OT is 5 s: faster than 2 OT and 4 OT
            (True, 15.0, (5 / 15, 5 / 20)),
            (True, 30.0, (5 / 30, 5 / 30)),
            (True, 90.0, (5 / 40, 5 / 40)),  # later than 8 OT
            (False, 8.0, (0.0, 0.0)),
        ],
    )
    def test_is_the_optimal_time_over_the_clipped_time(
        self, arrived: bool, time: float, expected: tuple[float, float]
    ) -> None:
        assert [its.name for its in CLIPPINGS] == ["2-8 OT", "4-8 OT"]
        assert tuple(its.score(arrived, time, 5.0) for its in CLIPPINGS) == pytest.approx(expected)

    def test_the_reference_path_runs_from_start_to_target_a_cell_to_the_left(self, here: Path) -> None:
        """Centres at (-4.575 + 0.15 column, 5.075 + 0.15 row), as in the challenge's run.py."""
        first, second, third = (-2.175, 5.075), (-2.175, 5.225), (-2.025, 9.425)
        expected = sqrt(0.175**2 + 2.075**2) + 0.15 + sqrt(0.15**2 + 4.2**2) + sqrt(0.025**2 + 3.575**2)
        assert reference_length(here / "BARN" / "path_files" / "path_0.npy") == pytest.approx(expected)
        assert (second[1] - first[1], third[1] - second[1]) == pytest.approx((0.15, 4.2))

    def test_a_drive_has_100_s(self) -> None:
        assert [most_steps(period) for period in (0.5, 0.3, 0.1, 7.0)] == [200, 334, 1000, 15]

    def test_one_drive_says_nothing_of_the_mean_and_equal_ones_have_no_spread(self) -> None:
        assert mean_score([0.25], CLIPPINGS[0]) == (0.25, 0.0, 0.5)
        assert mean_score([0.5, 0.5], CLIPPINGS[0]) == (0.5, 0.5, 0.5)
        mean, low, high = mean_score([0.0, 0.5] * 20, CLIPPINGS[0])
        normal = 1.96 * 0.25 / sqrt(40)
        assert (mean, low, high) == pytest.approx((0.25, 0.25 - normal, 0.25 + normal), abs=0.015)


class TestWorlds:
    def test_are_found_by_number_wherever_they_lie(self, here: Path) -> None:
        worlds = here / "BARN" / "worlds"
        for folder in (here / "BARN", worlds):
            assert world_files(folder) == {0: worlds / "world_0.world", 2: worlds / "world_2.world"}
        (worlds / "world_10.world").write_bytes((worlds / "world_0.world").read_bytes())
        assert list(world_files(worlds)) == [0, 2, 10]

    def test_two_of_one_number_are_refused_and_so_is_a_folder_without_any(self, here: Path) -> None:
        worlds = here / "BARN" / "worlds"
        (worlds / "world_02.world").write_bytes((worlds / "world_2.world").read_bytes())
        with pytest.raises(UserError, match=r"world_\d+\.world: there is another world of this number"):
            world_files(worlds)
        with pytest.raises(UserError, match=r"path_files: has no world_N\.world"):
            world_files(here / "BARN" / "path_files")

    def test_one_without_a_path_is_of_barn_if_its_obstacles_surround_the_start(self, here: Path) -> None:
        file = here / "BARN" / "worlds" / "world_2.world"
        assert read_foreign(file, Reading()).format == "BARN world"
        write_world(file, ((10.0, 10.0), (12.0, 14.0)))
        found = read_foreign(file, Reading())
        assert (found.format, found.start, found.target) != ("BARN world", None, None)
        assert found.start is None


class TestProtocol:
    def test_9_of_the_10_m_are_driven_at_2_m_per_s(self, here: Path) -> None:
        """The target is reached within 1 m of it: after 4.5 s, and v / 2 a to get to 2 m/s from rest with 2 m/s2."""
        results = drive("straight", n_worlds=1)
        (it,) = results.drives
        assert (it["world"], it["ending"], it["path_length"]) == (0, "goal", pytest.approx(9.0, abs=1e-6))
        assert it["time"] == pytest.approx(9 / 2 + 2 / (2 * 2), abs=1e-6)
        assert it["score 2-8 OT"] == 0.5
        assert it["score 4-8 OT"] == 0.25
        assert it["optimal_time"] == pytest.approx(reference_length(here / "BARN/path_files/path_0.npy") / 2)

    def test_a_collision_ends_it_and_a_world_without_a_path_has_the_shortest_one(self, here: Path) -> None:
        """The wall's near side is at 6.925 m; the front is 0.344 m ahead of the axle, which starts at 3 m."""
        (_, it) = drive("straight").drives
        assert (it["world"], it["ending"], it["score 2-8 OT"]) == (2, "collision", 0.0)
        assert it["path_length"] == pytest.approx(6.925 - 0.344 - 3.0, abs=0.03)
        around = 2 * sqrt(2.5**2 + 4.0**2) + 2.0  # by the corner of the wall, whose end is 2.5 m aside
        assert 10.0 < 2 * it["optimal_time"] < around

    def test_it_ends_after_100_s(self, here: Path) -> None:
        (it,) = drive(Turns(), n_worlds=1, changes={"task": {"stuck_after": 0}}).drives
        assert (it["ending"], it["time"], it["decisions"]) == ("timeout", pytest.approx(100.0), 200)

    def test_the_time_does_not_depend_on_the_decision_period(self, here: Path) -> None:
        changes = {"task": {"stuck_after": 0}, "drive": {"decision_period": 0.25}}
        (it,) = drive(Turns(), n_worlds=1, changes=changes).drives
        assert (it["ending"], it["time"], it["decisions"]) == ("timeout", pytest.approx(100.0), 400)

    def test_the_time_cannot_be_changed(self, here: Path) -> None:
        with pytest.raises(UserError, match="the challenge gives each drive 100 s"):
            drive("straight", changes={"task": {"max_steps": 40}})


class TestVerb:
    asked = ("barn", "BARN", "straight", "--sim", "kinematic", "--executor", "inline", "--out", "out")

    def test_leaves_scores_failures_and_pictures_and_repeats_itself(
        self, here: Path, run_cli: Cli, snapshot: Snapshot
    ) -> None:
        code, out, _ = run_cli(*self.asked)
        assert code == 0
        assert "1 of 2 worlds have no path_N.npy" in out
        values = json.loads((here / "out" / "results.json").read_text())
        (row,) = values["rows"]
        assert (row["worlds"], row["outcomes"]["goal"][0], row["time"]) == (2, 0.5, pytest.approx(5.0))
        assert row["scores"]["2-8 OT"][0] == 0.25
        assert [(its["number"], its["given"]) for its in values["worlds"]] == [(0, True), (2, False)]
        assert "| straight | collision | 2 |" in (here / "out" / "barn.md").read_text()
        assert (here / "out" / "failures.png").stat().st_size > 10_000
        before = snapshot(here / "out")
        assert run_cli(*self.asked)[0] == 0
        assert snapshot(here / "out") == before

    def test_a_failure_is_driven_again_by_its_command(self, here: Path, run_cli: Cli) -> None:
        run_cli(*self.asked)
        (failure,) = json.loads((here / "out" / "results.json").read_text())["failures"]
        _, *replay = shlex.split(failure["replay"])
        code, out, _ = run_cli(*replay, "--json", "--out", "again")
        assert (code, json.loads(out)["ending"]) == (0, "collision")

    def test_json_is_what_is_kept(self, here: Path, run_cli: Cli) -> None:
        code, out, _ = run_cli(*self.asked, "--worlds", 1, "--json")
        assert code == 0
        assert json.loads(out) == json.loads((here / "out" / "results.json").read_text())

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (("barn", "nowhere", "straight"), ["nowhere", "has no world_N.world"]),
            (("barn", "BARN", "no_such_policy"), ["no_such_policy"]),
            (("barn", "BARN", "straight", "--worlds", "3"), ["2 worlds", "not 3"]),
            (("barn", "BARN", "straight", "--robot", "rover"), ["rover", "jackal_tricycle"]),
        ],
    )
    def test_wrong_input_is_one_line(
        self, here: Path, run_cli: Cli, snapshot: Snapshot, arguments: tuple[str, ...], words: list[str]
    ) -> None:
        before = snapshot(here)
        code, out, err = run_cli(*arguments, "--sim", "kinematic")
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert [word for word in words if word not in err] == []
        assert snapshot(here) == before

    def test_a_damaged_path_is_refused_before_the_first_drive(self, here: Path, run_cli: Cli) -> None:
        (here / "BARN" / "path_files" / "path_0.npy").write_bytes(b"no array")
        code, _, err = run_cli(*self.asked)
        assert (code, err.count("\n")) == (2, 1)
        assert "path_0.npy" in err
        assert not (here / "out").exists()
