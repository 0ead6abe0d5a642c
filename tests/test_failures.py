"""Failures: features against geometry on paper, groups by drives that are made to belong to one, and the command."""

import csv
import json
import shutil
from collections.abc import Callable
from itertools import product
from math import atan2, cos, hypot, pi, radians, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from nnql_bullet.cli import main
from nnql_bullet.evaluation.drives import Drawn, FilmTask, Tier
from nnql_bullet.evaluation.failures import GROUPS, Contact, Timeout, features, group
from nnql_bullet.evaluation.policies import Policy
from nnql_bullet.evaluation.replays import FailedDrive, choose
from nnql_bullet.geometry import Array, OrientedBox
from nnql_bullet.recording import Recording, load_recording
from nnql_bullet.reports.failures import varied
from nnql_bullet.reports.player import player_text
from nnql_bullet.setting import Setting
from nnql_bullet.worlds.spec import Patrol

RunCli = Callable[..., tuple[int, str, str]]
Snapshot = Callable[[Path], dict[str, bytes]]

SPEED, RATE, PERIOD = 2.0, 30, 0.5
FOOTPRINT = {"x": 0.35, "y": 0.0, "half_length": 0.55, "half_width": 0.325, "yaw": 0.0}
FRONT, REAR, SIDE = 0.9, -0.2, 0.325
LEFT, RIGHT = radians(30.0), radians(-30.0)


def recording(
    poses: Array,
    ending: str,
    *boxes: OrientedBox,
    patrols: tuple[Patrol, ...] = (),
    turns: tuple[float, ...] = (),
    target: tuple[float, float] = (90.0, 90.0),
) -> Recording:
    """A drive through a world of 100 m, from its poses (m, 3), 30 a second; the last decisions ask for `turns`."""
    samples = np.arange(1, len(poses)) / RATE
    decisions = np.arange(0.0, samples[-1] - 1e-9, PERIOD)
    states = np.append(np.rint(decisions * RATE).astype(int), len(poses) - 1)
    n, m = len(decisions), len(samples)
    commands = np.zeros(n)
    commands[n - len(turns) :] = turns
    box = {"half_length": 1.0, "half_width": 1.0, "yaw": 0.0}
    world = {
        **{"name": "test", "seed": 0, "width": 100.0, "depth": 100.0, "obstacle_height": 1.5},
        **{
            "target": target,
            "target_radius": 2.0,
            "start": dict(zip(("x", "y", "yaw"), poses[0].tolist(), strict=True)),
        },
        "obstacles": [{"x": 5.0, "y": 95.0, **box}, *({f: getattr(b, f) for f in FOOTPRINT} for b in boxes)],
        "patrols": [
            {"box": {f: getattr(p.box, f) for f in FOOTPRINT}, "end": p.end, "speed": p.speed, "phase": p.phase}
            for p in patrols
        ],
    }
    return Recording(
        about={"world": world, "vehicle": {"footprint": FOOTPRINT, "sensor": (0.35, 0.0, 0.5)}, "ending": ending},
        state_time=np.append(decisions, samples[-1]),
        state_pose=poses[states],
        readings=np.full((n + 1, 8), 10.0),
        ray_distances=np.full((n + 1, 72), 10.0),
        state_property=np.full(n + 1, "SS"),
        q_values=np.full((n, 5), np.nan),
        overridden=np.zeros(n, np.bool_),
        action=np.zeros(n, np.int64),
        heading_command=commands,
        heading_error=np.zeros(n),
        clearance=np.full(n, 1.0),
        contact=np.zeros(n, np.bool_),
        reward_terms=np.zeros((n, 6)),
        sample_time=samples,
        sample_pose=poses[1:],
        joint_angles=np.zeros((m, 4)),
        wheel_speeds=np.zeros((m, 2)),
    )


def straight_to(x: float, y: float, yaw: float, seconds: float = 10.0) -> Array:
    """Poses of a vehicle that comes straight to a place."""
    back = np.arange(round(seconds * RATE), -1, -1) / RATE * SPEED
    return np.column_stack([x - back * cos(yaw), y - back * sin(yaw), np.full(len(back), yaw)])


def along(points: Array) -> Array:
    """Poses of a vehicle that drives a polyline (k, 2), its corners rounded by nothing."""
    legs = np.hypot(*np.diff(points, axis=0).T)
    way = np.arange(0.0, legs.sum(), SPEED / RATE)
    known = np.concatenate([[0.0], np.cumsum(legs)])
    x, y = (np.interp(way, known, column) for column in points.T)
    yaw = np.arctan2(*np.diff(points, axis=0).T[::-1])[np.searchsorted(known[1:], way, side="right")]
    return np.column_stack([x, y, (yaw + pi) % (2 * pi) - pi])


def circle(x: float, y: float, radius: float, seconds: float, way: int = 1) -> Array:
    """Poses of a vehicle that goes round a point, to the left or (-1) to the right."""
    angle = way * np.arange(round(seconds * RATE)) / RATE * SPEED / radius
    yaw = (angle + way * pi / 2 + pi) % (2 * pi) - pi
    return np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle), yaw])


def contact_of(its: Recording) -> Contact:
    found = features(its).end
    assert isinstance(found, Contact)
    return found


def world_place(pose: tuple[float, float, float], ahead: float, left: float) -> tuple[float, float]:
    x, y, yaw = pose
    return x + ahead * cos(yaw) - left * sin(yaw), y + ahead * sin(yaw) + left * cos(yaw)


YAWS = (0.0, 0.4, 2.0, -3.0)


class TestContact:
    def test_a_corner_of_a_box_in_the_front(self) -> None:
        for yaw, left in product(YAWS, (-0.2, 0.0, 0.2)):
            pose = (50.0, 40.0, yaw)
            # A diamond whose near corner stands on the front.
            middle = world_place(pose, FRONT + hypot(1.0, 1.0), left)
            its = recording(straight_to(*pose), "collision", OrientedBox(*middle, 1.0, 1.0, yaw + pi / 4))
            found = contact_of(its)
            assert (found.touched, found.share) == ("box", 0.0)
            assert found.angle == pytest.approx(0.0, abs=1e-6)
            assert found.bearing == pytest.approx(atan2(left, 0.55), abs=1e-6)
            assert found.place == pytest.approx(world_place(pose, FRONT, left))

    def test_a_front_corner_on_the_face_of_a_box(self) -> None:
        for yaw, side, degrees in product(YAWS, (1, -1), (10, 30, 60, 80)):
            pose, angle = (50.0, 40.0, yaw), radians(degrees)
            x, y = world_place(pose, FRONT, side * SIDE)
            through = yaw + side * angle  # the way straight through the face
            middle = OrientedBox(x + 3.0 * cos(through), y + 3.0 * sin(through), 3.0, 5.0, through)
            found = contact_of(recording(straight_to(*pose), "collision", middle))
            assert found.angle == pytest.approx(angle, abs=1e-6)
            assert found.place == pytest.approx((x, y))
            assert found.bearing == pytest.approx(side * atan2(0.325, 0.55))

    def test_a_corner_of_a_box_in_the_flank(self) -> None:
        for yaw, side in product(YAWS, (1, -1)):
            pose = (50.0, 40.0, yaw)
            middle = world_place(pose, 0.1, side * (SIDE + hypot(1.0, 1.0)))
            found = contact_of(recording(straight_to(*pose), "collision", OrientedBox(*middle, 1.0, 1.0, yaw + pi / 4)))
            assert found.angle == pytest.approx(pi / 2)
            assert found.bearing == pytest.approx(atan2(side * 0.325, 0.1 - 0.35))

    def test_a_wall_met_flat_is_touched_in_the_middle_of_the_front(self) -> None:
        found = contact_of(recording(straight_to(100.0 - FRONT, 30.0, 0.0), "collision"))
        assert (found.touched, found.angle, found.bearing) == ("wall", pytest.approx(0.0), pytest.approx(0.0))
        assert found.place == pytest.approx((100.0, 30.0))

    def test_two_faces_touch_in_the_middle_of_what_they_share(self) -> None:
        # The box reaches from 0.1 m left of the middle line to beyond the vehicle's left side.
        found = contact_of(recording(straight_to(50.0, 40.0, 0.0), "collision", OrientedBox(51.9, 42.1, 1.0, 2.0)))
        assert found.place == pytest.approx((50.9, 40.0 + (0.1 + 0.325) / 2))

    @pytest.mark.parametrize("depth", [0.0, 0.01, 0.02])
    def test_simulators_may_notice_it_a_little_late(self, depth: float) -> None:
        found = contact_of(recording(straight_to(100.0 - FRONT + depth, 30.0, radians(20)), "collision"))
        assert found.touched == "wall"
        assert found.angle == pytest.approx(radians(20))

    def test_the_nearest_is_what_was_touched(self) -> None:
        near = OrientedBox(50.0 + FRONT + 1.001, 40.0, 1.0, 1.0)
        patrol = Patrol(OrientedBox(50.0, 45.0, 1.0, 1.0), (50.0, 60.0), 1.0, 0.0)
        assert (
            contact_of(recording(straight_to(50.0, 40.0, 0.0), "collision", near, patrols=(patrol,))).touched == "box"
        )

    @pytest.mark.parametrize(
        ("from_x", "from_y", "x", "y", "angle", "share"),
        [
            (50.35, 60.0, 50.35, 40.0 + SIDE + 1.0, pi / 2, 1.0),  # into the flank
            (80.0, 40.0, 50.0 + FRONT + 1.0, 40.0, 0.0, 1 / 3),  # towards it, at half its speed
            (50.0 + FRONT - 10.0, 40.0, 50.0 + FRONT + 1.0, 40.0, 0.0, 0.0),  # away from it
        ],
    )
    def test_a_box_that_moves_has_its_share_of_the_speed(
        self, from_x: float, from_y: float, x: float, y: float, angle: float, share: float
    ) -> None:
        # It is where it touches after 10 s at 1 m/s, and would go on.
        along, across = (x - from_x, y - from_y)
        way = hypot(along, across)
        begin = x - 10.0 * along / way, y - 10.0 * across / way
        end = x + 10.0 * along / way, y + 10.0 * across / way
        patrol = Patrol(OrientedBox(*begin, 1.0, 1.0), end, 1.0, 0.0)
        found = contact_of(recording(straight_to(50.0, 40.0, 0.0), "collision", patrols=(patrol,)))
        assert found.touched == "moving box"
        assert found.angle == pytest.approx(angle, abs=1e-6)
        assert found.share == pytest.approx(share)

    @pytest.mark.parametrize(
        ("turns", "reversals"),
        [
            ((LEFT,) * 8, 0),
            ((LEFT, LEFT, RIGHT, RIGHT, LEFT), 2),
            ((LEFT, 0.0, 0.1, RIGHT), 1),  # what is no turn to a side does not count
            ((LEFT, RIGHT, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0),  # long before
        ],
    )
    def test_turns_that_change_sides_are_counted(self, turns: tuple[float, ...], reversals: int) -> None:
        its = recording(straight_to(100.0 - FRONT, 30.0, 0.0), "collision", turns=turns)
        assert contact_of(its).reversals == reversals


class TestLateness:
    def late(self, poses: Array, **world: Any) -> Timeout:
        found = features(recording(poses, "timeout", **world)).end
        assert isinstance(found, Timeout)
        return found

    @pytest.mark.parametrize("way", [1, -1])
    def test_rounds_are_those_of_the_last_minute(self, way: int) -> None:
        found = self.late(circle(40.0, 40.0, 5.0, 200.0, way))
        assert found.rounds == pytest.approx(way * 60 * SPEED / (2 * pi * 5.0), rel=1e-3)
        assert found.extent == pytest.approx(10.0, rel=1e-3)
        assert found.revisited == 1.0

    def test_distances_are_to_the_target(self) -> None:
        found = self.late(straight_to(90.0, 70.0, pi / 2, 35.0), target=(90.0, 90.0))
        assert found.progress == pytest.approx(70.0, abs=0.1)
        assert found.farthest == pytest.approx(90.0, abs=0.1)
        assert found.rounds == pytest.approx(0.0)
        assert found.revisited == 0.0

    def test_where_it_has_been_is_told_from_where_it_was_just_now(self) -> None:
        # 30 m there and 30 m back count from 10 s before: the whole way back but for its first 10 m.
        there_and_back = along(np.array([[10.0, 50.0], [40.0, 50.0], [40.0, 50.2], [10.0, 50.2]]))
        expected = (30.0 - 10.0 + 1.0) / 60.2
        assert self.late(there_and_back).revisited == pytest.approx(expected, abs=0.04)


ZIGZAG = np.array([[5.0 + 4.0 * i, 20.0 + 60.0 * (i % 4 in (1, 2))] for i in range(20)])
"""Up and down through the arena, never where it has been."""
PACING = np.array([[20.0 + 20.0 * (i % 2), 30.0] for i in range(30)])

MADE = {
    "struck": recording(
        straight_to(50.0, 40.0, 0.0),
        "collision",
        patrols=(Patrol(OrientedBox(50.35, 40.0 + SIDE + 1.0 + 10.0, 1.0, 1.0), (50.35, 30.0), 1.0, 0.0),),
        turns=(LEFT, RIGHT, LEFT),
    ),
    "flank": recording(straight_to(50.0, 100.0 - 0.68, radians(25)), "collision", turns=(LEFT, RIGHT, LEFT)),
    "dithering": recording(straight_to(100.0 - FRONT, 30.0, 0.0), "collision", turns=(LEFT, RIGHT, RIGHT, LEFT)),
    "head-on": recording(straight_to(100.0 - FRONT, 30.0, 0.0), "collision", turns=(LEFT, LEFT, LEFT)),
    "target circling": recording(circle(60.0, 60.0, 4.0, 250.0), "timeout", target=(61.0, 60.0)),
    "circling": recording(circle(60.0, 60.0, 4.0, 250.0, -1), "timeout"),
    "trapped": recording(along(PACING), "timeout"),
    "wandering": recording(along(ZIGZAG), "timeout"),
    "overturned": recording(circle(60.0, 60.0, 4.0, 20.0), "overturned"),
    "stuck": recording(circle(60.0, 60.0, 0.1, 30.0), "stuck", target=(61.0, 60.0)),
}
"""Drives that belong to a group by the way they are made."""


class TestGroups:
    @pytest.mark.parametrize("name", GROUPS)
    def test_each_drive_is_in_the_group_that_it_was_made_for(self, name: str) -> None:
        assert group(features(MADE[name])) == name

    def test_who_drives_into_a_moving_box_is_not_struck(self) -> None:
        away = Patrol(OrientedBox(50.0 + FRONT + 1.0 - 10.0, 40.0, 1.0, 1.0), (90.0, 40.0), 1.0, 0.0)
        assert group(features(recording(straight_to(50.0, 40.0, 0.0), "collision", patrols=(away,)))) == "head-on"

    def test_a_wide_round_is_a_place_where_it_has_been(self) -> None:
        wide = recording(circle(50.0, 50.0, 15.0, 250.0), "timeout")  # 1.3 rounds a minute
        assert group(features(wide)) == "trapped"

    def test_a_drive_that_comes_by_the_target_and_leaves_does_not_circle_it(self) -> None:
        by = recording(circle(60.0, 60.0, 4.0, 250.0), "timeout", target=(69.0, 60.0))
        assert group(features(by)) == "circling"


def test_what_a_player_is_told_can_stand_in_html_and_names_boxes_that_move() -> None:
    text = player_text(MADE["struck"], "</script><b> & co")
    assert not set("<>&") & set(text)
    told = json.loads(text)
    assert told["title"] == "</script><b> & co"
    (patrol,) = told["patrols"]
    assert patrol["box"] == pytest.approx([50.35, 51.325, 1.0, 1.0, 0.0], abs=6e-4)
    assert patrol["end"] == [50.35, 30.0]
    assert np.array(patrol["places"]) == pytest.approx(
        np.array([[0.0, 50.35, 51.325], [10.0, 50.35, 41.325]]), abs=6e-4
    )
    assert len(told["x"]) == len(told["y"]) == len(told["yaw"]) == 10 * told["rate"] + 1
    assert told["end"] == 10.0


def failed(*drives: tuple[str, str, int]) -> list[FailedDrive]:
    """From policy, world and seed; a policy's method is the first letter of its name."""
    setting = Setting("kinematic", "reference")
    return [
        FailedDrive(
            FilmTask(
                Policy(name, name, name[0], "nnql", 0, 100, 89, "It drives.", 0.8, "f"),
                Tier(world, world, None, (), True),
                setting,
                Drawn(world, seed, ""),
            ),
            "timeout",
            500,
        )
        for name, world, seed in drives
    ]


class TestChoice:
    ALL = failed(
        *(("a-0", "easy", seed) for seed in range(4)),
        *(("a-1", "easy", seed) for seed in (2, 5)),
        *(("a-1", "hard", seed) for seed in (3, 4)),
        ("b", "easy", 7),
    )

    def chosen(self, most: int) -> list[tuple[str, str, int]]:
        return [(one.film.policy.name, one.film.tier.name, one.seed) for one in choose(self.ALL, most)]

    def test_policies_of_a_method_take_turns(self) -> None:
        others = [("a-1", "hard", 3), ("b", "easy", 7)]
        assert self.chosen(1) == [("a-0", "easy", 0), *others]
        assert self.chosen(3) == [
            *(("a-0", "easy", 0), ("a-0", "easy", 1), ("a-1", "easy", 2)),
            *(("a-1", "hard", 3), ("a-1", "hard", 4), ("b", "easy", 7)),
        ]

    def test_enough_is_everything(self) -> None:
        assert choose(self.ALL, 6) == self.ALL

    @pytest.mark.parametrize(
        ("most", "expected"),
        [
            (1, [("a-0", 0)]),
            (2, [("a-0", 0), ("b", 7)]),
            (3, [("a-0", 0), ("a-1", 3), ("b", 7)]),  # of a in both of its worlds
            (4, [("a-0", 0), ("a-0", 1), ("a-1", 3), ("b", 7)]),
        ],
    )
    def test_what_is_shown_is_of_many_methods_and_worlds(self, most: int, expected: list[tuple[str, int]]) -> None:
        shown = varied(self.ALL, [one.place for one in self.ALL], most)
        assert [(one.film.policy.name, one.seed) for one in shown] == expected


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory: pytest.TempPathFactory, tiny_run: Path) -> Path:
    """A run of 12 episodes and a rule, evaluated where they fail. Read only."""
    work = tmp_path_factory.mktemp("failures")
    shutil.copytree(tiny_run, work / "tiny")
    where = ("--world", "moving", "--cover", "20", "--sim", "kinematic", "--worlds", "4", "--executor", "inline")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(work)
        assert main(["evaluate", "tiny", "straight", *where, "--out", "evaluate"]) == 0
        shutil.copytree("evaluate", "sorted")
        assert main(["failures", "sorted", "--most", "2", "--workers", "1"]) == 0
    return work


@pytest.fixture
def here(evaluated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it, as the working folder."""
    copy = shutil.copytree(evaluated, tmp_path / "work")
    monkeypatch.chdir(copy)
    return copy


def values_of(folder: Path) -> dict[str, Any]:
    values: dict[str, Any] = json.loads((folder / "failures/failures.json").read_text())
    return values


def lost(folder: Path) -> dict[tuple[str, str, int], str]:
    with (folder / "episodes.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    endings = {(row["policy"], row["world"], int(row["world_seed"])): row["ending"] for row in rows}
    return {drive: ending for drive, ending in endings.items() if ending != "goal"}


class TestCommand:
    def test_every_failure_that_was_driven_again_is_in_one_group(self, evaluated: Path) -> None:
        out = evaluated / "sorted"
        values, failures = values_of(out), lost(out)
        its = [one for part in values["groups"] for one in part["failures"]]
        found = {(one["policy"], one["world"], one["seed"]): one for one in its}
        assert len(found) == len(its) == values["replayed"]
        assert values["failures"] == len(failures)
        for place in {drive[:2] for drive in failures}:
            theirs = [drive for drive in failures if drive[:2] == place]
            assert [drive for drive in found if drive[:2] == place] != []
            assert sorted(drive for drive in found if drive[:2] == place) == sorted(theirs)[:2]
        for drive, one in found.items():
            recording = load_recording(out / one["recording"])
            assert recording.about["ending"] == one["ending"] == failures[drive]

    def test_the_folder_holds_what_the_report_names_and_what_the_evaluation_does(self, evaluated: Path) -> None:
        out = evaluated / "sorted"
        values = values_of(out)
        named = {"failures/failures.md", "failures/failures.json"}
        named |= {part["sheet"] for part in values["groups"]}
        named |= {one["recording"] for part in values["groups"] for one in part["failures"]}
        assert {str(path.relative_to(out)) for path in (out / "failures").iterdir()} == named
        first = {one["recording"] for one in json.loads((out / "results.json").read_text())["failures"]}
        assert first
        assert first <= named
        for part in values["groups"]:
            with Image.open(out / part["sheet"]) as sheet:
                assert min(sheet.size) > 600

    def test_the_text_counts_and_names_them_all(self, evaluated: Path) -> None:
        out = evaluated / "sorted"
        text, values = (out / "failures/failures.md").read_text(), values_of(out)
        assert f"{values['replayed']} of {values['failures']} failures" in text
        for part in values["groups"]:
            assert f"## {part['name'].capitalize()}: {len(part['failures'])}" in text
            assert part["rule"] in text
            assert [one["replay"] for one in part["failures"] if one["replay"] not in text] == []
            assert [one["title"] for one in part["failures"] if f"| {one['title']} |" not in text] == []
        rows = [
            line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith(("| tiny |", "| straight |"))
        ]
        assert sum(int(row[3]) for row in rows) == values["replayed"]
        assert sum(int(row[2]) for row in rows) == values["failures"]

    def test_the_command_of_a_failure_drives_it_again(self, here: Path, run_cli: RunCli) -> None:
        one = values_of(here / "sorted")["groups"][0]["failures"][0]
        assert run_cli(*one["replay"].split()[1:], "--out", "again")[0] == 0
        again, first = load_recording(here / "again/trajectory.npz"), load_recording(here / "sorted" / one["recording"])
        assert np.array_equal(again.sample_pose, first.sample_pose)

    def test_the_same_bytes_whoever_drives_and_whatever_was_there(
        self, here: Path, run_cli: RunCli, snapshot: Snapshot
    ) -> None:
        before = snapshot(here / "sorted")
        for name in ("of_before.npz", "of_before.png", "failures.txt"):
            (here / "sorted/failures" / name).touch()
        code, out, _ = run_cli("failures", "sorted", "--most", 2, "--workers", 2)
        assert code == 0
        assert snapshot(here / "sorted") == before
        counted, header, *rows, report = out.splitlines()
        values = values_of(here / "sorted")
        assert counted == "{replayed} of {failures} failures: of each method in each kind of world at most 2".format(
            **values
        )
        assert header.split("  ")[0] == "method"
        assert sum(int(count) for row in rows for count in row.split()[1:] if count != "-") == values["replayed"]
        assert report == "report: sorted/failures/failures.md"

    def test_evaluating_anew_leaves_nothing_stale(self, here: Path, run_cli: RunCli, snapshot: Snapshot) -> None:
        where = ("--world", "moving", "--cover", "20", "--sim", "kinematic", "--worlds", "4", "--executor", "inline")
        assert run_cli("evaluate", "tiny", "straight", *where, "--out", "sorted")[0] == 0
        assert snapshot(here / "sorted") == snapshot(here / "evaluate")

    def test_without_failures_there_is_little_to_say(self, here: Path, run_cli: RunCli) -> None:
        lines = (here / "sorted/episodes.csv").read_text().splitlines()
        (here / "sorted/episodes.csv").write_text(lines[0] + "\n")
        assert run_cli("failures", "sorted", "--workers", 1)[:2] == (
            0,
            "no drive of this evaluation failed\nreport: sorted/failures/failures.md\n",
        )


class TestRefusals:
    def refused(self, run_cli: RunCli, snapshot: Snapshot, *arguments: object) -> str:
        before = snapshot(Path())
        code, out, err = run_cli("failures", *arguments)
        complaints = [line for line in err.splitlines() if line.startswith("nnql-bullet: ")]  # beside slow progress
        assert (code, out, len(complaints)) == (2, "", 1)
        assert snapshot(Path()) == before
        return complaints[0]

    def test_no_evaluation(self, here: Path, run_cli: RunCli, snapshot: Snapshot) -> None:
        assert "tiny: holds no evaluation" in self.refused(run_cli, snapshot, "tiny")
        assert "nnql-bullet evaluate" in self.refused(run_cli, snapshot)

    def test_too_few(self, here: Path, run_cli: RunCli, snapshot: Snapshot) -> None:
        assert "most must be at least 1, not 0" in self.refused(run_cli, snapshot, "sorted", "--most", 0)

    @pytest.mark.parametrize(
        ("file", "text", "said"),
        [
            ("results.json", "{", "sorted/results.json: is not JSON"),
            ("results.json", "[]", "sorted: results are damaged"),
            ("episodes.csv", "policy,ending\nx,timeout\n", "sorted: results are damaged"),
        ],
    )
    def test_damage(self, here: Path, run_cli: RunCli, snapshot: Snapshot, file: str, text: str, said: str) -> None:
        Path("sorted", file).write_text(text)
        assert said in self.refused(run_cli, snapshot, "sorted")

    def test_a_policy_that_has_learned_on(self, here: Path, run_cli: RunCli, snapshot: Snapshot) -> None:
        assert run_cli("train", "--resume", "tiny", "--episodes", 13)[0] == 0
        complaint = self.refused(run_cli, snapshot, "sorted")
        assert "tiny: is not what was evaluated; evaluate anew: nnql-bullet evaluate tiny straight" in complaint

    def test_another_ending(self, here: Path, run_cli: RunCli, snapshot: Snapshot) -> None:
        path = Path("sorted/episodes.csv")
        path.write_text(path.read_text().replace("collision", "timeout", 1))
        complaint = self.refused(run_cli, snapshot, "sorted", "--workers", 1)
        assert "timeout after" in complaint
        assert "in the evaluation, but collision after" in complaint

    def test_another_world(self, here: Path, run_cli: RunCli, snapshot: Snapshot) -> None:
        path = Path("sorted/results.json")
        values = json.loads(path.read_text())
        for tier in values["tiers"]:
            for world in tier["worlds"]:
                world["digest"] = "0" * 16
        path.write_text(json.dumps(values))
        assert "its world is not what it was" in self.refused(run_cli, snapshot, "sorted", "--workers", 1)
