"""The exception for mistakes that a user can correct."""


class UserError(Exception):
    """Raised for bad input. Its message is one line that says what is wrong and what to do."""
