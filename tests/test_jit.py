"""What is compiled is announced, once; what is loaded from the cache is not."""

import os
import subprocess
import sys
from pathlib import Path
from shutil import rmtree

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = """
from nnql_bullet.jit import announced
from nnql_bullet.geometry import wrap_angle
with announced():
    wrap_angle(7.0)
    wrap_angle(1)
"""
IN_WORKERS = """
from multiprocessing import get_context
from nnql_bullet.geometry import wrap_angle
from nnql_bullet.jit import announced

def work(angle):
    with announced():
        return wrap_angle(angle)

if __name__ == "__main__":
    with get_context("spawn").Pool(1) as pool:
        pool.map(work, [7.0])
"""


def test_compiling_is_announced_once_and_loading_and_workers_are_not(tmp_path: Path) -> None:
    def told(program: str = PROGRAM) -> str:
        environment = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        (tmp_path / "program.py").write_text(program)
        command = [sys.executable, str(tmp_path / "program.py")]
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=True).stderr

    assert told(IN_WORKERS) == ""
    rmtree(tmp_path / "cache")
    first = told()
    assert first.count("compiling the") == first.count("\n") == 1
    assert str(tmp_path) in first
    assert told() == ""
