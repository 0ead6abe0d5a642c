"""What a run and an evaluation keep of the files that they are made of: they go anywhere, and no change is silent."""

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nnql_bullet as nb
from nnql_bullet import assets
from nnql_bullet.presets import load_config
from nnql_bullet.sources import changed_sources, files_digest, keep_sources, located
from nnql_bullet.vehicle.urdf import load_vehicle

Cli = Callable[..., tuple[int, str, str]]

ROBOTS = Path(__file__).resolve().parents[1] / "robots"
WORLD = """\
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
MESH = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
"""A tetrahedron as OBJ."""


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a robot, a world, and a run with both; to be copied."""
    home = tmp_path_factory.mktemp("home")
    shutil.copy(ROBOTS / "tricycle.urdf", home)
    (home / "mine.toml").write_text((ROBOTS / "tricycle.toml").read_text().replace("1.5708", "1.2"))
    (home / "w.toml").write_text(WORLD)
    files = {"robot": str(home / "mine.toml"), "world": str(home / "w.toml")}
    nb.train("paper", simulator="kinematic", vehicles=2, episodes=2, task={"max_steps": 30}, out=home / "run", **files)
    return home


@pytest.fixture
def home(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of that folder, which is the working folder; what the run names is elsewhere, as it was."""
    monkeypatch.chdir(shutil.copytree(trained, tmp_path / "copy"))
    return tmp_path / "copy"


def test_a_run_drives_reports_and_goes_on_without_its_files(
    home: Path, trained: Path, run_cli: Cli, tmp_path: Path
) -> None:
    before = nb.drive(home / "run", simulator="kinematic")
    moved = shutil.copytree(home / "run", tmp_path / "elsewhere")
    hidden = trained.rename(trained.with_name("hidden"))
    try:
        drive = nb.drive(moved, simulator="kinematic")
        assert np.array_equal(drive.state_pose, before.state_pose)
        assert drive.about["vehicle"]["name"] == "mine"
        drive.save("drive.npz")
        assert run_cli("report", moved)[0] == 0
        assert run_cli("train", "--resume", moved, "--episodes", 3, "--workers", 1)[0] == 0
    finally:
        hidden.rename(trained)


@pytest.mark.parametrize(
    ("file", "text", "new", "difference"),
    [
        ("w.toml", "cover = 0.05", "cover = 0.02", "layout.cover was 0.05, is 0.02"),
        ("mine.toml", "yaw_rate = 1.2", "yaw_rate = 1.1", "limits.yaw_rate was 1.2, is 1.1"),
        ("tricycle.urdf", "<robot", "<!-- new --><robot", "its text differs"),
        ("w.toml", "width = 30.0", "width = ", "it cannot be read"),
    ],
)
def test_a_file_that_changes_is_named_with_what_differs(
    trained: Path, home: Path, run_cli: Cli, file: str, text: str, new: str, difference: str
) -> None:
    kept = (trained / file).read_text()
    assert changed_sources(home / "run") == {}
    (trained / file).write_text(kept.replace(text, new, 1))
    try:
        found = changed_sources(home / "run")
        assert list(found) == [str(trained / file)]
        assert difference in found[str(trained / file)]
        for arguments in (("drive", "run", "--sim", "kinematic"), ("train", "--resume", "run", "--episodes", 2)):
            code, _, err = run_cli(*arguments)
            assert code == 0, err
            assert f"{file} has changed since" in err
            assert difference in err
            assert "own copy" in err
        if file == "w.toml":  # what is not asked of the run is no matter of its files
            assert "has changed" not in run_cli("drive", "run", "--sim", "kinematic", "--world", "empty")[2]
    finally:
        (trained / file).write_text(kept)


def test_an_evaluation_repeats_its_failures_without_its_files(
    trained: Path, home: Path, caplog: pytest.LogCaptureFixture
) -> None:
    world, robot = home / "w.toml", home / "mine.toml"
    where = {"worlds": [world], "seeds": range(2), "simulator": "kinematic", "changes": {"task": {"max_steps": 1}}}
    nb.evaluate("straight", robot=robot, out=home / "out", **where)  # type: ignore[arg-type]
    world.write_text(WORLD.replace("0.05", "0.02"))
    robot.write_text(robot.read_text().replace("1.2", "1.1"))
    moved = shutil.move(home / "out", home / "moved")
    assert [row["ending"] for row in nb.failures(moved).rows] == ["timeout", "timeout"]
    told = [record.getMessage() for record in caplog.records]
    assert sum("has changed since the evaluation" in line for line in told) == 2
    world.unlink()
    robot.unlink()
    assert len(nb.failures(moved).rows) == 2


def test_a_robot_is_kept_with_the_meshes_that_it_is_as_large_as(tmp_path: Path, trained: Path) -> None:
    home = tmp_path / "robots"
    (home / "shapes").mkdir(parents=True)
    (home / "shapes" / "m.obj").write_text(MESH)
    urdf, mesh = (ROBOTS / "tricycle.urdf").read_text(), '<geometry><mesh filename="shapes/m.obj"/></geometry>'
    chassis = f'<collision><origin xyz="0 0 0.5"/>{mesh}</collision>'
    (home / "mine.urdf").write_text(re.sub(r'(<link name="chassis">)', rf"\1{chassis}", urdf, count=1))
    (home / "mine.toml").write_text((ROBOTS / "tricycle.toml").read_text().replace("tricycle.urdf", "mine.urdf"))
    with_mesh, without = load_vehicle(home / "mine.toml"), load_vehicle("tricycle")
    assert with_mesh.footprint != without.footprint
    config = nb.load_run(trained / "run").config
    mine = replace(config, robot=str(home / "mine.toml"))
    keep_sources(mine, tmp_path / "run")
    copy = load_vehicle(located(mine, tmp_path / "run").robot)
    assert (copy.digest, copy.footprint) == (with_mesh.digest, with_mesh.footprint)
    assert files_digest(mine) != files_digest(config)


def test_the_digest_of_what_a_configuration_names_follows_shipped_files_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for kind in ("worlds", "robots"):
        shutil.copytree(assets.folder(kind), tmp_path / kind)
    config, now = load_config("paper", {}), files_digest(load_config("paper", {}), ["traps"])
    monkeypatch.setattr(assets, "folder", tmp_path.__truediv__)
    assert files_digest(config, ["traps"]) == now
    found = {now}
    for name, old, new in (
        ("worlds/paper", "0.05", "0.06"),
        ("worlds/traps", "8", "7"),
        ("robots/tricycle", "7.4", "7.3"),
    ):
        file = tmp_path / f"{name}.toml"
        file.write_text(file.read_text().replace(old, new))
        found.add(files_digest(config, ["traps"]))
    assert len(found) == 4
