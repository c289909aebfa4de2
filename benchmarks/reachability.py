"""AI2-THOR rooms drawn from metadata: precision and recall of the 0.25 m grid against the simulator's reachable
positions.

Run as ``python benchmarks/reachability.py [FOLDER]``; a line per floor plan, with room for the hand and without, for
the real floor plans of the folder (else of ``CONDVLN_REAL_DATA``), or for made ones where there are none.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from condvln.navigation.reachability import reachability
from condvln.samples.maker import make_samples
from condvln.sources.registry import open_source


def main() -> None:
    """Print the table."""
    named = sys.argv[1] if len(sys.argv) > 1 else os.environ.get("CONDVLN_REAL_DATA", "")
    folder = Path(named) / "ithor" if named and (Path(named) / "ithor").is_dir() else Path(named)
    if named and any(folder.glob("*-reachable.npy")):
        compare(folder)
        return
    print("no real floor plans (set CONDVLN_REAL_DATA): made ones, whose agent has no hand")
    with tempfile.TemporaryDirectory() as made:
        make_samples(Path(made), "ithor", 6)
        compare(Path(made))


def compare(folder: Path) -> None:
    """Print one line per floor plan of a folder that also holds its reachable positions."""
    source = open_source("ithor", folder)
    print(f"{'plan':14s} {'reachable':>9s}   body only: P     R      with hand: P     R      seconds")
    for handle in source.handles():
        file = folder / f"{handle.scene_id}-reachable.npy"
        if not file.is_file():
            continue
        positions = np.load(file, allow_pickle=False) * np.array([1.0, -1.0])
        geometry = source.geometry(source.read(handle.scene_id))
        if geometry is None:
            print(f"{handle.scene_id:14s} no floor")
            continue
        begun = time.perf_counter()
        body, both = reachability(geometry, positions, hand=False), reachability(geometry, positions)
        spent = time.perf_counter() - begun
        print(
            f"{handle.scene_id:14s} {both.reachable:9d}        {body.precision:.3f} {body.recall:.3f}"
            f"           {both.precision:.3f} {both.recall:.3f}      {spent:.2f}"
        )


if __name__ == "__main__":
    main()
