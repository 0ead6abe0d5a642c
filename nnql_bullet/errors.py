"""The exceptions and warnings that a caller is meant to catch, and what is said of libraries that do not load."""

import os
import traceback

from nnql_bullet.text import one_line

_VARIABLES = {"numpy": ("NUMPY_", "NPY_"), "matplotlib": ("MATPLOTLIB", "MPL")}
"""How the environment variables of a library begin, where not like its name."""


class UserError(Exception):
    """Raised for bad input. The message is one printable line that says what is wrong and what to do."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class WorkFailed(Exception):
    """Raised when a piece of work fails or its process dies. The message is one line that names the piece."""


class WorkerDied(Exception):
    """Raised when a process that simulates vehicles is gone. The message names it."""


class RobotWarning(UserWarning):
    """A robot does not move in contact physics as mechanics says; the message is one line that names what is off."""


def missing_library(library: str, extra: str) -> UserError:
    """The error for a library that is not installed, with the extra that installs it."""
    return UserError(f"{library} is not installed; install it with: pip install 'nnql-bullet[{extra}]'")


def failed_import(error: BaseException) -> str:
    """Says which library did not load, and which environment variables that it reads are set.

    Returns:
        One line; empty if the error was not raised while a library was imported.
    """
    frames = list(traceback.walk_tb(error.__traceback__))
    modules = [str(frame.f_globals.get("__name__")) for frame, _ in frames if frame.f_code.co_name == "<module>"]
    if isinstance(error, ModuleNotFoundError) and error.name:
        modules.append(error.name)
    library = modules[-1].partition(".")[0] if modules else __package__
    if library in (__package__, "__main__"):
        return ""
    begin = _VARIABLES.get(library, (f"{library.upper()}_",))
    given = [
        f"{name}={value}"
        for name, value in sorted(os.environ.items())
        if name.startswith(begin) or repr(value) in str(error)  # such as SOURCE_DATE_EPOCH, which NumPy reads
    ]
    advice = f"mend or unset {', '.join(given)}" if given else "install it again"
    return one_line(f"{library} does not load: {type(error).__name__}: {str(error).rstrip('.')}; {advice}")
