"""ReplicaCAD, HSSD, and any other dataset in the form of a Habitat scene dataset.

A scene instance places rigid and articulated templates by name. Labels come from the semantic lexicon, extents from the
GLB files (for articulated bodies, through the links of their URDF), rooms from region annotations. Without region
annotations the apartment is one room.
"""

from __future__ import annotations

import posixpath
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from condvln.formats.csv_table import csv_columns
from condvln.labels import vocabulary
from condvln.scene import MeshPart, Room, Scene, SceneObject, SceneWarning, round_mm
from condvln.scene.boxes import aabb_of, oriented_box, rounded_box, transform_points
from condvln.scene.meshes import shared_library
from condvln.scene.scene import SceneGeometry
from condvln.sources.regions import in_rooms, made_room, read_regions
from condvln.sources.scene_dataset import Lexicon, SceneDataset, Template, read_descriptors
from condvln.sources.scene_instance import Body, BodyReader, Placed, SceneInstance, read_scene_instance
from condvln.sources.scene_source import Note, Source, SourceOptions
from condvln.sources.solids import assembled_geometry
from condvln.sources.source import UNKNOWN_LABEL, InputLedger

__all__ = [
    "Assembly",
    "HssdSource",
    "ReplicaCadSource",
]


WHOLE_SCENE: Final = "apartment"
"""Id and label of the single room of a scene without region annotations."""

FLOOR_BAND: Final = 0.15
"""Metres. Objects whose bottom is within this of the lowest one stand on the floor; some (a door leaf) extend below
it.
"""


@dataclass(frozen=True, eq=False)
class Assembly:
    """The parts of a scene as listed in its files, before any mesh is placed."""

    bodies: list[Body]
    stage: tuple[MeshPart, ...]
    regions: tuple[Room, ...]
    navmeshes: tuple[str, ...]
    warnings: list[SceneWarning]


class ReplicaCadSource(Source):
    """The scenes of a Habitat scene dataset; raises ConfigError for any other folder."""

    family: ClassVar[str] = "replicacad"

    def __init__(self, root: Path, options: SourceOptions) -> None:
        super().__init__(root, options)
        self._meshes = shared_library(Path(root))
        SceneDataset(self.files)

    def listing(self) -> Iterator[tuple[str, Note]]:
        """See `Source.listing`."""
        dataset = SceneDataset(self.files)
        self.noted(dataset.listing)
        for scene_id, path in dataset.scenes().items():
            yield scene_id, partial(self._assemble, dataset, scene_id, path)

    def scene(self, scene_id: str) -> Scene:
        """Return one scene; see `Source.read`. Shared files are read again, so that corrections take effect."""
        dataset = SceneDataset(self.files)
        path = self.path_of(scene_id, dataset.scenes())
        assembly = self._assemble(dataset, scene_id, path, InputLedger())
        objects = self._objects(assembly.bodies)
        rooms = self._rooms(scene_id, assembly, objects)
        objects, lost = in_rooms(objects, rooms)
        unnamed = {o.room_id for o in objects if o.raw_label == UNKNOWN_LABEL}
        # If some object has no label, no absence can be claimed.
        rooms = tuple(replace(r, complete=r.room_id not in unnamed) for r in rooms)
        return self.made(scene_id, rooms, objects, [*assembly.warnings, *lost], assembly.navmeshes, assembly.stage)

    def geometry(self, scene: Scene) -> SceneGeometry | None:
        """Return the meshes of the stage and of all objects; see `Source.geometry`. None if the stage's mesh is
        missing.
        """
        return assembled_geometry(self._meshes, scene)

    def _assemble(self, dataset: SceneDataset, scene_id: str, path: str, ledger: InputLedger) -> Assembly:
        ledger.file(path)
        instance = read_scene_instance(dataset.document(path))
        lexicon, annotated = read_descriptors(dataset, posixpath.basename(scene_id), instance.semantics, ledger)
        reader = self.body_reader(dataset, lexicon, ledger)
        stage = () if instance.stage is None else reader.stage(instance.stage)
        bodies = [reader.rigid(p) for p in instance.objects] + [reader.articulated(p) for p in instance.articulated]
        ledger.objects = len(bodies)
        navmeshes, said = self._navmeshes(dataset, posixpath.basename(scene_id), instance, ledger)
        regions = () if annotated is None else read_regions(annotated[1], "dataset", self.family)
        names = [scene_id] if instance.stage is None else [scene_id, instance.stage.template]
        regions = self.drawn_rooms([*map(posixpath.basename, names)], ledger) or regions
        ledger.rooms = len(regions) or 1
        return Assembly(bodies, stage, regions, navmeshes, [*reader.warnings, *said])

    def body_reader(self, dataset: SceneDataset, lexicon: Lexicon, ledger: InputLedger) -> BodyReader:
        """Return the reader of one scene's bodies."""
        return BodyReader(dataset, lexicon, self.family, ledger)

    def _rooms(self, scene_id: str, assembly: Assembly, objects: Sequence[SceneObject]) -> tuple[Room, ...]:
        """Return the rooms of a scene before objects are assigned: its regions, else one room for the whole scene."""
        return assembly.regions or (_whole_scene(objects, self.family),)

    def _navmeshes(
        self, dataset: SceneDataset, scene_name: str, instance: SceneInstance, ledger: InputLedger
    ) -> tuple[tuple[str, ...], list[SceneWarning]]:
        """Return possible paths of the navmesh (see `shipped_navmeshes`), and a warning if the scene names an unknown
        navmesh.
        """
        named = instance.navmesh or dataset.default("scene_instances", "navmesh_instance")
        handles = [scene_name] if named is None else [named.text(), scene_name]
        configured: list[str] = []
        warnings: list[SceneWarning] = []
        for handle in handles:
            entry = dataset.entry("navmesh_instances", handle)
            if entry is not None:
                ledger.entry(dataset.config_path, f"navmesh_instances.{handle}", entry.value)
                configured.append(self.files.join("", entry.text(), where=entry.where, place=entry.place))
            elif named is not None and handle == named.text():
                message = f"the dataset names no navmesh {handle!r}; one of the scene's own name is looked for"
                warnings.append(SceneWarning("navmesh_handle_unknown", "navmesh", message))
        return self.shipped_navmeshes(scene_name, ledger, configured), warnings

    def _objects(self, bodies: Sequence[Body]) -> list[SceneObject]:
        """Return bodies as objects with their geometry. The objects have no room yet."""
        return [self._object(body) for body in bodies]

    def _object(self, body: Body) -> SceneObject:
        meshes = [self._meshes.geometry(part.path).vertices for part in body.parts]
        if not any(map(len, meshes)):
            matrix = body.to_scene(np.zeros(3) if body.com is None else body.com)
            item = SceneObject(body.placed.object_id, "", body.raw_label, body.label, round_mm(matrix[:3, 3]))
            return replace(item, static=body.placed.static)
        own = [transform_points(part.transform, v) for part, v in zip(body.parts, meshes, strict=True) if len(v)]
        com = body.com if body.com is not None else aabb_of(np.concatenate(own)).mean(axis=0)
        matrix = body.to_scene(com)
        parts = tuple(MeshPart(part.path, matrix @ part.transform) for part in body.parts)
        back = np.linalg.inv(parts[0].transform)
        local = [transform_points(back @ part.transform, v) for part, v in zip(parts, meshes, strict=True) if len(v)]
        world = np.concatenate([transform_points(matrix, v) for v in own])
        aabb = round_mm(aabb_of(world))
        centre = round_mm(aabb.mean(axis=0))
        obb = oriented_box(aabb_of(np.concatenate(local)), parts[0].transform)
        return SceneObject(
            object_id=body.placed.object_id,
            room_id="",
            raw_label=body.raw_label,
            label=body.label,
            center=centre,
            aabb=aabb,
            obb=None if obb is None else rounded_box(obb),
            radius=float(np.ceil(np.linalg.norm(world - centre, axis=1).max() * 1000) / 1000),
            mesh=parts,
            static=body.placed.static,
        )


def _whole_scene(objects: Sequence[SceneObject], family: str) -> Room:
    """Return the single room of a scene whose source has no rooms."""
    boxes = np.array([o.aabb for o in objects if o.aabb is not None]).reshape(-1, 2, 3)
    bottoms, tops = boxes[:, 0, 1], boxes[:, 1, 1]
    standing = bottoms[bottoms <= bottoms.min(initial=np.inf) + FLOOR_BAND]
    heights = float(np.median(standing)) if len(boxes) else 0.0, float(tops.max(initial=0.0))
    return made_room(family, WHOLE_SCENE, WHOLE_SCENE, heights, None, annotation="scene")


TABLE: Final = "semantics/objects.csv"
MAX_TABLE_BYTES: Final = 64 << 20
"""Size limit in bytes of the table of models; the released one has 4.4 MB."""

OPENINGS: Final = "objects/openings/"
OPENING: Final = "opening"
"""Raw label of templates in the folder of openings, which have no category."""


class HssdSource(ReplicaCadSource):
    """The scenes of HSSD (Habitat Synthetic Scenes Dataset, ``hssd-hab``); raises ConfigError for a folder without a
    scene dataset.

    Labels are in ``semantics/objects.csv``: the column ``id`` is the name of a model's template, ``main_category`` its
    category. A model that is not in the table has the semantic class of its configuration. Templates in
    ``objects/openings/`` have neither and are doors or windows.
    """

    family: ClassVar[str] = "hssd"

    def body_reader(self, dataset: SceneDataset, lexicon: Lexicon, ledger: InputLedger) -> BodyReader:
        """Return the reader of the scene's bodies, which knows the categories of the models."""
        categories: Mapping[str, str] = {}
        if dataset.has(TABLE):
            data = dataset.root.read(TABLE, MAX_TABLE_BYTES)
            categories = _categories(data, str(Path(self.root) / TABLE))
        return _HssdBodyReader(dataset, lexicon, self.family, ledger, categories)


class _HssdBodyReader(BodyReader):
    def __init__(
        self,
        dataset: SceneDataset,
        lexicon: Lexicon,
        family: str,
        ledger: InputLedger,
        categories: Mapping[str, str],
    ) -> None:
        super().__init__(dataset, lexicon, family, ledger)
        self._categories = categories

    def _labels(self, template: Template, placed: Placed) -> tuple[str, str]:
        raw = self._categories.get(template.handle)
        if self._categories:
            self.ledger.entry(TABLE, template.handle, raw)
        if raw is None and template.get("semantic_id") is None and template.path.startswith(OPENINGS):
            raw = OPENING
        if raw is None:
            return super()._labels(template, placed)
        return raw, vocabulary.canonical(raw, self.family)


@lru_cache(maxsize=2)
def _categories(data: bytes, where: str) -> Mapping[str, str]:
    """Return the category of each model by its name. Models without a category are left out.

    Raises
    ------
    FormatError : the table is not text in UTF-8, or lacks a column
    """
    rows = csv_columns(data, ("id", "main_category"), where)
    return {name: category for name, category in rows if name and category}
