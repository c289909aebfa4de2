"""What holds of made datasets of every family: same bytes everywhere, and, read back, the same apartments."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from condvln.labels import vocabulary
from condvln.samples import FAMILIES, FORMS, Layout, make_layouts, make_samples
from condvln.samples.catalogue import native_labels
from condvln.samples.thor_metadata import FLOOR_PLANS
from condvln.scene import Scene
from condvln.sources.registry import open_source

SCENES, SEED = 3, 21

# What a format does not hold: rooms of other types (iTHOR), rooms at all (RoboTHOR).
ROOMS_OF = {"ithor": set(FLOOR_PLANS)}


@pytest.fixture(scope="module")
def layouts() -> dict[str, Layout]:
    return make_layouts(SCENES, SEED)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("families")
    for family in FORMS:
        make_samples(base / family, family=family, scenes=SCENES, seed=SEED)
    return base


Scenes = dict[str, list[Scene]]


def read_from(folder: Path) -> Scenes:
    """All scenes of each family; none has a fault."""
    found: Scenes = {}
    for family in FAMILIES:
        source = open_source(family, folder / family)
        assert all(handle.fault is None for handle in source.handles()), family
        found[family] = [source.read(handle.scene_id) for handle in source.handles()]
    return found


@pytest.fixture(scope="module")
def scenes(folder: Path) -> Scenes:
    return read_from(folder)


def _digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def test_bytes_repeat_in_another_process_with_another_hash_seed(folder: Path, tmp_path: Path) -> None:
    code = (
        "import sys, pathlib; from condvln.samples import FORMS, make_samples\n"
        "for family in reversed(FORMS):\n"
        f"    make_samples(pathlib.Path(sys.argv[1]) / family, family, {SCENES}, {SEED})"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True, env={**os.environ, "PYTHONHASHSEED": "77"})
    assert _digests(tmp_path) == _digests(folder)


@pytest.mark.parametrize("family", sorted(set(FAMILIES) - {"procthor"}))
def test_files_of_a_scene_don_t_depend_on_how_many_are_made(family: str, folder: Path, tmp_path: Path) -> None:
    make_samples(tmp_path, family=family, scenes=SCENES - 1, seed=SEED)
    few, many = _digests(tmp_path), _digests(folder / family)
    assert {path for path in few if few[path] != many[path]} <= {
        "made.scene_dataset_config.json",
        "Per_Scene_Region_Weighted_Votes.csv",
    }


@pytest.mark.parametrize("family", ["procthor", "ithor", "robothor", "gibson", "mp3d"])
def test_native_words_mean_the_same_thing(family: str) -> None:
    column = {"gibson": "gibson", "mp3d": "mp3d"}.get(family, "ai2thor")
    for label, native in native_labels().items():
        assert vocabulary.canonical(getattr(native, column), family) == vocabulary.canonical(label, "replicacad")


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_read_back_they_are_the_same_apartments(family: str, scenes: Scenes, layouts: dict[str, Layout]) -> None:
    """Each object's room type, label and box come back, up to where the format puts its origin."""
    in_text = {s.scene_id: [o for o in s.objects if vocabulary.fit_for_text(o.label)] for s in scenes[family]}
    read = Counter(
        (room.label if family != "robothor" else "", o.label, *_shape(o.aabb))
        for s in scenes[family]
        for room in s.rooms
        for o in in_text[s.scene_id]
        if o.room_id == room.room_id
    )
    made = Counter(
        (layout.room_of[p.room_id].label if family != "robothor" else "", _label(p.label), *_shape(p.aabb))
        for layout in layouts.values()
        for p in layout.furniture
        if layout.room_of[p.room_id].label in ROOMS_OF.get(family, {layout.room_of[p.room_id].label})
    )
    assert read == made


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_read_back_the_distances_between_objects_are_the_same(
    family: str, scenes: Scenes, layouts: dict[str, Layout]
) -> None:
    """Frames may differ by a translation; turned, mirrored or mixed up axes would show in directions."""
    offsets = []
    made = [{room.room_id: layout.in_room(room.room_id) for room in layout.rooms} for layout in layouts.values()]
    known = {
        tuple(sorted((_label(p.label), *_shape(p.aabb)) for p in pieces)): pieces
        for rooms in made
        for pieces in (rooms.values() if family != "robothor" else [tuple(p for r in rooms.values() for p in r)])
    }
    for scene in scenes[family]:
        for room in scene.rooms:
            objects = [o for o in scene.objects if o.room_id == room.room_id and vocabulary.fit_for_text(o.label)]
            pieces = known[tuple(sorted((o.label, *_shape(o.aabb)) for o in objects))]
            key = lambda label, aabb: (label, *_shape(aabb), *np.round(aabb[0], 3))  # noqa: E731
            mine = np.array([p.aabb for p in sorted(pieces, key=lambda p: key(_label(p.label), p.aabb))])
            theirs = np.array([o.aabb for o in sorted(objects, key=lambda o: key(o.label, o.aabb))])
            shift = theirs - mine
            np.testing.assert_allclose(shift, np.broadcast_to(shift[:1, :1], shift.shape), atol=1.5e-3)
            offsets.append((scene.scene_id, shift[0, 0]))
    for scene_id, shift in offsets:
        same = [other for name, other in offsets if name == scene_id]
        np.testing.assert_allclose(same, np.broadcast_to(shift, (len(same), 3)), atol=1e-3)


def _label(label: str) -> str:
    return vocabulary.canonical(label, "replicacad")


def _shape(aabb: np.ndarray) -> tuple[float, ...]:
    """What no translation changes: size, and height above the floor."""
    low, high = np.round(aabb, 3)
    return (*np.round(high - low, 3).tolist(), float(low[1]))
