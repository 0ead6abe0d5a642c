"""The parser: from arguments to a verb, from what goes wrong to an exit code."""

import ast
import errno
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from nnql_bullet import __version__
from nnql_bullet.cli.console import complain, give_up_output, is_unread, messages, say
from nnql_bullet.errors import UserError, WorkerDied, WorkFailed, failed_import

VERBS = (
    "train",
    "sweep",
    "keys",
    "policies",
    "drive",
    "worlds",
    "render",
    "view",
    "evaluate",
    "barn",
    "failures",
    "ablate",
    "gap",
    "report",
    "export",
    "robot",
    "fidelity",
    "envelope",
    "doctor",
)
"""Each a function in a module of its name."""
RENAMED_VERBS = {"navigate": "drive", "ledger": "ablate"}
"""Verbs of version 0.1, and their names now."""

ABOUT = """\
A three-wheeled vehicle learns to avoid obstacles by neural-network Q-learning, in contact physics.

usage: nnql-bullet VERB [OPTIONS]
"""
START = """\
nnql-bullet VERB --help tells more. To begin:
  nnql-bullet drive --world traps --video
  nnql-bullet train --episodes 200 --out runs/first
  nnql-bullet drive runs/first
"""


def run(arguments: list[str]) -> int:
    """Parses and runs one verb; the exit code."""
    try:
        return _run(arguments)
    except UserError as error:
        return complain(str(error))
    except (WorkerDied, WorkFailed) as error:
        complain(str(error))
        return 1
    except Exception as error:
        unloaded = failed_import(error)
        if unloaded:
            return complain(unloaded)
        if not isinstance(error, OSError):
            raise
        if is_unread(error):
            return give_up_output()
        return complain(f"{error.filename or 'file system'}: {_remedy(error)}")


def _run(arguments: list[str]) -> int:
    verb, *rest = arguments or ["--help"]
    if verb == "--version":
        say(f"nnql-bullet {__version__}")
        return 0
    if verb in ("-h", "--help"):
        say(_overview())
        return 0
    if verb in RENAMED_VERBS:
        return complain(f"the verb '{verb}' is now '{RENAMED_VERBS[verb]}'")
    if verb not in VERBS:
        return complain(f"there is no verb '{verb}'; there are: {', '.join(VERBS)}")
    with messages():
        if arguments == ["doctor"]:  # before anything is imported that may not load here
            return verb_of(verb)()
        from nnql_bullet.cli.flags import parse  # takes seconds, as all that configures does
        from nnql_bullet.jit import announced

        try:
            call = parse(verb_of(verb), f"nnql-bullet {verb}", rest)
        except SystemExit:  # help was asked for
            return 0
        with announced():
            return call()


def verb_of(name: str) -> Callable[..., int]:
    """A verb, imported when it is asked for: what others need takes seconds and hundreds of megabytes."""
    verb: Callable[..., int] = getattr(import_module(f"nnql_bullet.cli.{name}"), name)
    return verb


def _overview() -> str:
    rows = [f"  {name:<10} {_first_line(name)}" for name in VERBS]
    return "\n".join([ABOUT, *rows, "", START])


def _first_line(name: str) -> str:
    """What a verb does, read from its source: to import it takes seconds, and fails where a library does not load."""
    tree = ast.parse(Path(__file__).with_name(f"{name}.py").read_text(encoding="utf-8"))
    verb = next(its for its in tree.body if isinstance(its, ast.FunctionDef) and its.name == name)
    return (ast.get_docstring(verb) or "").partition("\n")[0]


def _remedy(error: OSError) -> str:
    reason = error.strerror or str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"{reason}; free some space, or give another folder with --out"
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return f"{reason}; raise the limit (ulimit -n), or give fewer --workers"
    if error.errno in (errno.EEXIST, errno.ENOTDIR):
        return "there is a file, or a link to nothing, where a folder is wanted; give another folder with --out"
    if error.errno in (errno.EACCES, errno.EROFS, errno.EPERM):
        return f"{reason}; give a folder that can be written to with --out"
    return reason
