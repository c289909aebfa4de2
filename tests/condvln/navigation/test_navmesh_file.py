"""Navmesh files: byte-identical round trips, and one clear error for every way a file can lie."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from condvln.navigation.navmesh_file import (
    FILE_HEADER,
    SETTINGS_BLOCK,
    TILE_ENTRY,
    NavMeshFile,
    parse_navmesh,
    read_navmesh,
)
from condvln.navigation.polygon_tile import tile_of_polygons
from condvln.navigation.settings import NavMeshSettings
from condvln.navigation.tile import DETAIL_MESH, HEADER, LINK, POLYGON, link_tile
from schemas.errors import FormatError, MissingFileError

TILE_AT = FILE_HEADER.itemsize + SETTINGS_BLOCK.itemsize + TILE_ENTRY.itemsize
GRID = [[x, 0.1 * ((x * z) % 3), z] for z in range(5) for x in range(5)]
SQUARES = [[5 * z + x, 5 * z + x + 1, 5 * z + x + 6, 5 * z + x + 5] for z in range(4) for x in range(4)]


@pytest.fixture
def made() -> NavMeshFile:
    """Sixteen squares of one metre, some of them sloping."""
    settings = NavMeshSettings(agent_radius=0.18, agent_height=0.88)
    return NavMeshFile.of_tile(tile_of_polygons(GRID, SQUARES, settings), settings)


def real_navmeshes(real_data: Path) -> list[Path]:
    files = sorted(real_data.rglob("*.navmesh"))
    assert len(files) >= 150
    return files


def test_reading_and_writing_gives_back_every_byte(real_data: Path) -> None:
    versions = set()
    for file in real_navmeshes(real_data):
        data = file.read_bytes()
        navmesh = parse_navmesh(data, where=file)
        assert navmesh.to_bytes() == data, file
        versions.add(navmesh.version)
    assert versions == {1, 2}


def test_links_and_flags_are_those_that_habitat_saved(real_data: Path) -> None:
    """Every real file holds live links: made anew from the neighbours, they are the same bytes."""
    for file in real_navmeshes(real_data):
        tile = read_navmesh(file).tile
        blank = tile.polys.copy()
        blank["first_link"] = 0
        fresh = link_tile(tile.with_parts(polys=blank, links=np.zeros_like(tile.links)))
        assert fresh.to_bytes() == tile.to_bytes(), file


def test_zero_area_polygons_are_disabled_as_habitat_does(real_data: Path) -> None:
    """Flags reset to walkable come back as they were saved: disabled exactly where there is no area."""
    disabled = 0
    for file in real_navmeshes(real_data):
        tile = read_navmesh(file).tile
        enabled = tile.polys.copy()
        enabled["flags"] = 1
        assert link_tile(tile.with_parts(polys=enabled)).to_bytes() == tile.to_bytes(), file
        disabled += int((tile.polys["flags"] == 4).sum())
    assert disabled > 0


def test_settings_survive_both_ways(made: NavMeshFile, tmp_path: Path) -> None:
    (tmp_path / "a.navmesh").write_bytes(made.to_bytes())
    again = read_navmesh(tmp_path / "a.navmesh")
    assert again.settings == made.settings == NavMeshSettings(agent_radius=0.18, agent_height=0.88)
    assert again.settings.fits(0.18, 0.88, 0.2, 45.0)


def test_version_1_tells_sizes_through_its_tile(made: NavMeshFile) -> None:
    old = replace(made, version=1, settings=None)
    again = parse_navmesh(old.to_bytes())
    assert len(old.to_bytes()) == len(made.to_bytes()) - SETTINGS_BLOCK.itemsize
    assert again.settings is None
    assert again.known_settings == NavMeshSettings(agent_radius=0.18, agent_height=0.88)
    assert again.to_bytes() == old.to_bytes()


def test_a_padding_byte_is_kept_and_not_believed(made: NavMeshFile) -> None:
    odd = replace(made, static_objects_byte=118)
    again = parse_navmesh(odd.to_bytes())
    assert again.settings.include_static_objects is False
    assert again.to_bytes() == odd.to_bytes()


def test_missing_and_unreadable(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="navmesh file does not exist"):
        read_navmesh(tmp_path / "none.navmesh")
    with pytest.raises(FormatError, match="can't be read"):
        read_navmesh(tmp_path)


def put(offset: int, layout: str, *values: float) -> Callable[[bytes], bytes]:
    """A change of the bytes at ``offset``."""

    def change(data: bytes) -> bytes:
        packed = struct.pack("<" + layout, *values)
        return data[:offset] + packed + data[offset + len(packed) :]

    return change


def of_header(field: str, layout: str, *values: float) -> Callable[[bytes], bytes]:
    """A change of a field of the tile header."""
    return put(TILE_AT + HEADER.fields[field][1], layout, *values)


VERTS_AT = TILE_AT + HEADER.itemsize
POLYS_AT = VERTS_AT + 12 * len(GRID)
DETAIL_AT = POLYS_AT + len(SQUARES) * POLYGON.itemsize + 4 * len(SQUARES) * LINK.itemsize
TRIS_AT = DETAIL_AT + len(SQUARES) * DETAIL_MESH.itemsize
NODES_AT = TRIS_AT + 4 * 2 * len(SQUARES)
NAN, INF = float("nan"), float("inf")

LIES: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "empty": (lambda data: b"", "0 bytes are left"),
    "cut in the file header": (lambda data: data[:30], "bytes are left"),
    "cut in the settings": (lambda data: data[:60], "bytes are left"),
    "cut in the tile": (lambda data: data[:-5], "bytes, but .* are left"),
    "one byte more": (lambda data: data + b"\0", "bytes, but .* are left"),
    "false magic": (put(0, "i", 1), "not a Habitat navmesh"),
    "version 3": (put(4, "i", 3), "version 3"),
    "no tile": (put(8, "i", 0), "0 tiles"),
    "many tiles": (put(8, "i", 2**31 - 1), "tiles"),
    "grid of tiles": (put(32, "i", 16), "single-tile"),
    "NaN origin": (put(12, "f", NAN), "file header 0: .*NaN"),
    "flat grid": (put(24, "f", 0.0), "no extent"),
    "few references": (put(36, "i", 3), "can address 3"),
    "NaN setting": (put(40, "f", NAN), "settings"),
    "odd switch": (put(92, "B", 7), "filter switches"),
    "tile reference 0": (put(96, "I", 0), "reference"),
    "tile reference inside": (put(96, "I", 17), "reference"),
    "tile size": (put(100, "i", -1), "claims -1"),
    "tile magic": (of_header("magic", "i", 0), "not a Detour tile"),
    "tile version": (of_header("version", "i", 6), "not a Detour tile"),
    "tile of a grid": (of_header("x", "i", 1), "tiled mesh"),
    "2^31 polygons": (of_header("poly_count", "i", 2**31 - 1), "detail mesh"),
    "2^31 polygons and meshes": (
        lambda data: of_header("poly_count", "i", 2**31 - 1)(of_header("detail_mesh_count", "i", 2**31 - 1)(data)),
        "2147483647 records",
    ),
    "negative vertices": (of_header("vert_count", "i", -1), "empty"),
    "2^31 vertices": (of_header("vert_count", "i", 2**31 - 1), "2147483647 records"),
    "2^31 links": (of_header("max_link_count", "i", 2**31 - 1), "2147483647 records"),
    "no links": (of_header("max_link_count", "i", 0), "detail mesh|polygon|bounding|left over"),
    "no tree": (of_header("bv_node_count", "i", 0), "tree is missing"),
    "off-mesh connections": (of_header("off_mesh_con_count", "i", 1), "off-mesh"),
    "NaN bound": (of_header("bmin", "f", NAN), "tile header 3: .*NaN"),
    "bounds upside down": (of_header("bmin", "f", 99.0), "lower bound"),
    "infinite cells": (of_header("bv_quant_factor", "f", INF), "cells per metre"),
    "no cells": (of_header("bv_quant_factor", "f", 0.0), "cells per metre"),
    "NaN vertex": (put(VERTS_AT + 12 * 3 + 4, "f", NAN), "vertices 3: .*NaN"),
    "far vertex": (put(VERTS_AT, "f", 1e9), "vertices 0: .*1000 km"),
    "vertex not there": (put(POLYS_AT + 4, "H", len(GRID)), "polygon 0: it refers to a missing vertex"),
    "neighbour not there": (
        put(POLYS_AT + 2 * POLYGON.itemsize + 16, "H", len(SQUARES) + 1),
        "polygon 2: it refers to a missing neighbour",
    ),
    "two corners": (put(POLYS_AT + 30, "B", 2), "polygon 0: the polygon does not have 3 to 6"),
    "seven corners": (put(POLYS_AT + 30, "B", 7), "polygon 0: the polygon does not have 3 to 6"),
    "off-mesh polygon": (put(POLYS_AT + 31, "B", 0x40), "polygon 0: it is not a ground"),
    "no detail triangles": (put(DETAIL_AT + 9, "B", 0), "detail mesh 0"),
    "detail triangles not there": (put(DETAIL_AT + 4, "I", 2**32 - 1), "detail mesh 0: it refers to missing triangles"),
    "detail triangles shared": (put(DETAIL_AT + 9, "B", 3), "detail mesh: .*claim"),
    "detail vertices not there": (put(DETAIL_AT + 8, "B", 1), "detail mesh 0: it refers to missing vertices"),
    "detail corner not there": (put(TRIS_AT + 4 * 5, "B", 4), "detail mesh 2: a triangle"),
    "leaf not there": (put(NODES_AT + 12, "i", len(SQUARES)), "bounding volume node 0"),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_lie_is_told_with_its_place(made: NavMeshFile, tmp_path: Path, lie: str) -> None:
    change, message = LIES[lie]
    file = tmp_path / "bad.navmesh"
    file.write_bytes(change(made.to_bytes()))
    with pytest.raises(FormatError, match=message) as caught:
        read_navmesh(file)
    assert caught.value.where == str(file)
    assert caught.value.place
    assert "rebuild" in caught.value.remedy


def test_tile_portals_without_a_neighbour_tile_are_walls(made: NavMeshFile) -> None:
    """An edge marked as leading to another tile leads nowhere in a single tile, as in Detour."""
    file = put(POLYS_AT + 16, "H", 0x8001)(made.to_bytes())
    tile = parse_navmesh(file).tile
    assert tile.neighbours[0, 0] == -1
    assert parse_navmesh(file).to_bytes() == file
