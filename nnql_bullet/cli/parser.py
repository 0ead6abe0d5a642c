"""The parser: from arguments to a verb, from what goes wrong to an exit code."""

import errno
from collections.abc import Callable
from importlib import import_module
from inspect import getdoc

from nnql_bullet import __version__
from nnql_bullet.cli.console import complain, give_up_output, is_unread, messages, say
from nnql_bullet.errors import UserError, WorkFailed
from nnql_bullet.sim.base import WorkerDied

VERBS = (
    "train",
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
    except OSError as error:
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
    from nnql_bullet.cli.flags import parse  # takes seconds, as all that configures does

    try:
        call = parse(verb_of(verb), f"nnql-bullet {verb}", rest)
        with messages():
            return call()
    except SystemExit:  # help was asked for
        return 0


def verb_of(name: str) -> Callable[..., int]:
    """A verb, imported when it is asked for: what others need takes seconds and hundreds of megabytes."""
    verb: Callable[..., int] = getattr(import_module(f"nnql_bullet.cli.{name}"), name)
    return verb


def _overview() -> str:
    rows = [f"  {name:<10} {_first_line(verb_of(name))}" for name in VERBS]
    return "\n".join([ABOUT, *rows, "", START])


def _first_line(verb: Callable[..., int]) -> str:
    """What a verb does; empty under `python -OO`, which removes the docstrings."""
    return (getdoc(verb) or "").partition("\n")[0]


def _remedy(error: OSError) -> str:
    reason = error.strerror or str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"{reason}; free some space, or give another folder with --out"
    if error.errno in (errno.EACCES, errno.EROFS, errno.EPERM):
        return f"{reason}; give a folder that can be written to with --out"
    return reason
