"""Read a Habitat scene instance: which templates are placed, and where."""

from __future__ import annotations

import posixpath
from collections import Counter
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from condvln.formats.json_document import JsonNode
from condvln.scene.quaternions import from_wxyz, to_matrix
from condvln.sources.source import MAX_OBJECTS

__all__ = ["Placed", "SceneInstance", "read_scene_instance"]

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
