"""HM3D with semantics: instances, boxes and rooms from painted meshes, in each way to store the paint."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from condvln.export.vlnce import scene_file
from condvln.scene import Scene
from condvln.sources.painted_mesh import CELL, FINE
from condvln.sources.registry import open_source
from schemas.errors import ConfigError, InputError, MissingFileError
from tests.condvln.sources.painted_scan import NAME, SCAN, box, channels, linear, votes, write

FLOOR, BED, LAMP, WALL, PICTURE, BLACK = 0x8A6B4C, 0x1F03A2, 0xFE0210, 0x777777, 0x05C80A, 0
ROOM = ([0, 0, 0], [4, 0, 0], [0, 3, 0])
"""A floor of 4 m × 3 m."""

LINES = [
    f'1,{FLOOR:06X},"floor",0',
    f'2,{BED:06x},"bed",0',
    f'3,{LAMP:06X},"lamp",0',
]


def parts(kind: str) -> list[dict[str, Any]]:
    """The floor, a bed of 2 × 1.4 × 0.5 m, and a lamp on the floor beside it; each way to paint them."""
    pieces = [(FLOOR, [ROOM]), (BED, box([0.5, 1.0, 0], [2.5, 2.4, 0.5])), (LAMP, box([3, 2.6, 0], [3.2, 2.8, 1.5]))]
    if kind == "texture":
        return [{"quads": quads, "picture": [[channels(colour)]]} for colour, quads in pieces]
    quads = [quad for _, own in pieces for quad in own]
    tint = {"linear": linear, "plain": channels}[kind]
    return [{"quads": quads, "tints": [tint(colour) for colour, own in pieces for _ in own]}]


def read(folder: Path) -> Scene:
    (scene_id,) = open_source("hm3d", folder).scene_ids()
    return open_source("hm3d", folder).read(scene_id)


def said(scene: Scene, code: str) -> list[str]:
    return [warning.where for warning in scene.warnings if warning.code == code]


@pytest.mark.parametrize("kind", ["texture", "linear", "plain"])
def test_boxes_are_those_of_the_paint_turned_upright(tmp_path: Path, kind: str) -> None:
    write(tmp_path, LINES, parts(kind))
    scene = read(tmp_path)
    assert scene.scene_id == f"val/{SCAN}"
    bed, lamp = scene.object_of["bed_2"], scene.object_of["lamp_3"]
    assert bed.aabb is not None
    assert lamp.aabb is not None
    np.testing.assert_array_equal(bed.aabb, [[0.5, 0, -2.4], [2.5, 0.5, -1.0]])
    np.testing.assert_array_equal(lamp.aabb, [[3, 0, -2.8], [3.2, 1.5, -2.6]])
    (room,) = scene.rooms
    assert (room.floor_y, room.ceiling_y, room.complete, room.annotation) == (0.0, 1.5, True, "dataset")
    assert shapely.Polygon(room.polygon).equals(shapely.box(0, -3, 4, 0))
    assert not scene.warnings


def test_a_texture_counts_where_the_vertices_have_other_colours(tmp_path: Path) -> None:
    """As in version 0.2, where both are stored; and the other way round with a photograph."""
    both = [{**part, "tints": [channels(WALL)] * len(part["quads"])} for part in parts("texture")]
    write(tmp_path, LINES, both)
    assert {o.object_id for o in read(tmp_path).objects} == {"floor_1", "bed_2", "lamp_3"}
    photograph = [{**part, "picture": [[channels(WALL)]]} for part in parts("linear")]
    write(tmp_path, LINES, photograph)
    assert {o.object_id for o in read(tmp_path).objects} == {"floor_1", "bed_2", "lamp_3"}


def test_stored_vertex_colours_may_be_off_by_rounding_but_not_ambiguous(tmp_path: Path) -> None:
    near = [{**part, "tints": np.add(part["tints"], [1, -1, 2])} for part in parts("plain")]
    write(tmp_path, LINES, near)
    assert read(tmp_path).object_of["bed_2"].aabb is not None
    write(tmp_path, [*LINES, f'4,{BED + 0x020000:06X},"pillow",0'], near)
    assert said(read(tmp_path), "object_without_place") == ["bed_2", "pillow_4"]


def test_a_picture_that_is_painted_inside_of_a_face_has_its_box(tmp_path: Path) -> None:
    """A wall of two triangles, 4 m wide and 2 m high; the picture is on columns 1.5 to 2 m, rows 0.5 to 0.75 m."""
    picture = np.full((200, 400, 3), channels(WALL))
    picture[50:75, 150:200] = channels(PICTURE)
    wall = {"quads": [([0, 0, 0], [4, 0, 0], [0, 0, 2])], "picture": picture}
    write(tmp_path, [*LINES, f'4,{WALL:06X},"wall",0', f'5,{PICTURE:06X},"picture",0'], [*parts("texture"), wall])
    found = read(tmp_path).object_of["picture_5"].aabb
    assert found is not None
    np.testing.assert_allclose(found, [[1.5, 1.25, 0], [2.0, 1.5, 0]], atol=FINE)


def test_the_box_is_that_of_the_largest_piece_and_a_warning_says_so(tmp_path: Path) -> None:
    own = parts("plain")
    stray = {"quads": box([3.5, 0.1, 0], [3.6, 0.2, 0.1]), "tints": [channels(BED)] * 6}
    write(tmp_path, LINES, [*own, stray])
    scene = read(tmp_path)
    np.testing.assert_array_equal(scene.object_of["bed_2"].aabb, [[0.5, 0, -2.4], [2.5, 0.5, -1.0]])
    assert said(scene, "object_in_pieces") == ["bed_2"]
    # Pieces that nearly touch are one.
    write(tmp_path, LINES, [*own, {**stray, "quads": box([2.5 + CELL / 2, 1, 0], [2.6, 1.1, 0.1])}])
    scene = read(tmp_path)
    np.testing.assert_array_equal(scene.object_of["bed_2"].aabb, [[0.5, 0, -2.4], [2.6, 0.5, -1.0]])
    assert not said(scene, "object_in_pieces")


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ('9,c,"radiator",0', "unreadable_colour"),  # as in a list of the release
        (f'9,{WALL:06X},"radiator",0', "object_without_place"),
    ],
)
def test_an_instance_that_can_not_be_found_leaves_its_room_incomplete(tmp_path: Path, line: str, code: str) -> None:
    write(tmp_path, [*LINES, line], parts("plain"))
    scene = read(tmp_path)
    assert said(scene, code) == ["radiator_9"]
    assert "radiator_9" not in scene.object_of
    assert [room.complete for room in scene.rooms] == [False]
    assert len(scene.objects) == 3


def test_a_wall_that_goes_round_a_room_has_no_box_that_fills_it(tmp_path: Path) -> None:
    sides = [([0, 0, 0], [4, 0, 0], [0, 0, 2]), ([0, 0, 0], [0, 3, 0], [0, 0, 2]), ([4, 0, 0], [0, 3, 0], [0, 0, 2])]
    wall = {"quads": sides, "tints": [channels(WALL)] * 3}
    write(tmp_path, [*LINES, f'4,{WALL:06X},"wall",0'], [*parts("plain"), wall])
    scene = read(tmp_path)
    assert scene.object_of["wall_4"].box is None
    assert scene.object_of["bed_2"].box is not None
    (room,) = scene.rooms
    assert shapely.Polygon(room.polygon).equals(shapely.box(0, -3, 4, 0))


def test_instances_of_one_colour_can_not_be_told_apart(tmp_path: Path) -> None:
    write(tmp_path, [*LINES, f'4,{BED:06X},"sofa",0'], parts("plain"))
    scene = read(tmp_path)
    assert said(scene, "shared_colour") == ["bed_2", "sofa_4"]
    assert {o.object_id for o in scene.objects} == {"floor_1", "lamp_3"}
    assert not scene.rooms[0].complete


def test_an_instance_of_no_region_is_placed_by_its_centre(tmp_path: Path) -> None:
    write(tmp_path, [*LINES[:2], f'3,{LAMP:06X},"lamp",-1'], parts("plain"))
    scene = read(tmp_path)
    assert scene.object_of["lamp_3"].room_id == "region_0"
    assert said(scene, "no_parent_room") == ["lamp_3"]
    # Outside of every region it is left out.
    far = {"quads": box([9, 9, 0], [9.2, 9.2, 1]), "tints": [channels(WALL)] * 6}
    write(tmp_path, [*LINES, f'4,{WALL:06X},"box",-1'], [*parts("plain"), far])
    assert said(read(tmp_path), "object_outside_rooms") == ["box_4"]


def test_a_name_may_hold_commas_and_be_empty(tmp_path: Path) -> None:
    write(tmp_path, [LINES[0], f'2,{BED:06X},"bed, made",0', f'3,{LAMP:06X},"",0'], parts("plain"))
    assert {o.raw_label for o in read(tmp_path).objects} == {"floor", "bed, made", "unknown"}


def rooms_of(scene: Scene) -> dict[str, str]:
    return {room.room_id: room.label for room in scene.rooms}


def two_rooms(toilet: str, steps: str) -> tuple[list[str], list[dict[str, Any]]]:
    """A floor with something on it in each of two regions, 2 m apart."""
    shades = [0x101010, 0x303030, 0x505050, 0x707070]
    lines = [
        f'{k},{shade:06X},"{name}",{k // 3}'
        for k, (shade, name) in enumerate(zip(shades, ("floor", toilet, "floor", steps), strict=True), start=1)
    ]
    things = [ROOM], box([1, 1, 0], [1.5, 1.5, 0.6]), [([6, 0, 0], [2, 0, 0], [0, 3, 0])], box([7, 1, 0], [7.5, 2, 0.6])
    return lines, [
        {"quads": quads, "tints": [channels(shade)] * len(quads)} for shade, quads in zip(shades, things, strict=True)
    ]


def test_regions_are_typed_by_proposals_and_else_by_what_they_hold(tmp_path: Path) -> None:
    write(tmp_path, *two_rooms("toilet", "chair"))
    assert rooms_of(read(tmp_path)) == {"region_0": "bathroom", "region_1": "other room"}
    votes(tmp_path, {0: "Tie: Bedroom & Office", 1: "Rec room"})
    assert rooms_of(read(tmp_path)) == {"region_0": "bathroom", "region_1": "recreation room"}
    votes(tmp_path, {0: "Kitchen", 1: "Hall/stairwell"})
    assert rooms_of(read(tmp_path)) == {"region_0": "kitchen", "region_1": "hallway"}
    write(tmp_path, *two_rooms("toilet", "stairs"))
    assert rooms_of(read(tmp_path)) == {"region_0": "kitchen", "region_1": "other room"}
    votes(tmp_path, {0: "Unknown room"})
    assert rooms_of(read(tmp_path)) == {"region_0": "bathroom", "region_1": "other room"}


def test_another_scan_s_proposals_make_nothing_stale(tmp_path: Path) -> None:
    write(tmp_path, *two_rooms("toilet", "chair"))
    votes(tmp_path, {0: "Kitchen"})

    def inputs() -> list[Any]:
        (handle,) = open_source("hm3d", tmp_path).handles()
        return list(handle.inputs)

    before = inputs()
    table = tmp_path / "Per_Scene_Region_Weighted_Votes.csv"
    table.write_text(table.read_text() + "00802-other,0,1,1, Bedroom\n")
    assert inputs() == before
    votes(tmp_path, {0: "Bedroom"})
    assert inputs() != before


def test_furniture_leaves_no_hole_in_a_region_and_its_ceiling_counts(tmp_path: Path) -> None:
    """The floor has a hole where a wardrobe stands at the wall; the ceiling is whole."""
    ring = [([0, 0, 0], [4, 0, 0], [0, 2, 0]), ([0, 2, 0], [1, 0, 0], [0, 1, 0]), ([2, 2, 0], [2, 0, 0], [0, 1, 0])]
    above = [([0, 0, 2.5], [4, 0, 0], [0, 3, 0])]
    lines = [LINES[0], f'2,{WALL:06X},"ceiling",0', f'3,{LAMP:06X},"lamp",0']
    own = [(FLOOR, ring), (WALL, above), (LAMP, box([3, 1, 0], [3.2, 1.2, 1]))]
    write(tmp_path, lines, [{"quads": q, "tints": [channels(c)] * len(q)} for c, q in own])
    (room,) = read(tmp_path).rooms
    assert shapely.Polygon(room.polygon).equals(shapely.box(0, -3, 4, 0))
    assert (room.floor_y, room.ceiling_y) == (0.0, 2.5)


def test_of_a_scan_in_two_folders_that_of_its_split_counts(tmp_path: Path) -> None:
    write(tmp_path, LINES, parts("plain"), split="minival")
    assert open_source("hm3d", tmp_path).scene_ids() == [f"minival/{SCAN}"]
    write(tmp_path, LINES, parts("plain"), split="val")
    assert open_source("hm3d", tmp_path).scene_ids() == [f"val/{SCAN}"]


@pytest.mark.parametrize(
    ("number", "folder"),
    [("00000", "train"), ("00799", "train"), ("00800", "val"), ("00899", "val"), ("00900", "test")],
)
def test_the_folder_of_one_split_gives_the_same_scenes_as_that_of_all(tmp_path: Path, number: str, folder: str) -> None:
    """Also the path at which agents look for the mesh, which once lacked the split."""
    own = write(tmp_path, LINES, parts("plain"), split=folder)
    own.rename(own.parent / f"{number}-{NAME}")
    whole, part = open_source("hm3d", tmp_path), open_source("hm3d", tmp_path / folder)
    assert part.scene_ids() == whole.scene_ids() == [f"{folder}/{number}-{NAME}"]
    (scene_id,) = part.scene_ids()
    assert scene_file("hm3d", scene_id) == f"hm3d/{folder}/{number}-{NAME}/{NAME}.basis.glb"
    found, other = part.read(scene_id), whole.read(scene_id)
    assert repr((found.rooms, found.objects)) == repr((other.rooms, other.objects))
    assert part.geometry(found) is not None


def test_a_scan_whose_number_tells_no_split_keeps_its_folder(tmp_path: Path) -> None:
    own = write(tmp_path, LINES, parts("plain"))
    own.rename(own.parent / f"a-{NAME}")
    assert open_source("hm3d", tmp_path / "val").scene_ids() == [f"a-{NAME}"]


def test_the_painted_mesh_is_the_stage_where_there_is_no_other(tmp_path: Path) -> None:
    own = write(tmp_path, LINES, parts("plain"))
    source = open_source("hm3d", tmp_path)
    scene = source.read(f"val/{SCAN}")
    assert [part.path for part in scene.stage] == [f"val/{SCAN}/{NAME}.semantic.glb"]
    geometry = source.geometry(scene)
    np.testing.assert_allclose(
        [geometry.vertices.min(0), geometry.vertices.max(0)], [[0, 0, -3], [4, 1.5, 0]], atol=1e-6
    )
    shutil.copy(own / f"{NAME}.semantic.glb", own / f"{NAME}.basis.glb")
    assert [part.path for part in read(tmp_path).stage] == [f"val/{SCAN}/{NAME}.basis.glb"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "the first line"),
        (b'1,8A6B4C,"floor",0\n', "the first line"),
        (b"HM3D Semantic Annotations\n1,8A6B4C,floor\n", "3 fields"),
        (b'HM3D Semantic Annotations\nx,8A6B4C,"floor",0\n', "number of the instance"),
        (b'HM3D Semantic Annotations\n1,8A6B4C,"floor",kitchen\n', "number of the instance"),
        (b'HM3D Semantic Annotations\n1,8A6B4C,"floor",0\n1,8A6B4D,"bed",0\n', "two instances have the number 1"),
        (b'HM3D Semantic Annotations\n1,8A6B4C,"fl\xff",0\n', "not text"),
        (b'HM3D Semantic Annotations\n1,8A6B4C,"floor,0\n', "not a list"),
        (b'HM3D Semantic Annotations\n1,000001,"floor",0\n', "no face of the mesh"),
    ],
)
def test_a_broken_list_is_one_error_that_names_the_file(tmp_path: Path, text: bytes, message: str) -> None:
    own = write(tmp_path, LINES, parts("plain"))
    (own / f"{NAME}.semantic.txt").write_bytes(text)
    with pytest.raises(InputError, match=message) as caught:
        open_source("hm3d", tmp_path).read(f"val/{SCAN}")
    assert NAME in str(caught.value.where)


def test_a_scan_without_its_painted_mesh_is_told_when_scenes_are_listed(tmp_path: Path) -> None:
    own = write(tmp_path, LINES, parts("plain"))
    (own / f"{NAME}.semantic.glb").unlink()
    (handle,) = open_source("hm3d", tmp_path).handles()
    assert isinstance(handle.fault, MissingFileError)
    shutil.rmtree(own)
    with pytest.raises(ConfigError, match="no annotated scans"):
        open_source("hm3d", tmp_path)


def test_a_mesh_of_a_face_as_large_as_a_town_is_refused(tmp_path: Path) -> None:
    huge = {"quads": [([0, 0, 0], [900, 0, 0], [0, 900, 0])], "tints": [channels(FLOOR)]}
    write(tmp_path, LINES, [huge])
    with pytest.raises(InputError, match="too large"):
        read(tmp_path)


@pytest.mark.parametrize("table", [b"", b"Scene Name,Region #\n", b"\xff\xfe\x00"])
def test_a_broken_table_of_proposals_is_named(tmp_path: Path, table: bytes) -> None:
    write(tmp_path, LINES, parts("plain"))
    (tmp_path / "Per_Scene_Region_Weighted_Votes.csv").write_bytes(table)
    with pytest.raises(InputError) as caught:
        open_source("hm3d", tmp_path).read(f"val/{SCAN}")
    assert "Weighted_Votes" in str(caught.value.where)
