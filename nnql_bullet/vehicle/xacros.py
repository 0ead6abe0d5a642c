"""Expands xacros, the macros in which ROS writes URDFs, through xacrodoc."""

import ast
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr
from io import StringIO
from pathlib import Path
from threading import Lock
from typing import Any

from nnql_bullet.errors import UserError, missing_library
from nnql_bullet.files import is_file, real
from nnql_bullet.vehicle.description import Unfit

FORBIDDEN = {"vars", "type", "mro", "gi_frame", "cr_frame", "ag_frame", "tb_frame"}
"""Names by which an expression would come from a value to its class or its frame, and from there to anything."""
NAMESPACES = {"python", "math", "xacro"}
"""Names of xacro that hold functions."""
_lock = Lock()


def expand(path: Path, arguments: Mapping[str, str]) -> tuple[str, list[str]]:
    """Expands a xacro.

    Packages, as in $(find name), are looked for in the folders above the file and beside these, and where ROS has them.
    xacro evaluates the expressions ${...} as Python with few functions. It does not look into nested functions for
    what leads out of them; here such expressions are refused. What a file may still do is to read other files and
    environment variables, and to compute for long.

    Args:
        path: The xacro.
        arguments: Values of its arguments by name.

    Returns:
        The URDF, and what xacro warns of.

    Raises:
        UserError: If xacrodoc is not installed, or the file cannot be expanded.
    """
    if not is_file(path):
        raise UserError(f"{path}: there is no such file")
    try:
        from xacrodoc import XacroDoc
    except ImportError:
        raise missing_library("xacrodoc, which expands xacros,", "robots") from None
    try:
        with _fenced(real(path).parent) as said:
            options = {"subargs": dict(arguments), "resolve_packages": False, "walk_up": True}
            text = str(XacroDoc.from_file(str(path), **options).to_urdf_string())
    except Exception as error:  # xacro passes on all errors of the expressions that it evaluates
        reason = " ".join(str(error).split()) or type(error).__name__
        if lost := re.search(r"Package not found: (\S+)", reason):
            reason = f"package '{lost[1]}' is not found; put its folder beside the robot's or beside one above it"
        raise UserError(f"{path}: xacro cannot expand it: {reason}") from None
    return text, [line for line in said.getvalue().splitlines() if line.strip()]


@contextmanager
def _fenced(folder: Path) -> Iterator[StringIO]:
    """Lets xacro find files in a folder and packages around it, and evaluate what `_check` allows.

    xacrodoc gives xacro a text without a file, so that relative paths would begin in the working directory. What xacro
    prints is held back.
    """
    import xacro
    from xacrodoc import packages

    finder = packages.PackageFinder()
    finder.finder_funcs.insert(0, (lambda name: _package(folder, name), FileNotFoundError))
    evaluate, absolute = xacro.safe_eval, xacro.abs_filename_spec

    def evaluate_checked(expression: str, *names: Any, **more: Any) -> Any:
        _check(expression)
        return evaluate(expression, *names, **more)

    with _lock, redirect_stderr(StringIO()) as said:
        before = packages._finder
        packages._finder, xacro.safe_eval = finder, evaluate_checked
        xacro.abs_filename_spec = lambda name: str(folder / absolute(name))
        try:
            yield said
        finally:
            packages._finder, xacro.safe_eval, xacro.abs_filename_spec = before, evaluate, absolute


def _package(folder: Path, name: str) -> str:
    """Finds the folder of a package: of that name, above a folder or beside one of those above.

    Raises:
        FileNotFoundError: If there is none.
    """
    for above in (folder, *folder.parents):
        for tried in (above, above / name):
            if tried.name == name and tried.is_dir():
                return str(tried)
    raise FileNotFoundError(name)


def _check(expression: str) -> None:
    """Refuses an expression that names what leads out of xacro's functions.

    Raises:
        Unfit: If it does.
    """
    nodes = list(ast.walk(ast.parse(expression.strip(), mode="eval")))
    names = {getattr(node, "attr", "") or getattr(node, "id", "") for node in nodes}
    held = {id(node.value) for node in nodes if isinstance(node, ast.Attribute)}
    bare = {node.id for node in nodes if isinstance(node, ast.Name) and node.id in NAMESPACES and id(node) not in held}
    refused = {name for name in names if name.startswith("_") or name in FORBIDDEN} | bare
    if refused:
        raise Unfit(f"${{{expression}}} uses {', '.join(sorted(refused))}, which expressions of a robot need not")
