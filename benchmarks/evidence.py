"""Count how much evidence that is visible from the start (O0) has pixels in level views turned through 360° there.

``python -m benchmarks evidence`` makes episodes in real and made scenes and looks from each start in the eight
directions that are 45° apart, with a level camera of 90° × 90°. It prints the share of true conditions with O0 of which
a witness and its anchor have pixels, at 224 × 224 and at 896 × 896, and every condition of which they have none. Real
scenes are read from CONDVLN_REAL_DATA, or from shared/data beside the checkout; CONDVLN_EVIDENCE sets the number of
episodes of a category and scene.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from condvln.evaluation.walker import heading_of
from condvln.samples import make_samples
from condvln.sources.registry import open_source
from condvln.world import World, label_priors, open_world
from schemas.config import CameraConfig, InstructionsConfig
from schemas.evaluation import ManifestEpisode
from schemas.program import CATEGORIES, Condition

REAL: Final = Path(os.environ.get("CONDVLN_REAL_DATA", Path(__file__).resolve().parents[1].parent / "shared" / "data"))
PER_CATEGORY: Final = int(os.environ.get("CONDVLN_EVIDENCE", "16"))
SCANNED: Final = {"ithor": 7, "procthor": 40, "replicacad": 6}
MADE: Final = {"ithor": 4, "procthor": 8, "replicacad": 8}
PIXELS: Final = (224, 896)
DIRECTIONS: Final = 8


def worlds(kind: str, family: str, count: int, made: Path) -> Iterator[World]:
    """Open the first `count` scenes of a real family, or as many that are made in the folder `made`."""
    folder = REAL / family
    if kind == "made":
        folder = made / family
        make_samples(folder, family=family, scenes=count, seed=11)
    source = open_source(family, folder)
    for name in source.scene_ids()[:count]:
        yield open_world(source, name)


def pixels_of(world: World, row: ManifestEpisode, pixels: int) -> dict[int, int]:
    """Return the most pixels that each object has in one of the views from a start, by its number plus 1."""
    camera = CameraConfig(width=pixels, height=pixels, hfov=90.0, max_depth=None, normalized=False)
    most: dict[int, int] = {}
    for turn in range(DIRECTIONS):
        heading = heading_of(row.start_rotation) + turn * 2 * math.pi / DIRECTIONS
        frame = world.renderer.look(camera, row.start_position, heading, rgb=False)
        for number, count in zip(*(found.tolist() for found in np.unique(frame.instance, return_counts=True)),
                                 strict=True):  # fmt: skip
            most[number] = max(most.get(number, 0), count)
    return most


def shown(world: World, condition: Condition, most: dict[int, int]) -> bool:
    """Return whether a witness of a true condition and its anchors have pixels."""
    number = {item.object_id: k + 1 for k, item in enumerate(world.scene.objects)}
    anchors = () if condition.qualifier is None else condition.qualifier.anchor_ids
    return any(all(most.get(number[name], 0) for name in (witness, *anchors)) for witness in condition.witnesses)


def main() -> None:
    """Print the shares, and what is missing."""
    with tempfile.TemporaryDirectory(prefix="evidence") as name:
        count_all(Path(name))


def count_all(made: Path) -> None:
    """Count in real scenes, and in made ones that are written below `made`."""
    total = np.zeros((0, len(PIXELS)), bool)
    wanted = InstructionsConfig(per_category=dict.fromkeys(CATEGORIES, PER_CATEGORY), counterfactual_groups=0)
    for kind, families in (("real", SCANNED), ("made", MADE)):
        for family, count in families.items():
            if kind == "real" and not (REAL / family).is_dir():
                continue
            found: list[list[bool]] = []
            opened = list(worlds(kind, family, count, made))
            priors = label_priors(world.scene for world in opened)
            for world in opened:
                for row in world.episodes(instructions=wanted, priors=priors):
                    asked = [row.program.conditions[e.condition] for e in row.evidence or () if e.observability == "O0"]
                    asked = [condition for condition in asked if condition.truth]
                    if not asked:
                        continue
                    coarse = pixels_of(world, row, PIXELS[0])
                    for condition in asked:
                        seen = [shown(world, condition, coarse)] * 2
                        if not seen[0]:
                            fine = pixels_of(world, row, PIXELS[1])
                            seen[1] = shown(world, condition, fine)
                            tell(world, row, condition, coarse, fine)
                        found.append(seen)
            table = np.array(found, bool).reshape(-1, len(PIXELS))
            total = np.concatenate([total, table])
            report(f"{kind}/{family}", table)
    report("all", total)


def tell(
    world: World, row: ManifestEpisode, condition: Condition, coarse: dict[int, int], fine: dict[int, int]
) -> None:
    """Print a condition that has no pixels."""
    number = {item.object_id: k + 1 for k, item in enumerate(world.scene.objects)}
    anchors = () if condition.qualifier is None else condition.qualifier.anchor_ids
    for name in (*condition.witnesses, *anchors):
        item = world.scene.object_of[name]
        away = np.round(np.asarray(item.center) - np.asarray(row.start_position), 2)
        pixels = coarse.get(number[name], 0), fine.get(number[name], 0)
        size = None if item.box is None else np.round(item.box[1] - item.box[0], 3).tolist()
        place = f"{world.scene.scene_id} {row.episode_id}: {item.label} {name}"
        sys.stdout.write(f"  {place}, size {size}, at {away.tolist()} from the start, pixels {pixels}\n")


def report(name: str, table: np.ndarray) -> None:
    """Print the shares of one family."""
    if len(table):
        shares = ", ".join(f"{count} at {pixels}" for pixels, count in zip(PIXELS, table.sum(axis=0), strict=True))
        sys.stdout.write(f"{name}: {len(table)} true conditions that are O0; with pixels {shares} "
                         f"({100 * table[:, 0].mean():.2f} %)\n")  # fmt: skip
        sys.stdout.flush()


if __name__ == "__main__":
    main()
