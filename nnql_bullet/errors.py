"""The exceptions that a caller is meant to catch."""


class UserError(Exception):
    """Raised for bad input. The message is one line that says what is wrong and what to do."""


class WorkFailed(Exception):
    """Raised when a piece of work fails or its process dies. The message is one line that names the piece."""


def missing_library(library: str, extra: str) -> UserError:
    """The error for a library that is not installed, with the extra that installs it."""
    return UserError(f"{library} is not installed; install it with: pip install 'nnql-bullet[{extra}]'")
