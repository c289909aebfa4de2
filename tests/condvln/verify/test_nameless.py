"""Mutants of annotations: a nameless thing that may be what a text says is absent, and one object cut in two."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from condvln.scene import Room, Scene, SceneObject, round_mm
from condvln.verify.files import Row
from condvln.verify.likeness import left_apart
from condvln.verify.predicates import DIRECTIONS
from condvln.verify.referents import SceneReferents
from condvln.verify.surfaces import Shapes
from condvln.verify.words import words
from tests.condvln.verify.mutation import LEAST, problems

AWAY = 1.5
"""Metres from an anchor to a thing in a direction of it."""
WAYS = {"near": (0, 0), **DIRECTIONS}
"""(east, north) of where a thing stands that has a relation to an anchor."""


def with_thing(scene: Scene, room: str, raw: str, centre: np.ndarray, side: float) -> Scene:
    box = round_mm([centre - side / 2, centre + side / 2])
    return replace(scene, objects=(*scene.objects, SceneObject("nameless", room, raw, raw, round_mm(centre), aabb=box)))


def nameless(row: Row, scene: Scene) -> Iterator[tuple[str, Scene]]:
    """(kind, the scene with a thing of no name that may be what the text says is not there)."""
    for condition in row.manifest.program.conditions:
        if condition.truth or condition.definite:
            continue
        least, most = words().objects.get(condition.label, (0.0, 9.0))
        side = min(max(0.3, least), most)
        room = condition.room.room_id
        if condition.qualifier is None:
            place = next(o for o in scene.objects if o.room_id == room and o.box is not None)
            yield "absence of what a nameless thing may be", with_thing(scene, room, "no such type", place.center, side)
        elif condition.qualifier.predicate in WAYS:
            east, north = WAYS[condition.qualifier.predicate]
            step = np.array([east, 0.0, -north]) * AWAY / max(np.hypot(east, north), 1.0)
            place = scene.object_of[condition.qualifier.anchor_ids[0]].center + step
            yield "a relation that a nameless thing may be in", with_thing(scene, room, "no such type", place, side)


def cut(row: Row, scene: Scene) -> Iterator[tuple[str, Scene]]:
    """(kind, the scene of a family annotated by regions, in which a thing of the text is cut at a region's border)."""
    program = row.manifest.program
    named = {move.object_id for leaf in program.leaves for move in leaf.moves}
    named |= {name for c in program.conditions for name in c.witnesses}
    named |= {name for c in program.conditions if c.qualifier for name in c.qualifier.anchor_ids}
    for name in sorted(named):
        item = scene.object_of[name]
        if item.box is None:
            continue
        (x0, y0, z0), (x1, y1, z1) = item.box
        ground = np.array([[x0 - 9, z0 - 9], [x1, z0 - 9], [x1, z1 + 9], [x0 - 9, z1 + 9]])
        own = scene.room_of[item.room_id]
        beyond = replace(
            own, room_id="beyond", polygon=ground + np.array([x1 - x0 + 9, 0.0]), raw_label="Z", label="void"
        )
        rooms = (*(replace(r, polygon=ground) if r is own else r for r in scene.rooms), beyond)
        item = replace(item, aabb=item.box)
        rest = replace(
            item,
            object_id="rest",
            room_id="beyond",
            center=round_mm([x1 + 0.3, (y0 + y1) / 2, (z0 + z1) / 2]),
            aabb=round_mm([[x1 + 0.01, y0, z0], [x1 + 0.6, y1, z1]]),
            obb=None,
            parts=(),
            mesh=(),
        )
        others = (other for other in scene.objects if other.object_id != name)
        yield "a piece of one object", replace(scene, rooms=rooms, objects=(*others, item, rest))


def denies(row: Row) -> bool:
    """Whether a text says that nothing of a label is in a room, near something, or in a direction of it: few do, and
    each is tried.
    """
    conditions = row.manifest.program.conditions
    return any(c.qualifier is None or c.qualifier.predicate in WAYS for c in conditions if not (c.truth or c.definite))


@pytest.mark.parametrize("every", [6, pytest.param(2, marks=pytest.mark.soak)])
def test_texts_about_what_nobody_named_are_not_proven(made_export, every: int) -> None:
    tried: Counter[str] = Counter()
    missed: Counter[str] = Counter()
    for run in made_export.runs:
        scene = made_export.scenes[run.scene_id]
        shapes = Shapes(scene.root)
        for number, row in enumerate(run.rows):
            if number % every and not denies(row):
                continue
            assert not problems(row, scene, made_export, shapes)
            for kind, mutant in nameless(row, scene):
                tried[kind] += 1
                missed[kind] += not problems(row, mutant, made_export, shapes)
            for kind, mutant in cut(row, scene):
                tried[kind] += 1
                # Pieces are looked for in families that are annotated by regions; what is a piece there is one here.
                pieces = left_apart(replace(mutant, family="mp3d"))
                missed[kind] += "rest" not in pieces or len(pieces) < 2
    print("\n" + ", ".join(f"{tried[kind] - missed[kind]} of {tried[kind]}: {kind}" for kind in sorted(tried)))
    assert len(tried) == 3
    for kind, count in tried.items():
        assert count - missed[kind] >= LEAST * count, (kind, missed[kind], count)


def scan(cut_at: float, *, gap: float = 0.0, raise_by: float = 0.0, level: int = 0, warned: bool = False) -> Scene:
    """A refrigerator 0.8 m long over the border of two regions, cut at x = `cut_at`, and a chair."""
    floors = (np.array([[-4, -2], [0, -2], [0, 2], [-4, 2]]), np.array([[0, -2], [4, -2], [4, 2], [0, 2]]))
    rooms = tuple(
        Room(f"r{k}", "g", "garage", level * k, 0.0, 2.5, floor.astype(float), "dataset", True)
        for k, floor in enumerate(floors)
    )

    def box(name: str, room: str, raw: str, low: list[float], high: list[float]) -> SceneObject:
        corners = np.array([low, high])
        return SceneObject(name, room, raw, raw, corners.mean(axis=0), aabb=corners)

    left = box("left", "r0", "refrigerator", [-0.4, 0.0, 0.0], [cut_at, 1.8, 0.7])
    right = box("right", "r1", "refrigerator", [cut_at + gap, raise_by, 0.0], [0.4, 1.8 + raise_by, 0.7])
    chair = box("chair", "r1", "chair", [0.4, 0.0, 0.0], [0.8, 0.9, 0.7])
    scene = Scene("mp3d", "scan", Path(), rooms, (left, right, chair))
    said = type("Warned", (), {"code": "object_cut", "where": "left"})()
    return replace(scene, warnings=(said,)) if warned else scene


@pytest.mark.parametrize(
    ("scene", "pieces"),
    [
        (scan(0.0), {"left", "right"}),
        (scan(0.01, gap=0.01), {"left", "right"}),
        (scan(0.0, gap=0.05), set()),  # farther than a cut leaves
        (scan(0.0, raise_by=0.9), set()),  # one above the other's half
        (scan(0.0, level=1), set()),
        (scan(0.0, warned=True), set()),  # which the source put together of others already
        (replace(scan(0.0), family="gibson"), set()),
    ],
)
def test_pieces_at_the_border(scene: Scene, pieces: set[str]) -> None:
    assert left_apart(scene) == pieces


def test_a_text_about_a_piece_is_not_proven() -> None:
    from condvln.verify.phrases import Named, Phrase
    from schemas.config import Thresholds

    whole = scan(0.0)
    referents = SceneReferents(whole, Thresholds(), 0.3, Shapes(Path()))
    found = referents.thing(Phrase("chair", None, Named("garage", "chair")))
    assert not hasattr(found, "fact"), found
    pieces = referents.thing(Phrase("refrigerator", None, Named("garage", "chair")))
    assert getattr(pieces, "fact", None) == "whole_object"
