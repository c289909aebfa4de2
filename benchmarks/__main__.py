"""Run all benchmarks, or those named, each in its own process: ``python -m benchmarks [NAME …]``.

``python -m benchmarks versus COMMIT`` compares this tree with an earlier commit; it is not run with the others.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def main() -> int:
    """Run the chosen modules one after the other; return the worst exit code."""
    if sys.argv[1:2] == ["versus"]:
        from benchmarks.versus import main as compare

        compare(sys.argv[2:])
        return 0
    known = sorted(
        p.stem for p in Path(__file__).parent.glob("*.py") if not p.stem.startswith("_") and p.stem != "versus"
    )
    chosen = sys.argv[1:] or known
    unknown = sorted(set(chosen) - set(known))
    if unknown:
        print(f"no benchmark {', '.join(unknown)}; there are {', '.join(known)}", file=sys.stderr)
        return 1
    worst = 0
    for name in chosen:
        print(f"\n== {name} ==", flush=True)
        run = subprocess.run([sys.executable, "-c", f"from benchmarks.{name} import main; main()"], check=False)
        worst = max(worst, run.returncode)
    return worst


if __name__ == "__main__":
    sys.exit(main())
