"""What is compiled is announced, once; what is loaded from the cache is not."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = """
from nnql_bullet.jit import announced
from nnql_bullet.geometry import wrap_angle
with announced():
    wrap_angle(7.0)
    wrap_angle(1)
"""


def test_compiling_is_announced_once_and_loading_is_not(tmp_path: Path) -> None:
    def told() -> str:
        environment = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
        command = [sys.executable, "-c", PROGRAM]
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=True).stderr

    first = told()
    assert first.count("compiling the") == first.count("\n") == 1
    assert str(tmp_path) in first
    assert told() == ""
