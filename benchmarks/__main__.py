"""Run all benchmarks, or those named, each in its own process: ``python -m benchmarks [NAME …]``.

``ladder``, ``evidence`` and ``workers``, which take long, are run by name only. So is
``python -m benchmarks versus COMMIT``, which compares this tree with an earlier commit.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Final

BY_NAME: Final = {"evidence", "ladder", "workers"}
"""Benchmarks that are not run with the others."""


def known() -> list[str]:
    """Return the names of all benchmarks but ``versus``, which needs a commit."""
    paths = Path(__file__).parent.glob("*.py")
    return sorted(path.stem for path in paths if not path.stem.startswith("_") and path.stem != "versus")


def chosen(names: list[str]) -> list[str]:
    """Return the benchmarks to run, given those that are named."""
    return names or [name for name in known() if name not in BY_NAME]


def main() -> int:
    """Run the chosen modules one after the other; return the worst exit code."""
    if sys.argv[1:2] == ["versus"]:
        from benchmarks.versus import main as compare

        compare(sys.argv[2:])
        return 0
    names = chosen(sys.argv[1:])
    unknown = sorted({*names} - {*known()})
    if unknown:
        print(f"no benchmark {', '.join(unknown)}; there are {', '.join(known())}", file=sys.stderr)
        return 1
    worst = 0
    for name in names:
        print(f"\n== {name} ==", flush=True)
        run = subprocess.run([sys.executable, "-c", f"from benchmarks.{name} import main; main()"], check=False)
        worst = max(worst, run.returncode)
    return worst


if __name__ == "__main__":
    sys.exit(main())
