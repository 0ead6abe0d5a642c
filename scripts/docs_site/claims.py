"""Claims: figures in Markdown that are rendered from results/, and the check that no other figure slips in.

On a page of the site a claim is `{{ success covers paper cover_10 }}`: the name of a function and its arguments, which
name things in results/*.json; %20 is a space. No text is evaluated. In the README, which is read as it is, figures are
in the block that `hooks.py` writes.
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

Functions = Mapping[str, Callable[..., object]]
CLAIM = re.compile(r"\{\{ (.+?) \}\}")
FIGURE = re.compile(
    r"(?:\d ?%? |(?=\([^()]*[.%]))\((?:[^()\n]*interval )?[-+]?\d[\d.]*(?: ?%)?(?:-| to )[-+]?\d[\d.]*[^()]*\)"
)
"""An interval in brackets after a figure or in a sentence: 97.5 (87.1 to 99.6), (0 to 3.7 %), 98 (97-99), ..."""
GENERATED = re.compile(r"(?s)<!-- results: begin.*?<!-- results: end -->")
CODE = re.compile(r"(?ms)^ *```.*?^ *```|`[^`\n]*`")
FACTS = ("explanation/physics.md", "explanation/fidelity.md", "explanation/envelope.md", "explanation/speed.md")
"""Pages of measured properties of the simulators, which the verbs of the package print for any machine."""
TYPED = {
    "explanation/double-dqn.md": 39,
    "explanation/gap.md": 10,
    "explanation/shield.md": 35,
    "how-to/barn.md": 52,
    "how-to/scale.md": 6,
}
"""Number of figures that pages still type, measured by a command beside them but without a file in results/. It may
only fall: a figure that is added comes from results/."""


class WrongClaim(Exception):
    """A claim that results/ does not support."""


def claimed(text: str, functions: Functions) -> str:
    """Renders one claim.

    Raises:
        WrongClaim: If there is no such function, or results/ does not hold what it is about.
    """
    name, *arguments = (word.replace("%20", " ") for word in text.split())
    try:
        return str(functions[name](*arguments))
    except (LookupError, TypeError) as error:
        raise WrongClaim(f"{{{{ {text} }}}}: {error}") from None


def filled(markdown: str, functions: Functions) -> str:
    """Renders the claims of a page."""
    return CLAIM.sub(lambda found: claimed(found[1], functions), markdown)


def typed(markdown: str) -> list[str]:
    """Figures with intervals that are typed and not rendered."""
    text = markdown
    for generated in (GENERATED, CODE, CLAIM):
        text = generated.sub("", text)
    return [found[0] for found in FIGURE.finditer(text)]


def complaints(root: Path, functions: Functions) -> list[str]:
    """Says which claims of the README and the pages are wrong, and where figures are typed that are no claims.

    Args:
        root: Folder of the repository.
        functions: Functions that render from results/; other names on pages are left to the build of the site.
    """
    wrong = []
    for file in (root / "README.md", *sorted((root / "docs").rglob("*.md"))):
        page, text = file.relative_to(root).as_posix().removeprefix("docs/"), file.read_text(encoding="utf-8")
        for claim in CLAIM.findall(text):
            if claim.split()[0] in functions:
                try:
                    claimed(claim, functions)
                except WrongClaim as error:
                    wrong.append(f"{page}: {error}")
        found = typed(text)
        if page not in FACTS and len(found) != TYPED.get(page, 0):
            wrong.append(
                f"{page}: {len(found)} figures are typed, {TYPED.get(page, 0)} are known; render new ones from "
                f"results/, and lower the number in scripts/docs_site/claims.py where some are gone: {'; '.join(found)}"
            )
    return wrong
