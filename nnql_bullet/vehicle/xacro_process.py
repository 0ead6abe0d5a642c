"""Expands one xacro through xacrodoc, in a process of its own, in which xacro may be changed and may be stopped.

Packages, as in $(find name), are looked for in the folders above the file and beside these, and where ROS has them.
xacro evaluates the expressions ${...} as Python with few functions. It does not look into nested functions for what
leads out of them; here such expressions are refused.
"""

import ast
import json
import re
import sys
from contextlib import redirect_stderr, redirect_stdout, suppress
from io import StringIO
from math import ceil
from pathlib import Path
from typing import Any

from nnql_bullet.files import real

FORBIDDEN = {"vars", "type", "mro", "gi_frame", "cr_frame", "ag_frame", "tb_frame"}
"""Names by which an expression would come from a value to its class or its frame, and from there to anything."""
NAMESPACES = {"python", "math", "xacro"}
"""Names of xacro that hold functions."""


def answer() -> None:
    """Expands the xacro that standard input asks for, and ends with the URDF, or the reason against it, in JSON."""
    request = json.load(sys.stdin)
    path, most = Path(request["path"]), request["length"]
    try:
        _fence(real(path).parent)
        _limit(request["computing"], request["memory"])
        with redirect_stdout(StringIO()) as said, redirect_stderr(said):
            text = _expanded(path, request["arguments"])
        if len(text) + len(said.getvalue()) > most:
            raise ValueError(f"it becomes longer than {most} bytes")
        found = {"urdf": text, "warned": [line for line in said.getvalue().splitlines() if line.strip()]}
    except Exception as error:  # xacro passes on all errors of the expressions that it evaluates
        found = {"refused": _reason(error, request["memory"])}
    json.dump(found, sys.stdout)  # noqa: TID251 (a pipe to the process that started this one)


def _expanded(path: Path, arguments: dict[str, str]) -> str:
    from xacrodoc import XacroDoc

    options = {"subargs": arguments, "resolve_packages": False, "walk_up": True}
    return str(XacroDoc.from_file(str(path), **options).to_urdf_string())


def _reason(error: Exception, memory: int) -> str:
    """Says in one line why a xacro is not expanded."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return f"it needs more than {memory / 1e9:g} GB of memory"
        cause = getattr(cause, "exc", None) or cause.__cause__ or cause.__context__  # `exc` is xacro's own
    reason = " ".join(str(error).split()) or type(error).__name__
    if lost := re.search(r"Package not found: (\S+)", reason):
        reason = f"package '{lost[1]}' is not found; put its folder beside the robot's or beside one above it"
    return reason


def _limit(computing: float, memory: int) -> None:
    """Lets the system end this process after so much more processor time [s], and give it no more memory [bytes]."""
    with suppress(ImportError, ValueError, OSError):  # systems without limits, or with narrower ones
        import resource

        used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
        for kind, limit in ((resource.RLIMIT_CPU, ceil(used + computing)), (resource.RLIMIT_AS, memory)):
            resource.setrlimit(kind, (limit, resource.getrlimit(kind)[1]))


def _fence(folder: Path) -> None:
    """Lets xacro find files in a folder and packages around it, and evaluate what `_check` allows.

    xacrodoc gives xacro a text without a file, so that relative paths would begin in the working directory.
    """
    import xacro
    from xacrodoc import packages

    packages._finder = packages.PackageFinder()
    packages._finder.finder_funcs.insert(0, (lambda name: _package(folder, name), FileNotFoundError))
    evaluate, absolute = xacro.safe_eval, xacro.abs_filename_spec

    def evaluate_checked(expression: str, *names: Any, **more: Any) -> Any:
        _check(expression)
        return evaluate(expression, *names, **more)

    xacro.safe_eval = evaluate_checked
    xacro.abs_filename_spec = lambda name: str(folder / absolute(name))


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
        ValueError: If it does.
    """
    nodes = list(ast.walk(ast.parse(expression.strip(), mode="eval")))
    names = {getattr(node, "attr", "") or getattr(node, "id", "") for node in nodes}
    held = {id(node.value) for node in nodes if isinstance(node, ast.Attribute)}
    bare = {node.id for node in nodes if isinstance(node, ast.Name) and node.id in NAMESPACES and id(node) not in held}
    refused = {name for name in names if name.startswith("_") or name in FORBIDDEN} | bare
    if refused:
        raise ValueError(f"${{{expression}}} uses {', '.join(sorted(refused))}, which expressions of a robot need not")
