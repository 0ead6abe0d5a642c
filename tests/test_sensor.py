"""A sensor with any number of rays, any range and a blind arc, in every simulator and before every policy."""

import json
from contextlib import closing
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest

import nnql_bullet as nb
from nnql_bullet import paper
from nnql_bullet.agents.learning.frames import FrameMaker
from nnql_bullet.agents.rules.vfh import Vfh, VfhOptions
from nnql_bullet.env import Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Array, Circle, OrientedBox, Pose, Shape, as_rows, ray_distances
from nnql_bullet.mapping.point_cloud import moving_points, point_cloud
from nnql_bullet.presets import PRESETS
from nnql_bullet.recording import Recording
from nnql_bullet.rollout import run_episode
from nnql_bullet.run_config import Conditions, RunConfig, SimulatorName, changed
from nnql_bullet.sensing import Sensor, middle_readings, nearest_rays, ray_angles, sector_readings
from nnql_bullet.task import StateProperty
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.spec import WorldSpec
from tests.helpers import observed

COUNTS = (8, 72, 144, 180, 216, 360, 720, 1080)
SIMULATORS: tuple[SimulatorName, ...] = ("kinematic", "bullet", "mujoco")
RULES = ("straight", "random", "hand_rule", "potential_field", "fuzzy", "vfh", "look_ahead")
SHAPES = (
    OrientedBox(103.5, 101.0, 0.6, 0.4, 0.5),
    OrientedBox(98.0, 103.5, 1.0, 0.3, -0.4),
    OrientedBox(96.5, 98.0, 0.3, 0.7, 1.1),
    Circle(102.0, 96.8, 0.5),
    Circle(106.5, 104.5, 0.8),
)


def world_of(*shapes: Shape) -> WorldSpec:
    return WorldSpec("sensor", 0, 200.0, 200.0, shapes, Pose(100.0, 100.0, 0.3), (190.0, 190.0), 1.0, 1.5)


def scanned(simulator: SimulatorName, conditions: Conditions, world: WorldSpec) -> tuple[Array, VehicleSpec]:
    """Rays of a vehicle at the start of a world."""
    experiment = Experiment(RunConfig(simulator=simulator, conditions=conditions))
    with closing(experiment.simulator) as made:
        _, (rays,) = made.reset({0: world})
    return rays, experiment.vehicle


class TestRays:
    @pytest.mark.parametrize("rays", COUNTS)
    def test_they_are_evenly_spaced_and_centred_in_each_sector(self, rays: int) -> None:
        angles = ray_angles(rays)
        assert np.diff(angles) == pytest.approx(np.full(rays - 1, 2 * pi / rays))
        assert np.sort(np.cos(angles)) == pytest.approx(np.sort(np.cos(-angles)))
        assert np.sort(np.sin(angles)) == pytest.approx(np.sort(np.sin(-angles)), abs=1e-12)

    @pytest.mark.parametrize("rays", (*COUNTS, 12, 60, 100, 1436))
    def test_a_sector_has_the_rays_that_are_nearest_to_its_middle(self, rays: int) -> None:
        sectors = np.round(ray_angles(rays) / (pi / 4)).astype(int) % 8
        distances = np.where(np.eye(rays), 1.5, 10.0)
        expected = np.where(sectors[:, None] == np.arange(8), 1.5, 10.0)
        assert np.array_equal(sector_readings(distances), expected)
        off = np.abs(np.angle(np.exp(1j * (ray_angles(rays)[:, None] - np.arange(8) * pi / 4))))
        middle = np.where(off < off.min(axis=0) + 1e-9, 1.5, 10.0)
        assert np.array_equal(middle_readings(distances), middle)

    @pytest.mark.parametrize("factor", [1, 3, 5, 15])
    def test_odd_multiples_contain_the_paper_s(self, factor: int) -> None:
        many, few = Sensor(position=(0.0, 0.0, 0.0), rays=72 * factor), Sensor(position=(0.0, 0.0, 0.0))
        taken = nearest_rays(72 * factor)
        assert taken.tolist() == list(range(factor // 2, 72 * factor, factor))
        assert np.array_equal(many.directions[taken], few.directions)

    @pytest.mark.parametrize("rays", COUNTS)
    def test_others_are_represented_by_the_nearest(self, rays: int) -> None:
        off = np.abs(ray_angles(rays)[:, None] - ray_angles())
        off = np.minimum(off, 2 * pi - off)
        assert off[nearest_rays(rays), np.arange(72)] == pytest.approx(off.min(axis=0), abs=1e-9)

    def test_of_two_rays_in_the_middle_the_shorter_counts(self) -> None:
        distances = np.full((2, 16), 9.0)
        distances[0, 4], distances[1, 5] = 3.0, 2.0
        assert middle_readings(distances)[:, 2].tolist() == [3.0, 2.0]

    @pytest.mark.parametrize("rays", [24, 216])
    def test_of_an_odd_number_the_one_in_the_middle_does(self, rays: int) -> None:
        distances = np.random.default_rng(0).uniform(0, 10, rays)
        assert middle_readings(distances).tolist() == distances[rays // 16 :: rays // 8].tolist()

    @pytest.mark.parametrize(("arc", "hidden"), [((170.0, -170.0), 5), ((-90.0, 90.0), 37), ((181.0, 184.0), 0)])
    def test_a_blind_arc_leads_counter_clockwise(self, arc: tuple[float, float], hidden: int) -> None:
        sensor = Sensor(position=(0.0, 0.0, 0.0), blind_arc_degrees=arc)
        assert (~sensor.seen).sum() == hidden
        degrees = np.round(np.degrees(sensor.angles[~sensor.seen]))
        assert all((one - arc[0]) % 360 <= (arc[1] - arc[0]) % 360 for one in degrees)


class TestScans:
    @pytest.mark.parametrize("simulator", SIMULATORS)
    @pytest.mark.parametrize(("rays", "furthest"), [(360, 10.0), (1080, 5.0), (8, 20.0)])
    def test_every_simulator_reads_the_analytic_distance(
        self, simulator: SimulatorName, rays: int, furthest: float
    ) -> None:
        world = world_of(*SHAPES)
        found, vehicle = scanned(simulator, Conditions(rays=rays, sensor_range=furthest), world)
        start, (ahead, left, _) = world.start, vehicle.sensor.position
        eye = start.x + ahead * np.cos(start.yaw) - left * np.sin(start.yaw), start.y + ahead * np.sin(start.yaw)
        beside = [
            ray_distances(eye, vehicle.sensor.angles + start.yaw + nudge, world.solids, furthest)
            for nudge in (-1e-4, 0.0, 1e-4)
        ]
        off = np.min(np.abs(np.array(beside) - found), axis=0)  # of a ray that just passes an edge
        assert off.max() < 2e-3
        assert found.max() == furthest

    @pytest.mark.parametrize("simulator", SIMULATORS)
    @pytest.mark.parametrize("factor", [3, 5])
    def test_odd_multiples_read_what_72_do(self, simulator: SimulatorName, factor: int) -> None:
        few, _ = scanned(simulator, Conditions(), world_of(*SHAPES))
        many, _ = scanned(simulator, Conditions(rays=72 * factor), world_of(*SHAPES))
        assert np.array_equal(many[nearest_rays(72 * factor)], few)

    @pytest.mark.parametrize("simulator", SIMULATORS)
    def test_blind_rays_read_the_range_and_no_other_changes(self, simulator: SimulatorName) -> None:
        world = world_of(*SHAPES)
        whole, _ = scanned(simulator, Conditions(rays=360), world)
        found, vehicle = scanned(simulator, Conditions(rays=360, blind_arc_degrees=(-60.0, 100.0)), world)
        seen = vehicle.sensor.seen
        assert seen.sum() == 199
        assert (whole[~seen] < 10.0).any()
        assert (found[~seen] == 10.0).all()
        assert np.array_equal(found[seen], whole[seen])

    def test_readings_are_those_of_the_nearest_point_in_each_sector(self) -> None:
        """Against points all along the outlines of the shapes."""
        world = world_of(*SHAPES)
        found, vehicle = scanned("kinematic", Conditions(rays=360), world)
        points = np.concatenate([outline(shape) for shape in SHAPES])
        yaw, ahead = world.start.yaw, vehicle.sensor.position[0]
        dx, dy = (points - (100.0 + ahead * np.cos(yaw), 100.0 + ahead * np.sin(yaw))).T
        sectors = np.round((np.arctan2(dy, dx) - yaw) / (pi / 4)).astype(int) % 8
        nearest = [np.hypot(dx, dy)[sectors == k].min(initial=10.0) for k in range(8)]
        assert np.sum(np.array(nearest) < 10.0) >= 5
        farther = sector_readings(found) - nearest  # a degree is 0.1 m at most on these
        assert farther.min() > -2e-3
        assert farther.max() < 0.1


def outline(shape: Shape) -> Array:
    """Points along the outline of a shape (n, 2)."""
    if isinstance(shape, Circle):
        around = np.linspace(0, 2 * pi, 2000)
        return np.column_stack([shape.x + shape.radius * np.cos(around), shape.y + shape.radius * np.sin(around)])
    corners = shape.corners()
    shares = np.linspace(0, 1, 500)[:, None]
    return np.concatenate([corners[k] + shares * (corners[(k + 1) % 4] - corners[k]) for k in range(4)])


class TestPolicies:
    @pytest.mark.parametrize("simulator", SIMULATORS)
    @pytest.mark.parametrize("kind", [*RULES, *dict.fromkeys(preset.agent.kind for preset in PRESETS.values())])
    def test_each_drives_by_any_sensor(self, kind: str, simulator: SimulatorName) -> None:
        if kind == "fuzzy":
            pytest.importorskip("skfuzzy")
        for values in ({"rays": 360}, {"rays": 8, "sensor_range": 5.0}, {"rays": 144, "blind_arc_degrees": (150, 210)}):
            config = changed(
                RunConfig(simulator=simulator, physics="fast"),
                agent={"kind": kind},
                conditions=values,
                task={"max_steps": 3},
                shield={},
            )
            experiment = Experiment(config)
            with closing(experiment.simulator):
                summary = run_episode(experiment.navigation, world_of(*SHAPES[1:]), experiment.policy)
            assert summary.steps == 3

    @pytest.mark.parametrize("rays", [216, 360])
    def test_a_network_sees_through_an_odd_multiple_what_it_sees_through_72(self, rays: int) -> None:
        drives = [
            nb.drive("double_dqn", world="cover_10", seed=1, simulator="kinematic", conditions=Conditions(rays=count))
            for count in (72, rays)
        ]
        assert np.array_equal(drives[0].state_pose, drives[1].state_pose)
        assert drives[1].ray_distances.shape[1] == rays == drives[1].sensor.rays

    def test_a_network_s_frame_says_nothing_of_what_is_out_of_range(self) -> None:
        """A sensor of 5 m that meets nothing looks to it as one of 10 m that meets nothing."""
        vehicle, frames = load_vehicle("tricycle"), []
        for furthest in (5.0, 10.0, 20.0):
            seeing = replace(vehicle, sensor=replace(vehicle.sensor, range=furthest))
            maker = FrameMaker(24, 1, True, seeing, DriveOptions())
            nothing = (np.full(8, furthest), 40.0, 0.3, 0.0, 2.0, StateProperty.SAFE, np.full(72, furthest))
            frames.append(maker.look(maker.nothing(1), observed(nothing)).stacked)
        assert np.array_equal(frames[0], frames[1])
        assert np.array_equal(frames[2], frames[1])

    def test_histograms_weigh_a_wall_the_same_by_any_number_of_rays(self) -> None:
        vehicle, blocked = load_vehicle("tricycle"), []
        for rays in (72, 360, 1080):
            seeing = replace(vehicle, sensor=replace(vehicle.sensor, rays=rays))
            wall = ray_distances((0.0, 0.0), seeing.sensor.angles, as_rows((OrientedBox(5.0, 0.0, 0.5, 3.0),)), 10.0)
            agent = Vfh(VfhOptions(), seeing, DriveOptions())
            seen = observed((np.full(8, 4.5), 40.0, 0.0, 0.0, 2.0, StateProperty.SAFE, wall))
            blocked.append(agent.act(seen, agent.initial_state(1))[1].blocked)
        assert 10 < blocked[0].sum() < 40
        assert all(np.abs(one.astype(int) - blocked[0]).sum() <= 2 for one in blocked[1:])


def test_what_comes_out_of_a_blind_arc_does_not_move() -> None:
    sensor = Sensor(position=(0.0, 0.0, 0.0), rays=360, blind_arc_degrees=(-20.0, 20.0))
    now = np.where(np.cos(sensor.angles) > np.cos(0.5), 4.0, 10.0)
    before = np.where(sensor.seen, 10.0, np.nan)
    moved = np.array([0.0, 0.0, 0.0])
    found = moving_points(point_cloud(now, sensor), before, moved, 0.0, np.zeros(2))
    assert not found[~sensor.seen].any()
    assert found[sensor.seen & (now < 10.0)].sum() >= 15


def test_a_recording_tells_its_sensor_and_an_old_one_has_the_paper_s(tmp_path: Path) -> None:
    asked = Conditions(rays=24, sensor_range=6.0, blind_arc_degrees=(150.0, -150.0))
    kept = nb.drive("straight", simulator="kinematic", conditions=asked, changes={"task": {"max_steps": 2}})
    kept.save(tmp_path / "new.npz")
    loaded = Recording.load(tmp_path / "new.npz")
    assert loaded.sensor == asked.applied_to(load_vehicle("tricycle")).sensor
    assert loaded.ray_distances.shape == (3, 24)
    vehicle = {k: v for k, v in kept.about["vehicle"].items() if k not in ("sensor_range", "blind_arc_degrees")}
    replace(kept, about={**kept.about, "vehicle": vehicle}).save(tmp_path / "old.npz")
    old = Recording.load(tmp_path / "old.npz").sensor
    assert (old.range, old.blind_arc_degrees) == (paper.SENSOR_RANGE, None)
    replace(kept, ray_distances=kept.ray_distances[:, :23]).save(tmp_path / "odd.npz")
    with pytest.raises(UserError, match="not a whole recording"):
        Recording.load(tmp_path / "odd.npz")


def test_a_vehicle_s_file_may_say_all_of_it(tmp_path: Path) -> None:
    shipped = load_vehicle("tricycle")
    text = (shipped.urdf.parent / "tricycle.toml").read_text()
    (tmp_path / shipped.urdf.name).write_bytes(shipped.urdf.read_bytes())
    mine = tmp_path / "mine.toml"
    mine.write_text(text.replace("[sensor]\n", "[sensor]\nrays = 1080\nrange = 25.0\nblind_arc_degrees = [150, 210]\n"))
    sensor = load_vehicle(mine).sensor
    assert (sensor.rays, sensor.range, sensor.blind_arc_degrees) == (1080, 25.0, (150.0, 210.0))
    for wrong, message in (("rays = 101", "multiple of 4"), ("rays = 2880", "1440"), ("range = 0", "greater than 0")):
        mine.write_text(text.replace("[sensor]\n", f"[sensor]\n{wrong}\n"))
        with pytest.raises(UserError, match=f"sensor.*{message}"):
            load_vehicle(mine)


class TestCommandLine:
    def test_the_short_flags_reach_the_recording(self, run_cli, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
        given = ["--rays", "180", "--sensor-range", "7", "--blind-arc", "150", "-150", "--task.max-steps", "2"]
        code, out, err = run_cli("drive", "vfh", "--sim", "kinematic", "--out", str(tmp_path), "--json", *given)
        assert code == 0
        assert err.startswith("world 'paper': 2 steps of 0.5 s at 2 m/s are 2 m, and the target is 97 m away")
        assert json.loads(out)["steps"] == 2
        sensor = Recording.load(tmp_path / "trajectory.npz").sensor
        assert (sensor.rays, sensor.range, sensor.blind_arc_degrees) == (180, 7.0, (150.0, -150.0))

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            (["--rays", "101"], "'conditions.rays': input should be a multiple of 4"),
            (["--rays", "many"], "--rays: not a valid value: 'many'"),
            (["--sensor-range", "-1"], "'conditions.sensor_range'"),
            (["--blind-arc", "10", "10"], "a blind arc leads counter-clockwise"),
        ],
    )
    @pytest.mark.parametrize("verb", ["drive", "evaluate", "gap", "train"])
    def test_nonsense_is_refused_by_name(self, run_cli, verb: str, given: list[str], message: str) -> None:  # type: ignore[no-untyped-def]
        code, _, err = run_cli(verb, *([] if verb == "train" else ["straight"]), *given)
        assert code == 2
        assert message in err


def test_the_environment_s_box_is_the_sensor_s() -> None:
    env = nb.make_env(conditions={"sensor_range": 6.0, "rays": 24}, simulator="kinematic")
    seen, _ = env.reset(seed=0)
    assert env.observation_space.high[:8].tolist() == [6.0] * 8
    assert env.observation_space.contains(seen)
    env.close()


def test_navigation_has_room_for_its_rays() -> None:
    experiment = Experiment(RunConfig(simulator="kinematic", vehicles=3, conditions=Conditions(rays=1440)))
    with closing(experiment.new_simulator(1)) as simulator:
        navigation = Navigation(simulator, experiment.config.task)
        navigation.reset({1: world_of(*SHAPES)})
        assert navigation.observation.ray_distances.shape == (3, 1440)
