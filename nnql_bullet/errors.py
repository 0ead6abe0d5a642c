"""The exceptions and warnings that a caller is meant to catch."""

from nnql_bullet.text import one_line


class UserError(Exception):
    """Raised for bad input. The message is one printable line that says what is wrong and what to do."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class WorkFailed(Exception):
    """Raised when a piece of work fails or its process dies. The message is one line that names the piece."""


class RobotWarning(UserWarning):
    """A robot does not move in contact physics as mechanics says; the message is one line that names what is off."""


def missing_library(library: str, extra: str) -> UserError:
    """The error for a library that is not installed, with the extra that installs it."""
    return UserError(f"{library} is not installed; install it with: pip install 'nnql-bullet[{extra}]'")
