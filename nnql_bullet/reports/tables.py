"""Writes tables as text and CSV, and prepares values for JSON."""

import csv
import io
from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

NOT_A_CERTIFICATE = (
    "Evidence for an engineer, not a certificate; the standard that asks this question is ISO 3691-4 "
    "(driverless industrial trucks)."
)


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Writes a table as plain text with columns of the needed width."""
    widths = [max(len(line[column]) for line in (header, *rows)) for column in range(len(header))]
    lines = (
        "  ".join(f"{cell:<{width}}" for cell, width in zip(line, widths, strict=True)) for line in (header, *rows)
    )
    return "\n".join(line.rstrip() for line in lines)


def csv_text(records: Sequence[Mapping[str, Any]]) -> str:
    """Writes records as CSV, with the names of the first one as header; numbers are exact."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue()


def finite(values: Mapping[str, Any]) -> dict[str, Any]:
    """Replaces NaN and infinity, which JSON lacks, by None, also in tuples."""
    return {name: _finite(value) for name, value in values.items()}


def _finite(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not isfinite(value) else value
