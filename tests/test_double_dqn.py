"""Double-DQN: its targets and returns against ones by hand, its memory against brute force, the same run again."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from heapq import heappop, heappush
from itertools import islice
from math import cos, hypot, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers import Driving, observed, same
from numpy.typing import NDArray

from nnql_bullet.agents.learning.double_dqn import (
    DoubleDqn,
    DuelingNetwork,
    double_q_targets,
    soft_update,
    td_errors,
)
from nnql_bullet.agents.learning.frames import FrameMaker, as_bytes
from nnql_bullet.agents.learning.options import DoubleDqnOptions
from nnql_bullet.agents.learning.replay import CONTINUES, TERMINATED, TRUNCATED, Replay
from nnql_bullet.agents.symmetry import MIRRORED_ACTIONS
from nnql_bullet.config import parse
from nnql_bullet.env import (
    MANOEUVRES,
    TOWARD_TARGET,
    Navigation,
    Observation,
    heading_change,
)
from nnql_bullet.errors import UserError, WorkerDied
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import wrap_angles
from nnql_bullet.mapping import grid_map
from nnql_bullet.run_config import RunConfig
from nnql_bullet.sensing import RAYS, ray_angles, sector_readings
from nnql_bullet.sim.base import Simulator
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import StateProperty, TaskOptions
from nnql_bullet.training.base import LearningAgent
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec

Cli = Callable[..., tuple[int, str, str]]
Arrays = dict[str, NDArray[Any]]
SMALL = DoubleDqnOptions(hidden=(12,), batch_size=16, buffer_size=300, learning_starts=60, exploration_episodes=8)


def random_network(inputs: int = 6, seed: int = 0) -> DuelingNetwork:
    """A network none of whose weights is special."""
    generator = torch.Generator().manual_seed(seed)
    network = DuelingNetwork(inputs, (5, 4))
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, generator=generator)
    return network


def some_bytes(*shape: int, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


class TestNetwork:
    def test_it_is_dueling(self) -> None:
        """Q = V + A - mean A, layer by layer in NumPy."""
        network, seen = random_network(), some_bytes(7, 6)
        w = {name: value.detach().numpy() for name, value in network.state_dict().items()}
        x = seen / 127.5 - 1.0
        for layer in (0, 3):
            x = x @ w[f"hidden.{layer}.weight"].T + w[f"hidden.{layer}.bias"]
            x = (x - x.mean(axis=1, keepdims=True)) / np.sqrt(x.var(axis=1, keepdims=True) + 1e-5)
            x = np.maximum(x * w[f"hidden.{layer + 1}.weight"] + w[f"hidden.{layer + 1}.bias"], 0.0)
        value, advantage = (x @ w[f"{head}.weight"].T + w[f"{head}.bias"] for head in ("value", "advantage"))
        expected = value + advantage - advantage.mean(axis=1, keepdims=True)
        with torch.no_grad():
            q = network(torch.from_numpy(seen)).numpy()
        assert q == pytest.approx(expected, abs=1e-4)
        assert q.mean(axis=1) == pytest.approx(value[:, 0], abs=1e-4)

    def test_gradients_are_those_of_finite_differences(self) -> None:
        """Of one output squared, which is a quadratic function of a head's weights: any step is small enough."""
        network, seen = random_network(), torch.from_numpy(some_bytes(3, 6))
        parameter = network.advantage.weight
        (gradient,) = torch.autograd.grad(network(seen)[:, 2].square().sum(), parameter)
        with torch.no_grad():
            for place in ((0, 1), (2, 3), (5, 0)):
                ends = []
                for step in (0.1, -0.1):
                    parameter[place] += step
                    ends.append(float(network(seen)[:, 2].square().sum()))
                    parameter[place] -= step
                assert float(gradient[place]) == pytest.approx((ends[0] - ends[1]) / 0.2, rel=1e-3, abs=1e-3)

    def test_one_chooses_and_the_other_values(self) -> None:
        online, target, after = random_network(seed=1), random_network(seed=2), some_bytes(9, 6)
        returns, discounts = np.linspace(-1, 1, 9), np.array([0.0, 0.9, 0.81] * 3)
        found = double_q_targets(online, target, returns, discounts, after).numpy()
        for i in range(9):
            with torch.no_grad():
                mine, theirs = (net(torch.from_numpy(after[i : i + 1])).numpy()[0] for net in (online, target))
            assert found[i] == pytest.approx(returns[i] + discounts[i] * theirs[int(mine.argmax())], abs=1e-5)

    def test_the_target_follows_by_a_share(self) -> None:
        one, other = random_network(seed=1), random_network(seed=2)
        expected = [
            0.9 * a.detach() + 0.1 * b.detach() for a, b in zip(one.parameters(), other.parameters(), strict=True)
        ]
        soft_update(one, other, 0.1)
        for parameter, value in zip(one.parameters(), expected, strict=True):
            assert torch.allclose(parameter, value, atol=1e-6)


EPISODES = [(4, TERMINATED), (2, TERMINATED), (7, TRUNCATED), (1, TERMINATED), (9, TRUNCATED), (30, CONTINUES)]
"""Length and end of the episodes of each vehicle, one after the other; the second begins with the third."""


class Story:
    """What two vehicles did, kept whole, in lists, and beside it the ring."""

    def __init__(self, decisions: int, rows: int, frames: int) -> None:
        generator = np.random.default_rng(3)
        self.replay = Replay(rows, 2, 4, frames)
        self.frames = frames
        self.steps: list[list[dict[str, Any]]] = [[], []]
        for vehicle, episodes in enumerate((EPISODES, EPISODES[2:])):
            for length, end in episodes:
                for age in range(length):
                    self.steps[vehicle].append(
                        {
                            "age": age,
                            "begin": len(self.steps[vehicle]) - age,
                            "seen": generator.integers(0, 256, 4, dtype=np.uint8),
                            "action": int(generator.integers(6)),
                            "reward": float(np.float32(generator.normal())),
                            "later": float(np.float32(generator.normal())),
                            "ends": end if age == length - 1 else CONTINUES,
                        }
                    )
        for t in range(decisions):
            now = [self.steps[v][t] for v in (0, 1)]
            self.replay.add(
                np.array([s["seen"] for s in now]),
                *(np.array([s[name] for s in now]) for name in ("age", "action", "reward", "ends")),
                np.array([self.steps[v][t - 1]["later"] if t else 0.0 for v in (0, 1)]),
            )

    def stack(self, vehicle: int, t: int) -> list[int]:
        """The last frames of the same episode, the first one repeated."""
        begin = self.steps[vehicle][t]["begin"]
        return [int(b) for k in range(self.frames) for b in self.steps[vehicle][max(t - k, begin)]["seen"]]

    def expected(self, vehicle: int, t: int, steps: int, discount: float) -> tuple[float, float, bool]:
        """Return, discount of what comes after, and whether it counts."""
        total, factor = 0.0, 1.0
        for step in self.steps[vehicle][t : t + steps]:
            if step["ends"] == TERMINATED:
                return total + factor * step["reward"], 0.0, True
            if step["ends"] == TRUNCATED:
                return 0.0, 0.0, False
            total += factor * (step["reward"] + step["later"])
            factor *= discount
        return total, factor, True


class TestReplay:
    @pytest.mark.parametrize("decisions", [12, 20, 21, 33])
    @pytest.mark.parametrize(("frames", "steps"), [(1, 1), (3, 3), (2, 4)])
    def test_returns_and_stacks_are_those_by_hand(self, decisions: int, frames: int, steps: int) -> None:
        """Before the ring has gone round, when it just has, and after."""
        story = Story(decisions, 20, frames)
        choices = story.replay.choices(steps)
        assert choices.stop == decisions - steps
        assert choices.start == (max(decisions - 20, 0) + (frames - 1) * (decisions > 20))
        for vehicle in (0, 1):
            times = np.array(choices)
            batch = story.replay.batch(times, np.full(len(times), vehicle), steps, 0.8)
            for i, t in enumerate(choices):
                total, factor, counts = story.expected(vehicle, t, steps, 0.8)
                assert batch.counts[i] == counts
                assert batch.a_tm1[i] == story.steps[vehicle][t]["action"]
                assert batch.s_tm1[i].tolist() == story.stack(vehicle, t)
                if counts:
                    assert (batch.r_t[i], batch.discount_t[i]) == pytest.approx((total, factor), abs=1e-5)
                    if factor > 0:
                        assert batch.s_t[i].tolist() == story.stack(vehicle, t + steps)

    @pytest.mark.parametrize("decisions", [0, 7, 20, 33])
    def test_it_is_the_same_after_saving_and_loading(self, decisions: int) -> None:
        story, again = Story(decisions, 20, 3), Replay(20, 2, 4, 3)
        again.load_state_dict(story.replay.state_dict())
        assert same(again.state_dict(), story.replay.state_dict())
        assert again.choices(3) == story.replay.choices(3)

    def test_there_is_nothing_to_draw_at_first(self) -> None:
        assert len(Replay(20, 2, 4, 3).choices(3)) == 0
        assert len(Story(3, 20, 3).replay.choices(3)) == 0


def dijkstra(cells: grid_map.Cells, corner: NDArray[np.int64]) -> NDArray[np.float64]:
    """`path_lengths` by another algorithm."""
    size = grid_map.SIZE
    occupied = np.argwhere(cells > 0)
    cost = np.ones((size, size))
    for a, b in occupied.tolist():
        cost[max(a - 2, 0) : a + 3, max(b - 2, 0) : b + 3] = grid_map.COSTS[2]
    for a, b in occupied.tolist():
        cost[max(a - 1, 0) : a + 2, max(b - 1, 0) : b + 2] = grid_map.COSTS[1]
    cost[cells > 0] = grid_map.COSTS[0]
    left = np.full((size, size), np.inf)
    heap: list[tuple[float, int, int]] = []
    for a in range(size):
        for b in range(size):
            at_target = corner[0] + a in (-1, 0) and corner[1] + b in (-1, 0)
            if a in (0, size - 1) or b in (0, size - 1) or at_target:
                heappush(heap, (grid_map.MAP_CELL * hypot(corner[0] + a + 0.5, corner[1] + b + 0.5), a, b))
    while heap:
        way, a, b = heappop(heap)
        if way >= left[a, b]:
            continue
        left[a, b] = way
        for c, d in ((a + i, b + j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j):
            if 0 <= c < size and 0 <= d < size:
                beside = min(cost[a, d], cost[c, b]) if a != c and b != d else 0.0
                through = max(cost[a, b], beside) + max(cost[c, d], beside)
                longer = 0.5 * grid_map.MAP_CELL * hypot(a - c, b - d) * through
                heappush(heap, (way + longer, c, d))
    return left


class TestMap:
    @pytest.mark.parametrize(
        ("share", "corner"), [(0.0, (-80, 3)), (0.1, (-60, -70)), (0.35, (-20, -30)), (0.5, (7, 9))]
    )
    def test_ways_are_the_shortest_ones(self, share: float, corner: tuple[int, int]) -> None:
        generator = np.random.default_rng(int(100 * share))
        cells = (generator.random((grid_map.SIZE, grid_map.SIZE)) < share).astype(np.int8)
        at = np.array(corner)
        assert grid_map.path_lengths(cells, at, np.zeros(2)) == pytest.approx(dijkstra(cells, at), abs=1e-6)

    def test_without_anything_seen_the_way_is_the_straight_one(self) -> None:
        """But for the eight directions of steps between cells, which make it up to 8 % longer."""
        corner = np.array([-70, -60])
        left = grid_map.path_lengths(np.zeros((grid_map.SIZE, grid_map.SIZE), np.int8), corner, np.zeros(2))
        for place in ((-30.0, -20.0), (-40.5, -12.5), (-27.3, -33.1)):
            assert hypot(*place) - 0.1 <= grid_map.path_length_at(left, corner, *place) <= 1.09 * hypot(*place)

    def test_a_wall_is_gone_round(self) -> None:
        """A U around the vehicle, open away from the target: it is told to turn round."""
        middle, cell = grid_map.SIZE // 2, grid_map.MAP_CELL
        cells, corner = np.zeros((grid_map.SIZE, grid_map.SIZE), np.int8), np.array([-100, -middle])
        cells[middle + 6, middle - 9 : middle + 10] = 1
        cells[middle - 6 : middle + 7, middle - 9] = cells[middle - 6 : middle + 7, middle + 9] = 1
        pose = np.array([[cell * (middle - 99.5), cell / 2, 0.0]])
        before, target = pose[:, :2] - [[1.0, 0.0]], np.zeros((1, 2))
        around, ways, progress = grid_map.sensed(cells[None], corner[None], pose, before, target)
        far = around[0, grid_map.BEARINGS :]
        assert far[0] == grid_map.BARRED  # ahead
        assert around[0, 0] > 1.0
        assert far[grid_map.BEARINGS // 2] < -2.0  # behind
        assert ways[0] > -pose[0, 0] + 5.0
        assert progress[0] < -0.3  # it came from nearer to the way out

    def test_poses_are_those_driven(self, vehicle: VehicleSpec, kinematic_drive: list[tuple[Any, Any, Any]]) -> None:
        """Place and heading in the target's frame, against the simulator's own, over a whole drive with many turns."""
        maker = FrameMaker(24, 3, True, vehicle, DriveOptions())
        memory = maker.nothing(4)
        (first, _, target) = kinematic_drive[0]
        yaw = np.arctan2(*(target - first[:, :2]).T[::-1])
        for (poses, observations, _), actions in zip(
            kinematic_drive, random_manoeuvres(len(kinematic_drive)), strict=True
        ):
            look = maker.look(memory, observations)
            memory = maker.after(look, observations, actions)
            relative = poses[:, :2] - target
            c, s = np.cos(yaw), np.sin(yaw)
            expected = np.stack([c * relative[:, 0] + s * relative[:, 1], c * relative[:, 1] - s * relative[:, 0]], 1)
            assert look.memory.poses[:, :2] == pytest.approx(expected, abs=0.35)
            assert np.abs(wrap_angles(look.memory.poses[:, 2] - poses[:, 2] + yaw)).max() < 0.02

    def test_what_is_seen_is_entered_where_it_is(self, vehicle: VehicleSpec) -> None:
        """Against places all along the lines between what neighbouring rays met, where no vehicle fits through."""
        cells, corners = np.zeros((1, grid_map.SIZE, grid_map.SIZE), np.int8), np.zeros((1, 2), np.int64)
        pose, sensor, angles = np.array([[-30.2, 4.7, 0.6]]), np.array([0.35, 0.1]), ray_angles()
        distances = np.repeat(np.random.default_rng(0).uniform(2.0, 12.0, (1, RAYS // 4)), 4, axis=1).clip(max=10.0)
        grid_map.add_scans(cells, corners, pose, distances, sensor, angles, 10.0)
        start = np.array([-30.2 + 0.35 * cos(0.6) - 0.1 * sin(0.6), 4.7 + 0.35 * sin(0.6) + 0.1 * cos(0.6)])
        directions = np.stack([np.cos(angles + 0.6), np.sin(angles + 0.6)], axis=1)
        hits = start + (distances[0, :, None] + 0.15) * directions
        hits[distances[0] >= 10.0] = np.nan
        places = [
            hits[i] + share * (hits[(i + k) % RAYS] - hits[i])
            for i in range(RAYS)
            for k in range(5)
            for share in np.linspace(0, 1, 40)
            if np.hypot(*(hits[(i + k) % RAYS] - hits[i])) < (grid_map.NEIGHBOURS if k == 1 else grid_map.PASSAGE)
        ]
        along = {tuple(cell) for cell in np.floor(np.array(places) / grid_map.MAP_CELL).astype(int).tolist()}
        entered = {tuple(cell) for cell in (np.argwhere(cells[0] > 0) + corners[0]).tolist()}
        at_hits = np.floor(hits[np.isfinite(hits[:, 0])] / grid_map.MAP_CELL).astype(int).tolist()
        assert {tuple(cell) for cell in at_hits} <= entered <= along
        assert all(any(max(abs(a - c), abs(b - d)) <= 1 for c, d in entered) for a, b in along)
        middle = np.floor(pose[0, :2] / grid_map.MAP_CELL).astype(int) - grid_map.SIZE // 2
        assert corners[0].tolist() == middle.tolist()
        for _ in range(grid_map.SEEN):
            assert cells.any()
            grid_map.add_scans(cells, corners, pose, np.full((1, RAYS), 10.0), sensor, angles, 10.0)
        assert cells.sum() < 0.2 * grid_map.SEEN * len(entered)  # looked through often enough, but for odd corners

    def test_it_moves_along(self) -> None:
        generator = np.random.default_rng(0)
        cells = (generator.random((1, grid_map.SIZE, grid_map.SIZE)) < 0.3).astype(np.int8)
        before, corners = {tuple(c) for c in np.argwhere(cells[0]).tolist()}, np.zeros((1, 2), np.int64)
        middle = grid_map.SIZE // 2 + 0.5
        pose = np.array([[grid_map.MAP_CELL * (middle + 3), grid_map.MAP_CELL * (middle - 3), 0.0]])
        grid_map.add_scans(cells, corners, pose, np.zeros((1, 0)), np.zeros(2), np.zeros(0), 10.0)
        assert corners[0].tolist() == [3, -3]
        inside = {(a - 3, b + 3) for a, b in before if 0 <= a - 3 < grid_map.SIZE and 0 <= b + 3 < grid_map.SIZE}
        assert {tuple(cell) for cell in np.argwhere(cells[0]).tolist()} == inside


def random_manoeuvres(decisions: int) -> NDArray[np.int64]:
    """Some of them stops or backwards, as a shield may ask for."""
    return np.random.default_rng(0).integers(MANOEUVRES, size=(decisions, 4))


@pytest.fixture(scope="module")
def kinematic_drive(vehicle: VehicleSpec) -> list[tuple[Any, Any, Any]]:
    """Poses, observations and the target, at every decision of four vehicles that turn about and stop by chance."""
    experiment = Experiment(RunConfig(world="empty", simulator="kinematic"))
    fleet = KinematicSimulator(vehicle, DriveOptions(), 4)
    navigation = Navigation(fleet, TaskOptions())
    world = replace(experiment.world(0), start=replace(experiment.world(0).start, x=50.0, y=50.0))
    navigation.reset({i: world for i in range(4)})
    poses, drive = np.tile([world.start.x, world.start.y, world.start.yaw], (4, 1)), []
    for actions in random_manoeuvres(25):
        drive.append((poses, navigation.observation, np.array(world.target)))
        poses = navigation.step(actions).motion.pose.copy()
    fleet.close()
    return drive


def mirrored(observation: Observation) -> Observation:
    """What a vehicle sees whose left is right."""
    rays = observation.ray_distances[:, (8 - np.arange(RAYS)) % RAYS]
    return replace(
        observation,
        readings=sector_readings(rays),
        ray_distances=rays,
        target_bearing=-observation.target_bearing,
        landmark_bearing=-observation.landmark_bearing,
        yaw_rate=-observation.yaw_rate,
    )


class TestFrames:
    @pytest.mark.parametrize("rays", [8, 24, 72])
    @pytest.mark.parametrize("with_map", [False, True])
    def test_a_mirror_shows_what_a_mirrored_vehicle_sees(self, rays: Any, with_map: bool, vehicle: VehicleSpec) -> None:
        """Two vehicles drive as each other's mirror image. The map's cells are not mirrored exactly, so it is left
        out of the comparison but for where it says nothing else than the target's direction."""
        ahead, _, up = vehicle.sensor.position
        vehicle = replace(vehicle, sensor=replace(vehicle.sensor, position=(ahead, 0.0, up)))
        generator = np.random.default_rng(1)
        maker = FrameMaker(rays, 3, with_map, vehicle, DriveOptions())
        memories = [maker.nothing(1), maker.nothing(1)]
        distance = 60.0
        for _ in range(5):
            seen = generator.uniform(1.0, 10.0, RAYS) if not with_map else np.full(RAYS, 10.0)
            bearing = generator.uniform(-3, 3)
            one = observed((sector_readings(seen), distance, bearing, 0.7, 2.0, StateProperty.SAFE, seen))
            action = int(generator.integers(6))
            looks = []
            for i, (o, a) in enumerate(((one, action), (mirrored(one), int(MIRRORED_ACTIONS[action])))):
                looks.append(maker.look(memories[i], o))
                memories[i] = maker.after(looks[i], o, np.array([a]))
            expected = maker.mirrored(looks[0].stacked).astype(int)
            assert np.abs(expected - looks[1].stacked.astype(int)).max() <= (12 if with_map else 1)
            assert np.array_equal(maker.mirrored(maker.mirrored(looks[0].stacked)), looks[0].stacked)
            distance -= 1.0

    def test_mirrored_actions_turn_the_other_way(self) -> None:
        bearings = np.linspace(-1.5, 1.5, 7)
        for action in range(6):
            turns, others = heading_change(action, bearings), heading_change(int(MIRRORED_ACTIONS[action]), -bearings)
            assert others == pytest.approx(-turns)

    def test_bytes_lie_symmetrically(self) -> None:
        numbers = np.random.default_rng(0).uniform(-1.2, 1.2, 1000)
        assert np.array_equal(as_bytes(-numbers), 255 - as_bytes(numbers))
        assert as_bytes(np.array([-1.0, 1.0])).tolist() == [0, 255]

    def test_looking_leaves_the_memory_as_it_was(
        self, vehicle: VehicleSpec, kinematic_drive: list[tuple[Any, Observation, Any]]
    ) -> None:
        maker = FrameMaker(24, 3, True, vehicle, DriveOptions())
        memory = maker.nothing(4)
        for _, seen, _ in kinematic_drive[:6]:
            memory = maker.after(maker.look(memory, seen), seen, np.zeros(4, np.int64))
        before = memory.state_dict()
        looks = [maker.look(memory, kinematic_drive[6][1]) for _ in range(2)]
        assert same(before, memory.state_dict())
        assert same(looks[0].memory.state_dict(), looks[1].memory.state_dict())

    def test_progress_without_a_map_is_what_the_target_came_nearer(self, vehicle: VehicleSpec) -> None:
        maker = FrameMaker(8, 1, False, vehicle, DriveOptions())
        seen = [
            observed((np.full(8, 10.0), d, 0.0, 0.0, 2.0, StateProperty.SAFE, np.full(RAYS, 10.0)))
            for d in (40.0, 39.2)
        ]
        memory = maker.after(maker.look(maker.nothing(1), seen[0]), seen[0], np.array([TOWARD_TARGET]))
        assert maker.look(memory, seen[1]).progress == pytest.approx([0.8], abs=1e-9)


@pytest.fixture
def parts(small_world: Path) -> Iterator[Callable[..., tuple[Experiment, Any]]]:
    """Makes trainings in the small world, on the kinematic model."""
    fleets: list[Simulator] = []

    def make(vehicles: int = 3, seed: int = 5) -> tuple[Experiment, Any]:
        task = TaskOptions(max_steps=40)
        config = RunConfig(
            seed=seed, vehicles=vehicles, simulator="kinematic", world=str(small_world), task=task, agent=SMALL
        )
        experiment = Experiment(config)
        fleets.append(experiment.new_training_simulator(1))
        return experiment, experiment.trainer(Navigation(fleets[-1], task))

    yield make
    for fleet in fleets:
        fleet.close()


def test_told_what_was_done_it_goes_on_as_one_that_chose_it(
    vehicle: VehicleSpec, kinematic_drive: list[tuple[Any, Observation, Any]]
) -> None:
    """One of another mind does as it likes; another is told to do that, and then the first one comes to its senses."""
    agents = [DoubleDqn(SMALL, 0, vehicle, DriveOptions()) for _ in range(3)]
    one, other, untold = (Driving(agent, len(kinematic_drive[0][1].yaw_rate)) for agent in agents)
    minds = [
        {
            name: values + chance.normal(size=values.shape).astype(values.dtype)
            for name, values in agents[0].state_dict().items()
        }
        for chance in map(np.random.default_rng, range(2))
    ]
    for agent, mind in zip(agents, (0, 1, 1), strict=True):
        agent.load_state_dict(minds[mind])
    half = len(kinematic_drive) // 2
    for _, seen, _ in kinematic_drive[:half]:
        done = one.act(seen)
        assert not np.array_equal(other.act(seen), done)
        other.override(done)
        untold.act(seen)
    agents[0].load_state_dict(minds[1])
    mine, told, its_own = (agent.action_values(kinematic_drive[half][1]) for agent in (one, other, untold))
    assert np.array_equal(mine, told)
    assert not np.array_equal(mine, its_own)
    for _, seen, _ in kinematic_drive[half:]:
        assert np.array_equal(one.act(seen), other.act(seen))


class TestLearning:
    def test_the_seed_decides(self, parts: Callable[..., Any]) -> None:
        found = []
        for seed in (5, 5, 6):
            experiment, training = parts(seed=seed)
            torch.manual_seed(len(found))  # nobody else's chance matters
            episodes = list(islice(training.episodes(), 12))
            found.append((episodes, experiment.agent.state_dict()))
        assert found[0][0] == found[1][0] != found[2][0]
        assert same(found[0][1], found[1][1])
        assert not same(found[0][1], found[2][1])

    def test_nobody_elses_chance_is_touched(self, parts: Callable[..., Any]) -> None:
        torch.manual_seed(1)
        expected = float(torch.rand(1))
        torch.manual_seed(1)
        list(islice(parts()[1].episodes(), 9))
        assert float(torch.rand(1)) == expected

    def test_it_goes_on_as_if_it_had_never_stopped(self, parts: Callable[..., Any]) -> None:
        experiment, training = parts()
        stops = [
            (episode, experiment.agent.state_dict(), training.state_dict())
            for episode in islice(training.episodes(), 24)
        ]
        for stopped in (1, 14):
            experiment, training = parts()
            experiment.agent.load_state_dict(stops[stopped - 1][1])
            training.load_state_dict(stops[stopped - 1][2])
            rest = list(islice(training.episodes(), 24 - stopped))
            assert rest == [episode for episode, _, _ in stops[stopped:]]
            assert same(experiment.agent.state_dict(), stops[-1][1])
            assert same(training.state_dict(), stops[-1][2])

    def test_a_worker_that_dies_in_the_midst_of_a_step_costs_nothing(self, parts: Callable[..., Any]) -> None:
        experiment, training = parts()
        whole = list(islice(training.episodes(), 20)), experiment.agent.state_dict()
        experiment, training = parts()
        left, step = [55], training._navigation.step

        def mortal(*arguments: Any) -> Any:
            left[0] -= 1
            if left[0] < 0:
                raise WorkerDied("worker 1 of 1 died")
            return step(*arguments)

        training._navigation.step = mortal
        done = []
        with pytest.raises(WorkerDied):
            for episode in training.episodes():
                done.append(episode)
        again, resumed = parts()
        again.agent.load_state_dict(experiment.agent.state_dict())
        resumed.load_state_dict(training.state_dict())
        assert done + list(islice(resumed.episodes(), 20 - len(done))) == whole[0]
        assert same(again.agent.state_dict(), whole[1])

    def test_another_state_is_refused(self, parts: Callable[..., Any]) -> None:
        _, training = parts()
        list(islice(training.episodes(), 6))
        state = training.state_dict()
        for name in ("agent/memory/poses", "agent/replay/seen"):
            with pytest.raises(UserError, match="not the state"):
                parts()[1].load_state_dict({key: values for key, values in state.items() if key != name})

    def test_other_weights_are_refused(self, parts: Callable[..., Any]) -> None:
        agent = parts()[0].agent
        weights = agent.state_dict()
        for change in ({"value.bias": np.zeros(2)}, {"value.bias": np.full(1, np.nan)}, {"more": np.zeros(1)}):
            with pytest.raises(UserError, match="dueling network"):
                agent.load_state_dict(weights | change)

    @pytest.mark.parametrize(
        "values",
        [{"rays": 9}, {"frames": 0}, {"exploration_final": []}, {"exploration_final": [1.1]}, {"discount": 2.0}],
    )
    def test_options_that_make_no_sense_are_refused(self, values: dict[str, Any]) -> None:
        with pytest.raises(UserError, match=r"agent\."):
            parse(RunConfig, {"agent": {"kind": "double_dqn", **values}}, "x")

    def test_it_is_a_learner(self, parts: Callable[..., Any]) -> None:
        assert isinstance(parts()[0].agent, LearningAgent)

    def test_exploration_falls_to_shares_taken_by_turns(self) -> None:
        options = DoubleDqnOptions(exploration_final=(0.0, 0.2), exploration_episodes=100)
        assert options.exploration(np.array([0, 50, 51, 100, 101, 1000])) == pytest.approx([1, 0.5, 0.592, 0, 0.2, 0])
        assert [options.learning_rate_at(e) for e in (0, 6000, 9000, 12000, 99999)] == pytest.approx(
            [5e-4, 5e-4, 2.75e-4, 5e-5, 5e-5]
        )

    def test_it_finds_the_values_of_a_small_world(self) -> None:
        """Five places in a row, a step to the left or right each time; past the right end there is a reward.

        Two actions of the six are told apart: odd ones go right. What is learned from chance alone, is held
        against the values by hand.
        """
        generator, places, discount = np.random.default_rng(0), 5, 0.8
        replay, at, age = Replay(3000, 4, places, 1), np.zeros(4, np.int64), np.zeros(4, np.int64)
        for _ in range(3000):
            actions = generator.integers(6, size=4)
            after = np.maximum(at + np.where(actions % 2 == 1, 1, -1), 0)
            ends = np.where(after == places, TERMINATED, CONTINUES)
            seen = (255 * (at[:, None] == np.arange(places))).astype(np.uint8)
            replay.add(seen, age, actions, np.where(after == places, 1.0, 0.0), ends, np.zeros(4))
            at, age = np.where(after == places, 0, after), np.where(after == places, 0, age + 1)
        online, target = DuelingNetwork(places, (32,)), DuelingNetwork(places, (32,))
        optimizer = torch.optim.Adam(online.parameters(), lr=3e-3)
        for _ in range(600):
            batch = replay.sample(64, 1, discount, generator)
            optimizer.zero_grad()
            td_errors(online, target, batch).square().mean().backward()
            optimizer.step()
            soft_update(target, online, 0.05)
        with torch.no_grad():
            values = target(torch.from_numpy(255 * np.eye(places, dtype=np.uint8))).numpy()
        right = discount ** np.arange(places - 1, -1, -1.0)
        left = discount * right[np.maximum(np.arange(places) - 1, 0)]
        assert values[:, 1::2] == pytest.approx(np.tile(right[:, None], 3), abs=0.06)
        assert values[:, ::2] == pytest.approx(np.tile(left[:, None], 3), abs=0.06)


def test_a_world_of_the_mix_that_is_not_there_is_named(run_cli: Cli, small_config: Path, tmp_path: Path) -> None:
    config = tmp_path / "mix.toml"
    config.write_text(f"{small_config.read_text()}\n[training]\nworlds = ['{tmp_path / 'none.toml'}']\n")
    code, _, err = run_cli("train", "--config", config, "--sim", "kinematic", "--out", tmp_path / "run")
    assert code == 2
    assert "none.toml" in err
