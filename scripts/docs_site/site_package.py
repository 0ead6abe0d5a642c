"""Reads the package for the site: its options, its command line, its modules and its shipped policies.

Nothing is named here that the package can be asked for, so that a renamed key, verb or module needs no change here.
"""

import ast
import io
import os
import re
import textwrap
from contextlib import redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "nnql_bullet"
WIDTH = 80
"""Columns that the command line's help is laid out in."""


def find(name: str) -> Any:
    """The class or function of this name that some module of the package defines.

    Raises:
        LookupError: If no module defines it.
    """
    for path in sorted(PACKAGE.rglob("*.py")):
        if re.search(rf"^(class|def) {name}\b", path.read_text(encoding="utf-8"), re.MULTILINE):
            return getattr(import_module(module_name(path)), name)
    raise LookupError(f"nnql_bullet does not define {name}")


def module_name(path: Path) -> str:
    """The dotted name of a module file of the package."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


# Options ------------------------------------------------------------------------------------------------------------


def configuration() -> str:
    """Markdown tables of every key of a run's configuration."""
    return _key_tables(find("RunConfig"), 2)


def world_keys() -> str:
    """Markdown tables of every key of a world file."""
    return _key_tables(find("World"), 3)


def robot_keys() -> str:
    """Markdown tables of every key of a robot file."""
    return _key_tables(find("RobotFile"), 3)


def presets() -> str:
    """A Markdown table of the keys that each preset sets differently from the defaults."""
    run_config, load_config, to_values = find("RunConfig"), find("load_config"), find("to_values")
    defaults = find("dotted")(to_values(run_config()))
    rows = []
    for name in import_module("nnql_bullet.presets").PRESETS:
        values = find("dotted")(to_values(load_config(name, {})))
        same_agent = values.get("agent.kind") == defaults.get("agent.kind")
        changed = {
            key: value
            for key, value in values.items()
            if defaults.get(key) != value and (same_agent or not key.startswith("agent.") or key == "agent.kind")
        }
        if set(changed) != {"agent.kind"}:  # every kind of agent is a preset, all else being equal
            text = "<br>".join(f"`{key} = {_toml(value)}`" for key, value in changed.items())
            rows.append((f"`{name}`", text or "nothing: these are the defaults"))
    return _table(("preset", "keys that differ from the defaults"), rows)


def _key_tables(cls: type, level: int) -> str:
    """The keys of an options class and of those nested in it: a table for each of its tables, under a heading."""
    tables: dict[tuple[str, str], list[tuple[str, ...]]] = {("", ""): []}
    for key in import_module("nnql_bullet.config").keys(cls):
        table, _, name = key.name.rpartition(".")
        type_text, default = (
            key.type_text.replace(" | ", " or "),
            "" if key.default is None else f"`{_toml(key.default)}`",
        )
        tables.setdefault((table, key.kind), []).append((f"`{name}`", type_text, default, _sentence(key.about)))
    parts = []
    for (table, kind), rows in tables.items():
        if table:
            anchor = "-".join(re.findall(r"[a-z0-9]+", f"{table} {kind}".lower()))
            title = f"`[{table}]`" + (f' with `kind = "{kind}"`' if kind else "")
            parts.append(f"{'#' * level} {title} {{ #{anchor} }}")
        if rows:
            parts.append(_table(("key", "type", "default", "meaning"), rows))
    return "\n\n".join(parts)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, float):
        return f"{value:g}" if abs(value) < 1e-3 and value else repr(round(value, 6))
    return str(value)


def _sentence(text: str) -> str:
    """A docstring as one line of Markdown."""
    return re.sub(r"\s+", " ", text).strip().replace("|", "\\|")


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


# The command line ---------------------------------------------------------------------------------------------------


def command_line() -> str:
    """Every verb with its options, from its own --help."""
    overview = _said("--help")
    verbs = re.findall(r"^ {2}(\w+) +(\S.*)$", overview, re.MULTILINE)
    rows = [(f"[`{verb}`](#{verb})", _sentence(text)) for verb, text in verbs]
    sections = [f"## {verb} {{ #{verb} }}\n\n```text\n{_said(verb, '--help').strip()}\n```" for verb, _ in verbs]
    return "\n\n".join([_table(("verb", "what it does"), rows), *sections])


def _said(*arguments: str) -> str:
    """What the program prints."""
    from nnql_bullet.cli import main

    os.environ |= {"COLUMNS": str(WIDTH), "NO_COLOR": "1", "TERM": "dumb"}
    out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")  # an encoding, so that boxes are drawn in Unicode
    with redirect_stdout(out), redirect_stderr(out):
        try:
            code: Any = main(list(arguments))
        except SystemExit as stop:
            code = stop.code
    out.seek(0)
    text = out.read()
    if code:
        raise RuntimeError(f"nnql-bullet {' '.join(arguments)}: {text}")
    return text


# Modules ------------------------------------------------------------------------------------------------------------

HIDDEN = ("cli", "_data", "__main__", "__init__")


def api_pages() -> dict[str, tuple[str, str, str]]:
    """Of each part of the package a page: by file name its title, its first sentence, and its Markdown."""
    pages = {}
    for path in sorted(PACKAGE.iterdir()):
        name = path.stem
        is_module = path.suffix == ".py" or (path / "__init__.py").is_file()
        if not is_module or name in HIDDEN or name.startswith("_"):
            continue
        modules = [path] if path.suffix == ".py" else sorted(path.rglob("*.py"))
        about = _about(name)
        parts = [f"# `nnql_bullet.{name}`", *(f"::: {place}" for module in modules for place in _places(module))]
        if path.suffix != ".py":
            parts.insert(1, about)
        pages[name] = (name, about, "\n\n".join(parts) + "\n")
    return pages


def _places(path: Path) -> list[str]:
    """What of a module a page shows: all of it; of a package only what it defines itself, not what it passes on."""
    if path.name != "__init__.py":
        return [module_name(path)]
    body = ast.parse(path.read_text(encoding="utf-8")).body
    defined = [part.name for part in body if isinstance(part, (ast.FunctionDef, ast.ClassDef))]
    return [f"{module_name(path)}.{name}" for name in defined if not name.startswith("_")]


def layers() -> str:
    """A table of the layers that import-linter checks, from the top down."""
    import tomlkit

    contracts = tomlkit.parse((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    (layered,) = [contract["layers"] for contract in contracts if contract["type"] == "layers"]
    pages, rows = api_pages(), []
    for number, layer in enumerate(layered, 1):
        for name in (part.strip(" ()") for part in layer.split("|")):
            if not _source(name).is_file():  # a layer in brackets may be missing
                continue
            module = f"[`{name}`](../reference/api/{name}.md)" if name in pages else f"`{name}`"
            rows.append((str(number), module, _about(name)))
    return _table(("layer", "module", "what it is"), rows)


def _about(name: str) -> str:
    """The first sentence of a module's or folder's docstring."""
    text = ast.get_docstring(ast.parse(_source(name).read_text(encoding="utf-8"))) or ""
    return _sentence(text.partition("\n\n")[0])


def _source(name: str) -> Path:
    path = PACKAGE / f"{name}.py"
    return path if path.is_file() else PACKAGE / name / "__init__.py"


def api_index() -> str:
    """A table of the parts of the package."""
    return _table(("module", "what it holds"), [(f"[`{n}`]({n}.md)", about) for n, about, _ in api_pages().values()])


# Shipped policies ---------------------------------------------------------------------------------------------------


def policy_cards() -> str:
    """The card of every shipped policy, its headings one level down."""
    assets = import_module("nnql_bullet.assets")
    cards = [assets.card(path).read_text(encoding="utf-8").strip() for path in assets.policies().values()]
    return "\n\n".join(_card(card) for card in cards)


def _card(text: str) -> str:
    title, _, body = text.partition("\n")
    name, _, about = title.lstrip("# ").partition(":")
    body = re.sub(r"(?m)^## (.*)$", r"**\1**", body)
    body = re.sub(r"(?s)\*\*Configuration\*\*\n\n(```toml.*?```)", _folded, body)
    return f"## {name}\n\n{about.strip().capitalize()}.\n{body}"


def _folded(match: re.Match[str]) -> str:
    return '??? note "Configuration"\n\n' + textwrap.indent(match[1], "    ")
