"""Sizes of objects by label, over scenes whose labels were made or checked by people.

From them ``condvln/labels/sizes.csv`` was written: the least and the greatest longest side for which the label of a box
in a scan is trusted. The proposal is half of the 5th percentile and 1.5 times the 95th. A person rounded it, widened it
where there are few models, narrowed it where checked scans hold odd boxes (a book of 1 m), and added labels that
only scans have.

With them ``condvln/labels/usual.csv`` was compared: the sides that one sees of a thing from the side (the longer one of
its footprint, and its height) or, where it lies flat, from above.

``python -m benchmarks.label_sizes DATA`` prints a Markdown table; DATA holds a folder per family.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from condvln.labels.lists import usual_size
from condvln.sources.registry import open_source
from schemas.errors import CondVLNError

F64 = NDArray[np.float64]

FAMILIES: Final = ("replicacad", "procthor", "ithor", "gibson")


def sizes(root: Path, family: str) -> dict[str, set[tuple[float, ...]]]:
    """Return the sides in metres of each object of known extent, by label: the longer and the shorter one of its
    footprint, and its height. Each size of a label is there once.
    """
    found: dict[str, set[tuple[float, ...]]] = defaultdict(set)
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
                up = int(np.abs(item.obb.rotation[1]).argmax())
                sides = 2.0 * np.roll(item.obb.half_extents, 1 - up)
            elif item.box is not None:
                sides = item.box[1] - item.box[0]
            else:
                continue
            high, one, other = (round(float(side), 2) for side in sides[[1, 0, 2]])
            found[item.label].add((max(one, other), min(one, other), high))
    return found


def seen_sides(label: str, known: F64) -> F64:
    """Return the longer and the shorter side (2,) of what one sees of the things with a label: the smallest quarter of
    the models, whose sizes are `known` (n, 3), is not larger.
    """
    seen = known[:, :2] if usual_size(label).flat else known[:, [0, 2]]
    return np.asarray(np.percentile(np.sort(seen, axis=1)[:, ::-1], 25, axis=0))


def main(arguments: Sequence[str]) -> None:
    """Print the table."""
    (data,) = arguments
    known: dict[str, set[tuple[float, ...]]] = defaultdict(set)
    for family in FAMILIES:
        for label, own in sizes(Path(data) / family, family).items():
            known[label] |= own
    print("| label | sizes | longest side: least, 5 %, 95 %, greatest | proposal | seen: 25 % | usual |")
    print("|---|---|---|---|---|---|")
    for label, own in sorted(known.items()):
        table = np.array(sorted(own))
        longest = table.max(axis=1)
        low, high = np.percentile(longest, [5, 95])
        row = " ".join(f"{side:.2f}" for side in (longest.min(), low, high, longest.max()))
        seen, usual = seen_sides(label, table), usual_size(label)
        sides = f"{seen[0]:.2f} × {seen[1]:.2f} | {usual.long:g} × {usual.short:g} {usual.flat}"
        print(f"| {label} | {len(own)} | {row} | {low / 2:.2f} to {high * 1.5:.2f} | {sides} |")


if __name__ == "__main__":
    main(sys.argv[1:])
