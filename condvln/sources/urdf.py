"""Read articulated bodies: the visual meshes of a URDF's links, in the body's root frame with all joints at zero."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring
from numpy.typing import NDArray

from condvln.formats.json_document import MAX_COORDINATE
from condvln.scene.boxes import placement
from condvln.scene.rotations import rotation_rpy
from schemas.errors import FormatError

__all__ = ["MAX_URDF_BYTES", "LinkMesh", "read_urdf"]

MAX_URDF_BYTES: Final = 16 << 20
_REMEDY = "Take the file from its dataset again, or correct the element"
_SEPARATORS = re.compile(r"[,\s]+")


@dataclass(frozen=True, eq=False, slots=True)
class LinkMesh:
    """A visual mesh: file name as in the URDF, its link, and the (4, 4) transform to the body's root frame."""

    link: str
    filename: str
    transform: NDArray[np.float64]


def read_urdf(data: bytes, where: str) -> tuple[LinkMesh, ...]:
    """Return the visual meshes of all links, in file order.

    Numbers may be separated by blanks or commas (ReplicaCAD has ``scale="1, 1, 1"``).

    Raises
    ------
    FormatError : not XML, or XML with entities; a joint refers to an unknown link; the links do not form a tree
    """
    root = _parse(data, where)
    links = {}
    for link in root.findall("link"):
        name = _attribute(link, "name", where)
        if name in links:
            raise FormatError(f"two links are named {name!r}", where=where, place="link", remedy=_REMEDY)
        links[name] = link
    poses = _link_poses(root, set(links), where)
    meshes: list[LinkMesh] = []
    for name, link in links.items():
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None:
                scale = _numbers(mesh, "scale", (1.0, 1.0, 1.0), where, name)
                own = _origin(visual, where, name) @ placement(scale=scale)
                meshes.append(LinkMesh(name, _attribute(mesh, "filename", where), poses[name] @ own))
    return tuple(meshes)


def _parse(data: bytes, where: str) -> Element:
    if len(data) > MAX_URDF_BYTES:
        raise FormatError(f"the file is larger than {MAX_URDF_BYTES} bytes", where=where, remedy=_REMEDY)
    try:
        root: Element = fromstring(data, forbid_dtd=True)
    except ParseError as error:
        raise FormatError(f"not XML: {error}", where=where, remedy=_REMEDY) from None
    except DefusedXmlException as error:
        raise FormatError(f"a document type or entity is not allowed ({error})", where=where, remedy=_REMEDY) from None
    except (ValueError, LookupError, RecursionError) as error:
        raise FormatError(f"unreadable XML: {error}", where=where, remedy=_REMEDY) from None
    if root.tag != "robot":
        raise FormatError(f"the root element is <{root.tag}>, not <robot>", where=where, remedy=_REMEDY)
    return root


def _link_poses(root: Element, links: set[str], where: str) -> dict[str, NDArray[np.float64]]:
    """Return the (4, 4) transform of each link to the root frame, with joints at zero."""
    joints: dict[str, tuple[str, NDArray[np.float64]]] = {}
    children: dict[str, list[str]] = {}
    for joint in root.findall("joint"):
        name = _attribute(joint, "name", where)
        ends = [_link_of(joint, end, name, where) for end in ("parent", "child")]
        for end in ends:
            if end not in links:
                raise FormatError(
                    f"the joint refers to an unknown link {end!r}", where=where, place=f"joint {name}", remedy=_REMEDY
                )
        if ends[1] in joints:
            raise FormatError(
                f"the link {ends[1]!r} is the child of two joints", where=where, place=name, remedy=_REMEDY
            )
        joints[ends[1]] = (ends[0], _origin(joint, where, f"joint {name}"))
        children.setdefault(ends[0], []).append(ends[1])
    poses = {link: np.eye(4) for link in sorted(links) if link not in joints}
    waiting = list(poses)
    while waiting:
        parent = waiting.pop()
        for child in children.get(parent, ()):
            poses[child] = poses[parent] @ joints[child][1]
            waiting.append(child)
    if len(poses) != len(links):
        lost = sorted(links - set(poses))
        raise FormatError(f"the links {lost} form a cycle", where=where, place="joint", remedy=_REMEDY)
    return poses


def _link_of(joint: Element, end: str, name: str, where: str) -> str:
    element = joint.find(end)
    if element is None:
        raise FormatError(f"the joint has no <{end}>", where=where, place=f"joint {name}", remedy=_REMEDY)
    return _attribute(element, "link", where)


def _origin(element: Element, where: str, place: str) -> NDArray[np.float64]:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    roll, pitch, yaw = _numbers(origin, "rpy", (0.0, 0.0, 0.0), where, place)
    return placement(rotation_rpy(roll, pitch, yaw), _numbers(origin, "xyz", (0.0, 0.0, 0.0), where, place))


def _attribute(element: Element, name: str, where: str) -> str:
    value = element.get(name)
    if not value:
        raise FormatError(f"the attribute {name!r} is missing", where=where, place=f"<{element.tag}>", remedy=_REMEDY)
    return value


def _numbers(
    element: Element, name: str, default: tuple[float, float, float], where: str, place: str
) -> tuple[float, float, float]:
    text = element.get(name)
    if text is None:
        return default
    try:
        values = [float(part) for part in _SEPARATORS.split(text.strip())]
        x, y, z = values
    except ValueError:
        values = []
    if not values or not all(math.isfinite(v) and abs(v) <= MAX_COORDINATE for v in values):
        raise FormatError(f"{name}={text!r:.60} is not three finite numbers", where=where, place=place, remedy=_REMEDY)
    return x, y, z
