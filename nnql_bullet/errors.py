"""The exceptions that a caller is meant to catch."""


class UserError(Exception):
    """Raised for bad input. The message is one line that says what is wrong and what to do."""


class WorkFailed(Exception):
    """Raised when a piece of work fails or its process dies. The message is one line that names the piece."""
