"""What made a result: version, commit and code of the program, libraries, Python and machine.

The code of a result is a module and what it imports of this package, directly and indirectly, but for what only draws.
Its digest is of the syntax without docstrings and comments, so that a better sentence makes no result stale. Another
minor version of Python may write the syntax otherwise, and so give another digest.
"""

import ast
import platform
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from nnql_bullet import __version__
from nnql_bullet.files import write_text
from nnql_bullet.machine import cache_folder

PACKAGE = Path(__file__).resolve().parent
DRAWING = ("nnql_bullet.render", "nnql_bullet.reports")
"""Parts of the package that no number comes from."""
TRAINING = "nnql_bullet.session"
"""Module whose code trains and drives."""
LIBRARIES = (
    *("numpy", "scipy", "numba", "llvmlite", "torch", "pybullet", "pybullet-arm64", "mujoco", "trimesh"),
    *("deap", "scikit-fuzzy", "stable-baselines3", "sb3-contrib"),
)
"""Libraries that numbers come from, those of some agents last."""
GIT = ("git", "--no-optional-locks", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
TIMEOUT = 10.0
"""Longest wait for Git [s]."""


@cache
def made_by() -> dict[str, Any]:
    """Tells what makes results in this process, as values for JSON; `commit` only in a checkout."""
    commit = _commit()
    return {
        "version": __version__,
        **({"commit": commit} if commit else {}),
        "code": code_digest(TRAINING),
        "python": platform.python_version(),
        "libraries": libraries(),
        "platform": platform.platform(),
        "processor": _processor(),
    }


@cache
def libraries() -> dict[str, str]:
    """Returns the versions of those libraries that are installed."""
    return {name: found for name in LIBRARIES if (found := _version(name))}


@cache
def code_digest(module: str) -> str:
    """Hashes the code of a module and of all modules of this package that it imports, directly and indirectly.

    The user's cache keeps the digest for the sources as they are, as it takes seconds to work out.

    Args:
        module: Name of a module of this package.
    """
    sources = sha256(f"{module} {platform.python_version()}".encode())
    for file in sorted(PACKAGE.rglob("*.py")):
        sources.update(f"\n{file.relative_to(PACKAGE)}\n".encode() + file.read_bytes())
    cache_place = cache_folder()
    kept = cache_place / "code" / sources.hexdigest() if cache_place else None
    with suppress(OSError):  # none is kept yet
        if kept:
            return kept.read_text(encoding="utf-8").strip()
    code = "".join(f"{name}\n{_code(name)}\n" for name in sorted(closure(module)))
    digest = sha256(code.encode()).hexdigest()[:16]
    if kept:
        with suppress(OSError):
            kept.parent.mkdir(exist_ok=True)
            write_text(kept, f"{digest}\n")
    return digest


def closure(module: str) -> set[str]:
    """Finds a module and all modules of this package that it imports, also inside of functions.

    Imports for type checkers do not count, nor what only draws, nor the front door, which imports nothing by itself.
    """
    found: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name not in found and not name.startswith(DRAWING) and _file(name):
            found.add(name)
            waiting += [*_imports(name), name.rpartition(".")[0]]
    return found


def _file(module: str) -> Path | None:
    """The source of a module of this package; None for the front door and for what is no module."""
    first, *parts = module.split(".")
    if first != __package__ or not parts:
        return None
    place = PACKAGE.joinpath(*parts)
    files = (place.with_suffix(".py"), place / "__init__.py")
    return next((file for file in files if file.is_file()), None)


@cache
def _tree(module: str) -> ast.Module:
    file = _file(module)
    return ast.parse(file.read_bytes() if file else b"")


def _code(module: str) -> str:
    """A module's code without docstrings and comments, in one layout."""
    return ast.unparse(_Bare().visit(_tree(module)))


class _Bare(ast.NodeTransformer):
    """Drops strings that stand alone as statements: docstrings of modules, classes, functions and fields."""

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return None if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str) else node


def _imports(module: str) -> Iterator[str]:
    """Names that a module imports, and that may be modules."""
    waiting: list[ast.AST] = [_tree(module)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            waiting += node.orelse
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.stmt | ast.Module | ast.ExceptHandler | ast.match_case):
            waiting += ast.iter_child_nodes(node)


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return ""


def _commit() -> str:
    """The commit of the checkout that the program runs from, with -dirty if files differ; empty outside of one."""
    if not (PACKAGE.parent / ".git").exists():
        return ""
    try:
        answer = subprocess.run(
            GIT, cwd=PACKAGE.parent, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=TIMEOUT
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return answer.stdout.strip()


def _processor() -> str:
    """The processor's model, on which the last bits of a result may depend."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
