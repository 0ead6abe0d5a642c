"""What several tests share: the vehicle, worlds with known geometry, engines that are closed, and one small run."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from nnql_bullet.cli import main
from nnql_bullet.geometry import OrientedBox, Pose
from nnql_bullet.sim.bullet import PHYSICS, BulletEngine
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.spec import WorldSpec

SMALL_WORLD = """\
width = 30.0
depth = 30.0
start = [5.0, 5.0]
target = [25.0, 25.0]

[layout]
kind = "random_boxes"
cover = 0.05
min_side = 1.0
max_side = 2.0
clear_radius = 3.0
"""


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Nothing is kept in the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session")
def vehicle() -> VehicleSpec:
    return load_vehicle("tricycle")


@pytest.fixture(scope="session")
def world_of() -> Callable[..., WorldSpec]:
    """Makes a world of boxes; by default 200 m x 200 m, empty, start in the middle with yaw 0."""

    def make(
        *boxes: OrientedBox,
        start: Pose = Pose(100.0, 100.0, 0.0),  # noqa: B008 (frozen)
        target: tuple[float, float] = (190.0, 190.0),
        target_radius: float = 2.0,
        side: float = 200.0,
    ) -> WorldSpec:
        return WorldSpec("test", 0, side, side, boxes, start, target, target_radius, 1.5)

    return make


@pytest.fixture(scope="session")
def empty_world(world_of: Callable[..., WorldSpec]) -> WorldSpec:
    return world_of()


@pytest.fixture
def engine_of(vehicle: VehicleSpec) -> Iterator[Callable[..., BulletEngine]]:
    """Makes engines and closes them: (name of the physics settings, drive options, another vehicle)."""
    made: list[BulletEngine] = []

    def make(physics: str, spec: VehicleSpec | None = None, **drive: float) -> BulletEngine:
        made.append(BulletEngine(spec or vehicle, DriveOptions(**drive), PHYSICS[physics]))
        return made[-1]

    yield make
    for engine in made:
        engine.close()


@pytest.fixture(params=["reference", "fast"])
def physics(request: pytest.FixtureRequest) -> str:
    """Every named setting of the engine."""
    return str(request.param)


@pytest.fixture(scope="session")
def compiled_kernels(vehicle: VehicleSpec) -> None:
    """For tests of what is printed: the wait while the kinematic model is compiled, which is announced, is over."""
    KinematicSimulator(vehicle, DriveOptions(), 1).close()


@pytest.fixture(scope="session")
def small_world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A world file with short episodes."""
    path = tmp_path_factory.mktemp("worlds") / "small.toml"
    path.write_text(SMALL_WORLD)
    return path


@pytest.fixture(scope="session")
def small_config(tmp_path_factory: pytest.TempPathFactory, small_world: Path) -> Path:
    """A configuration whose episodes are short however they end."""
    path = tmp_path_factory.mktemp("configs") / "small.toml"
    path.write_text(f'world = "{small_world}"\n\n[task]\nmax_steps = 60\n')
    return path


@pytest.fixture(scope="session")
def tiny_run(tmp_path_factory: pytest.TempPathFactory, small_config: Path) -> Path:
    """A run folder of 12 episodes, to be read only; copy it to change it."""
    folder = tmp_path_factory.mktemp("runs") / "tiny"
    assert main(["train", "--episodes", "12", "--config", str(small_config), "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def run_cli(capfd: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Runs the command line in this process: exit code, standard output, standard error."""

    def run(*arguments: object) -> tuple[int, str, str]:
        capfd.readouterr()
        code = main([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        return code, out, err

    return run


@pytest.fixture(scope="session")
def spawn_cli() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs the command line in a process of its own."""

    def run(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "nnql_bullet", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, **options)

    return run


@pytest.fixture
def snapshot() -> Callable[[Path], dict[str, bytes]]:
    """Every file below a folder with its bytes: what must not change when something is refused."""

    def take(folder: Path) -> dict[str, bytes]:
        return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    return take
