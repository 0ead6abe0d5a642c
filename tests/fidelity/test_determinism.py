"""The same calls give the same bits: after anything, beside anything, in any process."""

import gc
import hashlib
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pybullet
import pytest

from nnql_bullet.geometry import OrientedBox, Pose
from nnql_bullet.sim.base import Sample
from nnql_bullet.sim.bullet import PHYSICS, BulletSimulator
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.spec import WorldSpec

TURNS = (0.0, 0.5, -1.0, 0.3, 0.9, -0.2, 0.0, -0.7, 1.0, 0.1)
BOXES = tuple(OrientedBox(x, y, 1.0, 0.5, 0.3 * x) for x in range(4, 40, 6) for y in (4.0, 12.0, 28.0, 36.0))
HERE = WorldSpec("here", 0, 40.0, 40.0, BOXES, Pose(10.0, 20.0, 0.1), (36.0, 20.0), 1.0, 1.5)
THERE = WorldSpec("there", 1, 60.0, 60.0, BOXES[:7], Pose(30.0, 30.0, -2.0), (50.0, 50.0), 2.0, 1.0)

Make = Callable[..., BulletSimulator]


class Drive:
    """A fixed series of decisions; `digest` covers every bit of what came of them."""

    def __init__(self, simulator: BulletSimulator, world: WorldSpec = HERE) -> None:
        self.simulator = simulator
        self.seen: list[object] = []
        self.trace: list[Sample] = []
        simulator.reset(world)

    def decide(self, turn: float) -> None:
        self.seen.append(self.simulator.advance(turn, self.trace))
        self.seen.append(self.simulator.scan().distances.tolist())

    def digest(self) -> str:
        return hashlib.sha256(repr((self.seen, self.trace)).encode()).hexdigest()


def driven(simulator: BulletSimulator, world: WorldSpec = HERE) -> str:
    drive = Drive(simulator, world)
    for turn in TURNS:
        drive.decide(turn)
    return drive.digest()


@pytest.fixture(scope="module")
def elsewhere() -> dict[str, str]:
    """The digests that another process finds."""
    command = [sys.executable, str(Path(__file__).resolve())]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return dict(line.split() for line in answer.stdout.splitlines())


def test_a_digest_tells_drives_apart(simulator_of: Make) -> None:
    simulator = simulator_of("fast")
    assert len({driven(simulator), driven(simulator, THERE), driven(simulator_of("reference"))}) == 3


def test_reset_within_an_episode_starts_afresh(simulator_of: Make, physics: str) -> None:
    simulator = simulator_of(physics)
    drive = Drive(simulator)
    for turn in TURNS[:3]:
        drive.decide(turn)
    assert driven(simulator) == driven(simulator_of(physics))


def test_interleaved_simulators_do_not_touch_each_other(simulator_of: Make, physics: str) -> None:
    other = "fast" if physics == "reference" else "reference"
    alone = driven(simulator_of(physics)), driven(simulator_of(other), THERE)
    first, second = Drive(simulator_of(physics)), Drive(simulator_of(other), THERE)
    for turn in TURNS:
        first.decide(turn)
        second.decide(turn)
    assert (first.digest(), second.digest()) == alone


def test_another_process_finds_the_same(simulator_of: Make, elsewhere: dict[str, str], physics: str) -> None:
    assert driven(simulator_of(physics)) == elsewhere[physics]


def test_scans_and_samples_change_nothing(simulator_of: Make, physics: str) -> None:
    quiet, watched = simulator_of(physics), simulator_of(physics)
    quiet.reset(HERE)
    watched.reset(HERE)
    for turn in TURNS:
        watched.scan()
        watched.sample()
        assert quiet.advance(turn) == watched.advance(turn, [])


def test_a_closed_simulator_is_disconnected_and_closing_twice_is_harmless(simulator_of: Make) -> None:
    simulator = simulator_of("fast")
    client = simulator.client
    assert pybullet.isConnected(client)
    simulator.close()
    assert not pybullet.isConnected(client)
    simulator.close()


def test_a_dropped_simulator_is_disconnected() -> None:
    simulator = BulletSimulator(load_vehicle("tricycle"), DriveOptions(), PHYSICS["fast"])
    simulator.reset(HERE)
    client = simulator.client
    assert pybullet.isConnected(client)
    del simulator
    gc.collect()
    assert not pybullet.isConnected(client)


def test_closing_one_leaves_the_others_connected(simulator_of: Make) -> None:
    first, second = simulator_of("fast"), simulator_of("fast")
    driven(second)
    first.close()
    assert driven(second) == driven(simulator_of("fast"))


if __name__ == "__main__":
    for name, settings in PHYSICS.items():
        print(name, driven(BulletSimulator(load_vehicle("tricycle"), DriveOptions(), settings)))
