"""Mutants of scenes in which a box can't tell what a text says: a look-alike, a second box, a thing that has fallen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from condvln.scene import MeshPart, Scene, SceneObject, round_mm
from condvln.verify.files import Row
from condvln.verify.surfaces import Shapes
from tests.condvln.verify.mutation import LEAST, problems


def put(scene: Scene, item: SceneObject) -> Scene:
    others = (other for other in scene.objects if other.object_id != item.object_id)
    return replace(scene, objects=(*others, item))


def shifted(item: SceneObject, name: str, raw: str, by: np.ndarray) -> SceneObject:
    """A box of the same size elsewhere."""
    assert item.box is not None
    return SceneObject(name, item.room_id, raw, raw, round_mm(item.center + by), aabb=round_mm(item.box + by))


def tilted(item: SceneObject, degrees: float) -> SceneObject:
    """Its box stays, its model lies."""
    turn, angle = np.eye(4), np.radians(degrees)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return replace(item, mesh=(MeshPart(item.mesh[0].path, turn @ item.mesh[0].transform),))


def mutants(row: Row, scene: Scene) -> Iterator[tuple[str, Scene]]:
    """(kind, the scene in which something that the text names is not surely what it says)."""
    program = row.manifest.program
    stops = {move.object_id: move.qualifier for leaf in program.leaves for move in leaf.moves}
    anchors = {name for c in program.conditions if c.qualifier for name in c.qualifier.anchor_ids}
    witnesses = {c.witnesses[0] for c in program.conditions if len(c.witnesses) == 1}
    for name in sorted({*stops, *anchors, *witnesses}):
        item = scene.object_of[name]
        if item.box is None:
            continue
        if name in anchors or (name in stops and stops[name] is None):
            yield "look-alike", put(scene, shifted(item, "alike", "no such type", np.array([4.0, 0.1, 4.0])))
        if name in stops and stops[name] is not None:
            second = shifted(item, "second", item.raw_label, np.array([0.05, 0.05, 0.05]))
            yield "second box", put(scene, second)
        floor = scene.room_of[item.room_id].floor_y
        if len(item.mesh) == 1 and item.box[0, 1] - floor <= 0.1:
            yield "fallen", put(scene, tilted(item, 25.0))
            yield "upright", put(scene, tilted(item, 15.0))


@pytest.mark.parametrize("every", [12, pytest.param(3, marks=pytest.mark.soak)])
def test_texts_about_what_a_box_cannot_tell_are_not_proven(made_export, every: int) -> None:
    tried: Counter[str] = Counter()
    caught: Counter[str] = Counter()
    for run in made_export.runs:
        scene = made_export.scenes[run.scene_id]
        shapes = Shapes(scene.root)
        for row in run.rows[::every]:
            assert not problems(row, scene, made_export, shapes)
            for kind, mutant in mutants(row, scene):
                tried[kind] += 1
                found = problems(row, mutant, made_export, shapes)
                # A tilted model has other surfaces, so that it may be near to other things.
                caught[kind] += "referent_upright" in found if kind == "upright" else bool(found)
    print("\n" + ", ".join(f"{caught[kind]} of {tried[kind]}: {kind}" for kind in sorted(tried)))
    assert set(tried) == {"look-alike", "second box", "fallen", "upright"}
    for kind, count in tried.items():
        assert caught[kind] == 0 if kind == "upright" else caught[kind] >= LEAST * count, (kind, caught[kind], count)
