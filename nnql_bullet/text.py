"""Text that is safe to show: in one line, for a terminal, and for a shell."""

import shlex
from collections.abc import Sequence

MOST_SHOWN = 2000
"""Characters of a line; of a longer one the middle is left out."""
MOST_LISTED = 10
"""Problems that are listed in a line; the others are counted."""


def printable(text: str, encoding: str = "utf-8") -> str:
    """Replaces control characters but line feeds by escapes, so that a name from a file cannot steer a terminal.

    So are characters replaced that the encoding lacks.
    """
    if not text.isprintable():
        text = "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text)
    return text.encode(encoding, "backslashreplace").decode(encoding)


def one_line(text: str) -> str:
    """Joins lines, replaces control characters by escapes, and leaves out the middle of what is too long."""
    line = printable(" ".join(text.split()))
    half = MOST_SHOWN // 2
    return line if len(line) <= MOST_SHOWN else f"{line[:half]} ... {line[-half:]}"


def listed(problems: Sequence[str]) -> str:
    """Writes problems in a line: one as it is, several with numbers."""
    if len(problems) == 1:
        return problems[0]
    shown = [f"({number}) {problem}" for number, problem in enumerate(problems[:MOST_LISTED], 1)]
    more = [f"and {len(problems) - MOST_LISTED} more"] if len(problems) > MOST_LISTED else []
    return f"{len(problems)} things are wrong: {'; '.join(shown + more)}"


def shell_line(*words: str) -> str:
    """Writes a command line that a shell splits into exactly these words; it is one line whatever they contain."""
    return " ".join(map(_quoted, words))


def _quoted(word: str) -> str:
    if word.isprintable():
        return shlex.quote(word)
    return "$'" + "".join(c if c.isprintable() and c not in "\\'" else _escaped(c) for c in word) + "'"


def _escaped(character: str) -> str:
    """The bytes of a character as a shell's $'...' takes them."""
    return "".join(f"\\x{byte:02x}" for byte in character.encode("utf-8", "surrogateescape"))
