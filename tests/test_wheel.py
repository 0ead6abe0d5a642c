"""What is installed from a wheel works without the checkout."""

import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[1]
TIMEOUT = 300.0

pytestmark = pytest.mark.slow


def call(*command: object, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(  # type: ignore[call-overload, no-any-return]
        [sys.executable, *map(str, command)], capture_output=True, text=True, timeout=TIMEOUT, check=False, **options
    )


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("build")
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    done = call("-m", "build", "--wheel", "--no-isolation", "--outdir", folder, CHECKOUT)
    assert done.returncode == 0, done.stdout + done.stderr
    [built] = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds the package alone; what it depends on comes from the running interpreter."""
    folder = tmp_path_factory.mktemp("installed")
    pip = ("-m", "pip", "--disable-pip-version-check", "install", "--no-deps", "--no-index", "--target")
    done = call(*pip, folder, wheel)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture
def run(installed: Path, tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs the interpreter in an empty folder, with the installed package before everything else."""

    def start(*command: object) -> subprocess.CompletedProcess[str]:
        return call(*command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(installed)})

    return start


def test_the_wheel_holds_package_robots_worlds_and_policies_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if ".dist-info/" not in name]
    data = {name.removeprefix("nnql_bullet/_data/") for name in names if "/_data/" in name}
    expected = {f"{kind}/{path.name}" for kind in ("robots", "worlds") for path in (CHECKOUT / kind).iterdir()}
    policies = CHECKOUT / "nnql_bullet" / "_data" / "policies"
    assert data == expected | {f"policies/{path.name}" for path in policies.iterdir()}
    assert all(name.startswith("nnql_bullet/") for name in names)
    assert [name for name in names if "__pycache__" in name or "/tests/" in name] == []


def test_the_installed_package_is_the_one_that_runs(
    run: Callable[..., subprocess.CompletedProcess[str]], installed: Path
) -> None:
    code = "import nnql_bullet; from nnql_bullet import assets; print(nnql_bullet.__file__, assets.folder('worlds'))"
    package, worlds = run("-c", code).stdout.split()
    assert Path(package).is_relative_to(installed)
    assert Path(worlds).is_relative_to(installed)


def test_it_trains_drives_and_reports_away_from_the_checkout(
    run: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    trained = run("-m", "nnql_bullet", "train", "--episodes", "1", "--world", "cover_2.5", "--out", "run")
    assert trained.returncode == 0, trained.stderr
    driven = run("-m", "nnql_bullet", "drive", "run", "--world", "paper", "--json", "--physics", "fast")
    assert (driven.returncode, driven.stderr) == (0, "")
    result = json.loads(driven.stdout)
    assert result["world"] == "paper"
    assert (tmp_path / result["picture"]).is_file()
    assert (tmp_path / result["recording"]).is_file()
    reported = run("-m", "nnql_bullet", "report", "run")
    assert (reported.returncode, reported.stderr) == (0, "")
    assert (tmp_path / "run" / "report.html").is_file()


def test_its_console_command_runs(run: Callable[..., subprocess.CompletedProcess[str]], installed: Path) -> None:
    done = run(installed / "bin" / "nnql-bullet", "--version")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("nnql-bullet ")
