"""An extension of Griffe for the site: in docstrings, `Example:` is a section of examples, as `Examples:` is."""

import re
from typing import Any

import griffe


class Examples(griffe.Extension):
    """Renames the section."""

    def on_object(self, *, obj: Any, **_: Any) -> None:
        """Looks at the docstring of one object."""
        if obj.docstring:
            obj.docstring.value = re.sub(r"(?m)^Example:$", "Examples:", obj.docstring.value)
