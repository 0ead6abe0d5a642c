"""What made a result: its digest follows the code and nothing else, and results of other code are not taken over."""

import json
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import nnql_bullet as nb
from nnql_bullet import provenance, runs
from nnql_bullet.evaluation import parts
from nnql_bullet.provenance import closure, code_digest, made_by

SOURCES = {
    "a.py": "from nnql_bullet.folder import b\n\ndef f(x):\n    from nnql_bullet import late\n    return b.g(x) + 1\n",
    "folder/__init__.py": "",
    "folder/b.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import nnql_bullet.typed\n\ng = abs\n",
    "late.py": "from nnql_bullet.render import film\nHOW = 'x'\n",
    "typed.py": "",
    "other.py": "",
    "render/__init__.py": "",
    "render/film.py": "",
}


@pytest.fixture
def digest_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str, str], str]]:
    """The digest of module a in a package that differs in one file."""
    monkeypatch.setattr(provenance, "PACKAGE", tmp_path / "package")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def forget() -> None:
        code_digest.cache_clear()
        provenance._tree.cache_clear()

    def digest(file: str, text: str) -> str:
        forget()
        for name, its in {**SOURCES, file: text}.items():
            (tmp_path / "package" / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / "package" / name).write_text(its)
        return code_digest("nnql_bullet.a")

    yield digest
    forget()


class TestDigest:
    def test_it_follows_the_code_that_is_imported_and_no_sentence(self, digest_with: Callable[[str, str], str]) -> None:
        now = digest_with("a.py", SOURCES["a.py"])
        assert closure("nnql_bullet.a") == {f"nnql_bullet.{name}" for name in ("a", "folder", "folder.b", "late")}
        for file, same in {
            "a.py": '"""About."""\n# why\n'
            + SOURCES["a.py"].replace("def f(x):\n", 'def f( x ):\n    """Does."""\n\n'),
            "typed.py": "x = 1\n",
            "other.py": "x = 1\n",
            "render/film.py": "x = 1\n",
        }.items():
            assert digest_with(file, same) == now, file
        for file, other in {
            "a.py": SOURCES["a.py"].replace("+ 1", "+ 2"),
            "folder/b.py": SOURCES["folder/b.py"].replace("abs", "int"),
            "folder/__init__.py": "x = 1\n",
            "late.py": SOURCES["late.py"].replace("'x'", "'y'"),
        }.items():
            assert digest_with(file, other) != now, file

    def test_what_drives_counts_and_what_draws_does_not(self) -> None:
        found = closure("nnql_bullet.evaluation.drives")
        assert {"nnql_bullet.sim.kinematic", "nnql_bullet.sim.bullet", "nnql_bullet.shield.shield"} <= found
        assert not {name for name in found if name.startswith(("nnql_bullet.render", "nnql_bullet.reports"))}

    def test_a_part_made_by_other_code_or_libraries_is_another_part(self, monkeypatch: pytest.MonkeyPatch) -> None:
        module = "nnql_bullet.evaluation.drives"
        now = parts.part_name(module, "drives", 1)
        assert parts.part_name(module, "drives", 1) == now != parts.part_name(module, "drives", 2)
        monkeypatch.setattr(parts, "code_digest", lambda _: "0")
        other_code = parts.part_name(module, "drives", 1)
        monkeypatch.setattr(parts, "libraries", lambda: {"numpy": "1.0"})
        assert len({now, other_code, parts.part_name(module, "drives", 1)}) == 3


class TestRecords:
    def test_it_names_version_commit_libraries_and_machine(self) -> None:
        found = made_by()
        assert found["version"] == nb.__version__
        assert {"numpy", "scipy", "numba", "torch"} <= found["libraries"].keys()
        root = Path(__file__).resolve().parents[1]
        if (root / ".git").exists():
            commit = subprocess.check_output(["git", "rev-parse", "HEAD"], cwd=root, text=True).strip()
            assert found["commit"].removesuffix("-dirty") == commit
        assert json.loads(json.dumps(found)) == found

    def test_recordings_and_results_hold_it(self) -> None:
        recording = nb.drive("straight", world="empty", simulator="kinematic")
        assert recording.about["made_by"] == made_by()

    def test_a_run_that_goes_on_with_other_code_says_so(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ) -> None:
        small = {"simulator": "kinematic", "vehicles": 2, "out": tmp_path / "run"}
        nb.train("paper", episodes=2, **small)
        (first,) = nb.load_run(tmp_path / "run").makers
        assert first == {**made_by(), "after_episodes": 0}
        nb.resume(tmp_path / "run", 3)
        assert nb.load_run(tmp_path / "run").makers == [first]
        assert "other code" not in caplog.text
        monkeypatch.setattr(runs, "made_by", lambda: {**made_by(), "code": "other"})
        nb.resume(tmp_path / "run", 4)
        assert nb.load_run(tmp_path / "run").makers == [first, {**first, "code": "other", "after_episodes": 3}]
        assert "was begun by other code" in caplog.text
