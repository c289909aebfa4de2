"""Mutants of containers: what a text speaks of is inside something shut, and the text is no longer proven.

The same container standing open is the control: whatever else it changes, it changes there too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from condvln.scene import Scene, SceneObject
from condvln.verify.files import Row
from condvln.verify.surfaces import Shapes
from tests.condvln.verify.mutation import LEAST, problems

CONTAINERS = ("safe", "toolbox", "jewelry box", "clothes dryer", "locker")
"""One of them is not spoken of in any one text."""


def shut_in(scene: Scene, item: SceneObject, label: str, openness: float | None) -> Scene:
    """The scene with a container that has a thing inside, by the word of the source."""
    inside = replace(item, receptacles=("container",))
    box = None if item.box is None else np.array([item.box[0] - 0.02, item.box[1] + 0.1])
    case = SceneObject("container", item.room_id, label, label, item.center, aabb=box, openness=openness)
    others = (o for o in scene.objects if o.object_id != item.object_id)
    return replace(scene, objects=(*others, inside, case))


def mutants(row: Row, scene: Scene) -> Iterator[tuple[str, SceneObject]]:
    """(kind, the object that is shut away); an absent label is borne by a new object."""
    program = row.manifest.program
    for name in sorted({move.object_id for leaf in program.leaves for move in leaf.moves}):
        yield "hidden target", scene.object_of[name]
    for condition in program.conditions:
        if condition.qualifier is not None:
            for name in condition.qualifier.anchor_ids:
                yield "hidden anchor", scene.object_of[name]
        for name in condition.witnesses:
            yield "hidden witness", scene.object_of[name]
        if not condition.truth:
            # For a relation, where the anchor is: so near that it would hold if it were seen.
            beside = condition.qualifier.anchor_ids[0] if condition.qualifier is not None else None
            if beside is not None and condition.qualifier.predicate != "near":
                continue
            place = (
                scene.object_of[beside]
                if beside
                else next(o for o in scene.objects if o.room_id == condition.room.room_id and o.box is not None)
            )
            if place.box is None:
                continue
            yield (
                "absence of what is shut away",
                SceneObject(
                    "mutant",
                    condition.room.room_id,
                    condition.label,
                    condition.label,
                    place.center,
                    aabb=np.array([place.center - 0.01, place.center + 0.01]),
                ),
            )


def said_near(row: Row, scene: Scene, item: SceneObject) -> bool:
    """Whether the text says of a thing like this, of what is near to it, or of what the container would hold besides,
    such as the pan on a stove, that it is near."""
    held = {item.label}
    if item.box is not None:
        low, high = item.box[0] - 0.02, item.box[1] + 0.1  # as in `shut_in`
        held |= {o.label for o in scene.objects if o.box is not None and ((o.box[1] > low) & (o.box[0] < high)).all()}
    program = row.manifest.program
    named = [*program.conditions, *(move for leaf in program.leaves for move in leaf.moves)]
    return any(
        one.qualifier.predicate == "near" and (one.label in held or item.object_id in one.qualifier.anchor_ids)
        for one in named
        if one.qualifier is not None
    )


@pytest.mark.parametrize("every", [6, pytest.param(1, marks=pytest.mark.soak)])
def test_texts_about_what_is_shut_away_are_not_proven(made_export, every: int) -> None:
    tried: Counter[str] = Counter()
    missed: Counter[str] = Counter()
    blamed: Counter[str] = Counter()
    for run in made_export.runs:
        scene = made_export.scenes[run.scene_id]
        shapes = Shapes(scene.root)
        for row in run.rows[::every]:
            assert not problems(row, scene, made_export, shapes)
            text = row.manifest.instruction_text
            label = next(name for name in CONTAINERS if name not in text)
            for kind, item in mutants(row, scene):
                tried[kind] += 1
                missed[kind] += not problems(row, shut_in(scene, item, label, 0.0), made_export, shapes)
                # What is put into something open is seen there, and near to nothing else.
                if kind != "absence of what is shut away" and not said_near(row, scene, item):
                    blamed[kind] += bool(problems(row, shut_in(scene, item, label, 1.0), made_export, shapes))
    print("\n" + ", ".join(f"{tried[kind] - missed[kind]} of {tried[kind]}: {kind}" for kind in sorted(tried)))
    assert set(tried) == {"hidden target", "hidden anchor", "hidden witness", "absence of what is shut away"}
    for kind, count in tried.items():
        assert count - missed[kind] >= LEAST * count, (kind, missed[kind], count)
        assert blamed[kind] <= (1 - LEAST) * count, f"{kind}: an open container was blamed"
