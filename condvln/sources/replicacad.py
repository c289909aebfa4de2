"""ReplicaCAD, and any other dataset in the form of a Habitat scene dataset.

A scene instance places rigid and articulated templates by name. Labels come from the semantic lexicon, extents from the
GLB files (for articulated bodies, through the links of their URDF), rooms from region annotations. Without region
annotations the apartment is one room.
"""

from __future__ import annotations

import posixpath
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from condvln.labels import vocabulary
from condvln.scene import MeshPart, Room, Scene, SceneObject, SceneWarning, round_mm
from condvln.scene.boxes import aabb_of, oriented_box, rounded_box, transform_points
from condvln.scene.geometry import SceneGeometry
from condvln.scene.meshes import shared_library
from condvln.sources.body import Body, BodyReader
from condvln.sources.input_ledger import InputLedger
from condvln.sources.lexicon import Lexicon, read_descriptors
from condvln.sources.mesh_geometry import assembled_geometry
from condvln.sources.regions import in_rooms, read_regions, side_regions
from condvln.sources.scene_dataset import SceneDataset
from condvln.sources.scene_instance import SceneInstance, read_scene_instance
from condvln.sources.scene_source import Note, SceneSource, SourceOptions
from condvln.sources.source import UNKNOWN_LABEL

__all__ = ["Assembly", "ReplicaCadSource"]

F64 = NDArray[np.float64]

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


class ReplicaCadSource(SceneSource):
    """The scenes of a Habitat scene dataset; raises ConfigError for any other folder."""

    family: ClassVar[str] = "replicacad"

    def __init__(self, root: Path, options: SourceOptions) -> None:
        super().__init__(root, options)
        self._meshes = shared_library(Path(root))
        SceneDataset(self.files)

    def listing(self) -> Iterator[tuple[str, Note]]:
        """See `SceneSource.listing`."""
        dataset = SceneDataset(self.files)
        self.noted(dataset.listing)
        for scene_id, path in dataset.scenes().items():
            yield scene_id, partial(self._assemble, dataset, scene_id, path)

    def scene(self, scene_id: str) -> Scene:
        """Return one scene; see `Source.read`. Shared files are read again, so that corrections take effect."""
        dataset = SceneDataset(self.files)
        path = dataset.scenes().get(scene_id)
        if path is None:
            raise self.not_there(scene_id)
        assembly = self._assemble(dataset, scene_id, path, InputLedger())
        objects = self._objects(assembly.bodies)
        rooms = self._rooms(scene_id, assembly, objects)
        objects, lost = in_rooms(objects, rooms)
        unnamed = {o.room_id for o in objects if o.raw_label == UNKNOWN_LABEL}
        return Scene(
            family=self.family,
            scene_id=scene_id,
            root=self.root,
            # If some object has no label, no absence can be claimed.
            rooms=tuple(replace(r, complete=r.room_id not in unnamed) for r in rooms),
            objects=tuple(sorted(objects, key=lambda o: o.object_id)),
            shipped_navmeshes=assembly.navmeshes,
            stage=assembly.stage,
            warnings=tuple(sorted({*assembly.warnings, *lost}, key=lambda w: (w.code, w.where, w.message))),
        )

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
        if self.options.regions is not None:
            names = [posixpath.basename(scene_id)]
            if instance.stage is not None:
                names.append(posixpath.basename(instance.stage.template))
            regions = side_regions(self.options.regions, names, self.family, ledger) or regions
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
        shaped: list[_Shaped] = []
        bare: dict[int, SceneObject] = {}
        for k, body in enumerate(bodies):
            meshes = [self._meshes.geometry(part.path).vertices for part in body.parts]
            if any(map(len, meshes)):
                shaped.append(_Shaped.of(body, meshes))
            else:
                matrix = body.to_scene(np.zeros(3) if body.com is None else body.com)
                centre = round_mm(matrix[:3, 3])
                item = SceneObject(body.placed.object_id, "", body.raw_label, body.label, centre)
                bare[k] = replace(item, static=body.placed.static)
        extended = iter(_extended(shaped) if shaped else ())
        return [bare[k] if k in bare else next(extended) for k in range(len(bodies))]


@dataclass(frozen=True, eq=False, slots=True)
class _Shaped:
    """A body with the vertices of its meshes.

    parts : its meshes, each with its (4, 4) transform into the scene's frame
    world, local : (n, 3) vertices in the scene's frame, and in that of the first part
    """

    body: Body
    parts: tuple[MeshPart, ...]
    world: F64
    local: F64

    @classmethod
    def of(cls, body: Body, meshes: Sequence[F64]) -> _Shaped:
        """Return the vertices (n, 3) of a body whose `meshes` have vertices (m, 3) in their own frames."""
        own = [transform_points(part.transform, v) for part, v in zip(body.parts, meshes, strict=True) if len(v)]
        com = body.com if body.com is not None else aabb_of(np.concatenate(own)).mean(axis=0)
        matrix = body.to_scene(com)
        parts = tuple(MeshPart(part.path, matrix @ part.transform) for part in body.parts)
        back = np.linalg.inv(parts[0].transform)
        local = [transform_points(back @ part.transform, v) for part, v in zip(parts, meshes, strict=True) if len(v)]
        return cls(body, parts, np.concatenate([transform_points(matrix, v) for v in own]), np.concatenate(local))


def _extended(shaped: Sequence[_Shaped]) -> list[SceneObject]:
    """Return bodies as objects. Their boxes and spheres are computed together, since most have few vertices."""
    sizes = [len(one.world) for one in shaped]
    first = np.cumsum([0, *sizes[:-1]])
    world = np.concatenate([one.world for one in shaped])
    aabbs = round_mm(_boxes(world, first))
    centres = round_mm(aabbs.mean(axis=1))
    away = np.maximum.reduceat(np.linalg.norm(world - np.repeat(centres, sizes, axis=0), axis=1), first)
    radii = (np.ceil(away * 1000) / 1000).tolist()
    extents = round_mm(aabbs[:, 1] - aabbs[:, 0])
    locals_ = _boxes(np.concatenate([one.local for one in shaped]), first)
    found = []
    for k, one in enumerate(shaped):
        obb = oriented_box(locals_[k], one.parts[0].transform)
        found.append(
            SceneObject(
                object_id=one.body.placed.object_id,
                room_id="",
                raw_label=one.body.raw_label,
                label=one.body.label,
                center=centres[k],
                aabb=aabbs[k],
                obb=None if obb is None else rounded_box(obb),
                size=extents[k],
                radius=radii[k],
                mesh=one.parts,
                static=one.body.placed.static,
            )
        )
    return found


def _boxes(points: F64, first: NDArray[np.intp]) -> F64:
    """Return the boxes (b, 2, 3) around groups of points (n, 3); the groups begin at the indices `first` (b,)."""
    return np.stack([np.minimum.reduceat(points, first), np.maximum.reduceat(points, first)], axis=1)


def _whole_scene(objects: Sequence[SceneObject], family: str) -> Room:
    """Return the single room of a scene whose source has no rooms."""
    boxes = np.array([o.aabb for o in objects if o.aabb is not None]).reshape(-1, 2, 3)
    bottoms, tops = boxes[:, 0, 1], boxes[:, 1, 1]
    standing = bottoms[bottoms <= bottoms.min(initial=np.inf) + FLOOR_BAND]
    return Room(
        room_id=WHOLE_SCENE,
        raw_label=WHOLE_SCENE,
        label=vocabulary.room_type(WHOLE_SCENE, family),
        level=0,
        floor_y=float(round_mm(np.median(standing))) if len(boxes) else 0.0,
        ceiling_y=float(tops.max(initial=0.0)),
        polygon=None,
        annotation="scene",
        complete=True,
    )
