"""The scripts in examples/ and the Python of how-to pages: each runs by itself, with a tiny budget."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "examples"
ARGUMENTS = {
    "custom_agent": ["--worlds", "2"],
    "custom_reward": ["--episodes", "4"],
    "custom_world": [],
    "compare": ["--worlds", "2"],
    "ppo": ["--steps", "40960", "--worlds", "30"],
    "train_drive_film": ["--episodes", "8", "--seconds", "1", "--size", "160", "90"],
}


def test_each_is_run_here_and_short() -> None:
    scripts = {path.stem: path.read_text(encoding="utf-8").splitlines() for path in FOLDER.glob("*.py")}
    assert scripts.keys() == ARGUMENTS.keys()
    assert all(len(lines) < (180 if name == "ppo" else 40) for name, lines in scripts.items())


def run(cwd: Path, *arguments: str) -> str:
    """What a new Python prints."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", ARGUMENTS)
def test_it_runs(name: str, tmp_path: Path) -> None:
    told = run(tmp_path, str(FOLDER / f"{name}.py"), *ARGUMENTS[name])
    assert told.strip()
    if name == "ppo":  # it learns to beat driving straight
        learned, straight = (float(line.split()[2]) for line in told.splitlines()[-2:])
        assert learned > straight + 30.0


@pytest.mark.slow
@pytest.mark.parametrize("page", ["agent", "deploy", "gymnasium", "learners", "reward"])
def test_the_python_of_a_page_runs(page: str, tmp_path: Path) -> None:
    text = (ROOT / "docs" / "how-to" / f"{page}.md").read_text(encoding="utf-8")
    code = "\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL)).replace(
        "vehicles=64", "vehicles=4, episodes=8"
    )
    assert code
    for library, extra in (("stable_baselines3", "sb3"), ("tree", "rllib")):
        if page == "learners":
            pytest.importorskip(library, reason=f"needs the extra [{extra}]")
    run(tmp_path, "-W", "error::DeprecationWarning", "-c", code)
