"""Write layouts as Matterport3D scans: ``.house`` files, panoramas, connectivity, whole-scene GLBs and navmeshes.

The folders are those of the dataset's download (``<scan>/house_segmentations/<scan>.house`` with
``panorama_to_region.txt``, ``connectivity/<scan>_connectivity.json``, the two category tables), plus Habitat's
``<scan>/<scan>.glb`` (z-up) and ``<scan>/<scan>.navmesh``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import orjson

from condvln.navigation.settings import NavMeshSettings
from condvln.samples.floor_mesh import navmesh_of
from condvln.samples.gibson import version_1
from condvln.samples.glb import Z_UP
from condvln.samples.house import CAMERA_HEIGHT, MPCAT40, REGION_LABELS, categories, house_text, pose, scan_point
from condvln.samples.layout import Layout
from condvln.samples.solid import layout_glb
from condvln.samples.viewpoints import Viewpoints, viewpoints_of

__all__ = ["mp3d_files"]

MAPPING_HEADER: Final = (
    "index", "raw_category", "category", "count", "nyuId", "nyu40id", "eigen13id",
    "nyuClass", "nyu40class", "eigen13class", "ModelNet40", "ModelNet10", "ShapeNetCore55", "synsetoffset",
    "wnsynsetid", "wnsynsetkey", "mpcat40index", "mpcat40",
)  # fmt: skip


def mp3d_files(layouts: Mapping[str, Layout]) -> Iterator[tuple[str, bytes]]:
    """Yield all files of the dataset as (path relative to its root, bytes)."""
    rows = [_mapping_row(i, name, index) for i, (name, index) in enumerate(categories(), start=1)]
    yield "category_mapping.tsv", _table([MAPPING_HEADER, *rows])
    yield "mpcat40.tsv", _table([["mpcat40index", "mpcat40"], *([str(i), name] for i, name in enumerate(MPCAT40))])
    for name, layout in layouts.items():
        views = viewpoints_of(layout)
        ids = [_panorama_id(name, i) for i in range(len(views.places))]
        segmentations = f"{name}/house_segmentations"
        yield f"{segmentations}/{name}.house", house_text(name, layout, views, ids)
        yield f"{segmentations}/panorama_to_region.txt", _panorama_regions(layout, views, ids)
        yield f"connectivity/{name}_connectivity.json", orjson.dumps(_connectivity(views, ids))
        yield f"{name}/{name}.glb", layout_glb(layout, Z_UP)
        yield f"{name}/{name}.navmesh", version_1(navmesh_of(layout, NavMeshSettings())).to_bytes()


def _mapping_row(number: int, name: str, index: int) -> list[str]:
    filled = {"index": str(number), "raw_category": name, "category": name, "count": "1"}
    filled |= {"mpcat40index": str(index), "mpcat40": MPCAT40[index]}
    return [filled.get(column, "") for column in MAPPING_HEADER]


def _table(rows: Sequence[Sequence[str]]) -> bytes:
    return "".join("\t".join(row) + "\n" for row in rows).encode()


def _panorama_id(name: str, number: int) -> str:
    """Return a panorama id of 32 hexadecimal digits, like those of Matterport3D."""
    return hashlib.sha256(f"{name}/{number}".encode()).hexdigest()[:32]


def _panorama_regions(layout: Layout, views: Viewpoints, ids: list[str]) -> bytes:
    order = [room.room_id for room in layout.rooms]
    lines = [
        f"{i} {pano} {order.index(room)} {REGION_LABELS[layout.room_of[room].label]}\n"
        for i, (pano, room) in enumerate(zip(ids, views.rooms, strict=True))
    ]
    return "".join(lines).encode()


def _connectivity(views: Viewpoints, ids: list[str]) -> list[dict[str, Any]]:
    return [
        {
            "image_id": pano,
            "pose": pose(scan_point(place[0], CAMERA_HEIGHT, place[1])),
            "included": True,
            "visible": views.visible[i].tolist(),
            "unobstructed": views.unobstructed[i].tolist(),
            "height": CAMERA_HEIGHT,
        }
        for i, (pano, place) in enumerate(zip(ids, views.places.tolist(), strict=True))
    ]
