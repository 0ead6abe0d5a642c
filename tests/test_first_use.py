"""A robot of one's own is checked once, when it is first driven in contact physics."""

import json
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

import nnql_bullet as nb
from nnql_bullet import assets
from nnql_bullet.fidelity import first_use
from nnql_bullet.fidelity.first_use import check_at_first_use, digest_of
from nnql_bullet.fidelity.probe import Bench, Measurement, Probe, at_most
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.work import Progress


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, in a process that has checked nothing."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(first_use, "_checked", set())
    return tmp_path / "cache"


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    """A copy of the shipped robot, which is one's own."""
    for suffix in (".toml", ".urdf"):
        (tmp_path / f"mine{suffix}").write_bytes((assets.folder("robots") / f"tricycle{suffix}").read_bytes())
    toml = tmp_path / "mine.toml"
    toml.write_text(toml.read_text().replace("tricycle.urdf", "mine.urdf"))
    return toml


@pytest.fixture
def slippery(mine: Path) -> Path:
    """One whose wheels spin when it speeds up."""
    mine.write_text(mine.read_text().replace("wheel_friction = 0.8", "wheel_friction = 0.1"))
    return mine


@pytest.fixture
def probed(monkeypatch: pytest.MonkeyPatch) -> list[Bench]:
    """Stands in for the probes: one quantity that is off; the benches that were probed."""
    seen: list[Bench] = []

    def measure(bench: Bench) -> list[Measurement]:
        seen.append(bench)
        return [at_most("sideways", "mm", 1.0, 2.5), at_most("slip", "%", 0.5, 0.1)]

    monkeypatch.setattr("nnql_bullet.fidelity.probes.PROBES", {"one": Probe("one", "One", "", "", measure)})
    return seen


def test_a_sound_robot_is_checked_without_a_word_and_not_again(cache: Path, mine: Path) -> None:
    seen: list[Progress] = []
    check_at_first_use(mine, "bullet", "fast", seen.append)
    assert seen[0].done == 0 and seen[-1].done == seen[-1].total > 10
    (kept,) = cache.rglob("*.json")
    assert json.loads(kept.read_text()) == {"robot": "mine", "engine": "bullet", "off": []}
    first_use._checked.clear()
    check_at_first_use(mine, "bullet", "fast", lambda now: pytest.fail("again"))


def test_what_is_off_is_named_in_one_line(cache: Path, slippery: Path) -> None:
    named = r"^robot 'mine' does not move in bullet as mechanics says: .*acceleration: speed after 1 s.*$"
    with pytest.warns(nb.RobotWarning, match=named) as told:
        check_at_first_use(slippery, "bullet", "fast")
    assert len(told) == 1 and "\n" not in str(told[0].message)
    assert f"--robot {slippery} --sim bullet --physics fast" in str(told[0].message)


def test_it_is_said_once_even_where_nothing_can_be_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mine: Path, probed: list[Bench]
) -> None:
    monkeypatch.setattr(first_use, "_checked", set())
    (tmp_path / "file").touch()
    monkeypatch.setattr(first_use, "cache_folder", lambda: tmp_path / "file")
    with pytest.warns(nb.RobotWarning, match=r"sideways 2\.5 mm \(1 mm on paper\)\. To see"):
        check_at_first_use(mine, "bullet", "fast")
    check_at_first_use(mine, "bullet", "fast")
    assert len(probed) == 1


def test_shipped_robots_and_the_kinematic_model_need_none(cache: Path, mine: Path, probed: list[Bench]) -> None:
    check_at_first_use("tricycle", "bullet", "fast")
    check_at_first_use(mine, "kinematic", "fast")
    assert not probed


def test_the_digest_is_of_the_vehicle_and_the_engine_not_of_the_place(mine: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    for path in (mine, mine.with_suffix(".urdf")):
        (tmp_path / "elsewhere" / path.name).write_bytes(path.read_bytes())
    here = digest_of(Bench(load_vehicle(mine), "bullet", "fast"))
    assert here == digest_of(Bench(load_vehicle(tmp_path / "elsewhere/mine.toml"), "bullet", "fast"))
    others = [Bench(load_vehicle(mine), "mujoco", "fast"), Bench(load_vehicle(mine), "bullet", "reference")]
    urdf = mine.with_suffix(".urdf")
    urdf.write_text(urdf.read_text().replace('mass value="104.5"', 'mass value="104.6"'))
    others.append(Bench(load_vehicle(mine), "bullet", "fast"))
    assert len({here, *map(digest_of, others)}) == 4


@pytest.mark.parametrize("check", [True, False])
def test_every_way_to_drive_checks_once_in_this_process_unless_told_not_to(
    cache: Path, mine: Path, probed: list[Bench], tmp_path: Path, check: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = {"robot": str(mine), "world": "empty", "physics": "fast"}
    ways: list[Callable[[], object]] = [
        lambda: nb.drive("straight", world="empty", robot=mine, physics="fast", check=check),
        lambda: nb.make_env(check=check, **own).close(),
        lambda: nb.train(**own, episodes=1, task={"max_steps": 1}, out=tmp_path / "run", overwrite=True, check=check),
        lambda: nb.evaluate(tmp_path / "run", worlds=["empty"], n_worlds=1, physics="fast", check=check),
        lambda: nb.gap(tmp_path / "run", n_worlds=1, physics="fast", faults=False, check=check),
    ]
    for number, way in enumerate(ways):
        monkeypatch.setattr(first_use, "_checked", set())
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / f"cache {number}"))
        probed.clear()
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            way()
        assert [its.category for its in told] == [nb.RobotWarning] * check, number
        assert len(probed) == check, number


def test_the_command_line_says_it_in_one_line_and_the_result_apart(
    cache: Path, mine: Path, probed: list[Bench], run_cli: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    command = "drive", "straight", "--world", "empty", "--robot", mine, "--physics", "fast", "--out", tmp_path / "out"
    code, out, err = run_cli(*command, "--json")
    assert code == 0 and json.loads(out)["ending"] == "goal"
    assert "nnql-bullet: robot 'mine' does not move in bullet as mechanics says: one: sideways 2.5 mm" in err
    assert "does not move" not in run_cli(*command)[2]
    first_use._checked.clear()
    for kept in cache.rglob("*.json"):
        kept.unlink()
    assert "does not move" not in run_cli(*command, "--no-check")[2]
    assert len(probed) == 1
