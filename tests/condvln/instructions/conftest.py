"""Made-up scenes: boxes of real labels at random places, and their facts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from condvln.instructions import LabelPriors, ProgramSampler
from condvln.instructions.degeneracy import degeneracies
from condvln.labels import vocabulary
from condvln.relations import TextFacts, relate_scene, text_facts
from condvln.scene import Room, RoomArrays, Scene, SceneObject, round_mm
from schemas.config import Thresholds
from schemas.program import CATEGORIES, Condition, ObjectRef, Program, Qualifier, RoomRef
from tests.condvln.instructions.made_sampler import made_sampler

T = Thresholds(sector_within=20.0)
"""Compass words at any distance, since the boxes of a made room stand anywhere: what is said of them is the paper's."""

HOUSE = ("kitchen", "living room", "bedroom", "bedroom", "bathroom")

LABELS = {
    "kitchen": ("refrigerator", "sink", "stove", "stool", "table", "chair", "microwave", "plate", "trash can", "lamp"),
    "living room": (
        "sofa",
        "television",
        "coffee table",
        "armchair",
        "chair",
        "lamp",
        "plant",
        "picture",
        "rug",
        "book",
    ),
    "bedroom": ("bed", "nightstand", "lamp", "wardrobe", "desk", "chair", "pillow", "picture", "dresser", "laptop"),
    "bathroom": ("toilet", "sink", "bathtub", "mirror", "towel", "trash can", "cabinet", "plant"),
    "apartment": (
        "sofa",
        "bed",
        "table",
        "chair",
        "stool",
        "lamp",
        "sink",
        "refrigerator",
        "plant",
        "desk",
        "television",
        "bicycle",
        "cabinet",
        "picture",
        "rug",
        "trash can",
        "bench",
        "wardrobe",
    ),
}

LACKING = 2
"""Labels typical of a room that it lacks, so that rooms of one type differ and absence can be claimed."""

SceneMaker = Callable[..., Scene]


def made_scene(
    seed: int,
    rooms: Sequence[str] = HOUSE,
    objects: int = 18,
    *,
    side: float = 5.0,
    complete: bool = True,
    repeats: float = 0.3,
) -> Scene:
    """Rooms of `side` metres in a row, each with `objects` boxes of labels typical of it; some labels repeat."""
    rng = np.random.default_rng(seed)
    made: list[SceneObject] = []
    for k, label in enumerate(rooms):
        names = list(rng.permutation(LABELS[label])[:-LACKING])
        while len(names) < objects:
            names.append(str(rng.choice(names[:3] if rng.random() < repeats else names)))
        for j, name in enumerate(names[:objects]):
            size = rng.uniform(0.2, 1.2, 3)
            centre = np.array([k * (side + 1.0), 0.0, 0.0]) + rng.uniform(0.0, side, 3) * [1.0, 0.3, 1.0]
            box = round_mm(np.array([centre - size / 2, centre + size / 2]))
            made.append(
                SceneObject(f"o{k}_{j:02}", f"r{k}", str(name), str(name), round_mm(box.mean(axis=0)), aabb=box)
            )
    return Scene(
        family="made",
        scene_id=f"made_{seed}",
        root=Path("."),
        rooms=tuple(
            Room(f"r{k}", label, label, 0, 0.0, 2.5, None, "scene" if len(rooms) == 1 else "dataset", complete)
            for k, label in enumerate(rooms)
        ),
        objects=tuple(made),
    )


@pytest.fixture(scope="session")
def make_scene() -> SceneMaker:
    """The maker of scenes: (seed, rooms, objects, ...) → Scene."""
    return made_scene


FactsMaker = Callable[[Scene], dict[str, TextFacts]]


def facts_of(scene: Scene) -> dict[str, TextFacts]:
    """Facts fit for text of all rooms of a scene."""
    return {room_id: text_facts(relations, T) for room_id, relations in relate_scene(scene, T).items()}


@pytest.fixture(scope="session")
def facts_maker() -> FactsMaker:
    """Scene → facts by room id."""
    return facts_of


@pytest.fixture(scope="session")
def sampled() -> list[tuple[Scene, dict[str, TextFacts], ProgramSampler, list[Program]]]:
    """Two houses and two apartments with their facts, sampler and programs, all categories."""
    kinds = [(HOUSE, 14), (HOUSE, 12), (("apartment",), 30), (("apartment",), 26)]
    scenes = [made_scene(seed, rooms, n) for seed, (rooms, n) in enumerate(kinds)]
    priors = LabelPriors.merged(LabelPriors.of_scene(scene, T, 0.3) for scene in scenes)
    wanted = dict.fromkeys(CATEGORIES, 6)
    found = []
    for scene in scenes:
        facts = facts_of(scene)
        sampler = made_sampler(scene, facts, priors.bits(scene, 0.05), per_category=wanted, candidates=10)
        found.append((scene, facts, sampler, [p for c in CATEGORIES for p in sampler.candidates(c)]))
    return found


def _words(label: str) -> set[str]:
    return set(vocabulary.overlapping(label))


def _in_sight(arrays: RoomArrays) -> list[bool]:
    """Whether people would think of each object by itself: it is not in something shut, nor a shelf or a drawer whose
    box is half inside that of other furniture.
    """
    found = []
    for item in arrays.objects:
        part = False
        for other in arrays.objects if item.label in ("shelf", "drawer") else ():
            if other.box is None or item.box is None or other.label in ("shelf", "drawer"):
                continue
            own, its = (float(np.prod(x.box[1] - x.box[0])) for x in (item, other))  # type: ignore[index]
            shared = np.minimum(item.box[1], other.box[1]) - np.maximum(item.box[0], other.box[0])
            inside = float(np.prod(np.maximum(shared, 0.0))) >= 0.5 * own > 0.0
            part |= inside and its > own and vocabulary.fit_for_text(other.label)
        found.append(not item.hidden and not part)
    return found


def _room_fits(ref: RoomRef, scene: Scene) -> list[str]:
    """Ids of the rooms that a room's name fits."""
    rooms = [r.room_id for r in scene.rooms if r.label in vocabulary.overlapping_rooms(ref.label)]
    if scene.single_room:
        return [scene.rooms[0].room_id]
    if ref.anchor_label is None:
        return rooms
    return [r for r in rooms if any(o.room_id == r and o.label in _words(ref.anchor_label) for o in scene.objects)]


def status_of(qualifier: Qualifier, arrays: RoomArrays, facts: TextFacts):
    """(n,) status of a qualifier for each object of the room; its anchors are alone in their labels."""
    sight = np.array(_in_sight(arrays), dtype=bool)
    seen = [x for x, there in zip(arrays.labels, sight, strict=True) if there]
    for label in qualifier.anchor_labels:
        assert sum(x in _words(label) for x in seen) == 1
    anchors = [arrays.object_ids.index(name) for name in qualifier.anchor_ids]
    rival = np.array([[x in _words(y) or y in _words(x) for x in arrays.labels] for y in arrays.labels])
    rival &= sight & sight[:, None]
    np.fill_diagonal(rival, False)
    if not anchors:
        return facts.sizes(rival)[qualifier.predicate]
    if qualifier.predicate == "closest to":
        return facts.closest(rival)[0][:, anchors[0]]
    if len(anchors) == 2:
        return facts.between(np.array([anchors]))[0][:, 0]
    return facts.status[qualifier.predicate][:, anchors[0]]


def _object_fits(ref: ObjectRef, scene: Scene, facts) -> list[str]:
    """Ids of the objects in sight that a name may fit, anything in the dead zone included."""
    arrays = scene.arrays(ref.room.room_id)
    seen = [(i, label) for i, (label, there) in enumerate(zip(arrays.labels, _in_sight(arrays), strict=True)) if there]
    fits = [i for i, label in seen if label in _words(ref.label)]
    if ref.qualifier is not None:
        assert len(fits) > 1, "a qualifier must be needed"
        status = status_of(ref.qualifier, arrays, facts[ref.room.room_id])
        assert status[arrays.object_ids.index(ref.object_id)] == 1
        fits = [i for i in fits if status[i] != -1]
    return [arrays.object_ids[i] for i in fits]


def _truth_of(condition: Condition, scene: Scene, facts) -> tuple[bool | None, tuple[str, ...]]:
    """Truth and witnesses of a condition; None where margins, or what is hidden, don't allow to tell."""
    arrays = scene.arrays(condition.room.room_id)
    meant = [i for i, label in enumerate(arrays.labels) if label in _words(condition.label)]
    sight = _in_sight(arrays)
    exact = [i for i in meant if arrays.labels[i] == condition.label and sight[i]]
    true, false = exact, not meant
    if condition.qualifier is not None:
        status = status_of(condition.qualifier, arrays, facts[condition.room.room_id])
        true = [i for i in exact if status[i] == 1]
        false = bool(exact) and all(status[i] == -1 for i in meant)
    return (True if true else False if false else None), tuple(arrays.object_ids[i] for i in true)


def proven(program: Program, scene: Scene, facts: dict[str, TextFacts]) -> None:
    """Every name fits its thing alone, every condition has its truth, and no rule is broken."""
    refs = [move for leaf in program.leaves for move in leaf.moves]
    for room in {r.room for r in refs} | {c.room for c in program.conditions}:
        assert _room_fits(room, scene) == [room.room_id]
    for ref in refs:
        assert _object_fits(ref, scene, facts) == [ref.object_id]
    for condition in program.conditions:
        truth, witnesses = _truth_of(condition, scene, facts)
        assert truth == condition.truth
        if scene.family in ("gibson", "mp3d"):
            # A thing on the border of two rooms is no witness; test_doubtful_things.py has these rules.
            assert {*condition.witnesses} <= {*witnesses}
            assert bool(condition.witnesses) == condition.truth
        else:
            assert condition.witnesses == witnesses
    assert degeneracies(program, vocabulary) == ()
    assert len({leaf.goal.label for leaf in program.leaves}) == len(program.leaves)


@pytest.fixture(scope="session")
def prove() -> Callable[[Program, Scene, dict[str, TextFacts]], None]:
    """Proves a program on its scene, by going through objects one by one."""
    return proven
