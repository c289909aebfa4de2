"""Write ``examples/tutorial.ipynb`` from ``docs/tutorial.md``: ``python examples/make_notebook.py``.

Prose and code are the tutorial's, a cell each.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
_FENCE = re.compile(r"```python\n(.*?)```\n?", re.DOTALL)


def notebook(tutorial: str) -> str:
    """Return the notebook's JSON."""
    cells: list[dict[str, Any]] = []
    for number, part in enumerate(_FENCE.split(tutorial)):
        text = part.strip("\n")
        if not text:
            continue
        lines = text.splitlines(keepends=True)
        if number % 2:
            cell = {"cell_type": "code", "execution_count": None, "metadata": {}, "outputs": [], "source": lines}
        else:
            cell = {"cell_type": "markdown", "metadata": {}, "source": lines}
        cells.append({"id": f"cell-{len(cells):02d}", **cell})
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    document = {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    (ROOT / "examples" / "tutorial.ipynb").write_text(
        notebook((ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")), encoding="utf-8"
    )
