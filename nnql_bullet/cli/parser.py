"""The parser: from arguments to a verb, from what goes wrong to an exit code."""

import errno
import functools
import io
import re
from collections.abc import Callable
from contextlib import redirect_stderr
from importlib import import_module
from inspect import getdoc

import tyro

from nnql_bullet import __version__
from nnql_bullet.cli.console import complain, say
from nnql_bullet.errors import UserError, WorkFailed
from nnql_bullet.sim.base import WorkerDied

VERBS = (
    "train",
    "policies",
    "drive",
    "render",
    "view",
    "evaluate",
    "failures",
    "ablate",
    "gap",
    "report",
    "fidelity",
    "envelope",
    "doctor",
)
"""Each a function in a module of its name."""

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
    verb, *rest = arguments or ["--help"]
    if verb == "--version":
        say(f"nnql-bullet {__version__}")
        return 0
    if verb in ("-h", "--help"):
        say(_overview())
        return 0
    if verb not in VERBS:
        return complain(f"there is no verb '{verb}'; there are: {', '.join(VERBS)}")
    try:
        return _call(verb, rest)
    except UserError as error:
        return complain(str(error))
    except (WorkerDied, WorkFailed) as error:
        complain(str(error))
        return 1
    except OSError as error:
        return complain(f"{error.filename or 'file system'}: {_remedy(error)}")


def verb_of(name: str) -> Callable[..., int]:
    """A verb, imported when it is asked for: what others need takes seconds and hundreds of megabytes."""
    verb: Callable[..., int] = getattr(import_module(f"nnql_bullet.cli.{name}"), name)
    return verb


def _call(verb: str, arguments: list[str]) -> int:
    """Parses the arguments of a verb, then runs it; a mistake in them is one line."""
    box = io.StringIO()
    try:
        with redirect_stderr(box):
            call = tyro.cli(_delayed(verb_of(verb)), prog=f"nnql-bullet {verb}", args=arguments)
    except SystemExit as stop:
        if not stop.code:
            return 0
        return complain(f"{_sentence(box.getvalue())}; see: nnql-bullet {verb} --help")
    return call()


def _delayed(verb: Callable[..., int]) -> Callable[..., Callable[[], int]]:
    """The verb with the same signature and help, that only takes note of its arguments."""

    @functools.wraps(verb)
    def note(*args: object, **kwargs: object) -> Callable[[], int]:
        return lambda: verb(*args, **kwargs)

    return note


def _sentence(box: str) -> str:
    """What the parser's box of text says first."""
    lines = [line.strip("╭╮╰╯│─ ") for line in box.splitlines()[1:]]
    text = " ".join(lines[: lines.index("")] if "" in lines else lines)
    text = re.sub(r"no type matching \S+ could be instantiated from \['(.*?)'\]", r"not a valid value: '\1'", text)
    sentence = re.split(r"\. | ?Perhaps| For full", text)[0].rstrip(".")
    choices = re.search(r"Expected one of \((.*?)\)", text)
    if choices:
        names = sorted(set(re.findall(r"'(.*?)'", choices[1])) - {"None"})
        sentence += f"; give one of: {', '.join(names)}"
    return sentence


def _overview() -> str:
    rows = [f"  {name:<10} {(getdoc(verb_of(name)) or '').splitlines()[0]}" for name in VERBS]
    return "\n".join([ABOUT, *rows, "", START])


def _remedy(error: OSError) -> str:
    reason = error.strerror or str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"{reason}; free some space, or give another folder with --out"
    if error.errno in (errno.EACCES, errno.EROFS, errno.EPERM):
        return f"{reason}; give a folder that can be written to with --out"
    return reason
