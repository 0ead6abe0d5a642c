"""The numbers of the paper are written in one module; what the linters can check of the layout is in pyproject.toml."""

import ast
from collections.abc import Iterator
from math import radians
from pathlib import Path

import pytest

from nnql_bullet import paper

PACKAGE = Path(paper.__file__).parent
NUMBERS = {name.lower(): value for name, value in vars(paper).items() if name.isupper()}


def bound(tree: ast.Module) -> Iterator[tuple[str, ast.expr, int]]:
    """Every name that is given a value in its definition: constants, fields of records, defaults of parameters."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            yield from ((ast.unparse(target), node.value, node.lineno) for target in node.targets)
        elif isinstance(node, ast.AnnAssign) and node.value:
            yield ast.unparse(node.target), node.value, node.lineno
        elif isinstance(node, ast.arguments):
            names = [argument.arg for argument in node.posonlyargs + node.args]
            defaults = [*zip(names[::-1], node.defaults[::-1], strict=False)]
            defaults += [(a.arg, d) for a, d in zip(node.kwonlyargs, node.kw_defaults, strict=True) if d]
            yield from ((name, value, value.lineno) for name, value in defaults)


def copies(source: str) -> list[str]:
    """Names of the paper's numbers that a text binds to the same number again, instead of to the one in paper.py."""
    found = []
    for name, value, line in bound(ast.parse(source)):
        names = {part.id for part in ast.walk(value) if isinstance(part, ast.Name)}
        if name.lower() in NUMBERS and names <= {"radians"}:
            number = eval(ast.unparse(value), {"__builtins__": {}, "radians": radians})  # noqa: S307
            if number == NUMBERS[name.lower()]:
                found.append(f"line {line}: {name}")
    return found


@pytest.mark.parametrize(
    "text",
    ["DISCOUNT = 0.15", "class A:\n speed: float = 2.0", "def f(*, temperature_max=0.8): ...", "TARGET = (90, 90)"],
)
def test_a_copied_number_is_seen(text: str) -> None:
    assert len(copies(text)) == 1


def test_no_module_copies_a_number_of_the_paper() -> None:
    files = sorted(set(PACKAGE.rglob("*.py")) - {PACKAGE / "paper.py"})
    found = {str(path.relative_to(PACKAGE)): copies(path.read_text(encoding="utf-8")) for path in files}
    assert len(files) > 100
    assert not {path: lines for path, lines in found.items() if lines}
