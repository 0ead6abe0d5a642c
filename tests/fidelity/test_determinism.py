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
from nnql_bullet.sim.bullet import PHYSICS, BulletEngine
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.spec import WorldSpec

TURNS = (0.0, 0.5, -1.0, 0.3, 0.9, -0.2, 0.0, -0.7, 1.0, 0.1)
BOXES = tuple(OrientedBox(x, y, 1.0, 0.5, 0.3 * x) for x in range(4, 40, 6) for y in (4.0, 12.0, 28.0, 36.0))
HERE = WorldSpec("here", 0, 40.0, 40.0, BOXES, Pose(10.0, 20.0, 0.1), (36.0, 20.0), 1.0, 1.5)
THERE = WorldSpec("there", 1, 60.0, 60.0, BOXES[:7], Pose(30.0, 30.0, -2.0), (50.0, 50.0), 2.0, 1.0)

Make = Callable[..., BulletEngine]


class Drive:
    """A fixed series of decisions; `digest` covers every bit of what came of them."""

    def __init__(self, engine: BulletEngine, world: WorldSpec = HERE) -> None:
        self.engine = engine
        self.seen: list[object] = []
        self.trace: list[Sample] = []
        engine.reset(world)

    def decide(self, turn: float) -> None:
        self.seen.append(self.engine.advance(turn, self.trace))
        self.seen.append(self.engine.scan().tolist())

    def digest(self) -> str:
        return hashlib.sha256(repr((self.seen, self.trace)).encode()).hexdigest()


def driven(engine: BulletEngine, world: WorldSpec = HERE) -> str:
    drive = Drive(engine, world)
    for turn in TURNS:
        drive.decide(turn)
    return drive.digest()


@pytest.fixture(scope="module")
def elsewhere() -> dict[str, str]:
    """The digests that another process finds."""
    command = [sys.executable, str(Path(__file__).resolve())]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return dict(line.split() for line in answer.stdout.splitlines())


def test_a_digest_tells_drives_apart(engine_of: Make) -> None:
    engine = engine_of("fast")
    assert len({driven(engine), driven(engine, THERE), driven(engine_of("reference"))}) == 3


def test_reset_within_an_episode_starts_afresh(engine_of: Make, physics: str) -> None:
    engine = engine_of(physics)
    drive = Drive(engine)
    for turn in TURNS[:3]:
        drive.decide(turn)
    assert driven(engine) == driven(engine_of(physics))


def test_interleaved_simulators_do_not_touch_each_other(engine_of: Make, physics: str) -> None:
    other = "fast" if physics == "reference" else "reference"
    alone = driven(engine_of(physics)), driven(engine_of(other), THERE)
    first, second = Drive(engine_of(physics)), Drive(engine_of(other), THERE)
    for turn in TURNS:
        first.decide(turn)
        second.decide(turn)
    assert (first.digest(), second.digest()) == alone


def test_another_process_finds_the_same(engine_of: Make, elsewhere: dict[str, str], physics: str) -> None:
    assert driven(engine_of(physics)) == elsewhere[physics]


def test_scans_and_samples_change_nothing(engine_of: Make, physics: str) -> None:
    quiet, watched = engine_of(physics), engine_of(physics)
    quiet.reset(HERE)
    watched.reset(HERE)
    for turn in TURNS:
        watched.scan()
        watched.sample()
        assert quiet.advance(turn) == watched.advance(turn, [])


def test_a_closed_simulator_is_disconnected_and_closing_twice_is_harmless(engine_of: Make) -> None:
    engine = engine_of("fast")
    client = engine.client
    assert pybullet.isConnected(client)
    engine.close()
    assert not pybullet.isConnected(client)
    engine.close()


def test_a_dropped_simulator_is_disconnected() -> None:
    engine = BulletEngine(load_vehicle("tricycle"), DriveOptions(), PHYSICS["fast"])
    engine.reset(HERE)
    client = engine.client
    assert pybullet.isConnected(client)
    del engine
    gc.collect()
    assert not pybullet.isConnected(client)


def test_closing_one_leaves_the_others_connected(engine_of: Make) -> None:
    first, second = engine_of("fast"), engine_of("fast")
    driven(second)
    first.close()
    assert driven(second) == driven(engine_of("fast"))


if __name__ == "__main__":
    for name, settings in PHYSICS.items():
        print(name, driven(BulletEngine(load_vehicle("tricycle"), DriveOptions(), settings)))
