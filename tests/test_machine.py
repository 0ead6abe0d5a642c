"""What the machine allows: cores by affinity and quota, and a place for caches that no other user can write to."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from nnql_bullet import machine
from nnql_bullet.machine import allowed_cores, private_folder

MANY = set(range(64))
ROOT = Path(__file__).resolve().parents[1]


def system(root: Path, cgroup: str, **limits: str) -> Path:
    """A root of a file system with the files of control groups."""
    (root / "proc/self").mkdir(parents=True)
    (root / "proc/self/cgroup").write_text(cgroup)
    for name, text in limits.items():
        file = root / "sys/fs/cgroup" / name.replace("__", "/").replace("cfs", "cpu.cfs").replace("max", "cpu.max")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return root


class TestCores:
    @pytest.fixture(autouse=True)
    def many(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(os, "sched_getaffinity", lambda pid: MANY, raising=False)

    @pytest.mark.parametrize(
        ("cgroup", "limits", "cores"),
        [
            ("0::/\n", {}, 64),
            ("0::/a/b\n", {"a__b__max": "max 100000\n"}, 64),
            ("0::/a/b\n", {"a__b__max": "200000 100000\n"}, 2),
            ("0::/a/b\n", {"a__max": "250000 100000\n", "a__b__max": "max 100000\n"}, 3),
            ("0::/out/of/sight\n", {"max": "50000 100000\n"}, 1),
            (
                "3:cpuset:/x\n2:cpu,cpuacct:/d\n",
                {"cpu,cpuacct__d__cfs_quota_us": "400000", "cpu,cpuacct__d__cfs_period_us": "100000"},
                4,
            ),
            (
                "2:cpu,cpuacct:/d\n",
                {"cpu,cpuacct__d__cfs_quota_us": "-1", "cpu,cpuacct__d__cfs_period_us": "100000"},
                64,
            ),
            ("0::/\n", {"max": "nonsense\n"}, 64),
        ],
    )
    def test_quotas(self, tmp_path: Path, cgroup: str, limits: dict[str, str], cores: int) -> None:
        assert allowed_cores(system(tmp_path, cgroup, **limits)) == cores

    def test_affinity(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {3, 5})
        assert allowed_cores(tmp_path) == 2
        assert allowed_cores(system(tmp_path, "0::/\n", max="800000 100000")) == 2


class TestPrivateFolder:
    @pytest.fixture(autouse=True)
    def elsewhere(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(machine.tempfile, "gettempdir", lambda: str(tmp_path))
        private_folder.cache_clear()
        yield
        private_folder.cache_clear()

    def test_only_its_user_can_write_to_it(self, tmp_path: Path) -> None:
        folder = private_folder()
        assert folder is not None
        assert folder.parent == tmp_path
        assert folder.stat().st_mode & 0o777 == 0o700

    def test_one_that_others_can_write_to_or_a_link_is_not_taken(self, tmp_path: Path) -> None:
        name = tmp_path / f"nnql-bullet-{os.getuid()}"
        name.mkdir()
        name.chmod(0o777)
        assert private_folder() is None
        name.rmdir()
        (tmp_path / "planted").mkdir()
        name.symlink_to(tmp_path / "planted")
        private_folder.cache_clear()
        assert private_folder() is None


PLACES = """
import os, sys, tempfile
from unittest.mock import patch
from numba.core import caching
from nnql_bullet import machine
for locator in (caching.InTreeCacheLocator, caching.UserWideCacheLocator):
    locator.from_function = classmethod(lambda cls, function, file: None)
if sys.argv[1:]:
    machine.private_folder = lambda: None
from nnql_bullet.geometry import wrap_angle
print(wrap_angle.stats.cache_path, wrap_angle(7.0))
"""


@pytest.mark.parametrize("private", [True, False])
def test_without_a_place_for_a_cache_the_loops_still_compile(tmp_path: Path, private: bool) -> None:
    environment = os.environ | {"TMPDIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", PLACES, *([] if private else ["none"])],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    where, angle = done.stdout.split()
    assert where.startswith(str(tmp_path)) if private else where == "None"
    assert float(angle) == pytest.approx(7.0 - 2 * 3.141592653589793)
