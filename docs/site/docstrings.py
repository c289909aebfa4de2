"""Extension of Griffe that converts the docstrings of this project to numpydoc.

We write ``name : what it is`` in a section, since the types are in the signature; numpydoc has a type after the colon.
"""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension, Object

_SECTION = re.compile(r"^(Parameters|Attributes|Returns|Yields|Raises)\n-{3,}\n", re.MULTILINE)
_ITEM = re.compile(r"^(\*{0,2}[A-Za-z_][\w., *]*) : ?(.*)$")
_ROLE = re.compile(r":(?:func|class|meth|mod|data|attr):`~?([^`]*)`")
_CODE = re.compile(r"``([^`]+)``")


def numpydoc(text: str) -> str:
    """Return a docstring with each item's description on its own lines, and without Sphinx roles."""
    text = _CODE.sub(r"`\1`", _ROLE.sub(lambda found: f"`{found.group(1).rpartition('.')[2]}`", text))
    pieces = _SECTION.split(text)
    out = [pieces[0]]
    for name, body in zip(pieces[1::2], pieces[2::2], strict=True):
        lines = []
        for line in body.split("\n"):
            found = _ITEM.match(line)
            lines += [found.group(1), f"    {found.group(2)}"] if found else [line]
        out.append(f"{name}\n{'-' * len(name)}\n" + "\n".join(lines))
    return "".join(out)


class HouseStyle(Extension):
    """Converts each docstring when it is loaded."""

    def on_object(self, *, obj: Object, **kwargs: Any) -> None:
        """Called once for each module, class, function and attribute."""
        if obj.docstring:
            obj.docstring.value = numpydoc(obj.docstring.value)
