"""Goals beyond sight: way points in turn, plans, and the carrot on them."""

import heapq
import json
from contextlib import closing
from dataclasses import replace
from itertools import count, pairwise, product
from math import hypot, inf, sqrt

import numpy as np
import pytest

import nnql_bullet as nb
from nnql_bullet.env import Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import OrientedBox, Pose, as_rows, clearance_at
from nnql_bullet.mapping import grid_map
from nnql_bullet.planning.course import Course
from nnql_bullet.planning.planner import Planner, PlanOptions
from nnql_bullet.rollout import run_episode, run_episodes
from nnql_bullet.run_config import RunConfig, changed
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.worlds.spec import WorldSpec
from nnql_bullet.worlds.waypoints import read_waypoints

WALL = OrientedBox(10.0, 6.0, 0.2, 6.0)  # from below, with a gap of 3 m above
WALLED = WorldSpec("walled", 0, 20.0, 15.0, (WALL,), Pose(3.0, 3.0, 0.0), (17.0, 3.0), 1.0, 1.5)


@pytest.fixture(scope="module")
def planner(vehicle):
    return Planner(PlanOptions(), vehicle)


def dijkstra(cost, side, end):
    """Cost of the cheapest way from each cell to `end`, with a heap."""
    best, heap = {end: 0.0}, [(0.0, end)]
    while heap:
        length, (row, column) = heapq.heappop(heap)
        if length > best[row, column]:
            continue
        for down, right in product((-1, 0, 1), repeat=2):
            there = row + down, column + right
            if there == (row, column) or not all(0 <= i < n for i, n in zip(there, cost.shape, strict=True)):
                continue
            through = length + side * hypot(down, right) * (cost[row, column] + cost[there]) / 2
            if through < best.get(there, inf):
                best[there] = through
                heapq.heappush(heap, (through, there))
    return best


class TestPlan:
    def test_ways_are_those_of_a_plain_dijkstra(self, vehicle):
        small = replace(WALLED, width=8.0, depth=6.0, obstacles=(OrientedBox(4.0, 2.0, 0.2, 2.0, 0.2),), target=(7, 1))
        planner = Planner(PlanOptions(), vehicle)
        ways = planner.ways(small, (1.0, 1.0), small.target)
        expected = dijkstra(ways.grid.cost, ways.grid.side, ways.grid.cell_of(*small.target))
        for cell in product(*map(range, ways.cost.shape)):
            assert ways.cost[cell] == pytest.approx(expected.get(cell, inf)) or not ways.grid.free[cell]

    def test_plan_goes_round_a_wall_where_the_vehicle_fits(self, planner, vehicle):
        path = planner.ways(WALLED, (3.0, 3.0), WALLED.target).way(3.0, 3.0)
        point = as_rows((OrientedBox(0.0, 0.0, 0.0, 0.0),))[0]
        clear = [clearance_at(x, y, 0.0, point, WALLED.solids) for x, y in path.tolist()]
        assert min(clear) > vehicle.width / 2
        assert path[-1].tolist() == [17.0, 3.0]
        corner = 2 * sqrt(7.0**2 + 9.0**2)  # over the end of the wall
        assert corner < np.hypot(*np.diff(path, axis=0).T).sum() < 1.25 * corner

    def test_plan_prefers_the_wide_of_two_passages(self, planner):
        walls = OrientedBox(10.0, 2.0, 0.2, 2.0), OrientedBox(10.0, 7.4, 0.2, 2.6)  # gaps of 0.8 m and of 5 m
        world = replace(WALLED, obstacles=walls, start=Pose(3.0, 4.4, 0.0), target=(17.0, 4.4))
        assert planner.ways(world, (3.0, 4.4), world.target).way(3.0, 4.4)[:, 1].max() > 10.0

    def test_without_a_way_it_says_where_it_is_narrowest(self, planner):
        closed = replace(WALLED, obstacles=(WALL, OrientedBox(10.0, 13.8, 0.2, 1.2)))  # a gap of 0.6 m
        with pytest.raises(UserError, match=r"narrows to 0\.60 m at \(\d+\.\d+, 12\.30\)"):
            planner.ways(closed, (3.0, 3.0), closed.target)

    def test_passage_as_narrow_as_the_vehicle_is_found(self, planner, vehicle):
        width = vehicle.width + 1e-6
        upper = (15.0 - 12.0 - width) / 2
        narrow = replace(WALLED, obstacles=(WALL, OrientedBox(10.0, 15.0 - upper, 0.2, upper)))
        assert len(planner.ways(narrow, (3.0, 3.0), narrow.target).way(3.0, 3.0))


class TestCarrot:
    def test_moves_on_ahead_and_is_seen(self, planner, vehicle):
        course = Course(WALLED, [WALLED.target], planner, 3.0, 3.0)
        ((_, corners),) = course.plans
        fine = np.concatenate([np.linspace(*ends, 200) for ends in pairwise(corners)])
        along = np.concatenate([[0.0], np.hypot(*np.diff(fine, axis=0).T).cumsum()])
        before, left = -1.0, inf
        for x, y in fine[::37].tolist():
            course.update(x, y, 0.5)
            at = along[np.hypot(*(fine - course.aim).T).argmin()]
            here = along[np.hypot(*(fine - (x, y)).T).argmin()]
            assert before - 0.05 <= at <= here + planner.look_ahead + 0.25
            assert at > here or course.aim == WALLED.target
            disc = as_rows((OrientedBox(0.0, 0.0, 0.0, 0.0),))[0]
            for share in np.linspace(0, 1, 30):
                u, v = x + share * (course.aim[0] - x), y + share * (course.aim[1] - y)
                assert clearance_at(u, v, 0.0, disc, WALLED.solids) > vehicle.width / 2 - 0.05
            assert course.distance_left < left + 0.05
            before, left = at, course.distance_left
        assert len(course.plans) == 1

    def test_off_the_plan_it_is_made_anew(self, planner):
        course = Course(WALLED, [WALLED.target], planner, 3.0, 3.0)
        course.update(3.0, 13.0, 5.0)
        assert [time for time, _ in course.plans] == [0.0, 5.0]
        assert course.plans[1][1][0].tolist() == [3.0, 13.0]

    def test_straight_rule_gets_round_a_wall_with_a_plan_alone(self):
        ends = {"start": (4.0, 5.0), "target": (36.0, 5.0)}
        world = nb.World.from_boxes([(20.0, 8.0, 0.4, 16.0)], width=40.0, depth=24.0, **ends)
        assert nb.drive("straight", world=world, simulator="kinematic").summary.ending == "collision"
        recording = nb.drive("straight", world=world, simulator="kinematic", plan=True)
        assert recording.summary.ending == "goal"
        assert recording.plans[0][0] == 0.0
        assert len(recording.aims) == len(recording.state_pose)
        toward = np.arctan2(*(recording.aims[0] - recording.state_pose[0, :2])[::-1])
        assert toward == pytest.approx(recording.world.start.yaw, abs=1e-5)  # it starts along its plan


class TestWayPoints:
    TURNS = (60.0, 60.0), (80.0, 30.0)

    def test_are_reached_in_turn_in_an_empty_world(self, tmp_path):
        recording = nb.drive("straight", world="empty", simulator="kinematic", waypoints=[*self.TURNS, (30.0, 90.0)])
        summary, world = recording.summary, recording.world
        assert summary.ending == "goal"
        assert world.waypoints == self.TURNS
        assert world.target == (30.0, 90.0)
        times = (*summary.waypoint_times, summary.duration)
        for time, place in zip(times, world.targets, strict=True):
            x, y, _ = recording.state_pose[np.searchsorted(recording.state_time, time - 1e-9)]
            assert 0.9 < hypot(x - place[0], y - place[1]) <= world.target_radius == 2.0
        assert list(times) == sorted(times)
        legs = [hypot(u - x, v - y) for (x, y), (u, v) in world.legs]
        assert sum(legs) - 10.0 < summary.path_length < sum(legs) + 10.0
        recording.save(tmp_path / "a.npz")
        again = nb.Recording.load(tmp_path / "a.npz")
        assert again.world == world
        assert again.summary.waypoint_times == summary.waypoint_times
        assert np.array_equal(again.aims, recording.aims)

    @pytest.mark.parametrize("simulator", ["bullet", "mujoco"])
    def test_are_reached_in_turn_in_contact_physics(self, simulator):
        pytest.importorskip("mujoco" if simulator == "mujoco" else "pybullet")
        places = (26.0, 26.0), (34.0, 24.0), (34.0, 32.0)
        asked = {"world": "empty", "simulator": simulator, "physics": "fast", "waypoints": places}
        recording = nb.drive("straight", **asked)
        summary = recording.summary
        assert summary.ending == "goal"
        times = [*summary.waypoint_times, summary.duration]
        assert len(times) == 3
        assert times == sorted(times)
        at = [recording.state_pose[np.searchsorted(recording.state_time, time - 1e-9), :2] for time in times]
        assert all(hypot(*(here - place)) <= 2.0 + 1e-6 for here, place in zip(at, places, strict=True))

    def test_several_vehicles_do_as_each_alone(self, vehicle):
        worlds = [
            WorldSpec("a", seed, 100.0, 100.0, (), Pose(20.0, 20.0, 0.0), (80.0, 80.0), 2.0, 1.5, (), places)
            for seed, places in enumerate([self.TURNS, (), ((30.0, 60.0),), ((21.0, 20.0), (22.0, 20.0))])
        ]
        config = changed(RunConfig(), agent={"kind": "straight"}, simulator="kinematic")
        policy = Experiment(config).policy
        together = run_episodes(_navigation(vehicle, 2), worlds, policy)
        alone = [run_episode(_navigation(vehicle, 1), world, policy) for world in worlds]
        assert together == alone
        assert [len(its.waypoint_times) for its in alone] == [2, 0, 1, 2]

    def test_with_one_target_observations_share_their_arrays(self, vehicle):
        navigation = _navigation(vehicle, 2)
        navigation.reset({i: replace(WALLED, seed=i) for i in range(2)})
        s_t = navigation.step(np.zeros(2, np.int64)).s_t
        assert s_t.landmark_distance is s_t.distance_left is s_t.target_distance

    def test_target_changes_in_the_middle_of_an_episode(self):
        env = nb.make_env(world="empty", simulator="kinematic")
        env.reset(seed=0)
        for action in (0, 5, 5):
            env.step(action)
        before = env._fleet.navigation.observation
        vector = env.set_target((20.0, 40.0), (60.0, 20.0))
        now = env._fleet.navigation.observation
        assert vector[8] == pytest.approx(now.target_distance[0])
        assert now.landmark_distance == pytest.approx(before.target_distance)
        assert now.distance_left[0] == pytest.approx(now.target_distance[0] + hypot(40.0, 20.0))
        with pytest.raises(UserError, match="outside the arena"):
            env.set_target((200.0, 0.0))
        terminated = truncated = False
        while not (terminated or truncated):
            vector, _, terminated, truncated, info = env.step(5)
        assert info["ending"] == "goal"
        x, y, _ = env._fleet.navigation._poses[0]
        assert hypot(x - 60.0, y - 20.0) <= 2.0
        env.close()

    @pytest.mark.parametrize("plan", [True, {"look_ahead": 3.0}])
    def test_an_environment_takes_way_points_and_a_plan_as_a_drive_does(self, plan):
        asked = {"world": "paper", "simulator": "kinematic", "waypoints": [(40.0, 30.0), (50.0, 60.0)]}
        changes = {} if plan is True else {"plan": plan}
        driven = nb.drive("straight", plan=True, changes=changes, seed=4, **asked)
        with closing(nb.make_env(plan=plan, **asked)) as env:
            env.reset(options={"world_seed": 4})
            steps = next(k for k in count(1) if any(env.step(5)[2:4]))
            assert env._fleet.navigation._poses[0] == pytest.approx(driven.state_pose[-1], abs=1e-9)
        assert (driven.summary.ending, driven.summary.steps) == ("goal", steps)

    @pytest.mark.parametrize("simulator", ["kinematic", pytest.param("bullet", marks=pytest.mark.slow)])
    def test_vectors_take_targets_by_vehicle(self, simulator):
        envs = nb.make_env(world="empty", simulator=simulator, physics="fast", n_envs=3, workers=2)
        envs.reset(seed=0)
        envs.set_target({1: [(24.0, 20.0)]})
        ended = np.zeros(3, np.bool_)
        for _ in range(4):
            ended |= envs.step(np.full(3, 5))[2]
        assert ended.tolist() == [False, True, False]
        envs.close()

    def test_a_map_that_is_moved_with_its_target_tells_the_same(self):
        rng = np.random.default_rng(0)
        cells = (rng.random((grid_map.SIZE, grid_map.SIZE)) < 0.05).astype(np.int8)
        corner, cell = np.array([-20, -31]), grid_map.MAP_CELL
        moved = grid_map.path_lengths(cells, corner + np.array([8, -5]), np.array([8 * cell, -5 * cell]))
        assert np.allclose(moved, grid_map.path_lengths(cells, corner, np.zeros(2)))

    def test_evaluation_keeps_way_points_and_plan(self, tmp_path):
        asked = {"worlds": ["empty"], "n_worlds": 1, "simulator": "kinematic", "out": tmp_path}
        results = nb.evaluate("straight", waypoints=[(40.0, 20.0), (40.0, 50.0)], plan=True, **asked)
        ((episode,), values) = results.episodes, json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
        assert 0 < float(episode["waypoint_times"]) < episode["duration"]
        assert results.rows[0]["waypoints"] == 1
        assert values["waypoints"] == [[40.0, 20.0], [40.0, 50.0]]
        assert values["plan"] is True
        assert "--plan --waypoints 40,20;40,50" in values["command"].replace("'", "")
        assert nb.evaluate("straight", plan=True, **asked).episodes[0]["duration"] != episode["duration"]

    def test_target_and_way_points_are_not_both_given(self):
        with pytest.raises(UserError, match="the last of these is the target"):
            nb.World.load("empty").between(target=(1.0, 2.0), waypoints=[(3.0, 4.0)])


class TestReading:
    @pytest.mark.parametrize(
        ("name", "text"),
        [
            ("a.csv", "1,2\n3.5,-4\n"),
            ("a.csv", "x,y\n1,2\n\n3.5,-4  # the door\n"),
            ("a.csv", "name;y;x\nhall;2;1\ndoor;-4;3.5\n"),
            ("a.txt", "1 2\n3.5\t-4"),
            ("a.json", "[[1, 2], [3.5, -4]]"),
            ("a.json", '{"waypoints": [{"x": 1, "y": 2}, {"x": 3.5, "y": -4}]}'),
        ],
    )
    def test_files(self, tmp_path, name, text):
        (tmp_path / name).write_text(text, encoding="utf-8")
        assert read_waypoints(tmp_path / name) == read_waypoints("1,2;3.5,-4") == ((1.0, 2.0), (3.5, -4.0))

    @pytest.mark.parametrize(
        ("name", "text", "where"),
        [
            ("a.csv", "1,2\n\n3\n", "line 3"),
            ("a.csv", "1,2\nx,4\n", "line 2"),
            ("a.csv", "1,2\n1,nan\n", "line 2"),
            ("a.csv", "x,y\n1\n", "line 2"),
            ("a.csv", "", "1 to 1000 places, not 0"),
            ("a.json", "[[1, 2],\n [3, ]]", "line 2"),
            ("a.json", "[[1, 2], [3]]", "way point 2"),
            ("a.json", "[[1, true]]", "way point 1"),
            ("a.json", json.dumps({"points": []}), "list of places"),
        ],
    )
    def test_errors_name_the_place(self, tmp_path, name, text, where):
        (tmp_path / name).write_text(text, encoding="utf-8")
        with pytest.raises(UserError, match=where):
            read_waypoints(str(tmp_path / name))

    @pytest.mark.parametrize("text", ["1", "1,2;3", "1,2;;3,4", "a.csv", "1e999,2"])
    def test_wrong_words_are_refused(self, text):
        with pytest.raises(UserError):
            read_waypoints(text)


def _navigation(vehicle, size):
    return Navigation(KinematicSimulator(vehicle, DriveOptions(), size, 1), RunConfig().task)
