"""Extensions of Griffe for the site."""

import re
from collections.abc import Iterator
from importlib import import_module
from inspect import getdoc
from typing import Any

import griffe


class Examples(griffe.Extension):
    """In docstrings, `Example:` is a section of examples, as `Examples:` is."""

    def on_object(self, *, obj: Any, **_: Any) -> None:
        """Renames the section of one object."""
        if obj.docstring:
            obj.docstring.value = re.sub(r"(?m)^Example:$", "Examples:", obj.docstring.value)


class Unpacked(griffe.Extension):
    """Of `**asked: Unpack[Group]` each key of the group is an argument, as `arguments.checked` makes it."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Looks at the functions of a package."""
        for module in _modules(pkg):
            for function in module.functions.values():
                for its in list(function.parameters):
                    if function.docstring and str(its.annotation).startswith("Unpack["):
                        del function.parameters[its.name]
                        group = pkg.modules_collection[its.annotation.slice.canonical_path]
                        for key in group.attributes.values():  # its own and those of its bases
                            kind, annotation = griffe.ParameterKind.keyword_only, key.annotation
                            added = griffe.Parameter(key.name, annotation=annotation, kind=kind, default="...")
                            function.parameters.add(added)
                        told = getdoc(getattr(import_module(module.path), function.name)) or ""
                        function.docstring.value = told.replace("\nExample:\n", "\nExamples:\n")


def _modules(module: griffe.Module) -> Iterator[griffe.Module]:
    yield module
    for its in module.modules.values():
        if not its.is_alias:
            yield from _modules(its)
