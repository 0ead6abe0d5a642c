"""Recordings as files, and the pictures drawn from them."""

import json
import struct
import zipfile
from collections.abc import Callable
from dataclasses import fields, replace
from itertools import cycle
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from numpy.lib import format as npy
from numpy.typing import NDArray

from nnql_bullet.agents.learning.nnql import Nnql
from nnql_bullet.agents.learning.options import NnqlOptions
from nnql_bullet.env import Navigation, Observation
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import OrientedBox, Pose
from nnql_bullet.recording import Recorder, Recording, load_recording
from nnql_bullet.reports.plots import draw_learning_curve, draw_trajectory
from nnql_bullet.rollout import EpisodeSummary, run_episode
from nnql_bullet.sim.engines import contact_simulator
from nnql_bullet.task import REWARD_TERMS, TaskOptions
from nnql_bullet.training.loop import TrainingEpisode
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import Patrol, WorldSpec

BLUE, ORANGE, RED, GREEN = "1f77b4", "e8590c", "c92a2a", "2b8a3e"  # safe, non-safe, collision, goal
GREY, VIOLET, YELLOW = "adb5bd", "b197fc", "fab005"  # box, box that moves, vehicle

Record = Callable[..., tuple[Recording, EpisodeSummary]]


@pytest.fixture(scope="module")
def record(vehicle: VehicleSpec) -> Record:
    """Records one episode of a fixed series of actions, over and over until it ends."""

    def make(world: WorldSpec, *actions: int, max_steps: int = 500) -> tuple[Recording, EpisodeSummary]:
        simulator = contact_simulator("bullet", "fast", vehicle, DriveOptions(), 1)
        recorder = Recorder(vehicle)
        script = cycle(actions)

        class Scripted(Nnql):
            """Follows the script, whatever its network says."""

            def act(self, observations: Observation, state: None) -> tuple[NDArray[np.int64], None]:
                return np.array([next(script)]), None

        navigation = Navigation(simulator, TaskOptions(max_steps=max_steps))
        summary = run_episode(navigation, world, Scripted(NnqlOptions(), 0), watcher=recorder)
        simulator.close()
        return recorder.recording(policy="script", physics="fast"), summary

    return make


@pytest.fixture(scope="module")
def goal(record: Record, world_of: Callable[..., WorldSpec]) -> tuple[Recording, EpisodeSummary]:
    box = OrientedBox(18.0, 14.0, 2.0, 1.0, 0.3)
    world = world_of(box, side=40.0, start=Pose(6.0, 8.0, 0.2), target=(30.0, 20.0))
    return record(world, 5)


@pytest.fixture(scope="module")
def collision(record: Record, world_of: Callable[..., WorldSpec]) -> tuple[Recording, EpisodeSummary]:
    box = OrientedBox(20.0, 10.0, 1.0, 4.0)
    world = world_of(box, side=40.0, start=Pose(6.0, 10.0, 0.0), target=(36.0, 36.0))
    return record(world, 0, 1, 3)


@pytest.fixture(scope="module")
def immediate(record: Record, world_of: Callable[..., WorldSpec]) -> tuple[Recording, EpisodeSummary]:
    """A collision in the very first physics steps."""
    box = OrientedBox(7.42, 10.0, 0.5, 4.0)
    return record(world_of(box, side=40.0, start=Pose(6.0, 10.0, 0.0), target=(36.0, 36.0)), 0)


@pytest.fixture(scope="module")
def patrolled(record: Record, world_of: Callable[..., WorldSpec]) -> tuple[Recording, EpisodeSummary]:
    """A drive between boxes that move, one of which ends it."""
    crossing = Patrol(OrientedBox(13.0, 5.0, 1.0, 0.7, 0.4), (13.0, 17.0), 0.8, 0.25)
    comes = Patrol(OrientedBox(34.0, 10.0, 0.8, 1.0), (10.0, 10.0), 0.5, 0.0)
    world = world_of(OrientedBox(20.0, 20.0, 1.0, 1.0), side=40.0, start=Pose(6.0, 10.0, 0.0), target=(36.0, 36.0))
    return record(replace(world, patrols=(crossing, comes)), 0)


@pytest.fixture
def saved(goal: tuple[Recording, EpisodeSummary], tmp_path: Path) -> Path:
    path = tmp_path / "trajectory.npz"
    goal[0].save(path)
    return path


class TestFile:
    @pytest.mark.parametrize("which", ["goal", "collision", "immediate", "patrolled"])
    def test_round_trip(self, request: pytest.FixtureRequest, tmp_path: Path, which: str) -> None:
        recording: Recording = request.getfixturevalue(which)[0]
        recording.save(tmp_path / "one.npz")
        loaded = load_recording(tmp_path / "one.npz")
        assert loaded.about == json.loads(json.dumps(recording.about))
        for field in fields(Recording):
            if field.name != "about":
                ours, theirs = getattr(recording, field.name), getattr(loaded, field.name)
                assert ours.dtype == theirs.dtype, field.name
                np.testing.assert_array_equal(theirs, ours, err_msg=field.name)

    @pytest.mark.parametrize("which", ["goal", "collision", "immediate"])
    def test_shapes_are_the_documented_ones(self, request: pytest.FixtureRequest, which: str) -> None:
        r: Recording
        summary: EpisodeSummary
        r, summary = request.getfixturevalue(which)
        n, m = summary.steps, len(r.sample_time)
        assert r.state_time.shape == r.state_property.shape == (n + 1,)
        assert r.state_pose.shape == (n + 1, 3)
        assert r.readings.shape == (n + 1, 8)
        assert r.ray_distances.shape == (n + 1, 72)
        assert r.q_values.shape == (n, 5)
        assert r.reward_terms.shape == (n, 6)
        for name in ("action", "heading_command", "heading_error", "clearance", "contact"):
            assert getattr(r, name).shape == (n,), name
        assert r.sample_time.shape == (m,)
        assert r.sample_pose.shape == (m, 3)
        assert r.joint_angles.shape == (m, 4)
        assert r.wheel_speeds.shape == (m, 2)

    def test_it_tells_what_happened(self, collision: tuple[Recording, EpisodeSummary]) -> None:
        r, summary = collision
        assert r.about["ending"] == summary.ending == "collision"
        assert r.about["policy"] == "script"
        assert r.state_property[-1] == "FS"
        assert r.contact.tolist() == [False] * (summary.steps - 1) + [True]
        assert r.action.tolist() == ([0, 1, 3] * summary.steps)[: summary.steps]
        assert np.degrees(r.heading_command) == pytest.approx(([0, 30, -30] * summary.steps)[: summary.steps])
        assert r.state_time[-1] == pytest.approx(summary.duration)
        assert r.reward_terms.sum(axis=0) == pytest.approx([summary.terms[name] for name in REWARD_TERMS])
        assert r.reward_terms.sum() == pytest.approx(summary.episode_return)
        assert r.clearance.min() == summary.clearance == 0.0
        assert np.sqrt(np.mean(r.heading_error**2)) == pytest.approx(summary.heading_error)
        assert int(np.sum(r.state_property[:-1] == "NS")) == summary.non_safe_steps

    def test_it_begins_on_the_start_and_its_samples_lead_to_the_end(
        self, collision: tuple[Recording, EpisodeSummary]
    ) -> None:
        r, summary = collision
        assert r.state_pose[0].tolist() == [6.0, 10.0, 0.0]
        assert r.sample_pose[-1].tolist() == r.state_pose[-1].tolist()
        assert r.sample_time[-1] == pytest.approx(r.state_time[-1])
        assert np.all(np.diff(r.sample_time) > 0)
        along = np.hypot(*np.diff(r.sample_pose[:, :2], axis=0).T).sum()
        assert along == pytest.approx(summary.path_length, abs=0.1)

    def test_it_keeps_world_and_vehicle(self, goal: tuple[Recording, EpisodeSummary]) -> None:
        r = goal[0]
        assert r.obstacles == (OrientedBox(18.0, 14.0, 2.0, 1.0, 0.3),)
        assert r.footprint == OrientedBox(0.35, 0.0, 0.55, 0.325)

    def test_it_knows_where_boxes_that_move_were(
        self, patrolled: tuple[Recording, EpisodeSummary], tmp_path: Path
    ) -> None:
        patrolled[0].save(tmp_path / "patrolled.npz")
        r = load_recording(tmp_path / "patrolled.npz")
        assert r.obstacles == (OrientedBox(20.0, 20.0, 1.0, 1.0),)
        assert r.patrols == (
            Patrol(OrientedBox(13.0, 5.0, 1.0, 0.7, 0.4), (13.0, 17.0), 0.8, 0.25),
            Patrol(OrientedBox(34.0, 10.0, 0.8, 1.0), (10.0, 10.0), 0.5, 0.0),
        )
        # By hand: half-way there at first, at the end after 7.5 s, on the way back at 10 s.
        standing, crossing, comes = r.boxes_at(10.0)
        assert standing == r.obstacles[0]
        assert crossing == OrientedBox(13.0, pytest.approx(17.0 - 0.8 * 2.5), 1.0, 0.7, 0.4)
        assert comes == OrientedBox(pytest.approx(29.0), 10.0, 0.8, 1.0)
        assert r.about["ending"] == "collision"
        # What it ran into was there: its front edge is at that of the box.
        (_, _, comes) = r.boxes_at(r.state_time[-1])
        assert r.state_pose[-1, 0] + 0.9 == pytest.approx(comes.x - 0.8, abs=0.03)

    def test_a_recording_from_before_there_were_any_has_none(
        self, goal: tuple[Recording, EpisodeSummary], tmp_path: Path
    ) -> None:
        world = {key: value for key, value in goal[0].about["world"].items() if key != "patrols"}
        replace(goal[0], about={**goal[0].about, "world": world}).save(tmp_path / "old.npz")
        assert load_recording(tmp_path / "old.npz").patrols == ()

    def test_action_values_are_missing_where_the_agent_did_not_ask(
        self, collision: tuple[Recording, EpisodeSummary]
    ) -> None:
        r = collision[0]
        non_safe = r.state_property[:-1] == "NS"
        assert non_safe.any()
        assert not non_safe.all()
        assert np.isfinite(r.q_values[non_safe]).all()
        assert np.isnan(r.q_values[~non_safe]).all()

    def test_it_holds_no_pickles(self, saved: Path) -> None:
        with zipfile.ZipFile(saved) as archive:
            names = archive.namelist()
            for name in names:
                with archive.open(name) as file:
                    version = npy.read_magic(file)
                    assert version == (1, 0)
                    _, _, dtype = npy.read_array_header_1_0(file)
                assert not dtype.hasobject, name
        assert len(names) == len(fields(Recording))

    def test_the_same_recording_gives_the_same_arrays_twice(
        self, record: Record, goal: tuple[Recording, EpisodeSummary], world_of: Callable[..., WorldSpec]
    ) -> None:
        box = OrientedBox(18.0, 14.0, 2.0, 1.0, 0.3)
        again, _ = record(world_of(box, side=40.0, start=Pose(6.0, 8.0, 0.2), target=(30.0, 20.0)), 5)
        np.testing.assert_array_equal(again.sample_pose, goal[0].sample_pose)
        np.testing.assert_array_equal(again.ray_distances, goal[0].ray_distances)


def refusal(path: Path) -> str:
    with pytest.raises(UserError) as refused:
        load_recording(path)
    return str(refused.value)


class TestRefusal:
    @pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.9, 0.999])
    def test_a_truncated_file(self, saved: Path, share: float) -> None:
        data = saved.read_bytes()
        saved.write_bytes(data[: int(share * len(data))])
        message = refusal(saved)
        assert str(saved) in message
        assert "\n" not in message

    @pytest.mark.parametrize(
        "content", [b"hello\nworld\n", b"\x89PNG\r\n\x1a\n" + bytes(64), b"PK\x03\x04", b"\x80\x04N."]
    )
    def test_a_foreign_file(self, tmp_path: Path, content: bytes) -> None:
        path = tmp_path / "other.npz"
        path.write_bytes(content)
        assert "\n" not in refusal(path)

    def test_a_missing_file_and_a_folder(self, tmp_path: Path) -> None:
        assert "\n" not in refusal(tmp_path / "none.npz")
        assert "\n" not in refusal(tmp_path)

    def test_arrays_of_another_program(self, tmp_path: Path) -> None:
        path = tmp_path / "other.npz"
        np.savez(path, x=np.arange(3))
        assert "\n" not in refusal(path)
        np.savez(path, about=np.array(json.dumps({"format": "another 7"})))
        assert "\n" not in refusal(path)
        np.savez(path, about=np.array("[1, 2]"))
        assert "\n" not in refusal(path)

    def test_a_missing_array(self, saved: Path, tmp_path: Path) -> None:
        with np.load(saved) as file:
            arrays = {name: file[name] for name in file.files if name != "readings"}
        np.savez(tmp_path / "less.npz", **arrays)
        assert "readings" in refusal(tmp_path / "less.npz")

    def test_a_pickle_is_not_opened(self, saved: Path, tmp_path: Path) -> None:
        with np.load(saved) as file:
            arrays = {name: file[name] for name in file.files}
        arrays["action"] = np.array([{"not": "a number"}], dtype=object)
        np.savez(tmp_path / "pickle.npz", **arrays)
        assert "\n" not in refusal(tmp_path / "pickle.npz")

    def test_flipped_bits_are_refused_in_one_line_or_do_no_harm(self, saved: Path) -> None:
        data = saved.read_bytes()
        refused = 0
        for place in np.linspace(0, len(data) - 1, 400, dtype=int):
            broken = bytearray(data)
            broken[place] ^= 0x55
            saved.write_bytes(broken)
            try:
                load_recording(saved)
            except UserError as error:
                refused += 1
                assert "\n" not in str(error)
        assert refused > 350


def pixels(path: Path) -> np.ndarray:
    with path.open("rb") as file:
        header = file.read(24)
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    picture = (matplotlib.image.imread(path)[:, :, :3] * 255).round().astype(int)
    assert picture.shape[1::-1] == struct.unpack(">II", header[16:])
    return picture


def count(picture: np.ndarray, colour: str, tolerance: int = 6) -> int:
    """Pixels of a colour, antialiased edges aside."""
    rgb = [int(colour[i : i + 2], 16) for i in (0, 2, 4)]
    return int(np.sum(np.abs(picture - rgb).max(axis=2) <= tolerance))


class TestTrajectoryPicture:
    def test_goal(self, goal: tuple[Recording, EpisodeSummary], tmp_path: Path) -> None:
        draw_trajectory(goal[0], tmp_path / "goal.png")
        picture = pixels(tmp_path / "goal.png")
        assert min(picture.shape[:2]) > 600
        assert count(picture, BLUE) > 200
        assert count(picture, GREY) > 500
        assert count(picture, YELLOW) > 50
        assert count(picture, "ffffff") > 0.2 * picture.shape[0] * picture.shape[1]

    def test_a_collision_is_marked(self, collision: tuple[Recording, EpisodeSummary], tmp_path: Path) -> None:
        recording = collision[0]
        draw_trajectory(recording, tmp_path / "collision.png")
        draw_trajectory(replace(recording, about={**recording.about, "ending": "timeout"}), tmp_path / "timeout.png")
        marked, unmarked = pixels(tmp_path / "collision.png"), pixels(tmp_path / "timeout.png")
        assert count(marked, RED) > count(unmarked, RED) + 100

    def test_path_colours_tell_safe_from_non_safe(
        self, collision: tuple[Recording, EpisodeSummary], tmp_path: Path
    ) -> None:
        recording = collision[0]
        seen = {}
        for name in ("SS", "NS"):
            states = np.full_like(recording.state_property, name)
            draw_trajectory(replace(recording, state_property=states), tmp_path / f"{name}.png")
            seen[name] = pixels(tmp_path / f"{name}.png")
        assert count(seen["SS"], BLUE) > 2 * count(seen["NS"], BLUE)
        assert count(seen["NS"], ORANGE) > 2 * count(seen["SS"], ORANGE)
        draw_trajectory(recording, tmp_path / "both.png")
        both = pixels(tmp_path / "both.png")
        assert count(seen["NS"], BLUE) < count(both, BLUE) < count(seen["SS"], BLUE)
        assert count(seen["SS"], ORANGE) < count(both, ORANGE) < count(seen["NS"], ORANGE)

    def test_obstacles_are_drawn(self, collision: tuple[Recording, EpisodeSummary], tmp_path: Path) -> None:
        recording = collision[0]
        world = {**recording.about["world"], "obstacles": []}
        draw_trajectory(recording, tmp_path / "with.png")
        draw_trajectory(replace(recording, about={**recording.about, "world": world}), tmp_path / "without.png")
        with_box, without = (count(pixels(tmp_path / f"{name}.png"), GREY) for name in ("with", "without"))
        assert with_box > without + 500

    def test_boxes_that_move_are_drawn_with_their_tracks(
        self, patrolled: tuple[Recording, EpisodeSummary], tmp_path: Path
    ) -> None:
        recording = patrolled[0]
        world = {**recording.about["world"], "patrols": []}
        draw_trajectory(recording, tmp_path / "with.png")
        draw_trajectory(replace(recording, about={**recording.about, "world": world}), tmp_path / "without.png")
        with_them, without = (pixels(tmp_path / f"{name}.png") for name in ("with", "without"))
        assert count(with_them, VIOLET) > 500
        assert count(without, VIOLET) == 0
        assert count(with_them, GREY) == pytest.approx(count(without, GREY), rel=0.1)

    def test_the_inset_shows_them_where_they_were_at_the_tightest_moment(
        self, record: Record, world_of: Callable[..., WorldSpec], tmp_path: Path
    ) -> None:
        """One comes as near as 1 m just when it passes, and is 7 m farther off when the drive ends."""
        passed = Patrol(OrientedBox(16.0, 13.0, 1.5, 1.5), (16.0, 31.0), 1.0, 31 / 36)
        world = world_of(side=40.0, start=Pose(6.0, 10.0, 0.0), target=(32.0, 10.0))
        recording, summary = record(replace(world, patrols=(passed,)), 0)
        assert summary.ending == "goal"
        assert 1.0 < summary.clearance < 1.5
        (end,) = recording.boxes_at(recording.state_time[-1])
        assert end.y == pytest.approx(13.0 + 7.0, abs=0.1)
        draw_trajectory(recording, tmp_path / "passing.png")
        picture = pixels(tmp_path / "passing.png")
        inset = picture[: picture.shape[0] // 2, 2 * picture.shape[1] // 3 :]
        assert count(inset, VIOLET) > 2000
        assert count(inset, YELLOW) > 500

    def test_a_collision_at_once_can_be_drawn(
        self, immediate: tuple[Recording, EpisodeSummary], tmp_path: Path
    ) -> None:
        draw_trajectory(immediate[0], tmp_path / "immediate.png")
        assert count(pixels(tmp_path / "immediate.png"), YELLOW) > 50

    def test_a_loaded_recording_draws_the_same_picture(
        self, goal: tuple[Recording, EpisodeSummary], saved: Path, tmp_path: Path
    ) -> None:
        draw_trajectory(goal[0], tmp_path / "first.png")
        draw_trajectory(load_recording(saved), tmp_path / "second.png")
        assert (tmp_path / "first.png").read_bytes() == (tmp_path / "second.png").read_bytes()


def training(endings: str) -> list[TrainingEpisode]:
    names = {"g": "goal", "c": "collision", "t": "timeout"}
    episodes = []
    for number, letter in enumerate(endings):
        summary = EpisodeSummary(
            world_seed=number,
            ending=names[letter],
            steps=10,
            duration=5.0,
            path_length=10.0,
            clearance=0.5,
            mean_clearance=2.0,
            lateral_acceleration=1.0,
            heading_error=0.0,
            non_safe_steps=3,
            episode_return=1.0,
            terms=dict.fromkeys(REWARD_TERMS, 0.0),
        )
        episodes.append(TrainingEpisode(number, summary, {"temperature": 0.5, "td_error": 0.1}))
    return episodes


class TestLearningCurve:
    def test_each_ending_has_its_colour(self, tmp_path: Path) -> None:
        seen = {}
        for letter in "gc":
            draw_learning_curve(training(letter * 40 + "t" * 40 + letter * 40), tmp_path / f"{letter}.png")
            seen[letter] = pixels(tmp_path / f"{letter}.png")
        # The curve of an ending that never comes is a straight line along the bottom.
        assert count(seen["g"], GREEN) > count(seen["c"], GREEN)
        assert count(seen["c"], RED) > count(seen["g"], RED)

    @pytest.mark.parametrize("endings", ["g", "gc", "gct", "g" * 7])
    def test_few_episodes_can_be_drawn(self, tmp_path: Path, endings: str) -> None:
        draw_learning_curve(training(endings), tmp_path / "few.png")
        assert pixels(tmp_path / "few.png").size > 0

    def test_an_older_picture_survives_a_failure(self, tmp_path: Path) -> None:
        path = tmp_path / "curve.png"
        draw_learning_curve(training("gc"), path)
        before = path.read_bytes()
        with pytest.raises((IndexError, ValueError)):
            draw_learning_curve([], path)
        assert path.read_bytes() == before
        assert [p.name for p in tmp_path.iterdir()] == ["curve.png"]
