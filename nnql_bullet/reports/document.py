"""A report as data: sections of paragraphs, tables, pictures and commands, for Markdown and HTML."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Table:
    """A table of printed cells."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    """A paragraph before the table."""
    note: str = ""
    """A paragraph after the table."""

    def markdown(self) -> str:
        """Returns the table with its caption and note as Markdown."""
        lines = (self.header, ("---",) * len(self.header), *self.rows)
        grid = "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines)
        return "\n\n".join(part for part in (_text(self.caption), grid, _text(self.note)) if part)


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture in the folder of the report."""

    file: str
    alt: str
    """Description for readers who do not see the picture."""

    def markdown(self) -> str:
        """Returns the picture as Markdown."""
        return f"![{_text(self.alt)}]({self.file})"


@dataclass(frozen=True, slots=True)
class Commands:
    """Lines for a shell."""

    lines: tuple[str, ...]

    def markdown(self) -> str:
        """Returns the lines as a Markdown block of code."""
        return "\n".join(("```", *self.lines, "```"))


Block = str | Table | Picture | Commands
"""A part of a section; a string is a paragraph with code between backticks."""


@dataclass(frozen=True, slots=True)
class Section:
    """Blocks under a title."""

    title: str
    """Empty for the section at the beginning of a report."""
    blocks: tuple[Block, ...]
    level: int = 2
    """Level of the title in Markdown."""

    def markdown(self) -> str:
        """Returns the section as Markdown."""
        title = [f"{'#' * self.level} {_text(self.title)}"] if self.title else []
        blocks = [_text(block) if isinstance(block, str) else block.markdown() for block in self.blocks]
        return "\n\n".join([*title, *blocks])


@dataclass(frozen=True, slots=True)
class Report:
    """Sections under a title."""

    title: str
    sections: tuple[Section, ...]

    def markdown(self) -> str:
        """Returns the report as Markdown."""
        return "\n\n".join([f"# {_text(self.title)}", *(section.markdown() for section in self.sections)]) + "\n"


def _text(text: str) -> str:
    """Text as Markdown: what looks like a tag outside of code is shown, not obeyed."""
    parts = text.split("`")
    return "`".join(part if number % 2 else part.replace("<", "&lt;") for number, part in enumerate(parts))


def _cell(text: str) -> str:
    """A cell of a table as Markdown: one line, whose bars do not end it."""
    return _text(" ".join(text.split("\n"))).replace("|", "\\|")


def table(header: Sequence[str], rows: Iterable[Iterable[object]], caption: str = "", note: str = "") -> Table:
    """Makes a table of any values; `str` prints each cell."""
    return Table(tuple(header), tuple(tuple(map(str, row)) for row in rows), caption, note)
