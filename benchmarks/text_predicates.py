"""Number of true and false statements of each predicate of text, by source.

Counts (label, anchors' labels) pairs over the scenes of a folder per family, as conditions are asked: anchors alone in
their label, larger or fixed, and every rival decided. A predicate may be a condition of a source where both truths
have at least `LEAST_PAIRS` different pairs over at least `LEAST_SCENES` scenes.

``python -m benchmarks.text_predicates DATA [FAMILY...]`` prints a Markdown table; DATA holds a folder per family.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from condvln.instructions.predicates import ASKED, PREDICATES
from condvln.instructions.referents import Referents
from condvln.instructions.statements import statement_truths
from condvln.labels import vocabulary
from condvln.relations import relate_scene, text_facts
from condvln.sources.registry import open_source
from schemas.config import SamplingConfig, Thresholds
from schemas.errors import CondVLNError
from schemas.program import Predicate

FAMILIES: Final = ("replicacad", "procthor", "ithor", "gibson", "mp3d")
LEAST_PAIRS: Final = 20
LEAST_SCENES: Final = 5

Counts = dict[tuple[Predicate, bool], tuple[set[tuple[str, str]], set[str]]]


def count(root: Path, family: str) -> tuple[int, Counts, dict[Predicate, int]]:
    """Return scenes, (pairs, scenes) by (predicate, truth), and by predicate the number of ways to tell an object from
    its rivals."""
    thresholds, size = Thresholds(), SamplingConfig().anchor_size
    found: Counts = defaultdict(lambda: (set(), set()))
    qualifiers: dict[Predicate, int] = defaultdict(int)
    source, scenes = open_source(family, root), 0
    for scene_id in source.scene_ids():
        try:
            scene = source.read(scene_id)
        except CondVLNError as error:
            print(f"{family}/{scene_id}: {error}", file=sys.stderr)
            continue
        scenes += 1
        for room_id, relations in relate_scene(scene, thresholds).items():
            facts = text_facts(relations, thresholds)
            room = scene.room_of[room_id]
            referents = Referents.of(room, scene.arrays(room_id), facts, vocabulary, size, family)
            own = referents.arrays.labels
            for ways in referents.qualifications:
                for predicate in {way.predicate for way in ways}:
                    qualifiers[predicate] += 1
            for truths in statement_truths(referents, vocabulary):
                keys = truths.anchor_keys(own)
                for truth, table in ((True, truths.true), (False, truths.false)):
                    pairs, where = found[truths.predicate, truth]
                    cells = np.argwhere(table).tolist()
                    pairs.update((truths.labels[row], keys[column]) for row, column in cells)
                    if cells:
                        where.add(scene_id)
    return scenes, found, qualifiers


def may_be_a_condition(found: Counts, predicate: Predicate) -> bool:
    """Whether both truths vary enough that neither the words nor the scene reveal them."""
    return all(
        len(found[predicate, truth][0]) >= LEAST_PAIRS and len(found[predicate, truth][1]) >= LEAST_SCENES
        for truth in (True, False)
    )


def main(arguments: Sequence[str]) -> None:
    """Print the table."""
    data, *families = arguments
    for family in families or FAMILIES:
        scenes, found, qualifiers = count(Path(data) / family, family)
        print(f"\n{family}, {scenes} {'scene' if scenes == 1 else 'scenes'}\n")
        print("| predicate | true pairs (scenes) | false pairs (scenes) | things distinguished by it | condition |")
        print("|---|---|---|---|---|")
        for predicate in PREDICATES:
            cells = ["–", "–"]
            if predicate in ASKED:
                cells = [
                    f"{len(pairs):,} ({len(where)})" for pairs, where in (found[predicate, t] for t in (True, False))
                ]
            asked = "yes" if predicate in ASKED and may_be_a_condition(found, predicate) else "no"
            print(f"| {predicate} | {cells[0]} | {cells[1]} | {qualifiers[predicate]:,} | {asked} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
