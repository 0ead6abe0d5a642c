"""The scripts in examples/: each runs by itself, with a tiny budget."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parent.parent / "examples"
ARGUMENTS = {
    "custom_agent": ["--worlds", "2"],
    "custom_reward": ["--episodes", "4"],
    "custom_world": [],
    "compare": ["--worlds", "2"],
    "train_drive_film": ["--episodes", "8", "--seconds", "1", "--size", "160", "90"],
}


def test_each_is_run_here_and_short() -> None:
    scripts = {path.stem: path.read_text(encoding="utf-8").splitlines() for path in FOLDER.glob("*.py")}
    assert scripts.keys() == ARGUMENTS.keys()
    assert all(len(lines) < 40 for lines in scripts.values())


@pytest.mark.slow
@pytest.mark.parametrize("name", ARGUMENTS)
def test_it_runs(name: str, tmp_path: Path) -> None:
    command = [sys.executable, str(FOLDER / f"{name}.py"), *ARGUMENTS[name]]
    environment = os.environ | {"PYTHONPATH": str(FOLDER.parent)}
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
