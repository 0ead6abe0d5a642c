"""Writes reports on runs, recordings and evaluations: text, tables, pictures and pages."""

from nnql_bullet.errors import UserError

try:
    import matplotlib  # noqa: F401  # before any of its modules
except ValueError as error:
    raise UserError(f"Matplotlib does not start; mend or unset MPLBACKEND: {error}") from None
