"""The one place that parses XML. No document type is taken, so no entity is expanded and no other file is read."""

from xml.etree import ElementTree
from xml.etree.ElementTree import Element

DEEPEST = 50
"""Largest depth of elements in elements."""


def parse_xml(source: str | bytes) -> Element:
    """Parses XML, in the encoding that it declares; returns its root.

    Raises:
        ValueError: If it is not XML, declares a document type, or is nested deeper than `DEEPEST`.
    """
    try:
        return ElementTree.fromstring(source, ElementTree.XMLParser(target=_Elements()))
    except (SyntaxError, LookupError) as error:  # those of the parser, and of unknown encodings
        raise ValueError(str(error)) from None


class _Elements(ElementTree.TreeBuilder):
    """Builds a tree that declares nothing and is not too deep."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Refuses a document type, which entities need."""
        raise ValueError("it declares a document type (<!DOCTYPE>); remove that, and write out its entities")

    def start(self, tag: str, attrs: dict[str, str], /) -> Element:
        """Begins an element."""
        self._depth += 1
        if self._depth > DEEPEST:
            raise ValueError(f"it has elements in elements, more than {DEEPEST} deep")
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> Element:
        """Ends an element."""
        self._depth -= 1
        return super().end(tag)
