"""Read a Habitat scene instance: which templates are placed where, and the label, mesh files and poses of each body."""

from __future__ import annotations

import posixpath
from collections import Counter
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from condvln.arrays import F64
from condvln.formats.json_document import JsonNode
from condvln.labels import vocabulary
from condvln.scene import MeshPart, SceneWarning
from condvln.scene.boxes import placement
from condvln.scene.rotations import asset_frame, from_wxyz, to_matrix
from condvln.sources.scene_dataset import Attribute, Lexicon, SceneDataset, Template
from condvln.sources.source import MAX_OBJECTS, UNKNOWN_LABEL, InputLedger

__all__ = [
    "Body",
    "BodyReader",
    "Placed",
    "SceneInstance",
    "read_scene_instance",
]

Origin = Literal["com", "asset_local"]

MAX_SCALE: Final = 1e3


@dataclass(frozen=True, eq=False, slots=True)
class Placed:
    """A placed object, articulated object or stage.

    template : its template's name as in the file
    translation (3,) metres; rotation (3, 3); scale (3,), applied first
    origin : the point of the body that is at `translation`
    static : it never moves: motion type STATIC, or an articulated body with a fixed base
    """

    object_id: str
    template: str
    translation: NDArray[np.float64]
    rotation: NDArray[np.float64]
    scale: NDArray[np.float64]
    origin: Origin
    static: bool
    node: JsonNode


@dataclass(frozen=True, eq=False, slots=True)
class SceneInstance:
    """The scene's stage, objects and articulated objects in file order, and the names of related files."""

    stage: Placed | None
    objects: tuple[Placed, ...]
    articulated: tuple[Placed, ...]
    navmesh: JsonNode | None
    semantics: JsonNode | None


def read_scene_instance(document: JsonNode) -> SceneInstance:
    """Read the scene of a ``.scene_instance.json`` document.

    Ids are the template's name and a running number in file order (``frl_apartment_chair_01:0``), unless an entry gives
    its own under ``id``.

    Raises
    ------
    FormatError : a type is wrong, a number is not finite, a rotation is zero, or an id is repeated
    """
    document.object()
    default = _origin(document, "com")
    stage = document.get("stage_instance")
    counter: Counter[str] = Counter()
    seen: set[str] = set()

    def placed(key: str) -> tuple[Placed, ...]:
        nodes = document.array(key)
        if len(nodes) > MAX_OBJECTS:
            document.fail(f"{len(nodes)} {key} (at most {MAX_OBJECTS})")
        return tuple(_placed(node, _object_id(node, counter, seen), default) for node in nodes)

    return SceneInstance(
        stage=None if stage is None else _placed(stage, "stage", default),
        objects=placed("object_instances"),
        articulated=placed("articulated_object_instances"),
        navmesh=document.get("navmesh_instance"),
        semantics=document.get("semantic_scene_instance"),
    )


def _object_id(node: JsonNode, counter: Counter[str], seen: set[str]) -> str:
    own = node.get("id")
    if own is not None:
        name = own.text()
        if not name.strip():
            own.fail("the id is empty")
    else:
        template = posixpath.basename(node["template_name"].text())
        name = f"{template}:{counter[template]}"
        counter[template] += 1
    if name in seen:
        node.fail(f"two objects have the id {name!r}")
    seen.add(name)
    return name


def _placed(node: JsonNode, object_id: str, default: Origin) -> Placed:
    if not node["template_name"].text().strip():
        node["template_name"].fail("the name is empty")
    translation, rotation = node.get("translation"), node.get("rotation")
    motion, fixed = node.get("motion_type"), node.get("fixed_base")
    return Placed(
        object_id=object_id,
        template=node["template_name"].text(),
        translation=np.zeros(3) if translation is None else translation.vector(3),
        rotation=np.eye(3) if rotation is None else _rotation(rotation),
        scale=_scale(node),
        origin=_origin(node, default),
        static=(motion is not None and motion.text().lower() == "static") or (fixed is not None and fixed.boolean()),
        node=node,
    )


def _rotation(node: JsonNode) -> NDArray[np.float64]:
    try:
        return to_matrix(from_wxyz(node.vector(4)))
    except ValueError as error:
        node.fail(str(error))


def _scale(node: JsonNode) -> NDArray[np.float64]:
    scale = np.ones(3)
    uniform, own = node.get("uniform_scale"), node.get("non_uniform_scale")
    if own is not None:
        scale = scale * own.vector(3, MAX_SCALE)
    if uniform is not None:
        scale = scale * uniform.number(MAX_SCALE)
    if not (np.abs(scale) > 0).all():
        node.fail("a scale is zero")
    return scale


def _origin(node: JsonNode, default: Origin) -> Origin:
    own = node.get("translation_origin")
    if own is None:
        return default
    named = own.text().lower()
    if named in ("com", "asset_local"):
        return "com" if named == "com" else "asset_local"
    return default


_UP, _FRONT = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0])
_MESH_SUFFIX: Final = ".glb"


@dataclass(frozen=True, eq=False, slots=True)
class Body:
    """One body of a scene before its geometry is read.

    parts : mesh files, each with its (4, 4) transform into the body's frame, scale included; empty if the extent is
        unknown
    com : (3,) the point of the body that is at the placement's position; None for the centre of its box
    """

    placed: Placed
    raw_label: str
    label: str
    parts: tuple[MeshPart, ...]
    com: F64 | None = field(default_factory=lambda: np.zeros(3))

    def to_scene(self, com: F64) -> F64:
        """Return the (4, 4) transform from the body's frame to the scene's. `com` (3,) is the body's centre of mass; it
        is used only if the scene file gives the position of the centre of mass.
        """
        back = placement(translation=-com if self.placed.origin == "com" else None)
        matrix: F64 = placement(self.placed.rotation, self.placed.translation) @ back
        return matrix


class BodyReader:
    """Resolves the templates of one scene, records the files it reads, and collects warnings."""

    def __init__(self, dataset: SceneDataset, lexicon: Lexicon, family: str, ledger: InputLedger) -> None:
        self.dataset = dataset
        self.lexicon = lexicon
        self.family = family
        self.ledger = ledger
        self._listed = vocabulary.raw_labels(family)
        self.warnings: list[SceneWarning] = []

    def stage(self, placed: Placed) -> tuple[MeshPart, ...]:
        """Return the mesh files of the stage in the scene's frame; empty, with a warning, if they are missing."""
        template = self._template("stages", placed)
        render = None if template is None else template.get("render_asset")
        if template is None or render is None:
            return ()
        path = self._mesh_path(render)
        if path is None:
            self._warn("missing_stage_mesh", placed.object_id, f"{self._path(render)} is not there: walls unknown")
            return ()
        own = placement(scale=self._scale(template) * placed.scale) @ placement(self._frame(template))
        return (MeshPart(path, placement(placed.rotation, placed.translation) @ own),)

    def rigid(self, placed: Placed) -> Body:
        """Return the body of an entry of ``object_instances``."""
        template = self._template("objects", placed)
        if template is None:
            return Body(placed, UNKNOWN_LABEL, vocabulary.canonical(UNKNOWN_LABEL, self.family), ())
        raw, label = self._labels(template, placed)
        scale = self._scale(template) * placed.scale
        path = self._rigid_mesh(template, placed)
        com = template.get("COM")
        return Body(
            placed,
            raw,
            label,
            () if path is None else (MeshPart(path, placement(scale=scale) @ placement(self._frame(template))),),
            com=None if com is None else com.node.vector(3) * scale,
        )

    def articulated(self, placed: Placed) -> Body:
        """Return the body of an entry of ``articulated_object_instances``, with all joints at zero."""
        template = self._template("articulated_objects", placed)
        if template is None:
            return Body(placed, UNKNOWN_LABEL, vocabulary.canonical(UNKNOWN_LABEL, self.family), ())
        raw, label = self._labels(template, placed)
        pose = placed.node.get("initial_joint_pose")
        if pose is not None and pose.value not in ([], {}):
            self._warn("joint_pose_ignored", placed.object_id, "initial_joint_pose is not applied: all joints at zero")
        return Body(placed, raw, label, self._links(template, placed))

    def _links(self, template: Template, placed: Placed) -> tuple[MeshPart, ...]:
        urdf = template.get("urdf_filepath")
        path = template.path if urdf is None else self._path(urdf)
        if not path.endswith(".urdf") or not self.dataset.has(path):
            self._warn("missing_template", placed.object_id, f"{path} is not a URDF file that is there: extent unknown")
            return ()
        self.ledger.file(path)
        folder = posixpath.dirname(path)
        where = str(self.dataset.root.folder / path)
        parts = []
        for link in self.dataset.links(path):
            mesh = self.dataset.root.join(folder, link.filename, where=where, place=f"link {link.link}")
            if not mesh.endswith(_MESH_SUFFIX) or not self.dataset.has(mesh):
                self._warn("missing_mesh", placed.object_id, f"{mesh} is not a GLB file that is there: extent unknown")
                return ()
            self.ledger.file(mesh)
            parts.append(MeshPart(mesh, placement(scale=placed.scale) @ link.transform))
        if not parts:
            self._warn("missing_mesh", placed.object_id, f"{path} has no visual meshes: extent unknown")
        return tuple(parts)

    def _rigid_mesh(self, template: Template, placed: Placed) -> str | None:
        """Return the path of the body's render mesh, else the path of the body's collision mesh; None if both are
        missing.
        """
        render, collision = template.get("render_asset"), template.get("collision_asset")
        if render is None and template.path.endswith(_MESH_SUFFIX):
            self.ledger.file(template.path)
            return template.path
        named = "no render mesh" if render is None else self._path(render)
        path = None if render is None else self._mesh_path(render)
        if path is not None:
            return path
        path = None if collision is None else self._mesh_path(collision)
        if path is None:
            self._warn("missing_mesh", placed.object_id, f"{named} is not there: extent unknown")
        else:
            self._warn("collision_mesh_used", placed.object_id, f"{named} is not there: extent from {path}")
        return path

    def _labels(self, template: Template, placed: Placed) -> tuple[str, str]:
        """Return the raw and the canonical label of a placed template. If the vocabulary lists the template's own name,
        the canonical label comes from that name.
        """
        semantic = template.get("semantic_id")
        raw = None if semantic is None else self.lexicon.name(semantic.node.integer(), self.ledger)
        if raw is None and template.handle in self._listed:
            raw = template.handle
        if raw is None:
            what = "no semantic_id" if semantic is None else f"semantic_id {semantic.node.value} is not a class"
            self._warn("unlabelled_object", placed.object_id, f"{template.path}: {what}")
            raw = UNKNOWN_LABEL
        return raw, vocabulary.canonical(template.handle if template.handle in self._listed else raw, self.family)

    def _template(self, kind: str, placed: Placed) -> Template | None:
        template, meant = self.dataset.template(kind, placed.template, self.ledger)
        if template is None:
            self._warn("missing_template", placed.object_id, f"no template {placed.template!r} among the {kind}")
        elif meant > 1:
            message = f"{placed.template!r} fits {meant} templates, {template.path or template.handle} is taken"
            self._warn("ambiguous_template", placed.object_id, message)
        return template

    def _mesh_path(self, asset: Attribute) -> str | None:
        """Return the path of a GLB named by an attribute; None if it does not exist or is not a GLB."""
        path = self._path(asset)
        if not path.endswith(_MESH_SUFFIX) or not self.dataset.has(path):
            return None
        self.ledger.file(path)
        return path

    def _path(self, attribute: Attribute) -> str:
        node = attribute.node
        return self.dataset.root.join(attribute.folder, node.text(), where=node.where, place=node.place)

    def _frame(self, template: Template) -> F64:
        """Return the (3, 3) rotation from the asset's own axes to Habitat's."""
        up, front = template.get("up"), template.get("front")
        own_up = _UP if up is None else up.node.vector(3)
        own_front = _FRONT if front is None else front.node.vector(3)
        try:
            return asset_frame(own_up, own_front)
        except ValueError as error:
            node: JsonNode = (up or front).node  # type: ignore[union-attr]
            node.fail(str(error))

    def _scale(self, template: Template) -> F64:
        scale = template.get("scale")
        return np.ones(3) if scale is None else scale.node.vector(3, MAX_SCALE)

    def _warn(self, code: str, where: str, message: str) -> None:
        self.warnings.append(SceneWarning(code, where, message))
