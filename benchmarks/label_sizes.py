"""Longest sides of objects by label, over scenes whose labels were made or checked by people.

From them ``condvln/labels/sizes.csv`` was written: the least and the greatest longest side for which the label of a box
in a scan is trusted. The proposal is half of the 5th percentile and 1.5 times the 95th. A person rounded it, widened it
where there are few models, narrowed it where checked scans hold odd boxes (a book of 1 m), and added labels that
only scans have.

``python -m benchmarks.label_sizes DATA`` prints a Markdown table; DATA holds a folder per family.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from condvln.sources.registry import open_source
from schemas.errors import CondVLNError

FAMILIES: Final = ("replicacad", "procthor", "ithor", "gibson")


def longest_sides(root: Path, family: str) -> dict[str, list[float]]:
    """Return the longest side in metres of each object of known extent, by label; each size of a label once."""
    found: dict[str, set[float]] = defaultdict(set)
    source = open_source(family, root)
    for scene_id in source.scene_ids():
        if family == "gibson" and not scene_id.startswith("verified/"):
            continue
        try:
            scene = source.read(scene_id)
        except CondVLNError as error:
            print(f"{family}/{scene_id}: {error}", file=sys.stderr)
            continue
        for item in scene.objects:
            if item.obb is not None:
                found[item.label].add(round(float(2.0 * item.obb.half_extents.max()), 2))
            elif item.box is not None:
                found[item.label].add(round(float((item.box[1] - item.box[0]).max()), 2))
    return {label: sorted(sides) for label, sides in found.items()}


def main(arguments: Sequence[str]) -> None:
    """Print the table."""
    (data,) = arguments
    sides: dict[str, list[float]] = defaultdict(list)
    for family in FAMILIES:
        for label, own in longest_sides(Path(data) / family, family).items():
            sides[label] += own
    print("| label | sizes | least, 5 %, 95 %, greatest | proposal |")
    print("|---|---|---|---|")
    for label, own in sorted(sides.items()):
        low, high = np.percentile(own, [5, 95])
        row = " ".join(f"{side:.2f}" for side in (min(own), low, high, max(own)))
        print(f"| {label} | {len(own)} | {row} | {low / 2:.2f} to {high * 1.5:.2f} |")


if __name__ == "__main__":
    main(sys.argv[1:])
